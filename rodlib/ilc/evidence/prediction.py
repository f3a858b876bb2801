"""What a filter leaves of one reference, trial by trial: a prediction, by the nominal plant."""

import numpy as np

from rodlib.ilc.filters import LearningFilter
from rodlib.ilc.problem.problem import Problem

TRIALS = (1, 2, 3, 5, 10)


def predicted_rms(problem: Problem, L: LearningFilter) -> dict[int, float]:
    """RMS of the error in some TRIALS, in the plant's units, from the first error's spectrum.

    By the law (23) e_{k+1} = M e_k + (1 - Q) e_1: where Q is less than one, a part of the first
    error stays. Without noise, and for trials without ends.
    """
    design = problem.design
    M = design.M(L.frequency_response(design.omega_L))
    T = one = np.broadcast_to(np.eye(design.channels), M.shape)
    rms = {}
    for trial in range(1, TRIALS[-1] + 1):
        if trial in TRIALS:
            left = T @ design.first_error @ T.conj().swapaxes(1, 2)
            variances = np.einsum("nii->i", left).real
            rms[trial] = float(np.sqrt(problem.scale**2 @ variances))
        T = M @ T + (1 - design.Q)[:, None, None] * one
    return rms
