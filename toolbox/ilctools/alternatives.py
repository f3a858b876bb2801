"""Norm-optimal learning, for the same law (23), and what it shares with a base of filters.

It is a :class:`ilctools.filters.LearningOperator`, as a :class:`ilctools.LearningFilter` is: it
goes where L goes.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import irfft
from scipy.sparse import csc_array, eye_array, kron
from scipy.sparse.linalg import SuperLU, splu

from ilctools import arguments
from ilctools.models import Model, balanced, frequency_response, sampled_plant


@dataclass(frozen=True)
class NormOptimal:
    """L = (P_N^T P_N + weight I)^-1 P_N^T, for trials of N samples.

    The change of v that minimises ||e - P_N change||^2 + weight ||change||^2. N. Amann, D. H. Owens
    and E. Rogers, Iterative learning control using optimal feedback and feedforward actions,
    International Journal of Control 65 (1996) 277-293; on the rod, the paper's [15].

    Attributes
    ----------
    P : control.StateSpace
        In discrete time, stable, from rest. With more outputs p than inputs m, no other change of
        v leaves less of an error, but for the weight; for the law (23) p and m must be equal.
    weight : float
        Above zero, in the square of the unit of y per unit of w.
    samples : int
        Length N of a trial.

    See Also
    --------
    Law : what takes it as L
    synthesise : a filter with bounds instead

    Notes
    -----
    The inverse is never formed. With x for the states of P and lambda for the multipliers of
    x(p) = A x(p-1) + B change(p-1), the conditions of optimality couple neighbouring samples alone:
    a sparse matrix, block tridiagonal and the same in each row, factored once. Of a transfer
    function with modes that are slow beside Ts and close to each other, coefficients determine a
    trial to few digits (three modes of 3, 4 and 5 Hz at 1 kHz: to a tenth): take its states,
    ``control.sample_system(control.ss(plant), Ts)``.

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from ilctools import Law, NormOptimal, zero_phase_butterworth
    >>> P = control.ss(0.5, 0.5, 1, 0, 1.0)
    >>> L = NormOptimal(P, weight=0.01, samples=50)
    >>> law = Law(zero_phase_butterworth(2, 1.0, 1.0), L)
    >>> law.next(np.zeros((50, 1)), np.ones((50, 1))).shape
    (50, 1)
    """

    P: Model
    weight: float
    samples: int

    def __post_init__(self):
        P = sampled_plant(self.P, "P")
        arguments.stable("P", P.poles())
        weight = arguments.positive("weight", self.weight)
        samples = arguments.whole("samples", self.samples, 1)
        vars(self).update(P=P, weight=weight, samples=samples)

    def __reduce__(self):  # to another process: the factors have no copy
        return NormOptimal, (self.P, self.weight, self.samples)

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.P.dt

    @property
    def channels(self) -> int:
        """Number p of outputs."""
        return self.P.noutputs

    def frequency_response(self, omega) -> np.ndarray:
        """(P^H P + weight I)^-1 P^H, to which L tends far from the ends of a long trial."""
        return regularised_inverse(frequency_response(self.P, omega), np.sqrt(self.weight))

    @cached_property
    def _model(self) -> tuple[np.ndarray, np.ndarray]:
        """[A, B] and [C, D] of P in states of like size: pivots stay near the diagonal."""
        A, B, C = balanced(self.P)
        return np.hstack([A, B]), np.hstack([C, self.P.D])

    @cached_property
    def _factors(self) -> SuperLU:
        """Of the conditions of optimality, for x(p), change(p), lambda(p), p = 0, 1, ..."""
        (AB, CD), N = self._model, self.samples
        n, size = AB.shape
        price = CD.T @ CD + self.weight * np.diag(np.arange(size) >= n)
        here = np.block([[price, np.eye(size, n)], [np.eye(n, size), np.zeros((n, n))]])
        before = np.zeros_like(here)
        before[size:, :size] = -AB
        system = kron(eye_array(N), here) + kron(eye_array(N, k=-1), before)
        system = csc_array(system + kron(eye_array(N, k=1), before.T))
        # samples in turn: pivots stay near the diagonal
        return splu(system, permc_spec="NATURAL")

    def apply(self, signal) -> np.ndarray:
        """The best change, shape (..., samples, m), for an error of shape (..., samples, p)."""
        shape = ..., self.samples, self.channels
        signal = arguments.array(f"signal, for an L of samples = {shape[1]},", signal, shape)
        return self._solved(signal @ self._model[1])[..., self.P.nstates :]

    def apply_transposed(self, signal) -> np.ndarray:
        """The transpose of the matrix that :meth:`apply` is: P_N (P_N^T P_N + weight I)^-1."""
        signal = arguments.array("signal", signal, (..., self.samples, self.P.ninputs))
        return self._solved(signal, self.P.nstates) @ self._model[1].T

    def _solved(self, right, first=0):
        """x and change, (..., samples, n + m), for right-hand sides of their conditions."""
        n, m = self.P.B.shape
        whole = np.zeros((*right.shape[:-1], 2 * n + m))
        whole[..., first : first + right.shape[-1]] = right
        columns = whole.reshape(-1, self.samples * whole.shape[-1]).T
        return self._factors.solve(columns).T.reshape(whole.shape)[..., : n + m]


def regularised_inverse(P, b) -> np.ndarray:
    """(P* P + b^2 I)^-1 P* of responses P, (n, p, m), by factors, for P may be large."""
    p, m = P.shape[1:]
    below = np.broadcast_to(b * np.eye(m), (len(P), m, m))
    Q, R = np.linalg.qr(np.concatenate([P, below], axis=1))
    return np.linalg.solve(R, Q[:, :p].conj().swapaxes(1, 2))


def coefficients_of(response) -> np.ndarray:
    """Coefficients of q^k, k = -n / 2, ..., n / 2 - 1, (n, p, m), of a filter.

    By its response at n / 2 + 1 frequencies, evenly from zero to the Nyquist frequency.
    """
    return np.fft.fftshift(irfft(response.conj(), axis=0), axes=0)
