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

import reprlib
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from scipy.fft import idct, irfft, next_fast_len, rfft

from ilctools import arguments
from ilctools.evidence.convergence import convergence
from ilctools.filters import LearningOperator
from ilctools.law.law import Law
from ilctools.loop.closed import ClosedLoop, CurrentTrialLoop, with_noise
from ilctools.models import frequency_response, impulse_response
from ilctools.problem.problem import convergence_matrix
from ilctools.signals import check_match

NEGLIGIBLE = 1e-17  # share of what is passed on that is no longer added up
FAINT = 1e-3  # gain of Q below which v is taken to have no higher frequencies,
ALL = 200  # in trials that are longer than this
STILL = 1e-2  # relative, by how much a variance may still change in the middle of a short trial
SIDE_BY_SIDE = 50  # signals that the law takes at a time
DOUBLINGS = 50  # of the number of trials, until what remains of the first is negligible


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
        With m outputs and d disturbances.
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
    _check_controller(loop)
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
    spectra = [Spectrum(omega, loop.Ts, x) for x in (measured, true, 0 * true)]
    return TrialNoise(P, *spectra)


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
    QPL = law.gain * (Q[:, None, None] * P @ L)
    M = convergence_matrix(P, Q, L)
    M = (1 - law.gain) * np.eye(M.shape[1]) + law.gain * M
    radius = np.abs(np.linalg.eigvals(M)).max(axis=1)
    if radius.max() >= 1:
        raise ValueError(
            f"law does not converge: M has an eigenvalue of modulus {radius.max():.6g} at "
            f"{x.omega[radius.argmax()]:.6g} rad/s"
        )
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
        "law does not converge on a trial with two ends: what noise does grows from trial to "
        "trial. Ask about one of them, trials = 10, or hold v at rest at the end"
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


def _check_controller(loop):
    """Refuse a loop whose controller is not known."""
    if isinstance(loop, ClosedLoop):
        raise ValueError(
            f"loop = {reprlib.repr(loop)} must be a CurrentTrialLoop: what a controller that "
            "is not ours makes of the sensors' noise is not known; measure e with v = 0"
        )
    arguments.instance("loop", loop, CurrentTrialLoop)


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
    _check_controller(loop)
    law, m = arguments.instance("law", law, Law).bound_to(loop), len(loop.outputs)
    arguments.instance("law.L", law.L, LearningOperator)
    samples = arguments.whole("samples", samples, 1)
    trials = None if trials is None else arguments.whole("trials", trials, 1)
    rest = arguments.whole("law.rest", law.rest, 0, samples - 1)
    [variance] = _density("sensor_variance", sensor_variance, 1, m)

    closed, noise = with_noise(loop, plant), np.sqrt(variance)
    h = impulse_response(closed, samples)
    P, T = h[..., :m], h[..., -m:] @ noise
    X = T.copy()  # of x: the noise itself, and what the loop makes of it
    X[0] += noise
    slowest = np.abs([*closed.poles(), *law.Q.poles]).max()
    length = 2 * rest + 2 * np.log(STILL) / np.log(min(slowest, arguments.CIRCLE))
    while True:
        length = min(int(np.ceil(length)), samples)
        learned = _learned(P[:length], X[:length], law, trials)
        middle = learned[length * 3 // 8 : length * 5 // 8 + 1]
        change = np.ptp(middle, axis=0) / STILL
        if length == samples or np.all(change <= middle.mean(axis=0)):
            break
        length *= 2
    half, absent = length // 2, samples - length
    learned = np.insert(learned, [half] * absent, learned[half], axis=0)
    true, measured = ((h**2).sum(axis=2).cumsum(axis=0) + learned for h in (T, X))
    coordinates = {
        "time": ("time", loop.Ts * np.arange(samples), {"units": "s"}),
        "channel": np.arange(1, m + 1),
        "output": ("channel", loop.outputs),
    }
    axes = "time", "channel"
    variances = {"true": (axes, true), "measured": (axes, measured), "learned": (axes, learned)}
    return np.sqrt(xr.Dataset(variances, coordinates))


def _learned(P, X, law, trials):
    """Variance of P v, shape (time, m), on a trial as long as the impulse responses P and X."""
    length, m, _ = P.shape
    if trials == 1:
        return np.zeros((length, m))
    cosines = _cosines(law.Q, length - law.rest, law.rest)
    count = len(cosines)
    size = count * m  # numbers of v: `count` in each channel

    # What the law makes of v and of e, in cosines of the next v.
    of_v = law.gain * law.Q.apply_transposed(cosines.T).T
    of_e = _after(law.L, m, of_v).reshape(count, length, m, m)
    of_e = of_e.transpose(0, 3, 2, 1).reshape(size, m, length)
    fast = next_fast_len(2 * length, real=True)
    P, X = (rfft(h.transpose(2, 1, 0), fast) for h in (P, X))  # (from, to, frequency)
    y = irfft(rfft(cosines, fast)[:, None, None] * P, fast)[..., :length]
    y = y.reshape(size, -1)  # of each cosine in each channel of v

    V, backward = np.zeros((size, size)), rfft(of_e[..., ::-1], fast)
    for sensor in X:  # noise of the last sample, which reaches least, to the first
        added = irfft(np.einsum("cjf,jf->cf", backward, sensor), fast)[:, :length]
        V += added @ added.T
    of_v = of_v @ cosines.T + (1 - law.gain) * np.eye(count)
    M = np.kron(of_v, np.eye(m)) - of_e.reshape(size, -1) @ y.T
    if trials is None:
        V = _accumulated(M, V)
    else:
        added, V = V, np.zeros_like(V)
        for _ in range(trials - 1):
            V = _through(M, V) + added
    return np.maximum(((V @ y) * y).sum(axis=0), 0).reshape(m, length).T


def _cosines(Q, active, rest):
    """Orthonormal rows that span what v can be: cosines that Q passes, zero in the rest."""
    gain = Q.frequency_response(np.arange(active) * np.pi / (active * Q.Ts))
    count = max(np.flatnonzero(gain > FAINT).max() + 1, min(active, ALL))
    cosines = idct(np.eye(count, active), norm="ortho", axis=1)
    return np.pad(cosines, [(0, 0), (0, rest)])


def _after(L, m, outputs):
    """`outputs` (any, time) after L of impulses at all times in m channels, side by side."""
    length = outputs.shape[1]
    size, parts = length * m, []
    for at in range(0, size, SIDE_BY_SIDE):
        impulses = np.eye(min(SIDE_BY_SIDE, size - at), size, at)
        filtered = L.apply(impulses.reshape(len(impulses), length, m))
        reached = np.abs(filtered).max(axis=0).max(axis=1)  # often few samples
        near = reached > NEGLIGIBLE * reached.max()
        parts.append(np.tensordot(outputs[:, near], filtered[:, near], (1, 1)))
    return np.concatenate(parts, axis=1)
