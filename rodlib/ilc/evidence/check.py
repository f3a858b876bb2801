"""What a filter does on another plant than that of its design: the rate, and does it converge?"""

from dataclasses import dataclass

import numpy as np

from rodlib.ilc.evidence.peak import estimated_peaks, highest, peak_beyond, proven_peaks
from rodlib.ilc.evidence.robustness import worst_case
from rodlib.ilc.filters import LearningFilter
from rodlib.ilc.problem.problem import Problem, tied


@dataclass(frozen=True)
class Check:
    """What a learning filter does on a plant. Made by :meth:`rodlib.Synthesis.check`."""

    gamma: (
        float  # largest sigma_max(M), of all plants within the radius: Lemma 1's rate
    )
    omega: float  # where it is, rad/s
    spectral_radius: float  # largest |eigenvalue of M| on the grid, Delta = 0
    proven: bool  # whether gamma holds at all frequencies, not on the grid and by splines only
    doubt: bool  # whether a radius, or what is assumed above the last sample, admits divergence
    basis: tuple[str, ...]  # what P and its radius rest on

    @property
    def monotone(self) -> bool:
        """Whether every trial brings the error nearer to its limit (Lemma 1)."""
        return self.gamma < 1

    @property
    def converges(self) -> bool:
        """Whether it is known that the trials converge, if not each of them comes nearer."""
        return self.monotone or (not self.doubt and self.spectral_radius < 1)

    def __repr__(self):
        how = "diverges" if self.spectral_radius >= 1 else "need not converge"
        if self.converges:
            how = (
                "converges monotonically"
                if self.monotone
                else "converges, not monotonically"
            )
        known = (
            "at all frequencies"
            if self.proven
            else "on the grid, and between by splines"
        )
        rate = (
            f"{how}: sigma_max(M) is {self.gamma:.4f} at most, at {self.omega:.4g} rad/s "
            f"({known}), |eigenvalue of M| {self.spectral_radius:.4f}"
        )
        return "\n".join([rate, *self.basis])


def check(problem: Problem, L: LearningFilter) -> Check:
    """What a filter, in units of `scale`, does on the plants of a problem."""
    worst = worst_case(problem, L)
    response = L.frequency_response(problem.omega)
    each = [problem.M(response, k) for k in range(len(problem.plants))]
    radius = np.abs(np.linalg.eigvals(each)).max()
    estimated = highest(estimated_peaks(problem, L, worst.peaks))
    beyond = peak_beyond(problem, L)
    gamma, omega = worst.sigma.max(), problem.omega[tied(worst.sigma).argmax()]
    for peak in (highest(proven_peaks(problem, L)), estimated, beyond):
        if peak is not None and peak.sigma > gamma * (1 + 1e-8):
            gamma, omega = peak.sigma, peak.omega
    within = problem.radius is not None
    doubt = within or (beyond is not None and beyond.sigma >= 1)
    basis = (*problem.basis, *problem.assumed)
    proven = estimated is None and not within
    return Check(float(gamma), float(omega), float(radius), proven, doubt, basis)
