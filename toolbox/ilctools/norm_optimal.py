"""Norm-optimal learning: an L for the law v_{k+1} = Q (v_k + L e_k), equation (23) of the paper.

:class:`NormOptimal` is a :class:`ilctools.filters.LearningOperator`, like
:class:`ilctools.LearningFilter`, and can be used wherever L is used.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ilctools import arguments
from ilctools.models import Model, balanced, frequency_response, stable_plant
from ilctools.riccati import TrialLeastSquares


@dataclass(frozen=True, eq=False)
class NormOptimal:
    """The norm-optimal law L = (P_N^T W P_N + weight I)^-1 P_N^T W, for trials of N samples.

    L computes, from the error e, the change of v that minimises the sum of
    (e - P_N change)^T W (e - P_N change) and weight ||change||^2. The matrix P_N maps the inputs of
    a trial to its outputs. W is I, or the diagonal matrix of the weights `errors`. The source is
    N. Amann, D. H. Owens and E. Rogers, Iterative learning control using optimal feedback and
    feedforward actions, International Journal of Control 65 (1996) 277-293. For the rod, see [15]
    of the paper.

    Attributes
    ----------
    P : control.StateSpace
        The plant in discrete time, stable, and at rest before a trial. If there are more outputs p
        than inputs m, part of the error remains. Apart from the effect of the weight, no other
        change of v leaves a smaller error.
    weight : float
        Weight of the change, above zero. Its unit is the square of the unit of y per unit of v.
    samples : int
        Length N of a trial, in samples.
    errors : array_like, shape (samples, p), or (samples,) of one output, optional
        Weights of the errors in W, by time and output. A weight is zero where the error does not
        count. A reference with NaN sets the weights automatically. Default: one.

    See Also
    --------
    Law : uses this law as L
    synthesise : designs a filter with bounds instead

    Notes
    -----
    The inverse is never formed. With the states of P, the change follows from one recursion
    backwards in time and one recursion forwards in time (:mod:`.riccati`). The gains of the
    recursions change only near the end of the trial. Therefore the recursions need little more
    memory than the signals. Rounding errors of the change are at most 1e-16 times the condition
    number of the normal equations, which is (sigma_max(P)^2 + weight) / weight.

    Some transfer functions have modes that are slow compared with Ts and close to each other. The
    coefficients of such a transfer function determine the signals of a trial only to a few digits.
    With three modes of 3, 4 and 5 Hz at a sampling rate of 1 kHz, the relative error of the signals
    is a tenth. Use a state-space model instead, as in
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
    errors: np.ndarray | None = None

    def __post_init__(self):
        P = stable_plant(self.P, "P")
        weight = arguments.positive("weight", self.weight)
        samples = arguments.whole("samples", self.samples, 1)
        vars(self).update(P=P, weight=weight, samples=samples)
        if self.errors is not None:
            vars(self)["errors"] = self._checked_errors()

    def _checked_errors(self):
        errors = np.asarray(self.errors)
        errors = errors.astype(float) if errors.dtype == bool else errors
        errors = errors[:, None] if errors.ndim == 1 else errors
        errors = arguments.array("errors", errors, (self.samples, self.columns))
        if errors.min() < 0 or not errors.any():
            raise ValueError(
                f"errors range from {errors.min():.6g} to {errors.max():.6g}, but must be 0 or "
                "more, and not all zero"
            )
        return errors

    @property
    def weight_of_errors(self) -> np.ndarray | float:
        """Weight of the errors in the norm that is minimised: `errors`."""
        return 1.0 if self.errors is None else self.errors

    def __getstate__(self):
        """Return all fields except the factors, which are faster to compute than to read."""
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
        """Weight of the change in the norm that is minimised: `weight`."""
        return self.weight

    def frequency_response(self, omega) -> np.ndarray:
        """Compute (P^H P + weight I)^-1 P^H, the limit of L far from the ends of a long trial.

        Weights of errors count by their means over time, because a law with weights that vary in
        time has no frequency response.
        """
        root = np.sqrt(np.ones(self.columns) if self.errors is None else self.errors.mean(axis=0))
        P = root[:, None] * frequency_response(self.P, omega)
        return regularised_inverse(P, np.sqrt(self.weight)) * root

    @cached_property
    def _states(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and C of P, with states scaled so that no state dominates because of its unit."""
        return balanced(self.P)

    @cached_property
    def _factors(self) -> TrialLeastSquares:
        """Factors of the least-squares problem on a trial, which are the same for any error."""
        return TrialLeastSquares(*self._states, self.P.D, self.weight, self.samples, self.errors)

    def apply(self, signal) -> np.ndarray:
        """Compute the minimising change of v for an error.

        The error has the shape (..., samples, p), and the change has the shape (..., samples, m).
        """
        shape = ..., self.samples, self.columns
        signal = arguments.array(f"signal, for an L of samples = {shape[1]},", signal, shape)
        signal = signal * self.weight_of_errors
        C, D = self._states[2], self.P.D
        change = np.empty((*signal.shape[:-1], self.P.ninputs))
        of_trials = change.reshape(-1, *change.shape[-2:])  # the same numbers
        for part, _, d in self._factors.solved(signal.reshape(-1, *shape[1:]), C, D):
            of_trials[:, part] = d
        return change

    def apply_transposed(self, signal) -> np.ndarray:
        """Apply W P_N (P_N^T W P_N + weight I)^-1, the transpose of the matrix of :meth:`apply`."""
        shape = ..., self.samples, self.P.ninputs
        signal = arguments.array("signal", signal, shape)
        C, D = self._states[2], self.P.D
        output = np.empty((*signal.shape[:-1], self.columns))
        of_trials = output.reshape(-1, *output.shape[-2:])
        to_x, to_d = np.zeros((len(D.T), C.shape[1])), np.eye(len(D.T))
        for part, x, d in self._factors.solved(signal.reshape(-1, *shape[1:]), to_x, to_d):
            of_trials[:, part] = x @ C.T + d @ D.T
        return output * self.weight_of_errors


def regularised_inverse(P, b) -> np.ndarray:
    """Compute (P* P + b^2 I)^-1 P* from the frequency responses P, shape (n, p, m).

    A QR decomposition avoids the product P* P, which would lose digits.
    """
    p, m = P.shape[1:]
    below = np.broadcast_to(b * np.eye(m), (len(P), m, m))
    Q, R = np.linalg.qr(np.concatenate([P, below], axis=1))
    return np.linalg.solve(R, Q[:, :p].conj().swapaxes(1, 2))
