"""Norm-optimal learning, for the same law (23).

It is a :class:`ilctools.filters.LearningOperator`, as a :class:`ilctools.LearningFilter` is: it
goes where L goes.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ilctools import arguments
from ilctools.models import Model, balanced, frequency_response, sampled_plant
from ilctools.riccati import TrialLeastSquares


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
    The inverse is never formed. By the states of P, the change follows from a recursion backwards
    in time and one forwards (:mod:`.riccati`). Their gains change near the end of the trial alone,
    so that memory is little more than the signals. Rounding moves the change by 1e-16 times the
    condition of the normal equations, (sigma_max(P)^2 + weight) / weight, at most.

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

    def __getstate__(self):
        """All fields, but no factors: another process computes them faster than it reads them."""
        return {name: value for name, value in vars(self).items() if name != "_factors"}

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
        """That of the norm in which it learns: `weight`."""
        return self.weight

    def frequency_response(self, omega) -> np.ndarray:
        """(P^H P + weight I)^-1 P^H, to which L tends far from the ends of a long trial."""
        return regularised_inverse(frequency_response(self.P, omega), np.sqrt(self.weight))

    @cached_property
    def _states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and C of P in states of like size: one that is large by its unit rules no other."""
        return balanced(self.P)

    @cached_property
    def _factors(self) -> TrialLeastSquares:
        """Of the least squares on a trial, for any error."""
        return TrialLeastSquares(*self._states, self.P.D, self.weight, self.samples)

    def apply(self, signal) -> np.ndarray:
        """The best change, shape (..., samples, m), for an error of shape (..., samples, p)."""
        shape = ..., self.samples, self.columns
        signal = arguments.array(f"signal, for an L of samples = {shape[1]},", signal, shape)
        C, D = self._states[2], self.P.D
        change = np.empty((*signal.shape[:-1], self.P.ninputs))
        of_trials = change.reshape(-1, *change.shape[-2:])  # the same numbers
        for part, _, d in self._factors.solved(signal.reshape(-1, *shape[1:]), C, D):
            of_trials[:, part] = d
        return change

    def apply_transposed(self, signal) -> np.ndarray:
        """The transpose of the matrix that :meth:`apply` is: P_N (P_N^T P_N + weight I)^-1."""
        shape = ..., self.samples, self.P.ninputs
        signal = arguments.array("signal", signal, shape)
        C, D = self._states[2], self.P.D
        output = np.empty((*signal.shape[:-1], self.columns))
        of_trials = output.reshape(-1, *output.shape[-2:])
        to_x, to_d = np.zeros((len(D.T), C.shape[1])), np.eye(len(D.T))
        for part, x, d in self._factors.solved(signal.reshape(-1, *shape[1:]), to_x, to_d):
            of_trials[:, part] = x @ C.T + d @ D.T
        return output


def regularised_inverse(P, b) -> np.ndarray:
    """(P* P + b^2 I)^-1 P* of responses P, (n, p, m), by factors, for P may be large."""
    p, m = P.shape[1:]
    below = np.broadcast_to(b * np.eye(m), (len(P), m, m))
    Q, R = np.linalg.qr(np.concatenate([P, below], axis=1))
    return np.linalg.solve(R, Q[:, :p].conj().swapaxes(1, 2))
