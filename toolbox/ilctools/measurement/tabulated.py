"""A table of a frequency response, and what is between its lines."""

import reprlib
from dataclasses import dataclass, replace

import control
import numpy as np

from ilctools import arguments
from ilctools.loop.closed import ClosedLoop
from ilctools.response.measured import Measured, interpolated, radius_of, with_phase


@dataclass(frozen=True, repr=False)
class TabulatedResponse(Measured):
    """A table of a frequency response, with what is known of its accuracy.

    The lines of a table that brings no radius count as exact; between them nothing is.
    """

    omega: np.ndarray  # rad/s, shape (n,)
    response: np.ndarray  # shape (n, m, m), complex
    uncertainty: np.ndarray  # (n,): the radius at each line, whatever the confidence
    loop: ClosedLoop | None  # names and sampling period, if the table says one

    def _radius(self, confidence, jointly):
        return self.uncertainty

    def _on(self, omega, confidence):
        """Splined over the logarithm of the frequency.

        The radius is that of the neighbours, interpolated, and by how much the spline differs from
        straight lines; beyond the ends of the table it contains all that is not larger than there.
        """
        low, high = self.omega[[0, -1]]
        within, knots = np.log(np.clip(omega, low, high)), np.log(self.omega)
        spline, radius = interpolated(knots, self.response, within)
        radius += np.interp(within, knots, self.uncertainty)
        beyond = 2 * np.linalg.norm(spline, 2, axis=(1, 2))
        return spline, radius + np.where(self._outside(omega), beyond, 0)

    def _outside(self, omega):
        low, high = self.omega[[0, -1]]
        return (omega < low * (1 - 1e-9)) | (omega > high * (1 + 1e-9))

    def _scaled(self, scale):
        units = scale / scale[:, None]
        # the norm of Delta is not more in these units
        widest = self.uncertainty * units.max()
        return replace(self, response=self.response * units, uncertainty=widest)

    def _basis(self, omega, confidence):
        low, high = self.omega[[0, -1]]
        known = "with its radius" if self.uncertainty.any() else "as exact as its lines"
        lines = [
            f"P from a table of {len(self.omega)} frequencies from {low:.4g} to {high:.4g} rad/s, "
            f"{known}",
            "assumed: between them P is not further from their spline than straight lines are",
        ]
        if outside := np.mean(self._outside(omega)):
            lines.append(f"assumed: beyond, at {outside:.0%} of omega, P is not larger than there")
        return lines


def tabulated(table: control.FrequencyResponseData, uncertainty=None) -> TabulatedResponse:
    """From python-control's frequency response data."""
    omega = arguments.array("log.omega", table.omega, ("frequency",))
    if len(omega) < 4 or omega[0] <= 0 or np.any(np.diff(omega) <= 0):
        raise ValueError(
            f"log.omega = {reprlib.repr(omega.tolist())} must be four positive increasing "
            "frequencies, or more"
        )
    arguments.square("log", table.ninputs, table.noutputs)
    shape = len(omega), "m", "m"
    P = arguments.array("log.frdata", np.moveaxis(table.frdata, -1, 0), shape, complex)
    with_phase("log", P)
    radius = radius_of(0.0 if uncertainty is None else uncertainty, P)
    timed = table.dt and table.dt is not True
    loop = ClosedLoop(None, table.dt, table.output_labels) if timed else None
    return TabulatedResponse(omega, P, radius, loop)
