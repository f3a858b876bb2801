"""The least change of a signal that brings commands and outputs within their limits.

P is the model (A, B, C, D) from the signal to the outputs. The change z solves a quadratic program:

    minimise    sum_p errors(p)' y(p)^2 + weight ||z(p)||^2,  y = C x + D z,  in all samples
    subject to  x(p+1) = A x(p) + B z(p),  x(0) = 0,   z(p) = 0 in the rest, p >= active
                low <= K x + N z <= high               for rows K, N of commands or of outputs

The weights `errors` and `weight` are those of :class:`Norm`. v is zero in the rest, the last
samples of a trial. The program has one stage for each sample. PIQP solves the program.
"""

from typing import NamedTuple

import control
import numpy as np
from scipy import sparse

from ilctools.models import balanced, dynamics_on_trial, on_trial

try:
    import piqp
except ImportError:  # piqp is not available on every platform
    piqp = None

# Regularisation of PIQP's systems. With PIQP's default, 1e-10, rounding may prevent convergence.
LEAST_REGULARISATION = 1e-8


class Rows(NamedTuple):
    """Limits low <= K x + N z <= high, in the first samples of a trial."""

    K: np.ndarray  # (rows, states)
    N: np.ndarray  # (rows, m)
    low: np.ndarray  # (time, rows), which may be infinite
    high: np.ndarray


class Norm(NamedTuple):
    """The cost of a change z that changes outputs by y: sum(errors y^2) + change sum(z^2)."""

    change: float
    errors: np.ndarray | float = 1.0  # (time, p)

    @classmethod
    def of(cls, L) -> "Norm":
        """Make the norm from the weights that a learning operator L states."""
        return cls(L.weight_of_change, getattr(L, "weight_of_errors", 1.0))

    def size(self, y, z) -> float:
        """Compute the cost of signals y (time, p) and z (time, m)."""
        return float(np.sum(self.errors * y**2) + self.change * np.sum(z**2))


class NotFound(RuntimeError):
    """The error if there is no signal within the limits, or if the solver finds no such signal."""


def nearest(
    P: control.StateSpace, norm: Norm, samples: int, active: int, limited: Rows, unit: float
) -> np.ndarray:
    """Compute the change z of least cost that keeps the limits, shape (active, m).

    The solver's tolerances are absolute. Therefore z is computed in units of `unit`, the expected
    size of z. Limits of signals that z does not change are ignored.
    """
    cost, dynamics, matrix = _program(P, norm, samples, active, limited)
    low, high = (end.ravel() / unit for end in (limited.low, limited.high))
    moved = np.diff(matrix.indptr) > 0  # rows that z moves; other commands may saturate
    bounded = moved & (np.isfinite(low) | np.isfinite(high))

    solver = piqp.SparseSolver()
    solver.settings.reg_lower_limit = LEAST_REGULARISATION
    solver.setup(
        cost.tocsc(), np.zeros(cost.shape[0]), dynamics, np.zeros(dynamics.shape[0]),
        matrix[bounded].tocsc(), low[bounded], high[bounded],
    )  # fmt: skip
    status = solver.solve()
    if status != piqp.PIQP_SOLVED:
        raise NotFound(
            f"the solver PIQP has found no v within the limits ({status}): are the limits very "
            "narrow, or do the signals of the loop have very different sizes?"
        )
    return unit * solver.result.x[-active * P.ninputs :].reshape(active, -1)


def _program(P, norm, samples, active, limited):
    """Make the matrices of the program: cost divided by weight, dynamics, and limited rows.

    The unknowns are the states x in all samples, and then the changes z in the first `active` ones.
    """
    n, p, m = P.nstates, P.noutputs, P.ninputs
    A, B, C = balanced(P, limited.K)  # without it, feasible programs may fail
    moving = slice(samples * n + active * m)  # z is zero in the rest
    y = on_trial(samples, C[:p], P.D)[:, moving]
    dynamics = dynamics_on_trial(samples, A, B)[:, moving]
    matrix = on_trial(samples, C[p:], limited.N)[: limited.low.size, moving]
    of_z = np.repeat([0.0, 1.0], [samples * n, active * m])
    of_y = np.broadcast_to(norm.errors, (samples, p)).ravel() / norm.change
    cost = y.T @ sparse.diags_array(of_y) @ y + sparse.diags_array(of_z)
    return cost, dynamics, matrix.tocsr()
