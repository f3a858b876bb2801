"""What a filter does on another plant than that of its design: does it converge, and how fast?"""

from dataclasses import replace

from ilctools.evidence.convergence import Convergence, as_systems, from_responses
from ilctools.evidence.peak import estimated_peaks, peak_beyond, proven_peaks
from ilctools.evidence.robustness import worst_case
from ilctools.filters import LearningFilter
from ilctools.problem.problem import Problem, tied


def check(problem: Problem, L: LearningFilter) -> Convergence:
    """How the trials converge with a filter, in units of `scale`, on the plants of a problem."""
    worst = worst_case(problem, L)
    gamma, at = worst.sigma.max(), problem.omega[tied(worst.sigma).argmax()]
    estimated = estimated_peaks(problem, L, worst.peaks)
    beyond = peak_beyond(problem, L)
    for peak in (*proven_peaks(problem, L), *estimated, beyond):
        if peak and peak.sigma > gamma * (1 + 1e-8):
            gamma, at = peak.sigma, peak.omega
    response = L.frequency_response(problem.omega)
    on_grid = from_responses(problem.omega, problem.plants, problem.Q, response)
    return replace(
        on_grid,
        sigma=worst.sigma,
        gamma=float(gamma),
        at=float(at),
        spectral_radius=float(on_grid.spectral_radius.max()),
        proven=not estimated and problem.radius is None,
        uncertain=problem.radius is not None or bool(beyond and beyond.sigma >= 1),
        assumptions=(*problem.basis, *problem.assumed),
        systems=as_systems(problem.models, problem.butterworth, L),
    )
