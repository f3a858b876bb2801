"""The largest norm of a trial among several plants, by a single Lanczos iteration.

The norm of a trial is the largest factor by which one trial can increase the distance of the ILC
signal v from its limit. For plant k, this distance is multiplied by T_k = Q_N (I - L_N P_k), see
:func:`.finite.trial_map`. The block-diagonal map with all T_k on its diagonal has the largest norm
of the T_k. All plants share Q and L. The matrix of L_N is therefore computed once, and filters the
signals of all plants at the same time.
"""

import numpy as np
import scipy.sparse.linalg as sparse
from scipy.fft import irfft, next_fast_len, rfft
from scipy.sparse import eye_array

from ilctools.filters import Filter, ZeroPhaseButterworth
from ilctools.models import impulse_response

LANCZOS = 30  # vectors that the iteration keeps, as in `finite`
TOLERANCE = 1e-8  # relative residual of the eigenvector, as in `finite`


def largest_trial_norm(
    plants, Q: ZeroPhaseButterworth, L: Filter, samples: int, learned_basis=None
) -> float:
    """Return the largest 2-norm of a trial among some plants.

    If `learned_basis` is passed, only the v that its columns span count, see
    :func:`.finite.learned_basis`. Otherwise all v count.
    """
    learned_basis = eye_array(samples * L.rows) if learned_basis is None else learned_basis
    maps = Maps(plants, Q, L, samples, learned_basis)
    size = len(plants) * learned_basis.shape[1]
    start = np.tile(np.random.default_rng(0).standard_normal(learned_basis.shape[1]), len(plants))
    normal = sparse.LinearOperator((size, size), matvec=maps.normal, dtype=float)
    options = {"ncv": min(LANCZOS, size), "tol": TOLERANCE, "return_eigenvectors": False}
    [largest] = sparse.eigsh(normal, 1, v0=start, **options)
    return float(np.sqrt(largest))


class Maps:
    """The maps T_k of all plants; each T_k is applied to its own signal v_k.

    Signals have the shape (plants, samples, channels).
    """

    def __init__(self, plants, Q, L, samples, learned_basis):
        self.Q, self.learned_basis = Q, learned_basis
        (p, m), self.length = plants[0].shape, next_fast_len(2 * samples)  # no wrap-around
        self.of_v, self.of_e = (len(plants), samples, m), (len(plants), samples, p)
        units = np.eye(samples * p)
        self.L_N = L.apply(units.reshape(-1, samples, p)).reshape(len(units), -1).T
        self.H = rfft([impulse_response(P, samples) for P in plants], self.length, axis=1)

    def normal(self, coordinates) -> np.ndarray:
        """Return T_k^T T_k v_k in the coordinates of `learned_basis`, raveled."""
        v = coordinates.reshape(len(self.H), -1) @ self.learned_basis.T
        changed = v - self.filtered(self.H, v.reshape(self.of_v)) @ self.L_N.T
        back = self.Q.apply_transposed(self.Q.apply(changed.reshape(self.of_v)))
        errors = (back.reshape(v.shape) @ self.L_N).reshape(self.of_e)
        result = back.reshape(v.shape) - self.filtered(self.H.conj().mT, errors)
        return (result @ self.learned_basis).ravel()

    def filtered(self, H, signals):
        """Return P_k v_k from the responses H, or P_k^T e_k from the adjoints of H, by plant."""
        spectra = rfft(signals, self.length, axis=1)[..., None]
        made = irfft((H @ spectra)[..., 0], self.length, axis=1)[:, : signals.shape[1]]
        return made.reshape(len(made), -1)
