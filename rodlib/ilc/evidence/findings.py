"""Why a problem may be badly chosen, and where a plant is not known well enough to learn."""

from collections.abc import Iterator

import numpy as np

from rodlib.ilc.models import impulse_response
from rodlib.ilc.problem.problem import TIED, Problem

SLOW = 0.05  # gain of the loop, within the band, below which it counts as slow: a share of its best
IDLE = 0.9  # share of the error in the band from which on learning counts as idle


def findings(problem: Problem, value: float) -> Iterator[str]:
    """Why little may be learned: a delay, a slow loop, or something unknown."""
    yield from problem.findings
    delay = _delay(problem.model[0], problem.order) if problem.model else 0
    if delay > problem.order:
        yield (
            f"P answers after {delay} samples or more, and the filter looks ahead by only "
            f"{problem.order}: it never sees what it does; take a longer filter"
        )
    if problem.objective == "peak":
        return
    passed = np.linalg.svd(problem.P[problem.in_band], compute_uv=False)[:, -1]
    weakest = (passed <= passed.min() * (1 + TIED)).argmax()
    if passed[weakest] < SLOW * passed.max():  # whatever the units are
        yield (
            f"at {problem.omega[problem.in_band][weakest]:.4g} rad/s, within the band, the loop "
            f"passes only {passed[weakest]:.2g} of w in some direction, and learning must make up "
            "for it; take a faster loop or a lower band"
        )
    if value > IDLE * problem.idle:
        yield f"the filter leaves {value / problem.idle:.0%} of the error in the band"


def _delay(P, order):
    """Samples after which P first answers to any input, counted up to one more than the order."""
    answers = np.abs(impulse_response(P, order + 2)).max(axis=(1, 2))
    size = np.abs(P.C).max() * np.abs(P.B).max() + np.abs(P.D).max(initial=0)
    return int(np.argmax(np.append(answers > 1e-12 * size, True)))


def useless(problem: Problem) -> Iterator[str]:
    """Where P is not known well enough for any learning."""
    lost = problem.omega[problem.unusable]
    if lost.size:
        yield (
            f"nothing can be learned at {lost.size} frequencies from {lost[0]:.4g} to "
            f"{lost[-1]:.4g} rad/s: the radius admits singular plants there, and M is |Q| or more, "
            f"{np.abs(problem.Q[problem.unusable]).max():.4g} at most"
        )
