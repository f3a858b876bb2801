"""Several plants stacked into one model, in which common states are kept once.

The base B = (P* P + b^2)^-1 P* E of :mod:`.base` needs this stacked model P, and the matrix E. The
p plants P_k, each divided by sqrt(p), have the same inputs. Copies of one plant that differ in gain
alone have all states in common. Similar plants have most states in common. With the factors of the
two Gramians of the stacked model,

    X X^T = sum over k of A^k B B^T A^kT,    Y Y^T = sum over k of A^kT C^T C A^k,

and Y^T X = U S V^T,

the states S^(-1/2) U^T Y^T x are balanced. If the states of the least singular values in S are left
out, the response differs by at most twice the sum of these values. The sources are K. Glover,
International Journal of Control 39 (1984) 1115-1193, and in discrete time U. M. Al-Saggaf and
G. F. Franklin, IEEE Transactions on Automatic Control 32 (1987) 815-819. The factors are found by
doubling, X <- [X, A^(2^j) X], and are never squared. Small singular values thus keep their digits.

The stacked P may be multiplied from the left by a matrix with orthonormal rows, if the row space of
this matrix contains the columns of [C, D]. The multiplication does not change P* P and P* E, which
are all that B needs. P therefore keeps as many outputs as [C, D] has columns.

If P has an error of d, then to first order B differs by at most 5 d / (4 b^2). The iteration matrix
M = Q (I - P L) differs by at most this value times sigma_max(P). d is chosen for a small change of
M. Afterwards P* P of the stacked model is compared with the mean of P_k* P_k over the plants.
"""

from typing import NamedTuple

import control
import numpy as np
from scipy.linalg import qr

from ilctools.models import balanced, frequency_response
from ilctools.singular_values import largest_singular_values

GROUP = 8  # models joined at a time: for 200 models, 2 take 1.6 times as long, and 32 twice as long
CHANGES = 1e-9, 1e-5  # change of M up to which states are left out. The second is used if too
# many states remain, because a finite filter in place of B would change M by 1e-4.
# Largest number of doublings of the terms of a Gramian. The response of a pole within 1e-14 of the
# unit circle lasts so long.
DOUBLINGS = 50
ROUNDING_OF_GRAMIAN = 1e-17  # relative to a Gramian's factor: smaller terms are not added
LEVELS_OF_GROUPS = 3  # levels of groups of GROUP, up to 512 models; each level adds its error
COMPARED_FREQUENCIES = 128  # number of frequencies, besides those of poles, to compare P* P at


class Pooled(NamedTuple):
    """The stacked model P and the matrix E of the base B = (P* P + b^2)^-1 P* E."""

    P: control.StateSpace
    E: np.ndarray  # (outputs of P, outputs of each plant)


def isometry(copies, size) -> np.ndarray:
    """Make E, a stack of `copies` identity matrices, divided by the square root of `copies`."""
    return np.tile(np.eye(size), (copies, 1)) / np.sqrt(copies)


def pooled(models, b, change) -> Pooled:
    """Make P and E from several models, with as few states as possible.

    States are left out as long as M changes by at most `change`. At many frequencies, P* P is
    then compared with the mean of P_k* P_k over the models P_k. If the difference is larger than
    expected, all states are kept.
    """
    count, (p, m) = len(models), models[0].shape
    if count == 1:
        return Pooled(models[0], np.eye(p))
    poles = np.concatenate([model.poles() for model in models])
    grid = np.linspace(0, np.pi, COMPARED_FREQUENCIES)
    omega = np.append(grid, np.abs(np.angle(poles))) / models[0].dt
    P = np.array([frequency_response(model, omega) for model in models])
    size = np.linalg.norm(P, 2, axis=(2, 3)).max()
    error = change * b**2 / (1.25 * size)
    few = _with_few_states(models, error)
    differs = _square(frequency_response(few.P, omega)) - _square(P).mean(axis=0)
    if largest_singular_values(differs).max() <= 2 * LEVELS_OF_GROUPS * error * size:
        return few
    return Pooled(control.append(*models) * isometry(count, m), isometry(count, p))


def _with_few_states(models, error) -> Pooled:
    """Join models in groups, and the results in groups again, until one model is left.

    The error of P is at most `error` for each level of groups.
    """
    share = 1 / np.sqrt(len(models))
    groups = [Pooled(model * share, np.eye(model.noutputs) * share) for model in models]
    while len(groups) > 1:
        parts = [groups[k : k + GROUP] for k in range(0, len(groups), GROUP)]
        # errors of outputs that stand one below the other add by their squares
        groups = [_joined(part, error / np.sqrt(len(parts))) for part in parts]
    return groups[0]


def _square(P):
    """Compute P* P."""
    return P.conj().swapaxes(-2, -1) @ P


def _joined(group, error) -> Pooled:
    """Join pooled plants, and reduce the states and outputs of the result.

    The error of P is at most `error`.
    """
    P = control.append(*(part.P for part in group))
    P *= np.tile(np.eye(group[0].P.ninputs), (len(group), 1))
    A, B, C = _truncated(*balanced(P), error)
    rows, upper = qr(np.hstack([C, P.D]), mode="economic")
    C, D = np.hsplit(upper, [len(A)])
    E = rows.T @ np.concatenate([part.E for part in group])
    return Pooled(control.ss(A, B, C, D, P.dt, remove_useless_states=False), E)


def _truncated(A, B, C, error):
    """Balance a model, and leave out states.

    The error of the frequency response is at most `error`.
    """
    X, Y = _gramian_factor(A, B), _gramian_factor(A.T, C.T)
    U, S, Vh = np.linalg.svd(Y.T @ X)
    lost = 2 * np.cumsum(S[::-1])[::-1]  # without this state and all smaller ones
    kept = int(np.sum(lost > error))
    root = np.sqrt(S[:kept])
    to, back = (Y @ U[:, :kept] / root).T, X @ Vh[:kept].T / root
    return to @ A @ back, to @ B, C @ back


def _gramian_factor(A, B):
    """Compute X with X X^T = sum over k of A^k B B^T A^kT, by doubling the number of terms."""
    X, power = B, A
    for _ in range(DOUBLINGS):
        further = power @ X
        if np.linalg.norm(further) <= ROUNDING_OF_GRAMIAN * np.linalg.norm(X):
            break
        X = np.hstack([X, further])
        if X.shape[1] > len(A):
            X = np.linalg.qr(X.T, mode="r").T
        power = power @ power
    return X
