"""The error in the first trial of a reference r, and the spectrum of this error.

If v is added to the reference of each output, the first error is e_1 = (I - P) r. Otherwise the
first error is e_1 = (I - P_r) r. Here P_r is the response of the loop to references, which is taken
to be zero if it is not known.

With E(w) = sum_p e_1(p) exp(-j w p), w = omega Ts, Parseval's theorem is

    1/N sum_p e_1(p) e_1(p)' = 1 / (pi N) Re integral_0^pi E(w) E(w)* dw.

Here the samples of a trial have the numbers p = 1 ... N. The integral over the interval around a
frequency is the power of e_1 that belongs to this frequency. Each interval ends halfway to the two
neighbouring frequencies.
"""

import numpy as np
from scipy.fft import irfft, rfft
from scipy.integrate import cumulative_trapezoid, trapezoid

from ilctools.models import frequency_response

FINER = 16  # lines of the summed spectrum, relative to the signal, so that no narrow line is missed
FADING = 10  # length of a trial relative to the time in which e_1 fades out after the end
TRIALS = 10  # number of trials whose error is predicted


def first_error(response, r) -> tuple[np.ndarray, np.ndarray]:
    """Return angles omega Ts from 0 to pi, and the spectrum E of e_1 at these angles, (angle, m).

    The spectrum contains only the error during the trial. After the end of the trial, e_1 is taken
    to fade to zero along a straight line. `r` (time, m) is the reference in the units of the
    response.
    """
    N, length = len(r), FINER * len(r)
    angles = np.linspace(0, np.pi, length // 2 + 1)
    R = rfft(r, length, axis=0)[..., None]
    directions = response.directions
    if response.added:
        P = _nominal(response, angles)[1]
        E = R - (P if directions is None else directions.back.of(P)) @ R
    elif response.of_reference is not None:
        E = R - frequency_response(response.of_reference, angles / response.Ts) @ R
    else:
        E = R
    e = irfft(E[..., 0], length, axis=0)[:N]
    faded = np.pad(e, [(0, N // FADING), (0, 0)], mode="linear_ramp")
    return angles, rfft(faded, length, axis=0)


def _nominal(response, angles):
    """Return frequencies, and the nominal P at these frequencies.

    Outside its samples, P is taken to be constant.
    """
    omega = angles / response.Ts
    if response.models[0] is None:
        omega = omega.clip(*response.omega[[0, -1]])
    return omega, response.anywhere(0, omega)[0]


def error_weights(spectrum, angles) -> np.ndarray:
    """Return weights |E| d omega at angles omega Ts, (n,), which sum to one.

    `spectrum` is the result of :func:`first_error`. A narrow line of the spectrum counts even if it
    lies between two frequencies.
    """
    fine, E = spectrum
    up_to = cumulative_trapezoid(np.sum(np.abs(E) ** 2, axis=1), fine, initial=0)
    edges = np.concatenate([[0], (angles[1:] + angles[:-1]) / 2, [np.pi]])
    weights = np.sqrt(np.diff(np.interp(edges, fine, up_to)).clip(0) * np.diff(edges))
    if not weights.any():
        raise ValueError(
            "reference leaves no error in the first trial, so that nothing can be learned: "
            "pass a reference that is not zero, or a band"
        )
    return weights / weights.sum()


def unreachable_rms(problem) -> np.ndarray:
    """Return the RMS of the part of the first error that no v removes, shape (p,).

    The RMS is in the plant's units. With fewer learned inputs than outputs, this part is (I - P
    P^+) e_1, because v = P^+ e_1 leaves the least error. P^+ is the pseudoinverse of P.
    """
    angles, E = problem.objective.first_error
    left = E - _back(problem.response, reachable(problem.response, (angles, E))[1])
    return problem.scale.y * np.sqrt(_power(left, angles))


def reachable(response, first_error) -> tuple[np.ndarray, np.ndarray]:
    """Return angles omega Ts, and the part P P^+ e_1 of the first error that some v removes.

    If P has directions without gain, the part is given in the other directions, see
    :mod:`ilctools.response.directions`.
    """
    (angles, E), directions = first_error, response.directions
    E = E if directions is None else E @ directions.U
    _, P = _nominal(response, angles)
    if P.shape[2] >= P.shape[1]:
        return angles, E
    return angles, (P @ np.linalg.pinv(P) @ E[..., None])[..., 0]


def _back(response, E):
    """Convert a spectrum in the directions of P, (angle, any), to the outputs, (angle, p)."""
    return E if response.directions is None else E @ response.directions.U.T


def _power(E, angles):
    """Compute the mean square of each output of a signal from its spectrum (angle, p)."""
    samples = 2 * (len(angles) - 1) / FINER
    return trapezoid(np.abs(E) ** 2, angles, axis=0) / (np.pi * samples)


def predicted_rms(problem, L) -> dict[int, float]:
    """Predict the RMS of the error in trials 1 to 10, in the plant's units.

    The prediction starts from the spectrum of the first error and uses the nominal plant. By the
    law (23) of the paper, e_{k+1} = Q (I - P L) e_k + (1 - Q) e_1. Where Q is less than one, a part
    of the first error remains. The prediction contains no noise, and no effects of the ends of a
    trial.
    """
    angles, E = problem.objective.first_error
    omega, P = _nominal(problem.response, angles)
    Q, L = (f.frequency_response(omega) for f in (problem.lowpass, L))
    M = Q[:, None, None] * (np.eye(P.shape[1]) - P @ L)  # of the error, even if m < p
    directions, rms = problem.response.directions, {}
    along = E if directions is None else E @ directions.U
    e, others = along[..., None], E - _back(problem.response, along)  # which no v changes
    stays = (1 - Q)[:, None, None] * e
    for trial in range(1, TRIALS + 1):
        power = _power(_back(problem.response, e[..., 0]) + others, angles)
        rms[trial] = float(np.sqrt(problem.scale.y**2 @ power))
        e = M @ e + stays
    return rms
