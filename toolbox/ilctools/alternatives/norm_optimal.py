"""Norm-optimal learning in lifted form: the best change of v for a whole trial, at once."""

from dataclasses import dataclass
from functools import cached_property

import control
import numpy as np
from scipy.sparse import csc_array, eye_array, kron
from scipy.sparse.linalg import SuperLU, splu

from ilctools import arguments
from ilctools.models import frequency_response, sampled_plant


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
    a sparse matrix, block tridiagonal and the same in each row, factored once.

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

    P: control.StateSpace
    weight: float
    samples: int

    def __post_init__(self):
        P = sampled_plant(self.P, "P")
        arguments.stable("P", P.poles())
        weight = arguments.positive("weight", self.weight)
        samples = arguments.whole("samples", self.samples, 1)
        vars(self).update(P=P, weight=weight, samples=samples)

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
        P = frequency_response(self.P, omega)
        adjoint = P.conj().swapaxes(1, 2)
        weight = self.weight * np.eye(self.P.ninputs)
        return np.linalg.solve(adjoint @ P + weight, adjoint)

    @cached_property
    def _factors(self) -> SuperLU:
        """Of the conditions of optimality, for x(p), change(p), lambda(p), p = 0, 1, ..."""
        A, B, C, D = self.P.A, self.P.B, self.P.C, self.P.D
        n, m = B.shape
        O, I = np.zeros, np.eye(n)  # noqa: E741
        here = np.block(
            [
                [C.T @ C, C.T @ D, I],
                [D.T @ C, D.T @ D + self.weight * np.eye(m), O((m, n))],
                [I, O((n, m + n))],
            ]
        )
        before = np.block([[O((n + m, 2 * n + m))], [-A, -B, O((n, n))]])
        N = self.samples
        system = kron(eye_array(N), here) + kron(eye_array(N, k=-1), before)
        system = csc_array(system + kron(eye_array(N, k=1), before.T))
        # samples in turn: pivots stay near the diagonal
        return splu(system, permc_spec="NATURAL")

    def apply(self, signal) -> np.ndarray:
        """The best change, shape (..., samples, m), for an error of shape (..., samples, p)."""
        signal = arguments.array("signal", signal, (..., self.samples, self.channels))
        n, m = self.P.B.shape
        right = np.zeros((*signal.shape[:-1], 2 * n + m))
        right[..., :n] = signal @ self.P.C
        right[..., n : n + m] = signal @ self.P.D
        columns = right.reshape(-1, self.samples * (2 * n + m)).T
        solution = self._factors.solve(columns).T.reshape(right.shape)
        return solution[..., n : n + m]
