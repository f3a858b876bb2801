"""Whether trials converge, told from their signals: what speaks against it is a finding, in words.

Four things are watched: the error, which shall not grow; v, which shall not grow while the error
stays; the outputs, which shall follow v as the loop's model says; and the rate at each frequency,
which shall be no more than was promised. What noise does is told from the trials themselves: in a
converged experiment their errors are independent and alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial

import control
import numpy as np
from scipy.special import fdtrc

from rodlib.ilc.models import frequency_response, state_sequence
from rodlib.ilc.problem.problem import convergence_matrix, largest_singular_values
from rodlib.ilc.units import by_unit

SURE = 1e-4  # probability of a false report by noise, in a trial
RISES = 3  # in a row, from which on the error may be said to grow
GROWTH = 1.5  # of the RMS over these rises; less is not worth a warning
LEAP = 3.0  # times the largest RMS before: growth in one trial
STEPS = 3  # of v, from which on it may be said to walk
ALIGNED = 0.9  # cosine between two steps in the same direction; noise makes it negative
HOLDS = 0.9  # of the first of these that the last one has
STAYS = 0.97  # of the error before that is left
WALKS = 0.3  # of the error, that these steps make together: a slow law does not
MATTERS = 0.2  # of the error: how far the outputs must be foretold to move, to be asked whether
FOLLOWS = 0.5  # of what was foretold: less is none of the model, whatever its accuracy
STANDARD = 3.0  # standard deviations of that share
LEARNED = (
    5.0  # times the noise of one trial, that learning may make of it: see `_loudest`
)
ROUNDING = 1e-9  # of the largest signal
GRID = 200  # frequencies at which the rate of the model is asked for
BREAKS = (
    0.05  # of the error: by how much more must be left in an octave than was promised
)
BACK = 6  # trials in which a rate is compared with the noise of the later ones


@dataclass(frozen=True, eq=False)
class Course:
    """The trials so far, in order: v, e, reference and outputs' names and units."""

    v: np.ndarray  # shape (trial, time, channel)
    e: np.ndarray
    reference: np.ndarray
    outputs: Sequence[str]
    units: Sequence[str]
    first: int = 1  # number of the first trial
    P: control.StateSpace | None = (
        None  # what the outputs shall follow v by; None: not known
    )
    rate: float | None = None  # max sigma(M) of the model with this law, if known
    turned: float | None = None  # and with -L
    sigma: np.ndarray | None = None  # omega Ts and sigma_max(M) there, as two rows

    def findings(self, k: int = -1) -> dict[str, str]:
        """What the trial with the index k says, with those before it, by kind."""
        k = range(len(self.v))[k]
        found = {
            "error": self._grows(k),
            "v": self._walks(k),
            "model": self._contradicts(k),
        }
        found["rate"] = self._breaks_its_promise(k)
        return {kind: text for kind, text in found.items() if text}

    def all_findings(self) -> dict[str, str]:
        """The first finding of each kind."""
        found = {}
        for k in range(1, len(self.v)):
            found = self.findings(k) | found
        return found

    def _named(self, channels):
        return (
            "" if len(channels) == len(self.outputs) else f" of {self._list(channels)}"
        )

    def _list(self, channels):
        return ", ".join(self.outputs[i] for i in channels)

    def _alike(self, k):
        """The first of the trials up to k that have its reference."""
        while k and np.array_equal(self.reference[k - 1], self.reference[k]):
            k -= 1
        return k

    def _grows(self, k):
        start = self._alike(k)
        for channels in by_unit(self.units).values():
            x = size(self.e[start : k + 1, :, channels])
            least = ROUNDING * np.abs(self.reference[k][:, channels]).max()
            x = np.maximum(x, max(least, ROUNDING * x.max(), np.finfo(float).tiny))
            since = len(x) - 1
            while since and x[since - 1] < x[since]:
                since -= 1
            rises = len(x) - 1 - since
            loud = self._loudest() * np.linalg.norm(noise_of(self.e[0][:, channels]))
            if not rises or x[-1] < max(GROWTH * x[since], loud):
                continue
            freedom = freedom_of(self.e[k][:, channels] - self.e[k - 1][:, channels])
            grown, leap = x[-1] / x[since], x[-1] / x[:-1].max()
            slowly = rises >= RISES and by_noise(grown, freedom, rises) < SURE
            if slowly or (leap >= LEAP and by_noise(leap, freedom) < SURE):
                number = self.first + start + since
                return (
                    f"the error{self._named(channels)} grows, by more than noise explains: its RMS "
                    f"was {x[since]:.3g} in trial {number} and is {x[-1]:.3g} in trial "
                    f"{self.first + k}. {self._why(self.e[k][:, channels])}"
                )
        return None

    def _loudest(self):
        """What learning makes of the noise of a trial, at most, if it converges.

        That is sqrt(1 + |Q P L|^2 / (1 - |M|^2)), where Q P L = Q - M is below 1 + |M|.
        """
        known = self.rate is not None and self.rate < 1
        return min(np.sqrt(2 / (1 - self.rate)), 2 * LEARNED) if known else LEARNED

    def _why(self, e):
        """Where it grows, and what the model says of growth."""
        remedy = "learn less, by a lower cut-off or a smaller step"
        if self.turned is not None and self.turned < 1 <= self.rate:
            return (
                f"By the loop's own model sigma_max(M) reaches {self.rate:.3g}, but with -L only "
                f"{self.turned:.3g}: likely L has the wrong sign, as for e = y - reference"
            )
        power, tenth = np.sum((e / np.abs(e).max()) ** 2, axis=1), max(1, len(e) // 10)
        for part, where, cure in (
            (power[:tenth], "first", "let the reference rest at first"),
            (power[-tenth:], "last", "let v rest there"),
        ):
            if part.sum() > power.sum() / 2:
                return (
                    f"Most of it is in the {where} tenth of the trial, where the filters reach "
                    f"beyond what was recorded: {cure}, or choose other ends of Q and L"
                )
        if self.rate is None:
            return f"If nothing new disturbs the trials, the law diverges: {remedy}"
        if self.rate >= 1:
            return f"By the loop's own model sigma_max(M) reaches {self.rate:.3g}: {remedy}"
        return (
            f"By the loop's model it would not, as sigma_max(M) <= {self.rate:.3g}: if nothing new "
            f"disturbs the trials, the plant is another. Measure P (shake), or {remedy}"
        )

    def _walks(self, k):
        if k < self._alike(k) + STEPS:
            return None
        for channels in by_unit(self.units).values():
            v, e = (s[k - STEPS : k + 1][:, :, channels] for s in (self.v, self.e))
            steps, x, length = np.diff(v, axis=0), size(e), size(v)
            s = size(steps)
            if not s.min() > ROUNDING * length.max() or not np.all(np.diff(length) > 0):
                continue
            cosines = (steps[1:] * steps[:-1]).sum(axis=2).mean(axis=1) / (
                s[1:] * s[:-1]
            )
            walked = size((v[-1] - v[0])[None])[0]
            if (
                cosines.min() >= ALIGNED
                and s[-1] >= HOLDS * s[0]
                and STAYS <= x[-1] / x[0] < GROWTH
                and walked >= WALKS * x[-1]
            ):
                return (
                    f"v{self._named(channels)} grows while the error does not fall: by "
                    f"{s[-1]:.3g} a trial, always in the same direction, and the RMS of the error "
                    f"is {x[0]:.3g} in trial {self.first + k - STEPS} and {x[-1]:.3g} in trial "
                    f"{self.first + k}. An actuator at its limit, perhaps: what the plant cannot "
                    "follow is no error to learn from"
                )
        return None

    def _contradicts(self, k):
        """Twice in succession, as something new may have disturbed one trial."""
        if self.P is None or k < 2:
            return None
        lags = self._lags(k)
        worst = np.flatnonzero(~np.isnan(lags + self._lags(k - 1)))
        if not worst.size:
            return None
        return (
            f"{self._list(worst)} of trials {self.first + k - 1} and {self.first + k} contradict "
            f"the loop's model: of what v was to change in them, {lags[worst].min():.0%} "
            "came, and the error does not fall. Look for a sensor or an actuator that is at its "
            "limit, exchanged or reversed; else measure P (shake)"
        )

    def _lags(self, k):
        """The share in which each output followed the change of w; NaN if it did, or may have."""
        w = self.reference[[k - 1, k]] + self.v[[k - 1, k]]
        change = w[1] - w[0]
        shares = np.full(change.shape[1], np.nan)
        x = np.sqrt(np.mean(self.e[[k - 1, k]] ** 2, axis=1))
        if not np.any(x[1] > STAYS * x[0]):
            return shares
        foretold = self._answer(change)
        y = self.reference[[k - 1, k]] - self.e[[k - 1, k]]
        moved = y[1] - y[0]
        for i in np.flatnonzero(x[1] > STAYS * x[0]):
            length = np.sqrt(np.mean(foretold[:, i] ** 2))
            if length <= max(MATTERS * x[1, i], ROUNDING * np.abs(y).max()):
                continue
            share = np.mean(moved[:, i] * foretold[:, i]) / length**2
            rest = moved[:, [i]] - share * foretold[:, [i]]
            deviation = size(rest[None])[0] / length / np.sqrt(freedom_of(rest))
            if share + STANDARD * deviation < FOLLOWS:
                shares[i] = share
        return shares

    def _answer(self, change):
        """What a change of w does to the outputs, by the model."""
        states = state_sequence(self.P.A, change @ self.P.B.T, np.zeros(self.P.nstates))
        return states @ self.P.C.T + change @ self.P.D.T

    def reached(self, k: int, channels=slice(None)) -> dict[str, np.ndarray]:
        """By octaves, up to `frequency` (rad/s): what trial k + 1 has of the error of trial k.

        `promised` is sigma_max(M), for endless trials; `foretold` is what the model makes of the v
        that was recorded, ends included; `noise` the share of white noise, as large as neighbours
        in time differ; `before` is the RMS of the error of trial k.
        """
        moved = np.diff((self.reference + self.v)[k : k + 2], axis=0)[0]
        foretold = (
            self.e[k] + self.reference[k + 1] - self.reference[k] - self._answer(moved)
        )
        signals = np.stack([self.e[k], foretold, self.e[k + 1]])[..., channels]
        before, *after = amplitudes(signals)
        edges = (
            np.append(octaves(len(moved)), len(moved) // 2 + 1) * 2 * np.pi / len(moved)
        )
        within = np.geomspace(np.maximum(edges[:-1], self.sigma[0, 0]), edges[1:], 9)
        promised = np.interp(within, *self.sigma).max(axis=0)
        white = np.linalg.norm(noise_of(self.e[k + 1][:, channels]))
        noise = white * np.sqrt(np.diff(edges) / edges[-1])
        before = np.maximum(before, np.finfo(float).tiny)
        shares = dict(
            zip(("foretold", "reached", "noise"), (*after, noise) / before, strict=True)
        )
        return {
            "frequency": edges[1:] / self.P.dt,
            "before": before,
            "promised": promised,
        } | shares

    def _breaks_its_promise(self, k):
        """Falls less than promised, by more than noise, which is how the last trials differ."""
        start = max(self._alike(k), k - BACK)
        if self.P is None or self.sigma is None or k < start + 4:
            return None
        for channels in by_unit(self.units).values():
            e = self.e[start : k + 1][:, :, channels]
            e = e / max(np.abs(e).max(), np.finfo(float).tiny)
            x, total = amplitudes(e), size(e)
            changed = np.diff(e, axis=0).swapaxes(1, 2)[
                ..., None
            ]  # each channel by itself
            power = power_of(changed) / 2  # if it was noise, that of one trial
            noise = by_octave(power.sum(axis=1))
            squares = by_octave((power[-1] ** 2).sum(axis=0)) + ROUNDING**4
            freedom = np.maximum(2, 2 * noise[-1] ** 2 / squares)
            for i in range(k - start - 3):
                if not np.any(x[i + 1] > BREAKS * total[i]):
                    continue
                of = self.reached(start + i, channels)
                excess = x[i + 1] - np.maximum(of["promised"], of["foretold"]) * x[i]
                later = noise[i + 2 :][-3:]
                ratio = np.maximum(excess, 0) ** 2 / (later.mean(axis=0) + ROUNDING**2)
                chance = fdtrc(freedom, freedom * (len(later) + 1) / 2, ratio) * len(
                    ratio
                )
                broken = (
                    (chance < SURE) & (excess > BREAKS * total[i]) & (x[i + 1] < x[i])
                )
                if broken.any():
                    return self._slowly(start + i, np.argmax(broken * excess), channels)
        return None

    def _slowly(self, k, octave, channels):
        """What is said of a rate that is not the one promised."""
        of = {
            name: values[octave] for name, values in self.reached(k, channels).items()
        }
        return (
            f"the rate is not the promised one: up to {of['frequency']:.2g} rad/s, trial "
            f"{self.first + k + 1} has {of['reached']:.2f} of the error{self._named(channels)} of "
            f"the one before; the loop's model foretells {of['foretold']:.2f}, sigma_max(M) is "
            f"{of['promised']:.2f} at most, and noise is less. If nothing new disturbed it, the "
            "plant is another: measure P (shake), or expect what was reached"
        )


def octaves(samples: int) -> np.ndarray:
    """The first harmonic of each octave of a trial's spectrum: 0, 2, 4, 8, ..."""
    return np.append(0, 2 ** np.arange(1, (samples // 2).bit_length()))


def power_of(signals) -> np.ndarray:
    """Mean square of signals (..., time, channel) at each harmonic, summed over the channels."""
    samples = signals.shape[-2]
    power = np.sum(np.abs(np.fft.rfft(signals, axis=-2) / samples) ** 2, axis=-1)
    power[..., 1 : (samples + 1) // 2] *= 2
    return power


def amplitudes(signals) -> np.ndarray:
    """RMS of signals (..., time, channel) in each octave, summed over the channels."""
    largest = max(np.abs(signals).max(), np.finfo(float).tiny)
    return largest * np.sqrt(by_octave(power_of(signals / largest)))


def by_octave(lines) -> np.ndarray:
    """Sums of what stands at the harmonics, octave by octave."""
    return np.add.reduceat(lines, octaves(2 * lines.shape[-1] - 2), axis=-1)


def size(signals) -> np.ndarray:
    """The RMS of each of the signals (trial, time, channel), summed over the channels."""
    largest = np.abs(signals).max(
        initial=np.finfo(float).tiny
    )  # whose square may be no number
    return largest * np.sqrt(np.sum((signals / largest) ** 2, axis=2).mean(axis=1))


def noise_of(signals) -> np.ndarray:
    """Standard deviation of white noise in signals (time, channel), from neighbours in time."""
    if len(signals) < 3:
        return np.zeros(signals.shape[1])
    largest = max(np.abs(signals).max(), np.finfo(float).tiny)
    return largest * np.sqrt(
        np.mean(np.diff(signals / largest, 2, axis=0) ** 2, axis=0) / 6
    )


def freedom_of(signal) -> float:
    """How many independent values a signal (time, channel) is worth, from its spectrum."""
    power = np.abs(np.fft.rfft(signal / max(np.abs(signal).max(), 1e-300), axis=0)) ** 2
    return 2.0 if not power.any() else max(2.0, 2 * power.sum() ** 2 / np.sum(power**2))


def by_noise(ratio, freedom, rises=None) -> float:
    """Probability that of independent, alike errors the last is `ratio` times the first.

    Two mean squares of so many degrees of freedom have a ratio that is F-distributed. With `rises`,
    so many of them in a row besides: of all orders of the errors, that is one.
    """
    exceeds = fdtrc(freedom, freedom, min(ratio, 1e100) ** 2)
    if rises is None:
        return exceeds
    return min(1.0, rises * (rises + 1) * exceeds) / factorial(min(rises + 1, 100))


def rates_of(P: control.StateSpace, Q, L) -> tuple[float, float, np.ndarray]:
    """max sigma(M) of a model with a law, and with -L; and where: omega Ts, sigma(M). Lemma 1."""
    grid = np.geomspace(1e-4, 1, GRID) * np.pi
    responses = frequency_response(P, grid / Q.Ts), Q.frequency_response(grid / Q.Ts)
    L = L.frequency_response(grid / Q.Ts)
    M, turned = (
        largest_singular_values(convergence_matrix(*responses, response))
        for response in (L, -L)
    )
    return float(M.max()), float(turned.max()), np.stack([grid, M])
