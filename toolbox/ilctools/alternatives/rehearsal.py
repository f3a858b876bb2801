"""One judge for every learning filter, trials on a plant known by its response; and one search.

Every design gets as many evaluations, and the same criterion.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft
from scipy.optimize import minimize
from scipy.stats import qmc

from ilctools import arguments, rate
from ilctools.filters import LearningOperator, ZeroPhaseButterworth, check_learning
from ilctools.law.law import Law
from ilctools.trials.run import learn

JUDGED = 500  # lines at which the rate is computed, spaced by their logarithms
EDGE = 0.05  # of the width of a box: a best value so close to its end is not inside
WORST = 1e9  # what a tuning costs that leads to no filter


@dataclass(frozen=True)
class Rehearsal:
    """Trials of finite length under the law (23), e_k = alone_k - P v_k, for one L after another.

    What :func:`ilctools.run_trials` computes from models is computed from what a plant does without
    learning, and from its response to v: both may be those of a rod for which there is no model,
    or a record.

    Attributes
    ----------
    P : ndarray, shape (samples + 1, m, m), complex
        Response of the loop at :func:`lines`. It must have decayed after a trial.
    Q : ZeroPhaseButterworth
    alone : ndarray, shape (trials, samples, m)
        Error of each trial without learning, with all noise and disturbances.
    rest : int
        Of :class:`ilctools.Law`.
    """

    P: np.ndarray
    Q: ZeroPhaseButterworth
    alone: np.ndarray
    rest: int = 0

    def __post_init__(self):
        arguments.instance("Q", self.Q, ZeroPhaseButterworth)
        alone = arguments.array("alone", self.alone, ("trial", "time", "m"))
        _, samples, m = alone.shape
        P = arguments.array("P", self.P, (samples + 1, m, m), complex)
        arguments.whole("rest", self.rest, 0, samples - 1)
        vars(self).update(alone=alone, P=P)

    def rate(self, L: LearningOperator) -> float:
        """Of Lemma 1, the largest sigma_max(M), at `JUDGED` of the lines."""
        samples = self.alone.shape[1]
        spaced = np.geomspace(1, samples, JUDGED).round().astype(int)
        at = np.unique(np.append(0, spaced))
        omega = lines(samples, self.Q.Ts)[at]
        return float(rate(self.P[at], self.Q, L, omega).gamma)

    def errors(self, L: LearningOperator) -> np.ndarray:
        """e_k, shape (trials, samples, m)."""
        trials, samples, m = self.alone.shape
        law = Law(self.Q, L, self.rest)
        check_learning(L, m)

        def trial(k, v):
            spectrum = rfft(v, 2 * samples, axis=0)
            Pv = irfft(np.einsum("nij,nj->ni", self.P, spectrum), axis=0)
            return {"e": self.alone[k] - Pv[:samples]}

        return learn(trial, law, law.first(samples), trials)

    def rms(self, L: LearningOperator) -> np.ndarray:
        """RMS(e_k) of Section IV, shape (trials,)."""
        return np.sqrt((self.errors(L) ** 2).sum(axis=2).mean(axis=1))


def lines(samples: int, Ts: float) -> np.ndarray:
    """Frequencies (rad/s) of a trial that is followed by as many zeros, shape (samples + 1,)."""
    samples = arguments.whole("samples", samples, 1)
    Ts = arguments.sampling_period("Ts", Ts)
    return 2 * np.pi * np.fft.rfftfreq(2 * samples, Ts)


@dataclass(frozen=True)
class Tuned:
    """The best that was found of a design."""

    parameters: dict[str, float]  # by name
    filter: LearningOperator
    value: float  # of the criterion


def tune(
    design: Callable,
    box: dict[str, tuple[float, float]],
    rehearsal: Rehearsal,
    M_max: float = 0.9,
    evaluations: int = 24,
) -> Tuned:
    """Search for the parameters of a design with which the trials are best.

    The criterion is the sum of RMS(e_k) over all trials but the first, rehearsed on the model of
    the design, with a rate of at most `M_max`. It counts speed, what is left in the end, and what
    noise and the ends of a trial do. Half of the evaluations are spread over the box (Halton's
    sequence), by the logarithms of the parameters; the others follow Nelder and Mead from the best.

    Parameters
    ----------
    design : callable
        From the parameters, by name, to a filter, or to what has one as its ``filter``, as a
        :class:`.Synthesis` does; a ValueError says that there is none.
    box : dict
        Lowest and highest value of each parameter, above zero; of whole numbers, whole numbers.
    rehearsal : Rehearsal
    M_max : float
        In (0, 1).
    evaluations : int
        Number of filters tried, four or more.

    Returns
    -------
    Tuned
        If no tuning that was tried converges at that rate, a ValueError says so; if the best one
        is at an edge of the box, a warning does.
    """
    arguments.instance("design", design, Callable)
    arguments.instance("rehearsal", rehearsal, Rehearsal)
    M_max = arguments.number("M_max", M_max, "in (0, 1)", 0, 1)
    evaluations = arguments.whole("evaluations", evaluations, 4)
    arguments.instance("box", box, dict)
    for name, ends in box.items():
        low, high = arguments.array(f"box[{name!r}]", ends, (2,))
        if not 0 < low < high:
            raise ValueError(f"box[{name!r}] = {ends} must be 0 < lowest < highest")
    low, high = np.log(list(box.values())).T
    candidates = []

    def cost(x):
        values = np.exp(low + x * (high - low)).tolist()
        parameters = dict(zip(box, values, strict=True))
        for name, (least, _) in box.items():
            if isinstance(least, int):
                parameters[name] = round(parameters[name])
        try:
            result = design(**parameters)
        except ValueError:
            return WORST
        L = getattr(result, "filter", result)
        arguments.instance(f"design(**{parameters})", L, LearningOperator)
        rate = rehearsal.rate(L)
        if rate > M_max * (1 + 1e-6):
            return WORST * rate / (1 + rate)  # towards a lower rate
        value = float(rehearsal.rms(L)[1:].sum())
        candidates.append(Tuned(parameters, L, value))
        return value

    spread = qmc.Halton(len(box), scramble=False).random(evaluations // 2 + 1)[1:]
    first = spread[np.argmin([cost(x) for x in spread])]
    toward = np.where(first < 0.5, 0.15, -0.15)
    simplex = np.vstack([first, first + np.diag(toward)])
    options = {"maxfev": evaluations - len(spread), "initial_simplex": simplex}
    bounds = [(0, 1)] * len(box)
    minimize(cost, first, method="Nelder-Mead", bounds=bounds, options=options)
    if not candidates:
        raise ValueError(f"design reaches a rate of M_max = {M_max} nowhere in box = {box}")
    best = min(candidates, key=lambda tuned: tuned.value)
    x = (np.log(list(best.parameters.values())) - low) / (high - low)
    for name, at in zip(box, x, strict=True):
        if abs(at - 0.5) > 0.5 - EDGE:
            found = f"{name} = {best.parameters[name]:.3g}"
            edge = f"{found} is at the edge of box[{name!r}] = {box[name]}"
            warnings.warn(f"{edge}: widen it", stacklevel=2)
    return best
