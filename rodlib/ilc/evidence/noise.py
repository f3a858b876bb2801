"""What is left of the error if something is new in every trial: noise, and random disturbances.

What comes again in every trial is learned. What is new in trial k, learning takes for an error
that will come again, and passes it on to all later trials. With n_k in the measured outputs and d_k
as a disturbance, the loop without learning deviates by

    t_k = T n_k + G d_k (the true outputs),    x_k = n_k + t_k (the measured ones, which e shows),

T and G being the closed loop's responses; with learning P v_k comes on top. As Q is a scalar,
v_{k+1} = Q (v_k + L e_k) with e_k = e_0 - P v_k - x_k gives for the random part p_k of P v_k

    p_{k+1} = M p_k - Q P L x_k,    M = Q (I - P L).

p_k depends on earlier trials alone, and so is independent of x_k and t_k: spectral densities add.
If sigma_max(M) <= c < 1, that of p_k has a trace of at most tr(Q P L Phi_x (Q P L)^H) / (1 - c^2).
Trials are taken to be without end, as in Lemma 1; with the start and the end of one,
:mod:`~rodlib.ilc.evidence.noisy_trial`.
"""

from dataclasses import dataclass, replace

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningOperator, check_learning
from rodlib.ilc.loop.closed import CurrentTrialLoop, with_noise
from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem.problem import largest_singular_values, tied
from rodlib.ilc.problem.responses import Q_on_grid

HERMITIAN = 1e-9  # relative, by how much a spectral density may miss being one
NEGLIGIBLE = 1e-17  # share of what is passed on that is no longer added up


@dataclass(frozen=True)
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
        points = np.concatenate([[0], self.omega, [np.pi / self.Ts]])
        power = np.einsum("nii->ni", self.density).real
        power = np.concatenate([power[:1], power, power[-1:]])
        return np.sqrt(np.trapezoid(power, points, axis=0) * self.Ts / np.pi)

    @property
    def total(self) -> float:
        """Root of the sum of their squares, as in :func:`rodlib.ilc.rms`."""
        return float(np.linalg.norm(self.rms))

    def __add__(self, other: "Spectrum") -> "Spectrum":
        """That of the sum with independent signals, known at the same frequencies."""
        return replace(self, density=self.density + other.density)


@dataclass(frozen=True)
class TrialNoise:
    """What is new in every trial, without learning. Made by :func:`trial_noise`."""

    P: np.ndarray  # (n, m, m): frequency response of the loop from w to y, (31)
    measured: Spectrum  # of x, how the measured outputs, and so e, deviate from trial to trial
    true: Spectrum  # of t, how the outputs themselves do


@dataclass(frozen=True)
class LearnedNoise:
    """What is random in a trial with learning. Made by :func:`converged_noise`."""

    measured: Spectrum  # of e, the error that the controller sees
    true: Spectrum  # of the error of the outputs themselves
    learned: Spectrum  # in both, of p: what learning has made of earlier trials


def trial_noise(
    loop: CurrentTrialLoop, omega, noise=0.0, disturbance=None, *, plant=None
) -> TrialNoise:
    """What the loop makes of noise and disturbances that are new in every trial.

    Parameters
    ----------
    loop : CurrentTrialLoop
        With m outputs and d disturbances.
    omega : array_like, shape (n,)
        Increasing angular frequencies, rad/s, up to the Nyquist frequency.
    noise : float or array_like
        Spectral density of what the sensors add to y, see :class:`Spectrum`. White noise: the
        variance, of all outputs or of each, shape (m,). Coloured noise: shape (n,) for all
        outputs, (n, m) for each, (n, m, m) where they depend on each other.
    disturbance : float or array_like, optional
        Likewise, for ``loop.disturbances``. Default zero.
    plant : control.StateSpace or control.TransferFunction, optional
        Another plant in the place of that of the design, as in :meth:`CurrentTrialLoop.around`.
    """
    arguments.instance("loop", loop, CurrentTrialLoop)
    omega, m = arguments.frequencies("omega", omega, loop.Ts), loop.plant.noutputs
    sensors = _density("noise", noise, omega, m)
    response = frequency_response(with_noise(loop, plant), omega)
    P, G, T = np.split(response, [m, -m], axis=2)
    true, measured = _through(T, sensors), _through(np.eye(m) + T, sensors)
    if disturbance is not None:
        if not loop.disturbances:
            raise ValueError("disturbance must be None: the loop has none")
        flows = _through(
            G, _density("disturbance", disturbance, omega, len(loop.disturbances))
        )
        true, measured = true + flows, measured + flows
    return TrialNoise(
        P, Spectrum(omega, loop.Ts, measured), Spectrum(omega, loop.Ts, true)
    )


def converged_noise(
    new: TrialNoise, Q, L: LearningOperator, step: float = 1.0
) -> LearnedNoise:
    """What is random in the error when all that comes again is learned.

    Parameters
    ----------
    new : TrialNoise
    Q : ZeroPhaseButterworth or array_like, shape (n,)
        The filter, or its frequency response on ``new.measured.omega``.
    L : LearningOperator
    step : float
        The `gain` of :class:`rodlib.Law`, the same after every trial.

    Returns
    -------
    LearnedNoise
        Its `learned` is the solution Phi of Phi = M Phi M^H + (Q P L) Phi_x (Q P L)^H, at each
        frequency; for one channel Phi_x |Q P L|^2 / (1 - |M|^2). A step a takes the place of M by
        (1 - a) I + a M, and of Q P L by a Q P L. If the trials do not converge at some frequency,
        a ValueError says so.
    """
    step = arguments.share("step", step)
    M, QPL = _learning(new, Q, L)
    M, added = _stepped(M, step), step**2 * _through(QPL, new.measured.density)
    rate = np.abs(np.linalg.eigvals(M)).max(axis=1)
    if rate.max() >= 1:
        raise ValueError(
            f"L does not converge: M has an eigenvalue of modulus {rate.max():.6g} at "
            f"{new.measured.omega[tied(rate).argmax()]:.6g} rad/s"
        )
    return _learned(new, accumulated(M, added))


def accumulated(M, added) -> np.ndarray:
    """Phi = M Phi M^H + `added`, the sum of M^k `added` M^k^H over all k, by Smith's method."""
    size = 1.0
    while size > NEGLIGIBLE:  # the number of terms doubles
        added = added + _through(M, added)
        M = M @ M
        size = largest_singular_values(M).max() ** 2
    return added


def noise_by_trial(new: TrialNoise, Q, L: LearningOperator, step) -> list[LearnedNoise]:
    """What is random in the error of each trial, from the first on, where v = 0.

    Parameters
    ----------
    new, Q, L : as for :func:`converged_noise`
    step : array_like, shape (trials - 1,)
        The `gain` of :class:`rodlib.Law`, from each trial to the next.

    Returns
    -------
    list of LearnedNoise
        One for each trial. With steps that tend to zero, and whose sum has no limit, what is
        learned of noise tends to zero, if all eigenvalues of M have a real part below one.
    """
    steps = [
        arguments.share(f"step[{k}]", a)
        for k, a in enumerate(arguments.row("step", step))
    ]
    M, QPL = _learning(new, Q, L)
    added = _through(QPL, new.measured.density)
    density = [np.zeros_like(added)]
    for a in steps:
        density.append(_through(_stepped(M, a), density[-1]) + a**2 * added)
    return [_learned(new, each) for each in density]


def _density(name, value, omega, m):
    """A density of shape (n, m, m), from any of the forms of :func:`trial_noise`."""
    given = arguments.array(name, value, (...,), complex)
    n = len(omega)
    if given.shape not in [(), (m,), (n,), (n, m), (n, m, m)]:
        raise ValueError(
            f"{name} has shape {given.shape}, but must be a variance, shape () or ({m},), or a "
            f"density at the {n} frequencies, shape ({n},), ({n}, {m}) or ({n}, {m}, {m})"
        )
    if given.ndim < 3:
        each = given[:, None] if given.shape == (n,) != (m,) else given
        given = np.broadcast_to(each, (n, m))[..., None] * np.eye(m)
    size = np.abs(given).max()
    apart = np.abs(given - given.conj().swapaxes(1, 2)).max()
    if apart > HERMITIAN * size or np.linalg.eigvalsh(given).min() < -HERMITIAN * size:
        raise ValueError(
            f"{name} is no spectral density: at each frequency it must be real and not negative, "
            "or a Hermitian matrix without negative eigenvalues"
        )
    return given


def _learning(new, Q, L):
    """M and Q P L, for a step of one."""
    arguments.instance("new", new, TrialNoise)
    q, m = Q_on_grid(Q, new.measured.omega, noise=new.measured.Ts)[1], new.P.shape[1]
    check_learning(L, m)
    arguments.one_period(noise=new.measured.Ts, L=L.Ts)
    q = q[:, None, None]
    QPL = q * new.P @ L.frequency_response(new.measured.omega)
    return q * np.eye(m) - QPL, QPL  # (40)


def _stepped(M, step):
    return (1 - step) * np.eye(M.shape[1]) + step * M


def _learned(new, density):
    learned = replace(new.measured, density=density)
    return LearnedNoise(new.measured + learned, new.true + learned, learned)


def _through(H, density):
    """Spectral density of a signal behind H."""
    return H @ density @ H.conj().swapaxes(1, 2)
