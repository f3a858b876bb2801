"""What noise and random disturbances, new in every trial, leave of the error.

A disturbance that repeats is learned. What is new in trial k, learning takes for an error that
will come again, and passes it on to all later trials. With n_k in the measured outputs and d_k as
a disturbance, the loop without learning deviates by

    t_k = T n_k + G d_k (the true outputs),    x_k = n_k + t_k (the measured ones, which e shows),

T and G being the closed loop's responses; with learning P v_k comes on top. As Q is a scalar,
v_{k+1} = Q (v_k + L e_k) with e_k = e_0 - P v_k - x_k gives for the random part p_k of P v_k

    p_{k+1} = M p_k - Q P L x_k,    M = Q (I - P L).

p_k depends on earlier trials alone, and so is independent of x_k and t_k: spectral densities add.
If sigma_max(M) <= c < 1, that of p_k has a trace of at most tr(Q P L Phi_x (Q P L)^H) / (1 - c^2).
A learning gain a takes the place of M by (1 - a) I + a M, and of Q P L by a Q P L.

This is for trials without ends, as Lemma 1 is: :func:`trial_noise`, :func:`converged_noise`. In a
real trial v is missing before the start. A learning filter with a large gain has coefficients that
all but cancel; of a sample of noise near the start it applies some and not the others, and these
do not cancel. :func:`noise_on_trial` computes what the law (23) makes of a trial, ends included:

    v_{k+1} = M v_k - B x_k,    V = M V M^T + B X B^T,    X = cov x_k,

and what learning adds to the error has the covariance P V P^T.
"""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from scipy.fft import idct
from scipy.signal import fftconvolve

from ilctools import arguments
from ilctools.evidence.convergence import convergence
from ilctools.filters import LearningOperator
from ilctools.law.law import Law
from ilctools.loop.closed import CurrentTrialLoop, with_noise
from ilctools.models import frequency_response, impulse_response
from ilctools.problem.problem import convergence_matrix
from ilctools.signals import check_match

FAINT = 1e-3  # gain of Q below which v is taken to have no higher frequencies,
ALL = 200  # in trials that are longer than this
STILL = 1e-2  # relative, by how much a variance may still change in the middle of a short trial
NEGLIGIBLE = 1e-17  # share of the noise of the first trial that is no longer added up
SIDE_BY_SIDE = 50  # samples whose noise the law takes at a time, for the memory of it
DOUBLINGS = 50  # of the number of trials, until that is reached


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Spectral density of m random signals.

    Its mean over all frequencies is the covariance, so that white noise has its variance as its
    density. One in unit^2 / Hz, counted over positive frequencies, is 2 Ts times as large.
    """

    omega: np.ndarray  # (n,), rad/s
    Ts: float  # s
    density: np.ndarray  # (n, m, m), complex

    @property
    def rms(self) -> np.ndarray:
        """Of each signal, (m,), by trapezia; beyond the frequencies the density stands still."""
        points = [0, *self.omega, np.pi / self.Ts]
        power = np.einsum("nii->ni", self.density).real
        power = np.pad(power, [(1, 1), (0, 0)], mode="edge")
        return np.sqrt(np.trapezoid(power, points, axis=0) * self.Ts / np.pi)

    @property
    def total(self) -> float:
        """Root of the sum of their squares, as in :func:`ilctools.rms`."""
        return float(np.linalg.norm(self.rms))

    def __add__(self, other: "Spectrum") -> "Spectrum":
        """That of the sum with independent signals, at the same frequencies."""
        return replace(self, density=self.density + other.density)


@dataclass(frozen=True, eq=False)
class TrialNoise:
    """What is random in a trial. Made by :func:`trial_noise` and :func:`converged_noise`."""

    P: np.ndarray  # (n, m, m): frequency response of the loop from w to y, (31)
    measured: Spectrum  # of the error that the controller sees
    true: Spectrum  # of the error of the outputs themselves
    learned: Spectrum  # in both: what learning has made of earlier trials


def trial_noise(
    loop: CurrentTrialLoop, omega, sensor_psd=0.0, disturbance_psd=None, *, plant=None
) -> TrialNoise:
    """What the loop makes of noise and disturbances that are new in every trial, L = 0.

    Parameters
    ----------
    loop : CurrentTrialLoop
        With m outputs and d disturbances. What a controller that is not ours makes of the
        sensors' noise is not known: for a ClosedLoop, measure e with v = 0.
    omega : array_like, shape (n,)
        Increasing angular frequencies, rad/s, up to the Nyquist frequency.
    sensor_psd : float or array_like
        Spectral density of what the sensors add to y, see :class:`Spectrum`; not of y as measured
        in the closed loop. White noise: the
        variance, of all outputs or of each, shape (m,). Coloured noise: shape (n, m).
    disturbance_psd : float or array_like, optional
        Likewise, for ``loop.disturbances``. Default zero.
    plant : control.StateSpace or control.TransferFunction, optional
        Another plant in the place of that of the design, as in :meth:`CurrentTrialLoop.around`.

    See Also
    --------
    converged_noise : when all is learned
    noise_on_trial : on a trial with two ends

    Examples
    --------
    >>> import control
    >>> A, B = [[1, 0.01], [0, 1]], [[0], [0.01]]  # a mass of 1 kg, F in N, x in m
    >>> stage = control.ss(A, B, [[1, 0]], 0, 0.01, inputs=["F"], outputs=["x"])
    >>> import numpy as np
    >>> from ilctools import current_trial_loop, trial_noise
    >>> omega = np.geomspace(0.01, 100 * np.pi, 200)
    >>> noise = trial_noise(current_trial_loop(stage, ["F"]), omega, sensor_psd=0.02**2)
    >>> bool(noise.measured.total >= 0.02)
    True
    """
    arguments.instance("loop", loop, CurrentTrialLoop)
    omega = arguments.increasing_frequencies("omega", omega, loop.Ts)
    m = len(loop.outputs)
    sensors = _density("sensor_psd", sensor_psd, len(omega), m)
    response = frequency_response(with_noise(loop, plant), omega)
    P, G, T = np.split(response, [m, -m], axis=2)
    true, measured = _through(T, sensors), _through(np.eye(m) + T, sensors)
    if disturbance_psd is not None:
        sources = len(loop.disturbances)
        if not sources:
            raise ValueError("disturbance_psd must be None: the loop has no disturbance")
        flows = _density("disturbance_psd", disturbance_psd, len(omega), sources)
        added = _through(G, flows)
        true, measured = true + added, measured + added
    learned = Spectrum(omega, loop.Ts, np.zeros_like(true))
    measured, true = (replace(learned, density=density) for density in (measured, true))
    return TrialNoise(P, measured, true, learned)


def converged_noise(new: TrialNoise, law: Law) -> TrialNoise:
    """What is random in the error when all that repeats is learned.

    Parameters
    ----------
    new : TrialNoise
        Without learning, by :func:`trial_noise`.
    law : Law
        The rest at the end of a trial and limits are left out of account.

    Returns
    -------
    TrialNoise
        Its `learned` is the solution Phi of Phi = M Phi M^H + (Q P L) Phi_x (Q P L)^H, at each
        frequency; for one channel Phi_x |Q P L|^2 / (1 - |M|^2).

    Raises
    ------
    ValueError
        If the trials do not converge at some frequency.

    See Also
    --------
    trial_noise : before anything is learned
    noise_on_trial : on a trial with two ends

    Examples
    --------
    >>> import control
    >>> A, B = [[1, 0.01], [0, 1]], [[0], [0.01]]  # a mass of 1 kg, F in N, x in m
    >>> stage = control.ss(A, B, [[1, 0]], 0, 0.01, inputs=["F"], outputs=["x"])
    >>> import numpy as np
    >>> from ilctools import converged_noise, current_trial_loop, synthesise, trial_noise
    >>> from ilctools import zero_phase_butterworth
    >>> loop, omega = current_trial_loop(stage, ["F"]), np.geomspace(0.01, 100 * np.pi, 200)
    >>> law = synthesise(loop, zero_phase_butterworth(2, 10.0, 0.01)).law()
    >>> noise = trial_noise(loop, omega, sensor_psd=0.02**2)
    >>> bool(converged_noise(noise, law).learned.total > 0)
    True
    """
    arguments.instance("new", new, TrialNoise)
    arguments.instance("law", law, Law)
    x = new.measured
    check_match(noise=x, law=law)
    P, Q, L = convergence(new.P, law.Q, law.L, x.omega).responses
    M = convergence_matrix(P, Q, L)
    M = (1 - law.gain) * np.eye(M.shape[1]) + law.gain * M
    QPL = law.gain * (Q[:, None, None] * P @ L)
    learned = replace(x, density=_accumulated(M, _through(QPL, x.density)))
    return TrialNoise(new.P, x + learned, new.true + learned, learned)


def _accumulated(M, added):
    """Phi = M Phi M^H + `added`, the sum of M^k `added` M^k^H over all k, by Smith's method."""
    for _ in range(DOUBLINGS):
        added = added + _through(M, added)
        M = M @ M
        size = np.linalg.norm(M, axis=(-2, -1)).max() ** 2
        if size < NEGLIGIBLE:
            return added
        if size > 1 / NEGLIGIBLE:
            break
    raise ValueError(
        "law does not converge: what noise does grows from trial to trial. Ask about one trial "
        "(trials = 10 of noise_on_trial), or hold v at rest at the end"
    )


def _density(name, value, n, m):
    """A density of shape (n, m, m), from any of the forms of :func:`trial_noise`."""
    density = arguments.array(name, value, (...,))
    if density.shape not in [(), (m,), (n, m)] or density.min() < 0:
        raise ValueError(
            f"{name} must be variances or spectral densities, 0 or more, of shape (), ({m},) or "
            f"({n}, {m}); it has shape {density.shape}, and {density.min():g} is the least"
        )
    return np.broadcast_to(density, (n, m))[..., None] * np.eye(m)


def _through(H, density):
    """Spectral density of a signal behind H."""
    return H @ density @ H.conj().swapaxes(-2, -1)


def noise_on_trial(
    loop: CurrentTrialLoop,
    law: Law,
    samples: int,
    sensor_variance,
    *,
    trials: int | None = None,
    plant=None,
) -> xr.Dataset:
    """What white noise that is new in every trial does to a trial that has two ends.

    Parameters
    ----------
    loop, plant :
        As for :func:`ilctools.run_trials`.
    law : Law
        The filters act with their own `ends`; limits are left out of account.
    samples : int
        Length of a trial.
    sensor_variance : float or array_like, shape (m,)
        Of what the sensors add to y in each sample, of all outputs or of each: of their data sheet,
        not of y as it is measured in the closed loop, which answers to its sensors; that follows,
        `measured`. Coloured noise is for :func:`ilctools.trial_noise`, far from the ends.
    trials : int, optional
        The number of the trial that is asked about; 1 is the first, where v = 0. Default: after so
        many that nothing changes any more. If that never happens, a ValueError says so.

    Returns
    -------
    xarray.Dataset
        RMS over all that the noise could have been, at each time and in each channel: `true`, of
        the outputs themselves; `measured`, of e, the error that the controller sees; `learned`, in
        both, of what learning has made of earlier trials. :func:`ilctools.rms` of one of
        them is that of the trial.

    See Also
    --------
    converged_noise : the same on trials without ends

    Notes
    -----
    Long trials are cut short in the middle: the first half of a short trial is the start of the
    long one, the second half its end, and the variance in the middle stands still, to a hundredth
    over a quarter of the short trial, or it is made twice as long. There v is written in cosines,
    up to where Q falls below a thousandth. Both change the RMS of the paper's trial by less than
    a ten-thousandth. Next to an end it may be half a percent in a sample, if the loop is fast or
    the filters hold their ends. A trial of up to 200 samples is exact to rounding.

    Examples
    --------
    >>> import control
    >>> A, B = [[1, 0.01], [0, 1]], [[0], [0.01]]  # a mass of 1 kg, F in N, x in m
    >>> stage = control.ss(A, B, [[1, 0]], 0, 0.01, inputs=["F"], outputs=["x"])
    >>> from ilctools import Law, LearningFilter, current_trial_loop, noise_on_trial
    >>> from ilctools import zero_phase_butterworth
    >>> loop, Q = current_trial_loop(stage, ["F"]), zero_phase_butterworth(2, 10.0, 0.01)
    >>> law = Law(Q, LearningFilter([[[0.1]]], 0.01))
    >>> noise = noise_on_trial(loop, law, samples=100, sensor_variance=0.02**2)
    >>> noise.sizes["time"]
    100
    """
    arguments.instance("loop", loop, CurrentTrialLoop)
    law, m = arguments.instance("law", law, Law).bound_to(loop), len(loop.outputs)
    arguments.instance("law.L", law.L, LearningOperator)
    samples = arguments.whole("samples", samples, 1)
    trials = None if trials is None else arguments.whole("trials", trials, 1)
    arguments.whole("law.rest", law.rest, 0, samples - 1)
    [variance] = _density("sensor_variance", sensor_variance, 1, m)

    variances = _variances(with_noise(loop, plant), law, samples, np.sqrt(variance), trials)
    coordinates = {
        "time": ("time", loop.Ts * np.arange(samples), {"units": "s"}),
        "channel": np.arange(1, m + 1),
        "output": ("channel", loop.outputs),
    }
    signals = {name: (("time", "channel"), variance) for name, variance in variances.items()}
    return np.sqrt(xr.Dataset(signals, coordinates))


def _variances(closed, law, samples, noise, trials):
    """Of the signals of :func:`noise_on_trial`, each (time, m), with sensors of such deviations."""
    h, m = impulse_response(closed, samples), len(noise)
    P, T = h[..., :m], h[..., -m:] @ noise
    X = T.copy()  # of x: the noise itself, and what the loop makes of it
    X[0] += noise
    learned = _learned_between(P, X, law, trials, np.abs(closed.poles()).max())
    true, measured = ((response**2).sum(axis=2).cumsum(axis=0) + learned for response in (T, X))
    return {"true": true, "measured": measured, "learned": learned}


def _learned_between(P, X, law, trials, slowest):
    """Variance of P v, shape (time, m), of a long trial by the two halves of a short one."""
    samples = len(P)
    slowest = min(max(slowest, np.abs(law.Q.poles).max()), arguments.CIRCLE)
    length = 2 * law.rest + int(np.ceil(2 * np.log(STILL) / np.log(slowest)))
    while length < samples:
        learned = _learned(P[:length], X[:length], law, trials)
        middle = learned[length * 3 // 8 : length * 5 // 8 + 1]
        if np.all(np.ptp(middle, axis=0) <= STILL * middle.mean(axis=0)):
            half = length // 2
            return np.insert(learned, [half] * (samples - length), learned[half], axis=0)
        length *= 2
    return _learned(P, X, law, trials)


def _learned(P, X, law, trials):
    """Variance of P v, shape (time, m), on a trial as long as the impulse responses P and X."""
    if trials == 1:
        return np.zeros(P.shape[:2])
    M, B, Pv = _next_trial(P, X, law)
    added = B @ B.T
    if trials is None:
        V = _accumulated(M, added)
    else:
        V = np.zeros_like(M)
        for _ in range(trials - 1):
            V = _through(M, V) + added  # V = M V M^T + B X B^T
    return np.maximum(((V @ Pv) * Pv).sum(axis=0), 0).reshape(len(P), -1)


def _next_trial(P, X, law):
    """M and B of v_{k+1} = M v_k - B x_k, and P v: v in cosines in each channel, x by impulses."""
    length, m, _ = P.shape
    cosines = _cosines(law.Q, length - law.rest, law.rest)
    count = len(cosines)
    of_v = law.gain * law.Q.apply_transposed(cosines.T).T

    def passed_on(e):
        """Cosines of the next v, in each channel, by signals e (any, time, m), side by side."""
        return np.tensordot(of_v, law.L.apply(e), (1, 1)).swapaxes(1, 2).reshape(count * m, -1)

    Pv = fftconvolve(cosines[:, None, :, None], np.moveaxis(P, 2, 0)[None], axes=2)
    Pv = Pv[:, :, :length].reshape(count * m, length, m)
    kept = of_v @ cosines.T + (1 - law.gain) * np.eye(count)
    M = np.kron(kept, np.eye(m)) - passed_on(Pv)
    # Noise of each sensor in each sample, (sensor, output, sample, time), in whatever order.
    late = np.concatenate([np.zeros_like(X), X]).T
    impulses = np.lib.stride_tricks.sliding_window_view(late, length, axis=2)[:, :, 1:]
    blocks = np.array_split(impulses, 1 + length // SIDE_BY_SIDE, axis=2)
    B = [passed_on(block.transpose(0, 2, 3, 1).reshape(-1, length, m)) for block in blocks]
    return M, np.hstack(B), Pv.reshape(count * m, -1)


def _cosines(Q, active, rest):
    """Orthonormal rows that span what v can be: cosines that Q passes, zero in the rest."""
    gain = Q.frequency_response(np.arange(active) * np.pi / (active * Q.Ts))
    count = max(np.flatnonzero(gain > FAINT).max() + 1, min(active, ALL))
    cosines = idct(np.eye(count, active), norm="ortho", axis=1)
    return np.pad(cosines, [(0, 0), (0, rest)])
