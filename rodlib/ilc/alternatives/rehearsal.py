"""Trials on a plant that is known by its response: the same judge for every learning filter."""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft

from rodlib.ilc import arguments
from rodlib.ilc.evidence import rate
from rodlib.ilc.filters import LearningOperator, ZeroPhaseButterworth, check_learning, update
from rodlib.ilc.trials import learn

JUDGED = 500  # lines at which the rate is computed, spaced by their logarithms


@dataclass(frozen=True)
class Rehearsal:
    """Trials of finite length under the law (23), e_k = alone_k - P v_k, for one L after another.

    What :func:`rodlib.run_trials` computes from models is computed from what a plant does without
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
        Of :func:`rodlib.update`.
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
        rest = arguments.whole("rest", self.rest, 0, samples - 1)
        for name, value in {"alone": alone, "P": P, "rest": rest}.items():
            object.__setattr__(self, name, value)

    def rate(self, L: LearningOperator) -> float:
        """Of Lemma 1, the largest sigma_max(M), at `JUDGED` of the lines."""
        samples = self.alone.shape[1]
        chosen = np.unique(np.append(0, np.geomspace(1, samples, JUDGED).round().astype(int)))
        return float(rate(self.P[chosen], self.Q, L, lines(samples, self.Q.Ts)[chosen]).gamma)

    def errors(self, L: LearningOperator) -> np.ndarray:
        """e_k, shape (trials, samples, m)."""
        trials, samples, m = self.alone.shape
        check_learning(L, m)

        def run(k, v):
            Pv = self.P @ rfft(v, 2 * samples, axis=0)[..., None]
            return self.alone[k] - irfft(Pv[..., 0], 2 * samples, axis=0)[:samples]

        def following(k, v, e):
            return update(v, e, self.Q, L, self.rest)

        return learn(run, np.zeros_like(self.alone[0]), following, trials)

    def rms(self, L: LearningOperator) -> np.ndarray:
        """RMS(e_k) of Section IV, shape (trials,)."""
        return np.sqrt((self.errors(L) ** 2).sum(axis=2).mean(axis=1))


def lines(samples: int, Ts: float) -> np.ndarray:
    """Frequencies (rad/s) of a trial that is followed by as many zeros, shape (samples + 1,)."""
    samples, Ts = arguments.whole("samples", samples, 1), arguments.sampling_period("Ts", Ts)
    return 2 * np.pi * np.fft.rfftfreq(2 * samples, Ts)
