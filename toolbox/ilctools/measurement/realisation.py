"""The lowest order with which a model follows a frequency response.

    G(z) = (C (z I - A)^-1 B + D) diag(z^-delay)

A and C are those of the balanced realisation of the impulse response g without its delays, by the
singular values of its Hankel matrix (B. L. Ho and R. E. Kalman, Regelungstechnik 14 (1966) 545-548;
S. Kung, 12th Asilomar Conference (1978) 705-714); a lower order has their first rows and columns.
In B and D the response is linear: least squares, each frequency by its radius; D is zero if
g(0) is.
"""

import control
import numpy as np

from ilctools.models import shift_register
from ilctools.singular_values import largest_singular_values

MOST = 60  # states beside the delays
ROWS = 300  # of a Hankel matrix, in samples
EARLY = 0.01  # of the largest of an impulse response: what is less, at its beginning, is a delay


def model_within(
    radius: np.ndarray, P: np.ndarray, angles: np.ndarray, g: np.ndarray, stable: bool
) -> control.StateSpace | None:
    """A model within `radius` (n,) of P (n, p, m) at omega Ts; of impulse response (p, m, time)."""
    loud = np.abs(g) > EARLY * np.abs(g).max(axis=2, keepdims=True)
    late = np.maximum(np.argmax(loud, axis=2).min(axis=0) - 1, 0)  # one is that of the states
    for delay in (late, 0 * late):
        ahead = np.stack([np.roll(g[:, j], -d, 1) for j, d in enumerate(delay)], axis=1)
        A, C = _balanced(ahead)
        waves = np.exp(-1j * np.outer(angles, delay))[:, None]
        for order in range(min(MOST, len(A)) + 1):
            A_r, C_r = A[:order, :order], C[:, :order]
            if stable and order and np.abs(np.linalg.eigvals(A_r)).max() >= 1:
                continue
            B, D, response = _fitted(A_r, C_r, P / waves, angles, radius, ahead[..., 0].any())
            if np.all(largest_singular_values(response * waves - P) <= radius):
                return _delayed(A_r, B, C_r, D, delay)
    return None


def _balanced(g):
    """A and C of the highest order."""
    rows = min(ROWS, (g.shape[2] - 2) // 2)
    most = min(MOST, rows * min(g.shape[:2]))
    with np.errstate(divide="ignore", invalid="ignore"):  # states that g does not need
        model, S = control.eigensys_realization(g, most, rows, rows)
    n = min(most, np.count_nonzero(S / S[0] > 1e-12))
    return model.A[:n, :n], model.C[:, :n]


def _fitted(A, C, P, angles, radius, direct):
    """B and D by least squares, and the response."""
    n, p, _ = P.shape
    resolvent = np.exp(1j * angles)[:, None, None] * np.eye(len(A)) - A
    states = np.linalg.solve(resolvent.swapaxes(1, 2), np.broadcast_to(C.T, (n, *C.T.shape)))
    eye = np.broadcast_to(direct * np.eye(p), (n, p, p))
    X = np.concatenate([states.swapaxes(1, 2), eye], axis=2)
    left, right = ((x / radius[:, None, None]).reshape(n * p, -1) for x in (X, P))
    left, right = (np.concatenate([x.real, x.imag]) for x in (left, right))
    unit = np.linalg.norm(left, axis=0)
    unit[unit == 0] = 1.0
    BD = np.linalg.lstsq(left / unit, right, rcond=None)[0] / unit[:, None]
    return BD[: len(A)], BD[len(A) :], X @ BD


def _delayed(A, B, C, D, delay):
    """The model behind a shift register for each input; it says its order and delay."""
    name = f"P of order {len(A)} behind {', '.join(map(str, delay))} samples"
    core = control.ss(A, B, C, D, True)
    if delay.any():
        core = core * control.append(*(shift_register([d], True) for d in delay))
    return control.ss(core, name=name)
