"""A table of a frequency response, and its interpolation between the table's frequencies."""

import reprlib
from dataclasses import dataclass, replace

import control
import numpy as np

from ilctools import arguments, labels
from ilctools.loop.closed import ClosedLoop
from ilctools.response.measured import Measured, radius_of, with_phase


@dataclass(frozen=True, repr=False)
class TabulatedResponse(Measured):
    """A table of a frequency response, with what is known about its accuracy.

    If a table has no radius, its values count as exact. Between the frequencies of the table,
    values are interpolated, and are never exact.
    """

    estimated = False  # the author of the table determines its unit
    omega: np.ndarray  # rad/s, shape (n,)
    response: np.ndarray  # shape (n, p, m), complex
    uncertainty: np.ndarray  # (n,): the radius at each frequency, for any confidence
    loop: ClosedLoop | None  # names and sampling period, if the table states a period

    def _radius(self, confidence, jointly):
        return self.uncertainty

    def _scaled(self, of_P):
        # in these units, the norm of the error is at most this
        widest = self.uncertainty * of_P.max()
        return replace(self, response=self.response * of_P, uncertainty=widest)

    def _basis(self, omega, confidence):
        low, high = self.omega[[0, -1]]
        known = "with its radius" if self.uncertainty.any() else "taken as exact there"
        return (
            f"P from a table of {len(self.omega)} frequencies from {low:.4g} to {high:.4g} rad/s, "
            f"{known}",
            *self._between(omega, confidence),
        )


def tabulated(table: control.FrequencyResponseData, uncertainty=None) -> TabulatedResponse:
    """Make a tabulated response from python-control's frequency response data."""
    omega = arguments.array("log.omega", table.omega, ("frequency",))
    if len(omega) < 4 or omega[0] <= 0 or np.any(np.diff(omega) <= 0):
        raise ValueError(
            f"log.omega = {reprlib.repr(omega.tolist())} must be four or more positive "
            "frequencies in increasing order"
        )
    shape = len(omega), "p", "m"
    P = arguments.array("log.frdata", np.moveaxis(table.frdata, -1, 0), shape, complex)
    with_phase("log", P)
    uncertainty, _ = labels.on("uncertainty", uncertainty, omega)
    radius = radius_of(0.0 if uncertainty is None else uncertainty, P)
    timed = table.dt and table.dt is not True
    names = {"outputs": table.output_labels}
    if table.ninputs != table.noutputs:  # otherwise v is added to the references
        names |= {"references": {}, "learned": table.input_labels}
    loop = ClosedLoop(None, table.dt, **names) if timed else None
    return TabulatedResponse(omega, P, radius, loop)
