"""What a filter leaves of one reference, trial by trial: a prediction, by the nominal plant."""

import numpy as np

from ilctools.filters import LearningFilter
from ilctools.problem.problem import Problem

TRIALS = (1, 2, 3, 5, 10)


def predicted_rms(problem: Problem, L: LearningFilter) -> dict[int, float]:
    """RMS of the error in some TRIALS, in the plant's units, from the first error's spectrum.

    By the law (23) e_{k+1} = M e_k + (1 - Q) e_1: where Q is less than one, a part of the first
    error stays. Without noise, and for trials without ends.
    """
    M = problem.M(L.frequency_response(problem.omega))
    T = one = np.eye(problem.channels)  # e_k = T e_1
    rms = {}
    for trial in range(1, TRIALS[-1] + 1):
        variances = (T @ problem.objective.first_error * T.conj()).sum(axis=(0, 2)).real
        rms[trial] = float(np.sqrt(problem.scale**2 @ variances))
        T = M @ T + (1 - problem.Q)[:, None, None] * one
    return {trial: rms[trial] for trial in TRIALS}
