"""Small problems for the solvers."""

import numpy as np

from ilctools.problem.pose import pose


def plant(m, n=20, seed=0):
    rng = np.random.default_rng(seed)
    omega = np.geomspace(1e-3, np.pi, n)
    z = np.exp(1j * omega)[:, None, None]
    P = (np.eye(m) + 0.2 * rng.standard_normal((m, m))) * 0.2 / (z - 0.8)
    return P, 1 / (1 + omega**4), omega


def posed(P, Q, omega, structure, objective="sum", L_max=5.0, M_max=0.9, uncertainty=None):
    kind = {"structure": structure, "objective": objective, "uncertainty": uncertainty}
    return pose(P, Q, omega, 1.0, order=4, M_max=M_max, L_max=L_max, band=(1e-3, 1), **kind)
