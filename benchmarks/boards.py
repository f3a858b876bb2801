"""What to measure next on a heater board, and for how long, as in notebook 13.

A board with a quadratic loss, which was fitted to a log of a real one, is recorded with ten draws
of moves and noise for some minutes, and shaken for some hours. From each record comes the least
sigma_max(M) that any filter can have: for boards within the intervals of a fitted heat balance, or
for all within the radius of P. Both tables go to figures/performance.md.
"""

import warnings
from functools import cache

import numpy as np
from runner import publish, run, table
from scipy.optimize import least_squares

from ilctools import (
    InfeasibleError,
    current_trial_loop,
    measured_response,
    multisine,
    read_table,
    shake,
    synthesise,
    zero_phase_butterworth,
)
from rodlib import fit_heat_balance, heat_balance
from rodlib.paper.repository import ROOT

DRAWS, DRAWN, TS = 10, 50, 3.0  # of moves and noise; boards from each fit; s
SIZES = {"T1": 15.0, "T2": 10.0, "Q1": 30.0, "Q2": 40.0}
GIVEN = {"controls": ["Q1", "Q2"], "sizes": SIZES}
OMEGA, Q = np.geomspace(1e-4, np.pi / TS, 300), zero_phase_butterworth(2, 0.05, TS)
BOUNDS = {"order": 10, "L_max": 5.0, "band": (1e-4, 0.02), "structure": "diagonal"}
BOUNDS["objective"] = "peak"
MINUTES = (12, 36)  # of moves
HOURS = (1.5, 3.0, 6.0)


@cache
def logs():
    """Both logs, and their fits."""
    columns = {"time": 0, "inputs": {"Q1": 1, "Q2": 2}, "outputs": {"T1": 3, "T2": 4}}
    read = [
        read_table(ROOT / "data" / "tclab" / f"board-{Ts}.csv", **columns) for Ts in ("1s", "3s")
    ]
    return read, [fit_heat_balance(log.u[0], log.y[0], log.Ts) for log in read]


def stepped(x, z, u, dt):
    """Heaters H, K and thermometers S, T a step later; in plain numbers, for speed."""
    (H, K, S, T), (g, h, a, c, tau, b), (one, two) = x, z, u
    more = g * one - a * H - c * (H - K) - b * (H * H)
    other = h * two - a * K - c * (K - H) - b * (K * K)
    S, T = S + dt * (H - S) / tau, T + dt * (K - T) / tau
    return H + dt * more, K + dt * other, S, T


def with_squares(log, fit):
    """The board with a quadratic loss nearest to a log: logarithms of g1, g2, a, c, tau, b."""
    u, y, dt = log.u.values[0], log.y.values[0], log.Ts / 3

    def off(z):
        x, read, zero, z = (0.0, 0.0, 0.0, 0.0), [], z[6:], np.exp(z[:6]).tolist()
        for heaters in u.tolist():
            read.append(x[2:])
            for _ in range(3):
                x = stepped(x, z, heaters, dt)
        return (read + zero - y).ravel()

    start = [*np.log(fit.values), np.log(5e-5), *fit.zero]
    bound = [-12.0] * 6 + [0, 0], [7.0] * 6 + [50, 50]
    given = {"bounds": bound, "x_scale": "jac", "ftol": 1e-12, "xtol": 1e-10}
    return least_squares(off, start, **given).x


class Board:
    """A board with a quadratic loss, as a rig; it waits until it rests."""

    inputs = ("Q1", "Q2")

    def __init__(self, z, heaters, noise, draw):
        self.z, self.heaters = np.exp(z[:6]).tolist(), heaters
        self.noise, self.draw = noise, draw
        self.limits = dict.fromkeys(self.inputs, (-heaters, 100 - heaters))

    def begin(self, trial):
        self.rng = np.random.default_rng([self.draw, trial])
        held = np.full(2, self.heaters)
        still = least_squares(lambda x: self.after(x, held) - x, [10.0] * 4)
        self.state, self.zero = still.x, still.x[2:]

    def after(self, x, u):
        x, u = x.tolist(), np.clip(u, 0, 100).tolist()
        for _ in range(3):  # steps of 1 s
            x = stepped(x, self.z, u, 1.0)
        return np.array(x)

    def read(self):
        noise = self.noise * self.rng.standard_normal(2)
        return self.state[2:] - self.zero + noise

    def apply(self, u):
        self.state = self.after(self.state, self.heaters + u)


def loop_of(values):
    """A loop that is designed for the heat balance of a fit."""
    return current_trial_loop(heat_balance(*values, TS), **GIVEN)


def within(fit, loop):
    """Responses of a loop with boards that are drawn from the intervals of a fit."""
    rng, spread = np.random.default_rng(1), np.linalg.cholesky(fit.covariance)
    far = np.sqrt(5 / rng.chisquare(5, DRAWN))  # Student's t: six parts of a log
    off = (far * (spread @ rng.standard_normal((5, DRAWN)))).T
    boards = [heat_balance(*(fit.values * np.exp(x)), TS) for x in off]
    return [loop.frequency_response(OMEGA[::3], board) for board in boards]


def least_promise(plants):
    """Least sigma_max(M) that a filter can have for all plants; 1 if that is none below one."""
    try:
        most = BOUNDS | {"M_max": 1 - 1e-9}
        return synthesise(plants, Q, OMEGA[::3], TS, **most).certificate.grid_M
    except InfeasibleError:
        return 1.0


def moved(minutes, draw, z, noise):
    """What a fit leaves of a record (K), and its promise; infinite if a loop is unstable."""
    rig = Board(z, 40.0, noise, 1)
    rig.begin(draw)
    random = np.random.default_rng(draw)
    moves = random.choice([-15.0, 15.0], (minutes, 2)).repeat(20, axis=0)  # %
    read = [(rig.read(), rig.apply(u))[0] for u in moves]
    with warnings.catch_warnings(action="ignore"):
        fit = fit_heat_balance(moves, read, TS)
        own = loop_of(fit.values)
        try:
            least = least_promise([own, *within(fit, own)])
        except ValueError:  # a drawn board makes its loop unstable
            least = np.inf
    return np.std(fit.left), least, len(fit.unknown) > 0


def shaken(hours, draw, z, noise, values):
    """Largest radius of P from a board that was shaken, and the least promise for all in it."""
    loop = loop_of(values)
    # three periods of two realisations for each of two inputs
    lowest = 12.1 * 2 * np.pi / (3600 * hours)
    plan = multisine(loop, lowest, highest=0.15, amplitude=1.2, hours=hours)
    with warnings.catch_warnings(action="ignore"):  # that lines are far apart, or y drifts
        P = measured_response(shake(Board(z, 40.0, noise, draw), loop, plan))
    best = synthesise(P, Q, OMEGA, TS, **BOUNDS).certificate.grid_M
    return P.radius(0.99, jointly=True).max(), best


def ranges(results, digits):
    """The ranges of all columns of a kind."""
    ends = zip(np.min(results, axis=0), np.max(results, axis=0), digits, strict=True)
    return [f"{a:.{n}f} to {b:.{n}f}" for a, b, n in ends]


def main():
    """Both tables go to figures/performance.md."""
    (A, _), fits = logs()
    z = with_squares(A, fits[0])
    noise = np.sqrt(np.mean(np.diff(A.y.values[0], 2, axis=0) ** 2, axis=0) / 6)
    numbers = range(1, DRAWS + 1)
    cases = [(minutes, n, z, noise) for minutes in MINUTES for n in numbers]
    found = np.reshape([*run(moved, cases)], (-1, DRAWS, 3))
    rows = [
        [str(minutes), *ranges(one[:, :2], (2, 2)), f"{one[:, 2].sum():.0f} of {DRAWS}"]
        for minutes, one in zip(MINUTES, found, strict=True)
    ]
    cases = [(hours, n, z, noise, fits[1].values) for hours in HOURS for n in numbers]
    found = np.reshape([*run(shaken, cases)], (-1, DRAWS, 2))
    others = [[f"{hours:g}", *ranges(one, (3, 2))] for hours, one in zip(HOURS, found, strict=True)]
    titles = ["minutes of moves", "left (K)", "least promise", "a parameter undetermined"]
    tables = (
        table(titles, rows),
        table(["hours of shaking", "radius of P", "least promise"], others),
    )
    publish("boards", "\n\n".join(tables) + "\n")


if __name__ == "__main__":
    main()
