"""A table of a frequency response, and what is between its lines."""

from dataclasses import dataclass, replace

import control
import numpy as np
from scipy.interpolate import make_interp_spline

from rodlib.ilc import arguments
from rodlib.ilc.loop import ClosedLoop


@dataclass(frozen=True)
class TabulatedResponse:
    """A table of a frequency response, with what is known of its accuracy.

    Made by :func:`rodlib.measured_response`. The lines of a table that brings no radius count as
    exact; between them nothing is.
    """

    omega: np.ndarray  # rad/s, shape (n,)
    response: np.ndarray  # shape (n, m, m), complex
    uncertainty: np.ndarray  # (n,): the radius at each line, whatever the confidence
    loop: ClosedLoop | None  # names and sampling period, if the table says one

    def on(self, omega, confidence: float = 0.95, scale=None) -> tuple[np.ndarray, np.ndarray]:
        """Response and radius on other frequencies, as :meth:`MeasuredResponse.on` gives them.

        The response is a cubic spline over the logarithm of the frequency. The radius is that of
        the neighbours, interpolated, and by how much the spline differs from straight lines; beyond
        the ends of the table it contains all that is not larger than there.
        """
        arguments.number("confidence", confidence, "between 0 and 1", 0, 1)
        omega = np.abs(arguments.row("omega", omega))
        if scale is not None:
            scale = arguments.array("scale", scale, (self.response.shape[1],))
            units = scale / scale[:, None]
            widest = self.uncertainty * units.max()  # the norm of Delta is not more in these units
            own = replace(self, response=self.response * units, uncertainty=widest)
            return own.on(omega, confidence)
        low, high = self.omega[[0, -1]]
        within, knots = np.log(np.clip(omega, low, high)), np.log(self.omega)
        spline, straight = (make_interp_spline(knots, self.response, k)(within) for k in (3, 1))
        radius = np.linalg.norm(spline - straight, 2, axis=(1, 2))
        radius += np.interp(within, knots, self.uncertainty)
        outside = (omega < low * (1 - 1e-9)) | (omega > high * (1 + 1e-9))
        return spline, radius + np.where(outside, 2 * np.linalg.norm(spline, 2, axis=(1, 2)), 0)

    def basis(self, omega, confidence: float = 0.95) -> tuple[str, ...]:
        """What the table holds, and what is assumed beside it."""
        arguments.number("confidence", confidence, "between 0 and 1", 0, 1)
        omega, (low, high) = arguments.row("omega", omega), self.omega[[0, -1]]
        known = "with its radius" if self.uncertainty.any() else "as exact as its lines"
        lines = [
            f"P from a table of {len(self.omega)} frequencies from {low:.4g} to {high:.4g} rad/s, "
            f"{known}",
            "assumed: between them P is not further from their spline than straight lines are",
        ]
        outside = np.mean((omega < low * (1 - 1e-9)) | (omega > high * (1 + 1e-9)))
        if outside:
            lines.append(f"assumed: beyond, at {outside:.0%} of omega, P is not larger than there")
        return tuple(lines)

    def __repr__(self):
        return "\n".join(self.basis(self.omega))


def tabulated(table: control.FrequencyResponseData, uncertainty=None) -> TabulatedResponse:
    """From python-control's frequency response data."""
    omega = arguments.array("log.omega", table.omega, ("frequency",))
    if len(omega) < 4 or omega[0] <= 0 or np.any(np.diff(omega) <= 0):
        raise ValueError(f"log.omega = {omega} must be four positive increasing ones, or more")
    shape = len(omega), "m", "m"
    P = arguments.array("log.frdata", np.moveaxis(table.frdata, -1, 0), shape, complex)
    radius = 0.0 * omega if uncertainty is None else uncertainty
    radius = arguments.array("uncertainty", radius, (len(omega),))
    if radius.min() < 0:
        raise ValueError(f"uncertainty reaches {radius.min():.6g}, but must not be negative")
    timed = table.dt and table.dt is not True
    loop = ClosedLoop(None, table.dt, table.output_labels) if timed else None
    return TabulatedResponse(omega, P, radius, loop)
