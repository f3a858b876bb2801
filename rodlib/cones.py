"""The synthesis problem in the form in which the two solvers take it.

Given P_i (m x m) and Q_i (scalar) at the frequencies omega_i, find the real coefficients C_k of
L(z) = sum_k C_k z^k that minimise the sum over a band, or the largest, of sigma_max(M_i), where
M_i = Q_i (I - P_i L_i), subject to sigma_max(M_i) <= M_max and sigma_max(W L_i) <= 1 at all
frequencies, where W is I / L_max. G_i = F_i + T_i L_i stands for M_i, for W L_i or, if L is
diagonal, for an entry of it.
Two choices keep the numbers tame and the operations few:

- The powers z, z^2, ... are replaced by a basis that is orthonormal with the weight that M and L
  give each frequency. It is computed in long doubles, see :func:`rodlib.filters.time_shifts`.
- Arrays have the frequency last, so that an operation on all the small matrices is a few
  operations on long vectors: for m = 2 several times faster than a call of LAPACK for each.
"""

from dataclasses import dataclass, replace

import numpy as np

from rodlib.certificate import weight_of_L
from rodlib.filters import time_shifts

GENEROUS = 3.0  # bound on what is minimised, in its unit: never active


class Infeasible(RuntimeError):
    """No filter of this order and structure meets the bounds; see `smallest_M_max`."""

    def __init__(self, M_max, smallest_M_max):
        super().__init__(f"M_max = {M_max:.10g} is too small, {smallest_M_max:.10g} is possible")
        self.smallest_M_max = smallest_M_max


@dataclass(frozen=True)
class Solution:
    """A learning filter, and the multipliers from which its optimality can be proven.

    Attributes
    ----------
    coefficients : ndarray, shape (m, m, order)
        L(z) = sum_k coefficients[:, :, k - 1] z^k.
    U, V : ndarray, shape (n, m, m), complex
        Multipliers of M and of L.
    peak : float
        Largest sigma_max of the first cone: of M_i, or of W L_i for the least gain.
    method : str
        That found it.
    iterations : int
    """

    coefficients: np.ndarray
    U: np.ndarray
    V: np.ndarray
    peak: float
    method: str
    iterations: int


@dataclass(frozen=True)
class Cone:
    """sigma_max(F + T L) <= b at each frequency, for a q x q part L of the filter.

    The entries `entries` of the filter stand at `rows`, `cols` of L; the others are zero.
    """

    F: np.ndarray
    T: np.ndarray
    entries: np.ndarray
    rows: np.ndarray
    cols: np.ndarray

    def response(self, L):
        """T L, given all entries of the filter, shape (entries, n)."""
        D = np.zeros(self.T.shape, dtype=complex)
        D[self.rows, self.cols] = L[self.entries]
        return product(self.T, D)

    def gradient(self, W):
        """The g with Re tr(W T L) = Re sum g L."""
        return product(W, self.T)[self.cols, self.rows]


@dataclass(frozen=True)
class Problem:
    """What to minimise, and within which bounds.

    Attributes
    ----------
    cones : tuple of Cone
        M, then W L, or each of its entries if L is diagonal; W L, then M for the least gain.
    basis, R : ndarray, shape (order, n) and (order, order)
        L = x basis at the frequencies, for x of shape (entries, order); the coefficients are
        the rows of x R^-T.
    entries : int
        How many entries of L are not zero.
    free : ndarray
        Frequencies at which sigma_max of the first cone has a variable t for a bound.
    shared : bool
        Whether it is the same for all of them: their largest is minimised, not their sum.
    bounds : ndarray, shape (2,)
        On sigma_max of the first cone, and on t; of the others.
    M_max : float
        What the largest of the first cone must not exceed.
    """

    cones: tuple
    basis: np.ndarray
    R: np.ndarray
    entries: int
    free: np.ndarray
    shared: bool
    bounds: np.ndarray
    M_max: float

    @property
    def idle(self):
        """The objective without learning."""
        size = np.abs(self.cones[0].F[0, 0, self.free])
        return size.max() if self.shared else size.sum()

    def peak(self):
        """The problem of the smallest possible bound on M."""
        size = np.abs(self.cones[0].F[0, 0])
        bounds = np.array([3 * size.max(), self.bounds[1]])
        return replace(self, free=np.arange(len(size)), shared=True, bounds=bounds)

    def levels(self, t, bounds):
        """The bound on each cone, given t and the bounds on M and L."""
        b = [np.full(self.basis.shape[1], bounds[min(j, 1)]) for j in range(len(self.cones))]
        b[0][self.free] = t
        return b

    def matrices(self, x):
        """G of each cone, from the unknowns x, shape (entries, order)."""
        L = x @ self.basis
        return [cone.F + cone.response(L) for cone in self.cones]

    def unknowns(self, coefficients):
        """The x of given coefficients, shape (m, m, order)."""
        cone = self.cones[0]
        return (coefficients[cone.rows, cone.cols] @ self.R.T).astype(float)

    def solution(self, x, multipliers, method, iterations):
        """Solution from the unknowns and the multipliers of G, shape (q, q, n) for each cone."""
        cone, m = self.cones[0], len(self.cones[0].T)
        C = np.zeros((m, m, x.shape[1]))
        c = x.astype(self.R.dtype)  # back substitution, in the precision of R
        for k in reversed(range(len(self.R))):
            c[:, k] = (c[:, k] - c[:, k + 1 :] @ self.R[k, k + 1 :]) / self.R[k, k]
        C[cone.rows, cone.cols] = c
        U, *V = (
            product(cone.T if j else np.eye(m)[..., None], N).transpose(2, 0, 1)
            for j, (cone, N) in enumerate(zip(self.cones, multipliers, strict=True))
        )
        V = V[0] if V[0].shape[1] == m else np.concatenate(V, axis=1) * np.eye(m)
        peak = np.linalg.norm(self.matrices(x)[0], 2, axis=(0, 1)).max()
        return Solution(C, U, V, peak, method, iterations)


def product(A, B):
    """A B at each frequency."""
    if A.shape[0] * B.shape[1] > 36:  # large enough for BLAS
        return np.matmul(A, B, axes=[(0, 1)] * 3)
    C = A[:, 0, None] * B[0]
    for j in range(1, len(B)):
        C += A[:, j, None] * B[j]
    return C


def adjoint(A):
    return A.conj().swapaxes(0, 1)


def orthonormalise(A):
    """A = Q R by Gram and Schmidt, in the precision of A; NumPy's QR is for doubles only."""
    Q, R = A.copy(), np.zeros((A.shape[1],) * 2, dtype=A.dtype)
    for j in range(A.shape[1]):
        for _ in range(3):  # one pass loses a digit for each of the condition number
            share = Q[:, :j].T @ Q[:, j]
            Q[:, j] -= Q[:, :j] @ share
            R[:j, j] += share
        R[j, j] = np.sqrt(Q[:, j] @ Q[:, j])
        Q[:, j] /= R[j, j]
    return Q, R


def whitened_basis(P, Q, angles, order, W):
    """Phi = R^-T [z; z^2; ...], orthonormal with the weight that M and W L give each frequency."""
    weight = np.linalg.norm(Q[:, None, None] * P, axis=(1, 2)) / np.abs(Q).max()
    weight = np.hypot(weight, np.linalg.norm(W, 2))
    weight = np.maximum(weight, 1e-8 * weight.max())
    z = weight * time_shifts(angles, order).T
    Phi, R = orthonormalise(np.concatenate([z.real, z.imag], axis=1).T)
    n = len(angles)
    return ((Phi[:n] + 1j * Phi[n:]).T / weight).astype(complex, order="C"), R


def formulate(P, Q, omega, Ts, *, order, M_max, L_max, band_mask, structure, objective):
    """State (39), (45) without and with (46), or the least gain for M_max, in terms of cones.

    Parameters
    ----------
    P : ndarray, shape (n, m, m), complex
        Frequency response of the plant.
    Q : ndarray, shape (n,)
        Frequency response of the Q-filter.
    omega : ndarray, shape (n,)
        Angular frequencies in (0, pi / Ts].
    Ts : float
        Sampling period.
    order : int
    M_max : float
    L_max : float or None
        None: see :func:`rodlib.certificate.weight_of_L`.
    band_mask : ndarray of bool, shape (n,)
        Frequencies over which "sum" sums.
    structure : {"diagonal", "full"}
    objective : {"sum", "peak", "gain"}
        "gain" minimises the largest sigma_max(W L). `L_max` is its unit, and no bound.

    Returns
    -------
    Problem
    """
    n, m, _ = P.shape
    rows, cols = np.indices((m, m)).reshape(2, -1) if structure == "full" else 2 * (np.arange(m),)
    entries = np.arange(len(rows))
    identity = np.repeat(np.eye(m, dtype=complex)[..., None], n, axis=2)
    T = np.ascontiguousarray(-Q * P.transpose(1, 2, 0))
    W = weight_of_L(P, Q, L_max)
    cones = [Cone(Q * identity, T, entries, rows, cols)]
    if structure == "full" or objective == "gain":
        cones.append(Cone(0 * identity, W[..., None] * np.ones(n), entries, rows, cols))
    else:  # smaller cones, one for each entry
        one = np.ones((1, 1, n), dtype=complex)
        cones += [Cone(0 * one, W[e, e] * one, entries[[e]], rows[:1], cols[:1]) for e in entries]
    basis, R = whitened_basis(P, Q, omega * Ts, order, W)
    if objective == "gain":
        free, bounds = np.arange(n), np.array([GENEROUS, M_max])
        return Problem(tuple(cones[::-1]), basis, R, len(rows), free, True, bounds, GENEROUS)
    bounds = np.array([M_max, 1.0])
    free = np.flatnonzero(band_mask)
    problem = Problem(tuple(cones), basis, R, len(rows), free, False, bounds, M_max)
    return problem.peak() if objective == "peak" else problem
