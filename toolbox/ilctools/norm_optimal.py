"""Norm-optimal learning, for the same law (23).

It is a :class:`ilctools.filters.LearningOperator`, as a :class:`ilctools.LearningFilter` is: it
goes where L goes.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from ilctools import arguments
from ilctools.models import (
    Model,
    balanced,
    dynamics_on_trial,
    frequency_response,
    on_trial,
    sampled_plant,
)

# SuperLU counts in 32 bits, and asks for thirty times as much memory as its matrix has entries.
MOST_ENTRIES = 2**31 // 30
BYTES_OF_ENTRY = 50  # of matrix and factors, by measurement: 41 to 51 for 4 to 31 states


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
    The inverse is never formed. With the states x of P in all samples, z = (x, change) and
    multipliers l, the change minimises ||e - Y z||^2 + weight ||change||^2 subject to F z = 0, and

        [ Y' Y + weight S' S   F' ] [ z ]   [ Y' e ]
        [ F                    0  ] [ l ] = [ 0    ],    change = S z.

    The matrix couples neighbouring samples alone. It is factored once, for any number of errors;
    its memory grows with the samples and with the square of the number of states. Rounding moves
    the change by 1e-16 times the condition of the normal equations,
    (sigma_max(P)^2 + weight) / weight, at most.

    A transfer function whose modes are slow beside Ts and close to each other has coefficients that
    determine a trial to few digits (three modes of 3, 4 and 5 Hz at 1 kHz: to a tenth). Take its
    states instead, ``control.sample_system(control.ss(plant), Ts)``.

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
        self._check_memory()

    def _check_memory(self):
        """Refuse a trial whose factors would not fit, before any work."""
        of_one, of_two = (self._on_trial(samples)[1].nnz for samples in (1, 2))
        of_sample = of_two - of_one
        if self.samples * of_sample > MOST_ENTRIES:
            size = self.samples * of_sample * BYTES_OF_ENTRY / 1e9
            raise ValueError(
                f"samples = {self.samples}: the factors of such a trial would take {size:.2g} GB, "
                f"and fit for {MOST_ENTRIES // of_sample} samples at most: take a shorter trial, "
                "or a filter of synthesise with base=None"
            )

    def __getstate__(self):
        """All fields, but no factors: another process computes them faster than it reads them."""
        return {part.name: getattr(self, part.name) for part in fields(self)}

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.P.dt

    @property
    def rows(self) -> int:
        """Number m of inputs of P."""
        return self.P.ninputs

    @property
    def columns(self) -> int:
        """Number p of outputs of P."""
        return self.P.noutputs

    @property
    def weight_of_change(self) -> float:
        """It learns in the norm that it minimises."""
        return self.weight

    def frequency_response(self, omega) -> np.ndarray:
        """(P^H P + weight I)^-1 P^H, to which L tends far from the ends of a long trial."""
        return regularised_inverse(frequency_response(self.P, omega), np.sqrt(self.weight))

    def _on_trial(self, samples: int) -> tuple[sparse.csc_array, sparse.csc_array]:
        """Y of a trial, and the symmetric matrix of its conditions of optimality."""
        # in states of like size: one that is large by its unit rules no other
        A, B, C = balanced(self.P)
        n, m = B.shape
        Y = on_trial(samples, C, self.P.D)
        F = dynamics_on_trial(samples, A, B)
        of_d = np.repeat([0.0, self.weight], [samples * n, samples * m])
        cost = Y.T @ Y + sparse.diags_array(of_d)
        return Y, sparse.block_array([[cost, F.T], [F, None]], format="csc")

    @cached_property
    def _factored(self) -> tuple[sparse.csc_array, SuperLU]:
        """Y, and the factors of the conditions, for any error."""
        Y, conditions = self._on_trial(self.samples)
        # one column at a time: wider panels take twice the memory and are no faster
        return Y, splu(conditions, panel_size=1)

    def _solved(self, right) -> np.ndarray:
        """z of the conditions with a right-hand side beside z, each of shape (numbers, trials)."""
        _, factors = self._factored
        whole = np.zeros((factors.shape[0], right.shape[1]))
        whole[: len(right)] = right
        return factors.solve(whole)[: len(right)]

    def apply(self, signal) -> np.ndarray:
        """The best change, shape (..., samples, m), for an error of shape (..., samples, p)."""
        shape = ..., self.samples, self.columns
        signal = arguments.array(f"signal, for an L of samples = {shape[1]},", signal, shape)
        Y, _ = self._factored
        z = self._solved(Y.T @ signal.reshape(-1, Y.shape[0]).T)
        change = z[self.samples * self.P.nstates :]
        return change.T.reshape(*signal.shape[:-1], self.rows)

    def apply_transposed(self, signal) -> np.ndarray:
        """The transpose of the matrix that :meth:`apply` is: P_N (P_N^T P_N + weight I)^-1."""
        signal = arguments.array("signal", signal, (..., self.samples, self.rows))
        Y, _ = self._factored
        changes = signal.reshape(-1, self.samples * self.rows).T
        right = np.zeros((Y.shape[1], changes.shape[1]))
        right[self.samples * self.P.nstates :] = changes
        output = Y @ self._solved(right)
        return output.T.reshape(*signal.shape[:-1], self.columns)


def regularised_inverse(P, b) -> np.ndarray:
    """(P* P + b^2 I)^-1 P* of responses P, (n, p, m), by factors, for P may be large."""
    p, m = P.shape[1:]
    below = np.broadcast_to(b * np.eye(m), (len(P), m, m))
    Q, R = np.linalg.qr(np.concatenate([P, below], axis=1))
    return np.linalg.solve(R, Q[:, :p].conj().swapaxes(1, 2))
