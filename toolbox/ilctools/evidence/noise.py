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

This is for trials without ends, as Lemma 1 is. In a real trial v is missing before the start. A
learning filter with a large gain has coefficients that all but cancel; of a sample of noise near
the start it applies some and not the others, and these do not cancel. How much that is, trials show
that are simulated with noise alone: :func:`ilctools.run_trials`, with a reference of zero.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ilctools import arguments
from ilctools.filters import check_learning
from ilctools.law.law import Law
from ilctools.loop.closed import CurrentTrialLoop, whole_loop
from ilctools.models import frequency_response
from ilctools.problem.problem import convergence_matrix
from ilctools.signals import check_match


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
    run_trials : on a trial with two ends, simulated with noise

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
    if disturbance_psd is not None and not loop.disturbances:
        raise ValueError("disturbance_psd must be None: the loop has no disturbance")
    psd = 0.0 if disturbance_psd is None else disturbance_psd
    response = frequency_response(whole_loop(loop, plant)[:m, :], omega)
    P, G, T = np.split(response, [m, -m], axis=2)
    n = _density("sensor_psd", sensor_psd, len(omega), m)
    d = _density("disturbance_psd", psd, len(omega), len(loop.disturbances))
    by_d, spectrum = _through(G, d), partial(Spectrum, omega, loop.Ts)
    true, measured = _through(T, n) + by_d, _through(np.eye(m) + T, n) + by_d
    return TrialNoise(P, spectrum(measured), spectrum(true), spectrum(0 * by_d))


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
    run_trials : on a trial with two ends, simulated with noise

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
    P, m = new.P, new.P.shape[1]
    check_learning(law.L, m, "law.L")
    Q, L = (f.frequency_response(x.omega) for f in (law.Q, law.L))
    M = convergence_matrix(P, Q, L)
    M = (1 - law.gain) * np.eye(m) + law.gain * M
    QPL = law.gain * (Q[:, None, None] * P @ L)
    learned = replace(x, density=_accumulated(M, _through(QPL, x.density)))
    return TrialNoise(new.P, x + learned, new.true + learned, learned)


def _accumulated(M, added):
    """Phi = M Phi M^H + `added`, as linear equations for the entries of Phi."""
    if np.abs(np.linalg.eigvals(M)).max() >= 1:
        raise ValueError(
            "law does not converge: what noise does grows from trial to trial. Simulate a few "
            "trials with noise (run_trials), or bound sigma_max(M) below one (M_max of synthesise)"
        )
    n, m, _ = M.shape
    both = np.einsum("nij,nkl->nikjl", M, M.conj()).reshape(n, m * m, m * m)
    entries = np.linalg.solve(np.eye(m * m) - both, added.reshape(n, m * m, 1))
    return entries.reshape(added.shape)


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
