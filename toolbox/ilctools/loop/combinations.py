"""Learning on combinations: as many of the outputs as there are inputs.

m inputs cannot bring p > m outputs z to their references, but m combinations T z of them. With
G = P(1), the response at rest, and weights W, those of least squares are

    T = (G' W G)^-1 G' W,    T P(1) = I.

z may be measured, or estimated by the loop's observer (16), as in J. Wallén, M. Norrlöf and S.
Gunnarsson, A framework for analysis of observer-based ILC, Asian Journal of Control 13 (2011) 3-14.
"""

import control
import numpy as np

from ilctools import arguments
from ilctools.loop.closed import ClosedLoop
from ilctools.models import Model, sampled_plant

CONDITION = 1e6  # of the response at rest, beyond which errors of the model take over


def combinations(P: Model, weights=None) -> tuple[np.ndarray, ClosedLoop]:
    """As many combinations T z of outputs as there are inputs, and the loop from w to them.

    T = (G' W G)^-1 G' W with G = P(1), the response at rest: if T (r - z) = 0 there, no w leaves
    less of (r - z)' W (r - z). If r moves, another may: see :class:`ilctools.NormOptimal`. With T r
    and T z, measured or estimated, in the place of r and y, all works that wants p = m.

    Parameters
    ----------
    P : control.StateSpace or control.TransferFunction
        From w, m inputs, to z, p >= m outputs, in discrete time and stable: any loop with more
        sensors than inputs; or ``control.ss(loop.P.A, loop.P.B, C_z, 0, loop.Ts)`` of outputs
        z = C_z x that the loop's observer (16) estimates as C_z x-hat.
    weights : array_like, shape (p,), optional
        The diagonal of W. Default: all one.

    Returns
    -------
    T : ndarray, shape (m, p)
        The combinations of a signal of shape (time, p) are ``signal @ T.T``.
    loop : ClosedLoop
        Its P is T P, which is I at rest; outputs c1, c2, ...

    See Also
    --------
    NormOptimal : where the reference moves

    Examples
    --------
    >>> import control
    >>> from ilctools import combinations
    >>> P = control.ss(0.5, 0.5, [[1.0], [3.0]], 0, 1.0)  # one input, two sensors
    >>> T, loop = combinations(P)
    >>> T, float(loop.P(1.0).real.round(6))
    (array([[0.1, 0.3]]), 1.0)
    """
    P = sampled_plant(P, "P")
    arguments.stable("P", P.poles())
    p, m = P.shape
    if p < m:
        raise ValueError(
            f"P has {p} outputs for {m} inputs, which they do not distinguish: leave inputs out, "
            f"or drive all by {p} patterns"
        )
    weights = np.ones(p) if weights is None else arguments.array("weights", weights, (p,))
    if weights.min() < 0:
        raise ValueError(f"weights reach {weights.min():.6g}, but must be 0 or more")
    G = np.sqrt(weights)[:, None] * P(1.0).real.reshape(p, m)
    if not (condition := np.linalg.cond(G)) < CONDITION:
        raise ValueError(
            f"P at rest, by weights, has a condition of {condition:.3g}: some inputs move the same "
            "outputs, or none. Leave inputs out, or give them units in which they count alike"
        )
    T = np.linalg.pinv(G) * np.sqrt(weights)
    model = control.ss(P.A, P.B, T @ P.C, T @ P.D, P.dt, inputs=P.input_labels)
    return T, ClosedLoop(model, outputs=[f"c{i + 1}" for i in range(m)])
