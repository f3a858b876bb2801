"""Our default against what a user would design by hand.

`make measure WHAT=peers` runs it and writes its table to figures/performance.md. All know the same
P and have the same Q. The opponents are tuned on the nominal plant by what they are judged by, the
RMS of the error in trials 2 to 10, with its reference and its very noise; ours is the default,
`synthesise(P, Q)`, and knows neither.
"""

import re
import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from kinds import KINDS, bump
from runner import publish, run, table
from scipy.interpolate import make_interp_spline
from scipy.linalg import solve
from scipy.optimize import minimize
from scipy.stats.qmc import Sobol

from ilctools import (
    LearningFilter,
    NormOptimal,
    current_trial_loop,
    frequency_response,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.models import impulse_response
from rodlib import heat_balance

OFF = (1, -1, 2, -2)  # in ten percent
TRIALS, NOISE = 10, 1e-3  # of the largest reference of each channel
LINES = 2**12  # of the response of P, up to the Nyquist frequency
POINTS, FURTHER = 7, 120  # 2^7 points in a box, and steps from the best of them
BEST, WORST = 1.2, 3.0  # times the best of the others: the goals
BOARDS = {  # a heat balance, as notebook 13 fits it to each log
    "board-1s": (0.00331009, 0.00182322, 0.0051606, 0.00175896, 18.1419),
    "board-3s": (0.00361772, 0.00145475, 0.00512376, 0.00272151, 19.8653),
}
HUGE = 1e30  # of an error: enough


@dataclass(frozen=True)
class Case:
    """What is known of a plant, the plants to be judged on, of which the first is nominal."""

    known: object
    plants: list
    reference: np.ndarray
    cutoff: float

    @cached_property
    def noise(self):
        """Of all trials, the same for every law."""
        shape = (TRIALS, *self.reference.shape)
        sizes = NOISE * np.abs(self.reference).max(axis=0)
        return sizes * np.random.default_rng(7).standard_normal(shape)

    @cached_property
    def passing(self):
        """Of each plant, what is to be multiplied by the transform of a trial and as many zeros."""
        N = len(self.reference)
        return [np.fft.rfft(impulse_response(P, N), 2 * N, axis=0) for P in self.plants]

    def errors(self, Q, L, number=0):
        """RMS of the error e_k = r - P (r + v_k) of each trial, without the sensors' noise."""
        r, N = self.reference, len(self.reference)
        v, sizes = np.zeros_like(r), np.full(TRIALS, HUGE)
        for k, noise in enumerate(self.noise):
            w = np.fft.rfft(r + v, 2 * N, axis=0)
            y = np.fft.irfft(np.einsum("nij,nj->ni", self.passing[number], w), 2 * N, axis=0)[:N]
            sizes[k] = np.sqrt(np.sum((r - y) ** 2) / N)
            if not sizes[k] < HUGE:
                break
            v = Q.apply(v + L.apply(r - y - noise))  # (23)
        return sizes


def later(errors):
    """The RMS of trials 2 to 10, in that of the first."""
    return np.sqrt(np.mean(errors[1:] ** 2)) / errors[0]


def of_board(name):
    """A real heater board; ten percent off is the other one, or as far to the other side."""
    own = np.array(BOARDS[name])
    [other] = (np.array(values) for board, values in BOARDS.items() if board != name)
    model, *off = (heat_balance(*own * (other / own) ** k, 3.0) for k in (0, *OFF))
    sizes = {"T1": 10.0, "T2": 8.0, "Q1": 30.0, "Q2": 40.0}
    loop = current_trial_loop(model, ["Q1", "Q2"], sizes=sizes)
    return Case(loop, [loop.around(P)[:, :2] for P in (model, *off)], bump(300, [12.0, 6.0]), 0.05)


def case_of(name):
    """The case of a name."""
    if name in BOARDS:
        return of_board(name)
    kind, *off = (KINDS[name](k) for k in (0, *OFF))
    return Case(kind.given, [each.P for each in (kind, *off)], kind.reference, kind.cutoff)


@dataclass(frozen=True)
class Inversion:
    """A response at the lines of a trial that is padded to four times its length."""

    response: np.ndarray

    def apply(self, signal):
        n = 4 * len(signal)
        spectrum = np.fft.rfft(signal, n, axis=0)[..., None]
        return np.fft.irfft((self.response @ spectrum)[..., 0], n, axis=0)[: len(signal)]


def size_of(P, omega, Q):
    """The largest sigma_max(P) up to the cut-off."""
    return np.linalg.norm(P[omega <= Q.cutoff], 2, axis=(1, 2)).max()


def opponents(problem, samples):
    """Designs by hand for a P as it is known, by name, each from parameters in a box.

    The boxes are in powers of ten; with them is for how many channels one by one.
    """
    m, Ts, Q, model = problem.channels, problem.Ts, problem.lowpass, problem.response.models[0]

    def known(omega):
        """P as it is known, at any frequency, and P*."""
        if model is not None:
            P = frequency_response(model, omega)
        else:
            at = np.clip(omega, problem.omega[0], problem.omega[-1])
            P = make_interp_spline(problem.omega, problem.P, k=1)(at)
        return P, P.conj().swapaxes(1, 2)

    omega = np.linspace(0, np.pi / Ts, LINES + 1)
    P, adjoint = known(omega)
    at_rest, size = P[0].diagonal().real, size_of(P, omega, Q) ** 2
    square = Q.frequency_response(omega)[:, None, None] ** 2
    # The inverse transforms of Q^2 P* P and Q^2 P*: normal equations over all lags.
    correlations = [np.fft.irfft(square * X, axis=0) for X in (adjoint @ P, adjoint)]
    lines = 2 * np.pi * np.fft.rfftfreq(4 * samples, Ts)
    P_lines, adjoint_lines = known(lines)

    def proportional_derivative(parameters):
        """Gain, slope in samples and lead of each channel; three are those of all."""
        gain, slope, lead = np.broadcast_to(10 ** np.reshape(parameters, (-1, 3)), (m, 3)).T
        own, lead = np.arange(m), np.rint(lead).astype(int)
        coefficients = np.zeros((m, m, lead.max() + 1))
        coefficients[own, own, lead] = (1 + slope) * gain / at_rest
        coefficients[own, own, lead - 1] = -slope * gain / at_rest
        return LearningFilter(coefficients, Ts, first=0)

    def least_squares(parameters):
        """The filter of so many samples ahead and back with the least sum of |Q (I - P L)|^2.

        A ridge on its coefficients is added.
        """
        ahead, back, ridge = 10 ** np.array(parameters)
        lags = np.arange(-int(back), int(np.rint(ahead)) + 1)
        normal, right = correlations
        normal = normal[lags - lags[:, None]].swapaxes(1, 2).reshape(len(lags) * m, -1)
        normal = normal + ridge * size * np.eye(len(normal))
        x = solve(normal, right[-lags].reshape(-1, m), assume_a="pos").reshape(-1, m, m)
        return LearningFilter(x.transpose(1, 2, 0), Ts, first=int(lags[0]))

    def zero_phase_inversion(parameters):
        """A gain, a ridge, and the cut-off of a low-pass filter without phase."""
        gain, ridge, cutoff = 10 ** np.array(parameters)
        F = zero_phase_butterworth(2, min(cutoff * Q.cutoff, 0.99 * np.pi / Ts), Ts)
        normal = adjoint_lines @ P_lines + ridge * size * np.eye(m)
        inverse = np.linalg.solve(normal, adjoint_lines)
        return Inversion(gain * F.frequency_response(lines)[:, None, None] * inverse)

    def norm_optimal(parameters):
        """Of a model, with a weight."""
        return NormOptimal(model, 10 ** parameters[0] * size, samples)

    ridge = (-10, 1)  # in |P|^2
    designs = {
        "PD": (proportional_derivative, [(-1.5, 0.5), (-2, 2), (0, 2.2)], m),
        "least squares": (least_squares, [(0, 2.2), (-0.5, 2.2), ridge], 1),
        "inversion": (zero_phase_inversion, [(-1, 0.3), ridge, (-0.5, 1.5)], 1),
    }
    if model is not None:
        designs["norm-optimal"] = norm_optimal, [ridge], 1
    return designs


def tuned(design, box, channels, cost):
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
    """The designs of a plant, each with its RMS on all plants."""
    case = case_of(name)
    with warnings.catch_warnings(action="ignore"):
        Q = zero_phase_butterworth(2, case.cutoff, case.plants[0].dt)
        ours = synthesise(case.known, Q)
        laws = {"ours": ours.filter}
        for key, design in opponents(ours.problem, len(case.reference)).items():
            laws[key] = tuned(*design, lambda L: later(case.errors(Q, L)))
    left = {
        key: np.array([later(case.errors(Q, L, number)) for number in range(1 + len(OFF))])
        for key, L in laws.items()
    }
    return name, base_of(ours.problem), left


def base_of(problem):
    """The b of B, in words."""
    found = re.search(r"with b = (\S+),", "\n".join(problem.chosen))
    return found[1] if found else "none"


def ratios(results):
    """RMS of ours in the least of the others: nominal, and the worst of the plants off."""
    ours, *others = np.array([[each[0], each[1:].max()] for each in results.values()])
    return ours / np.min(others, axis=0)


def losses(rows):
    """How many plants are within the goal, and by name those which are not."""
    of = pd.DataFrame({name: ratios(results) for name, _, results in rows})
    for (_, each), what in zip(of.iterrows(), ("nominal plant", "worst of those off"), strict=True):
        beyond = each[each > BEST]
        named = ", ".join(f"{name} ({ratio:.2g})" for name, ratio in beyond.items()) or "none"
        yield (
            f"Within {BEST} times the best on the {what}: {len(each) - len(beyond)} of {len(each)};"
            f" above {WORST:g} times: {sum(beyond > WORST)}. Not within: {named}."
        )


def table_of(rows):
    """The rows as a table in Markdown, and what is lost."""
    lines, laws = [], ["ours", "PD", "least squares", "inversion", "norm-optimal"]
    for name, base, results in rows:
        cells = dict.fromkeys(laws, "none") | {
            law: f"{each[0]:.2g}, {each[1:3].max():.2g}, {each[3:].max():.2g}"
            for law, each in results.items()
        }
        lines.append([name, base, *cells.values(), *(f"{ratio:.2f}" for ratio in ratios(results))])
    titles = ["plant", "base", *laws, "ratio", "ratio, off"]
    return "\n\n".join([table(titles, lines), *losses(rows)])


if __name__ == "__main__":
    publish("peers", table_of(list(run(row, [*KINDS, *BOARDS]))) + "\n")
