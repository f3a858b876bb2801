"""The low-pass filter Q: the Butterworth filter (43) of the paper, or samples of Q."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ilctools import arguments
from ilctools.filters import ZeroPhaseButterworth
from ilctools.problem import defaults
from ilctools.response.samples import Samples

RIPPLE = 1.2  # largest |Q| that passes: the overshoot of a windowless FIR filter, applied twice
IMAGINARY = 1e-6  # relative: largest imaginary part of a real Q that rounding explains


@dataclass(frozen=True, eq=False)
class SampledQ:
    """Q by its samples, with splines between the samples and constant values outside them."""

    omega: np.ndarray  # (n,), rad/s
    samples: np.ndarray  # (n,)

    @property
    def cutoff(self) -> float:
        """The frequency above which the samples stay below one half, rad/s."""
        return defaults.cutoff(self.samples, self.omega)

    def frequency_response(self, omega) -> np.ndarray:
        """Return Q at some frequencies, (k,)."""
        return self._as_response.at(np.maximum(omega, self.omega[0]))[0][:, 0, 0]

    @cached_property
    def _as_response(self):
        return Samples(self.omega, self.samples[:, None, None], 0 * self.samples)


def lowpass_of(Q, omega) -> ZeroPhaseButterworth | SampledQ:
    """Check Q; return a filter unchanged, and samples of Q on omega as a `SampledQ`."""
    known = isinstance(Q, ZeroPhaseButterworth | SampledQ)
    samples = Q.frequency_response(omega) if known else Q
    samples = arguments.array("Q", samples, (len(omega),), complex)
    if (largest := np.abs(samples).max()) > RIPPLE:
        raise ValueError(
            f"Q has a gain of {largest:.4g} at {omega[np.abs(samples).argmax()]:.4g} rad/s: "
            "pass a low-pass filter whose gain is at most one, because v overshoots otherwise"
        )
    if np.abs(samples.imag).max() > IMAGINARY * np.abs(samples).max():
        raise ValueError(
            f"Q shifts the phase by up to {np.abs(np.angle(samples)).max():.2g} rad, as a "
            "filter does that runs in one direction only: pass the |Q|^2 of this filter, or "
            "zero_phase_butterworth(order, cutoff, Ts)"
        )
    return Q if known else SampledQ(omega, samples.real)
