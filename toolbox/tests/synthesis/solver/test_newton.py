"""The Newton step, against the whole system of equations, entry for entry."""

from dataclasses import replace

import numpy as np
import pytest
from plants import random_response
from problems import posed

from ilctools.synthesis.formulate import formulate
from ilctools.synthesis.solver.interior_point import begin
from ilctools.synthesis.solver.newton import NewtonSystem

ORDER = 2
PROGRAMS = {
    "a t of each column": {},
    "a shared t": {"objective": "peak"},
    "a radius": {"uncertainty": 0.1},
    "a radius and a shared t": {"uncertainty": 0.1, "objective": "peak", "structure": "diagonal"},
}


@pytest.mark.parametrize("choices", PROGRAMS.values(), ids=PROGRAMS)
def test_the_step_solves_the_whole_system(choices):
    P, Q, omega = random_response(1, 2, 5)
    program = formulate(posed(P, Q, omega, 1.0, order=ORDER, L_max=8.0, **choices)).program
    x = np.random.default_rng(0).normal(0, 0.1, (len(program.rows), ORDER))
    p = begin(program, x)
    still, X = p.moved(p, -1, -1), [np.linalg.inv(S.T).T for S in p.S]
    of_t = slice(x.size, x.size + len(p.t))
    ends = np.cumsum([x.size, len(p.t), *map(len, p.d)])

    def change(unknowns):
        dx, dt, *dd, _ = np.split(unknowns, ends)
        dx = dx.reshape(x.shape)
        return replace(still, x=dx, t=dt, d=dd, G=program.linear(dx)).S

    changes = [change(unit) for unit in np.eye(ends[-1])]
    H, residual = 0, np.zeros(ends[-1])
    for dS, Y, X_j in zip(zip(*changes, strict=True), p.Y, X, strict=True):
        H = H + np.einsum("aijc,jkc,bklc,lic->ab", dS, Y, dS, X_j, optimize=True).real
        residual += np.einsum("aijc,jic->a", dS, Y).real
    residual[of_t] -= program.cost + p.eta
    H[of_t, of_t] += np.diag(p.eta / p.room)
    system = NewtonSystem(program, X, p.Y, p.eta / p.room)
    dx, dt, dd = system.solve(p.stationarity, p.Y, p.eta)
    step = np.concatenate([dx.ravel(), dt, *dd])
    np.testing.assert_allclose(H @ step, residual, atol=1e-9 * np.abs(residual).max())
