"""Our default against what a user would design by hand, and lists of plants against norm-optimal.

`make measure WHAT=peers` runs it and writes its tables to figures/performance.md. All know the same
P and have the same Q. The opponents are tuned on the nominal plant by what they are judged by, the
RMS of the error in trials 2 to 10, with its reference and its very noise; ours is the default,
`synthesise(P, Q)`, and knows neither. A list of plants is that of the rod, all of whose parameters
are off.
"""

import re
import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from kinds import KINDS, bump
from plants_of_peers import PLANTS, double_mass, their_reference
from runner import publish, run, table
from scipy.interpolate import make_interp_spline
from scipy.linalg import solve
from scipy.optimize import minimize
from scipy.stats.qmc import Sobol

from ilctools import (
    ClosedLoop,
    InfeasibleError,
    LearningFilter,
    NormOptimal,
    convergence,
    current_trial_loop,
    frequency_response,
    read_table,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.models import impulse_response
from rodlib import Spread, draw, fit_heat_balance, heat_balance, paper_loop, responses
from rodlib.paper.repository import ROOT

OFF = (1, -1, 2, -2)  # in ten percent
TRIALS, NOISE = 10, 1e-3  # of the largest reference of each channel
HEIGHTS = (1.0, 0.6, 0.8)  # of the references of the channels
LINES = 2**12  # of the response of P, up to the Nyquist frequency
POINTS, FURTHER = 7, 120  # 2^7 points in a box, and steps from the best of them
BEST, WORST = 1.2, 3.0  # times the best of the others: the goals
BOARDS = ("board-1s", "board-3s")
HUGE = 1e30  # of an error: enough
DESIGNS = {
    "ours": "ours",
    "proportional_derivative": "PD",
    "least_squares": "least squares",
    "zero_phase_inversion": "inversion",
    "norm_optimal": "norm-optimal",
}
DRAWS, RODS, OTHERS, SPREAD = 10, 300, 400, 0.2
FILTERS = ((0.2, None), (0.25, None), (0.3, None), (0.3, 3), (0.3, 21))  # b; order of K
ROD_BAND = (1e-4, 0.02)  # rad/s


@dataclass(frozen=True)
class Case:
    """What is known of a plant, the plants to be judged on, of which the first is nominal."""

    known: object
    plants: list
    reference: np.ndarray
    cutoff: float
    noise_size: float = NOISE

    @cached_property
    def noise(self):
        """Of all trials, the same for every law."""
        shape = (TRIALS, *self.reference.shape)
        sizes = self.noise_size * np.abs(self.reference).max(axis=0)
        return sizes * np.random.default_rng(7).standard_normal(shape)

    @cached_property
    def passing(self):
        """Of each plant, what is to be multiplied by the transform of a trial and as many zeros."""
        N = len(self.reference)
        return [np.fft.rfft(impulse_response(P, N), 2 * N, axis=0) for P in self.plants]

    def errors(self, Q, L, number=0):
        """RMS of the error e_k = r - P (r + v_k) of each trial, without the sensors' noise."""
        r, N = self.reference, len(self.reference)
        v, sizes = np.zeros_like(r), []
        for noise in self.noise:
            w = np.fft.rfft(r + v, 2 * N, axis=0)
            y = np.fft.irfft(np.einsum("nij,nj->ni", self.passing[number], w), 2 * N, axis=0)[:N]
            sizes.append(np.sqrt(np.sum((r - y) ** 2) / N))
            if not sizes[-1] < HUGE:
                return np.append(sizes, np.full(TRIALS - len(sizes), HUGE))
            v = Q.apply(v + L.apply(r - y - noise))  # (23)
        return np.array(sizes)


def later(errors):
    """The RMS of trials 2 to 10, in that of the first."""
    return np.sqrt(np.mean(errors[1:] ** 2)) / errors[0]


def fitted(name):
    """The parameters of a heat balance that is fitted to a log."""
    columns = {"time": 0, "inputs": {"Q1": 1, "Q2": 2}, "outputs": {"T1": 3, "T2": 4}}
    log = read_table(ROOT / "data" / "tclab" / f"{name}.csv", **columns)
    return fit_heat_balance(log.u[0], log.y[0], log.Ts).values


def of_board(name):
    """A real heater board; ten percent off is the other one, or as far to the other side."""
    own, other = map(fitted, BOARDS[:: 1 if name == BOARDS[0] else -1])
    model, *off = (heat_balance(*own * (other / own) ** k, 3.0) for k in (0, *OFF))
    sizes = {"T1": 10.0, "T2": 8.0, "Q1": 30.0, "Q2": 40.0}
    loop = current_trial_loop(model, ["Q1", "Q2"], sizes=sizes)
    return Case(loop, [loop.around(P)[:, :2] for P in (model, *off)], bump(300, [12.0, 6.0]), 0.05)


def case_of(name):
    """The case of a name."""
    if name in BOARDS:
        return of_board(name)
    if name in KINDS:
        kinds = [KINDS[name](off) for off in (0, *OFF)]
        kind = kinds[0]
        known = kind.loop if kind.known is None else kind.known
        return Case(known, [each.P for each in kinds], kind.reference, kind.cutoff)
    (P, cutoff, samples), *off = (PLANTS[name](k / 10) for k in (0, *OFF))
    reference = bump(samples, HEIGHTS[: P.noutputs])
    if name == "double_mass":
        reference = their_reference()
    return Case(ClosedLoop(P), [P, *(each for each, *_ in off)], reference, cutoff)


@dataclass(frozen=True)
class Inversion:
    """A response at the lines of a trial that is padded to four times its length."""

    response: np.ndarray
    Ts: float

    def frequency_response(self, omega):
        """Between the lines, by straight ones."""
        lines = 2 * np.pi * np.fft.rfftfreq(2 * len(self.response) - 2, self.Ts)
        return make_interp_spline(lines, self.response, k=1)(omega)

    @property
    def channels(self):
        return self.response.shape[-1]

    def apply(self, signal):
        n = 2 * len(self.response) - 2
        spectrum = np.fft.rfft(signal, n, axis=-2)[..., None]
        return np.fft.irfft((self.response @ spectrum)[..., 0], n, axis=-2)[..., : n // 4, :]


class Opponents:
    """Designs by hand for a P as it is known, each from parameters in a box."""

    def __init__(self, problem, samples):
        self.problem, self.samples, self.Ts = problem, samples, problem.Ts
        self.m, self.cutoff = problem.channels, problem.lowpass.cutoff
        self.omega = np.linspace(0, np.pi / self.Ts, LINES + 1)
        self.P = self.known(self.omega)
        self.size = np.linalg.norm(self.P[self.omega <= self.cutoff], 2, axis=(1, 2)).max()
        self.own = self.P[0].diagonal().real  # gains at rest

    def known(self, omega):
        """P as it is known, at any frequency."""
        if (model := self.problem.response.models[0]) is not None:
            return frequency_response(model, omega)
        at = np.clip(omega, self.problem.omega[0], self.problem.omega[-1])
        return make_interp_spline(self.problem.omega, self.problem.P, k=1)(at)

    @cached_property
    def correlations(self):
        """The inverse transforms of Q^2 P* P and Q^2 P*: normal equations over all lags."""
        square = self.problem.lowpass.frequency_response(self.omega)[:, None, None] ** 2
        adjoint = self.P.conj().swapaxes(1, 2)
        return [np.fft.irfft(square * X, axis=0) for X in (adjoint @ self.P, adjoint)]

    def proportional_derivative(self, parameters):
        """Gain, slope in samples and lead of each channel; three are those of all."""
        sets = np.broadcast_to(10 ** np.reshape(parameters, (-1, 3)), (self.m, 3))
        leads = np.rint(sets[:, 2]).astype(int)
        coefficients = np.zeros((self.m, self.m, leads.max() + 1))
        for i, (gain, slope, _) in enumerate(sets):
            coefficients[i, i, leads[i]] = (1 + slope) * gain / self.own[i]
            coefficients[i, i, leads[i] - 1] -= slope * gain / self.own[i]
        return LearningFilter(coefficients, self.Ts, first=0)

    def least_squares(self, parameters):
        """The filter of so many samples ahead and back with the least sum of |Q (I - P L)|^2.

        A ridge on its coefficients is added.
        """
        ahead, back, ridge = 10 ** np.array(parameters)
        lags, m = np.arange(-int(back), int(np.rint(ahead)) + 1), self.m
        normal, right = self.correlations
        normal = normal[lags - lags[:, None]].swapaxes(1, 2).reshape(len(lags) * m, -1)
        normal = normal + ridge * self.size**2 * np.eye(len(normal))
        x = solve(normal, right[-lags].reshape(-1, m), assume_a="pos").reshape(-1, m, m)
        return LearningFilter(x.transpose(1, 2, 0), self.Ts, first=int(lags[0]))

    def zero_phase_inversion(self, parameters):
        """A gain, a ridge, and the cut-off of a low-pass filter without phase."""
        gain, ridge, cutoff = 10 ** np.array(parameters)
        cutoff = min(cutoff * self.cutoff, 0.99 * np.pi / self.Ts)
        F = zero_phase_butterworth(2, cutoff, self.Ts)
        n = 4 * self.samples
        omega = 2 * np.pi * np.fft.rfftfreq(n, self.Ts)
        P = self.known(omega)
        adjoint = P.conj().swapaxes(1, 2)
        inverse = np.linalg.solve(adjoint @ P + ridge * self.size**2 * np.eye(self.m), adjoint)
        return Inversion(gain * F.frequency_response(omega)[:, None, None] * inverse, self.Ts)

    def norm_optimal(self, parameters):
        """Of a model, with a weight."""
        return NormOptimal(
            self.problem.response.models[0], 10 ** parameters[0] * self.size**2, self.samples
        )


BOXES = {  # powers of ten
    "proportional_derivative": [(-1.5, 0.5), (-2, 2), (0, 2.2)],  # gain P at rest, samples, samples
    "least_squares": [(0, 2.2), (-0.5, 2.2), (-10, 1)],  # samples, samples, in |P|^2
    "zero_phase_inversion": [(-1, 0.3), (-10, 1), (-0.5, 1.5)],  # gain, in |P|^2, in Q's cut-off
    "norm_optimal": [(-10, 1)],  # in |P|^2
}


def tuned(design, box, cost, channels=1):
    """The best of a box: points spread evenly, and Nelder and Mead from the best of them."""

    def of(parameters):
        try:
            return np.log10(cost(design(parameters)))
        except (np.linalg.LinAlgError, RuntimeError, ValueError):
            return np.log10(HUGE)

    low, high = np.transpose(box)
    points = low + (high - low) * Sobol(len(box), seed=0).random_base2(POINTS)
    start = np.tile(min(points, key=of), channels)
    simplex = start + 0.1 * np.vstack([0 * start, np.diag(np.tile(high - low, channels))])
    bounds, options = [*box] * channels, {"initial_simplex": simplex, "maxfev": FURTHER}
    with warnings.catch_warnings(action="ignore"):
        best = minimize(of, start, method="Nelder-Mead", bounds=bounds, options=options).x
    return design(min(best, start, key=of))


def row(name):
    """The designs of a plant, each with its RMS on all plants; None where there is none."""
    case = case_of(name)
    with warnings.catch_warnings(action="ignore"):
        Ts = getattr(case.known, "Ts", None) or case.plants[0].dt
        Q = zero_phase_butterworth(2, case.cutoff, Ts)
        ours = synthesise(case.known, Q)
        opponents = Opponents(ours.problem, len(case.reference))
        designs = {"ours": ours.filter}
        for key, box in BOXES.items():
            if key == "norm_optimal" and ours.problem.response.models[0] is None:
                continue
            channels = opponents.m if key == "proportional_derivative" else 1
            design, cost = getattr(opponents, key), lambda L: later(case.errors(Q, L))
            designs[key] = tuned(design, box, cost, channels)
    numbers = range(len(case.plants))
    left = {
        key: np.array([later(case.errors(Q, L, number)) for number in numbers])
        for key, L in designs.items()
    }
    fifth = None
    if name == "double_mass":
        theirs = Case(None, [double_mass(0.5)[0]], case.reference, case.cutoff, noise_size=0.0)
        size = np.sqrt(len(case.reference))  # from an RMS to a 2-norm
        fifth = {key: size * theirs.errors(Q, L)[[0, 4]] for key, L in designs.items()}
    return name, base_of(ours.problem), left, fifth


def base_of(problem):
    """The b of B, in words."""
    found = re.search(r"with b = (\S+),", "\n".join(problem.chosen))
    return found[1] if found else "none"


def ratios(results):
    """RMS of ours in the least of the others: nominal, and the worst of the plants off."""
    ours, *others = results.values()
    best = np.min([[each[0], each[1:].max()] for each in others], axis=0)
    return np.array([ours[0], ours[1:].max()]) / best


def losses(rows):
    """How many plants are within the goal, and by name those which are not."""
    of = {name: ratios(results) for name, _, results, _ in rows}
    for k, what in enumerate(("on the nominal plant", "on the worst of those off")):
        beyond = {name: each[k] for name, each in of.items() if each[k] > BEST}
        worst = sum(ratio > WORST for ratio in beyond.values())
        named = ", ".join(f"{name} ({ratio:.2g})" for name, ratio in beyond.items()) or "none"
        yield (
            f"Within {BEST} times the best {what}: {len(of) - len(beyond)} of {len(of)}; above "
            f"{WORST:g} times: {worst}. Not within: {named}."
        )


def table_of(rows):
    """The rows as a table in Markdown, what is lost, and the double mass of others."""
    lines, fifth = [], next(each for *_, each in rows if each)
    for name, base, results, _ in rows:
        cells = [
            f"{each[0]:.2g}, {each[1:3].max():.2g}, {each[3:].max():.2g}"
            if (each := results.get(key)) is not None
            else "none"
            for key in DESIGNS
        ]
        nominal, off = ratios(results)
        lines.append([name, base, *cells, f"{nominal:.2f}", f"{off:.2f}"])
    titles = ["plant", "base", *DESIGNS.values(), "ratio", "ratio, off"]
    theirs = ", ".join(f"{DESIGNS[key]} {last:.3f}" for key, (_, last) in fifth.items())
    parts = [table(titles, lines), *losses(rows)]
    first = fifth["ours"][0]
    parts.append(
        f"Double mass, load of 1.5, 2-norm of the error from {first:.2f} in trial 1 to that in "
        f"trial 5: {theirs}; its authors' two laws 0.636 and 0.562."
    )
    return "\n\n".join(parts)


def of_rod(root):
    """Of one draw of rods for the bounds and one to judge: mean of sigma_max(M), and its shares."""
    loop, Q, spread = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0), Spread.of_all(SPREAD)
    omega = np.union1d(np.geomspace(ROD_BAND[0], 0.3, 100), np.linspace(0.3, np.pi, 100))
    bounds, others = (
        responses(loop, [draw(spread, k, 2 * root + i) for k in range(count)], omega)
        for i, count in ((1, RODS), (2, OTHERS))
    )
    P, rows = loop.frequency_response(omega), {}
    size = np.linalg.norm(P[omega <= Q.cutoff], 2, axis=(1, 2)).max()
    choices = {"M_max": 0.97, "band": ROD_BAND}
    for b, order in FILTERS:
        L = NormOptimal(loop.P, b**2, 600)
        if order is not None:
            try:
                with warnings.catch_warnings(action="ignore"):
                    given = [P, *bounds], Q, omega, 1.0
                    L = synthesise(*given, base=b / size, order=order, **choices).filter
            except InfeasibleError:
                rows[b, order] = None
                continue
        nominal = convergence(P, Q, L, omega).mean(ROD_BAND)
        reached = convergence(others, Q, L, omega)
        means, monotone = reached.mean(ROD_BAND), np.mean(reached.gamma < 1)
        rows[b, order] = nominal, np.median(means), np.quantile(means, 0.95), 100 * monotone
    return rows


def table_of_rod(draws):
    """Ranges over the draws, in Markdown."""
    lines = []
    for b, order in FILTERS:
        found = np.array([each for rows in draws if (each := rows[b, order]) is not None]).T
        cells = [
            f"{each.min():.3f} to {each.max():.3f}, {np.median(each):.3f}" for each in found[:3]
        ]
        cells.append(f"{found[3].min():.2f} to {found[3].max():.2f}, {np.median(found[3]):.2f}")
        what = f"B K, b = {b}, {order} taps" if order else f"norm-optimal, b = {b}"
        lines.append([what, *cells, f"{len(draws) - found.shape[1]}"])
    titles = ["L", "nominal", "median", "95 %", "monotone (%)", "infeasible"]
    return table(titles, lines)


if __name__ == "__main__":
    rows = list(run(row, [*KINDS, *PLANTS, *BOARDS]))
    publish("peers", f"{table_of(rows)}\n\n{table_of_rod(list(run(of_rod, range(DRAWS))))}\n")
