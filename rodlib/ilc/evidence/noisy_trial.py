"""What does noise leave of a trial with two ends? Exactly, sample by sample.

In :mod:`~rodlib.ilc.evidence.noise` trials have no ends. In a real one v is missing before the
start. A learning filter with a large gain has coefficients that all but cancel; of a sample of
noise near the start it applies some and not the others, and these do not cancel. Here the filters
themselves tell what the law (23) makes of a trial, ends included:

    v_{k+1} = M v_k - B x_k,    V = M V M^T + B X B^T,    X = cov x_k,

and what learning adds to the error has the covariance P V P^T.
"""

import numpy as np
import xarray as xr
from scipy.fft import idct, irfft, next_fast_len, rfft

from rodlib.ilc import arguments
from rodlib.ilc.evidence.finite_trial import impulse_response
from rodlib.ilc.evidence.noise import NEGLIGIBLE
from rodlib.ilc.filters import LearningOperator, ZeroPhaseButterworth
from rodlib.ilc.law.law import Law
from rodlib.ilc.loop.closed import CurrentTrialLoop, with_noise

FAINT = 1e-3  # gain of Q below which v is taken to have no higher frequencies,
ALL = 200  # in trials that are longer than this
STILL = 1e-2  # relative, by how much a variance may still change in the middle of a short trial
SIDE_BY_SIDE = 50  # signals that the law takes at a time
DOUBLINGS = 50  # of the number of trials, until what is left of the first is negligible


def noise_on_trial(
    loop: CurrentTrialLoop,
    Q: ZeroPhaseButterworth,
    L: LearningOperator,
    samples: int,
    noise,
    *,
    trials: int | None = None,
    rest: int = 0,
    step: float = 1.0,
    plant=None,
) -> xr.Dataset:
    """What white noise that is new in every trial does to a trial that has two ends.

    Parameters
    ----------
    loop, plant :
        As for :func:`rodlib.run_trials`.
    Q, L, rest, step :
        As for :class:`rodlib.Law`, step for the learning gain; the filters act with their own
        `ends`.
    samples : int
        Length of a trial.
    noise : float or array_like, shape (m,)
        Variance of what the sensors add to y in each sample, of all outputs or of each. Coloured
        noise is for :func:`rodlib.trial_noise`, far from the ends.
    trials : int, optional
        The number of the trial that is asked about; 1 is the first, where v = 0. Default: after so
        many that nothing changes any more. If that never happens, a ValueError says so.

    Returns
    -------
    xarray.Dataset
        RMS over all that the noise could have been, at each time and in each channel: `true`, of
        the outputs themselves; `measured`, of e, the error that the controller sees; `learned`, in
        both, of what learning has made of earlier trials. :func:`rodlib.ilc.rms` of one of
        them is that of the trial.

    Notes
    -----
    Long trials are cut short in the middle: the first half of a short trial is the start of the
    long one, the second half its end, and the variance in the middle stands still, to a hundredth
    over a quarter of the short trial, or it is made twice as long. There v is written in cosines,
    up to where Q falls below a thousandth. Both change the RMS of the paper's trial by less than
    a ten-thousandth. Next to an end it may be half a percent in a sample, if the loop is fast or
    the filters hold their ends. A trial of up to 200 samples is exact to rounding.
    """
    law = Law(Q, L, rest, step, loop=loop)
    closed, m = with_noise(loop, plant), loop.plant.noutputs
    samples = arguments.whole("samples", samples, 1)
    trials = None if trials is None else arguments.whole("trials", trials, 1)
    rest = arguments.whole("rest", law.rest, 0, samples - 1)
    noise = arguments.array("noise", noise, (...,))
    noise = arguments.array("noise", noise, (m,) if noise.ndim else ()) * np.ones(m)
    if noise.min() < 0:
        raise ValueError(
            f"noise reaches {noise.min():g}, but a variance is not negative"
        )
    h = impulse_response(closed, samples)
    P, T = h[..., :m], h[..., -m:] * np.sqrt(noise)
    X = T.copy()  # of x: the noise itself, and what the loop makes of it
    X[0] += np.diag(np.sqrt(noise))
    law, slowest = (Q, L, rest, law.gain), np.abs([*closed.poles(), *Q.poles]).max()
    length = 2 * rest + 2 * np.log(STILL) / np.log(min(slowest, arguments.CIRCLE))
    while True:
        length = min(int(np.ceil(length)), samples)
        learned = _learned(P[:length], X[:length], law, trials)
        middle = learned[length * 3 // 8 : length * 5 // 8 + 1]
        if length == samples or np.all(
            np.ptp(middle, axis=0) <= STILL * middle.mean(axis=0)
        ):
            break
        length *= 2
    first = length // 2
    learned = np.insert(learned, [first] * (samples - length), learned[first], axis=0)
    true, measured = ((Y**2).sum(axis=2).cumsum(axis=0) + learned for Y in (T, X))
    power = {"true": true, "measured": measured, "learned": learned}
    time = ("time", loop.Ts * np.arange(samples), {"units": "s"})
    return xr.Dataset(
        {name: (("time", "channel"), np.sqrt(each)) for name, each in power.items()},
        {
            "time": time,
            "channel": np.arange(1, m + 1),
            "output": ("channel", loop.outputs),
        },
    )


def _learned(P, X, law, trials):
    """Variance of P v, shape (time, m), on a trial as long as the impulse responses P and X."""
    length, m, _ = P.shape
    Q, L, rest, step = law
    active = length - rest  # samples of v
    gain = Q.frequency_response(np.arange(active) * np.pi / (active * Q.Ts))
    count = max(np.flatnonzero(gain > FAINT).max() + 1, min(active, ALL))
    cosines = np.pad(
        idct(np.eye(count, active), norm="ortho", axis=1), [(0, 0), (0, rest)]
    )

    def of_impulses(apply, channels, outputs):
        """`outputs` after a filter of impulses at all times in all channels, side by side."""
        parts = []
        for at in range(0, length * channels, SIDE_BY_SIDE):
            one = np.eye(
                min(SIDE_BY_SIDE, length * channels - at), length * channels, at
            )
            out = apply(one.reshape(len(one), length, -1))
            reached = out.any(axis=(0, 2))  # by a short filter few samples
            parts.append(np.tensordot(outputs[:, reached], out[:, reached], (1, 1)))
        return np.concatenate(parts, axis=1)

    of_v = (
        step * of_impulses(Q.apply, 1, cosines)[..., 0]
    )  # what the law makes, in cosines, of v
    of_e = (
        of_impulses(L.apply, m, of_v).reshape(count, length, m, m).transpose(0, 3, 2, 1)
    )
    of_e = of_e.reshape(count * m, m, length)  # and of e
    fast = next_fast_len(2 * length, real=True)
    P, X = (
        rfft(each.transpose(2, 1, 0), fast) for each in (P, X)
    )  # from, to, frequency
    y = irfft(rfft(cosines, fast)[:, None, None] * P, fast)[..., :length].reshape(
        count * m, -1
    )
    V, backward = np.zeros((count * m,) * 2), rfft(of_e[..., ::-1], fast)
    for (
        noise
    ) in X:  # of a sensor, from the last sample, which reaches least, to the first
        added = irfft(np.einsum("cjf,jf->cf", backward, noise), fast)[:, :length]
        V += added @ added.T
    of_e = of_e.reshape(count * m, -1)
    of_v = of_v @ cosines.T + (1 - step) * np.eye(count)
    V = _accumulated(np.kron(of_v, np.eye(m)) - of_e @ y.T, V, trials)
    return np.maximum(((V @ y) * y).sum(axis=0), 0).reshape(m, length).T


def _accumulated(M, added, trials):
    """The sum of M^k `added` M^k^T over all k, or in trial number `trials`, by doubling."""
    if trials is not None:
        total, power = np.zeros_like(added), np.eye(len(M))
        for bit in f"{trials - 1:b}":
            total, power = total + power @ total @ power.T, power @ power
            if bit == "1":
                total, power = added + M @ total @ M.T, M @ power
        return total
    for _ in range(DOUBLINGS):
        added = added + M @ added @ M.T
        M = M @ M
        size = np.linalg.norm(M) ** 2
        if size < NEGLIGIBLE:
            return added
        if size > 1 / NEGLIGIBLE:
            break
    raise ValueError(
        "L does not converge on a trial with two ends: what noise does grows from trial to trial. "
        "Ask about one of them, trials = 10, or hold v at rest at the end"
    )
