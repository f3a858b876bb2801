"""A response that is known at some frequencies, as of a table, and what is between them."""

from dataclasses import dataclass, replace

import control
import numpy as np
from scipy.interpolate import make_interp_spline

from rodlib.ilc import arguments
from rodlib.ilc.loop import ClosedLoop, Loop


class SplinedResponse:
    """The frequency response from w to y at some frequencies, each with a radius.

    What is one has `omega` (rad/s, shape (n,)), `response` (shape (n, m, m), complex), `anchored`,
    `radius` and `in_units_of`.
    """

    def on(self, omega, confidence: float = 0.95, scale=None) -> tuple[np.ndarray, np.ndarray]:
        """Response and radius on other frequencies, for the synthesis.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Frequencies, rad/s.
        confidence : float
            Probability that the truth lies within the radius at all measured frequencies.
        scale : array_like, shape (m,), optional
            Units of the channels, of both response and radius; see :func:`rodlib.ilc.synthesise`.

        Returns
        -------
        response : ndarray, shape (n, m, m), complex
            A cubic spline through what was measured, at negative frequencies as well, and I at
            frequency zero, if that is known of the loop.
        radius : ndarray, shape (n,)
            That of the neighbours, interpolated linearly, and by how much the spline differs from
            straight lines. Above the highest frequency the response is the one there, and the
            radius contains all that is not larger. :meth:`basis` says what is assumed by that.
        """
        omega = np.abs(arguments.row("omega", omega))
        if scale is not None:
            scale = arguments.array("scale", scale, (self.response.shape[1],))
            return self.in_units_of(scale).on(omega, confidence)
        radius, knots, P = self.radius(confidence, jointly=True), self.omega, self.response
        both, P_both = np.append(-knots[::-1], knots), np.append(P[::-1].conj(), P, axis=0)
        if self.anchored:
            radius, knots = np.append(0.0, radius), np.append(0.0, knots)
            both = np.insert(both, len(P), 0.0)
            P_both = np.insert(P_both, len(P), self.loop.static_gain, axis=0)
        spline, straight = (
            make_interp_spline(both, P_both, k)(np.minimum(omega, knots[-1])) for k in (3, 1)
        )
        bend = np.linalg.norm(spline - straight, 2, axis=(1, 2))
        beyond = omega > knots[-1] * (1 + 1e-9)
        anything = 2 * np.linalg.norm(P[-1], 2) + radius[-1]
        return spline, np.where(beyond, anything, np.interp(omega, knots, radius) + bend)


@dataclass(frozen=True)
class TabulatedResponse(SplinedResponse):
    """A table of a frequency response, with what is known of its accuracy.

    Made by :func:`rodlib.measured_response`. The lines of a table that brings no radius count as
    exact; between them nothing is.
    """

    omega: np.ndarray  # rad/s, shape (n,)
    response: np.ndarray  # shape (n, m, m), complex
    uncertainty: np.ndarray  # (n,): the radius at each line, whatever the confidence
    loop: Loop | None  # names and sampling period, if the table says one

    anchored = False  # nothing is known at zero

    @classmethod
    def of(cls, table: control.FrequencyResponseData, uncertainty=None) -> "TabulatedResponse":
        """From python-control's frequency response data."""
        omega = arguments.array("log.omega", table.omega, ("frequency",))
        if len(omega) < 4 or omega[0] < 0 or np.any(np.diff(omega) <= 0):
            raise ValueError(f"log.omega = {omega} must be four increasing frequencies or more")
        shape = len(omega), "m", "m"
        P = arguments.array("log.frdata", np.moveaxis(table.frdata, -1, 0), shape, complex)
        radius = 0.0 * omega if uncertainty is None else uncertainty
        radius = arguments.array("uncertainty", radius, (len(omega),))
        if radius.min() < 0:
            raise ValueError(f"uncertainty reaches {radius.min():.6g}, but must not be negative")
        timed = table.dt and table.dt is not True
        loop = ClosedLoop(None, table.dt, table.output_labels) if timed else None
        return cls(omega, P, radius, loop)

    def radius(self, confidence: float = 0.95, jointly: bool = False) -> np.ndarray:
        """That of the table, at each line."""
        arguments.number("confidence", confidence, "between 0 and 1", 0, 1)
        arguments.flag("jointly", jointly)
        return self.uncertainty

    def in_units_of(self, scale) -> "TabulatedResponse":
        """The same with its channels divided by scale."""
        # The norm of Delta with its channels divided by scale is not more than this
        units = scale / scale[:, None]
        widest = self.uncertainty * units.max()
        return replace(self, response=self.response * units, uncertainty=widest)

    def basis(self, omega, confidence: float = 0.95) -> tuple[str, ...]:
        """What the table holds, and what is assumed beside it."""
        low, high = self.omega[[0, -1]]
        beyond = np.count_nonzero(arguments.row("omega", omega) > high * (1 + 1e-9))
        lines = [
            f"P from a table of {len(self.omega)} frequencies from {low:.4g} to {high:.4g} rad/s, "
            + (
                "with its radius" if self.uncertainty.any() else "which says no radius: as if exact"
            ),
            "assumed: between them P is not further from their spline than straight lines are",
        ]
        if beyond:
            lines.append(beyond_of(high, beyond))
        return tuple(lines)

    def __repr__(self):
        return "\n".join(self.basis(self.omega))


def beyond_of(high, count):
    """What is assumed above the highest frequency, in words."""
    return (
        f"assumed: above {high:.4g} rad/s, at {count} of the design frequencies, P is not larger "
        "than there"
    )
