"""What noise of the sensors, new in every trial, leaves of the error.

A disturbance that repeats is learned. What is new in trial k, learning takes for an error that
will come again, and passes it on to all later trials. With n_k in the measured outputs, the loop
without learning deviates by

    t_k = T n_k (the true outputs),    x_k = n_k + t_k (the measured ones, which e shows),

T being the closed loop's response; with learning P v_k comes on top. As Q is a scalar,
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

from dataclasses import dataclass

import numpy as np

from ilctools import arguments
from ilctools.law.law import Law
from ilctools.loop.closed import CurrentTrialLoop, whole_loop
from ilctools.models import frequency_response
from ilctools.problem.problem import convergence_matrix
from ilctools.signals import check_match

DOUBLINGS = 50  # of the trials that are summed up


@dataclass(frozen=True, eq=False)
class TrialNoise:
    """What is random in a trial. Made by :func:`trial_noise`.

    Densities have the shape (n, m, m). Their mean over all frequencies is the covariance, so that
    white noise has its variance as its density. One in unit^2 / Hz, counted over positive
    frequencies, is 2 Ts times as large.
    """

    omega: np.ndarray  # (n,), rad/s
    Ts: float  # s
    measured: np.ndarray  # density of the error that the controller sees
    true: np.ndarray  # of the error of the outputs themselves
    learned: np.ndarray  # in both: what learning has made of earlier trials

    def rms(self, kind="true") -> np.ndarray:
        """Of each output, (m,): "measured", "true" or "learned"; beyond omega as at its ends.

        Their norm is that of :func:`ilctools.rms`.
        """
        power = np.einsum("nii->ni", getattr(self, kind)).real
        power = np.pad(power, [(1, 1), (0, 0)], mode="edge")
        points = [0, *self.omega, np.pi / self.Ts]
        return np.sqrt(np.trapezoid(power, points, axis=0) * self.Ts / np.pi)


def trial_noise(loop: CurrentTrialLoop, omega, sensor_psd, *, law=None, plant=None) -> TrialNoise:
    """What the loop, and learning, make of sensors' noise that is new in every trial.

    Parameters
    ----------
    loop : CurrentTrialLoop
        With m outputs. What a controller that is not ours makes of the
        sensors' noise is not known: for a ClosedLoop, measure e with v = 0.
    omega : array_like, shape (n,)
        Increasing angular frequencies, rad/s, up to the Nyquist frequency.
    sensor_psd : float or array_like
        Spectral density of what the sensors add to y, see :class:`TrialNoise`; not of y as measured
        in the closed loop. White noise: the variance, of all outputs or of each, shape (m,).
        Coloured noise: shape (n, m).
    law : Law, optional
        When all that repeats is learned. The rest at the end of a trial and limits are left out of
        account. Default: nothing is learned.
    plant : control.StateSpace or control.TransferFunction, optional
        Another plant in the place of that of the design, as in :meth:`CurrentTrialLoop.around`.

    Raises
    ------
    ValueError
        If the trials do not converge at some frequency.

    See Also
    --------
    run_trials : on a trial with two ends, simulated with noise

    Examples
    --------
    >>> import control
    >>> A, B = [[1, 0.01], [0, 1]], [[0], [0.01]]  # a mass of 1 kg, F in N, x in m
    >>> stage = control.ss(A, B, [[1, 0]], 0, 0.01, inputs=["F"], outputs=["x"])
    >>> import numpy as np
    >>> from ilctools import current_trial_loop, synthesise, trial_noise, zero_phase_butterworth
    >>> loop, omega = current_trial_loop(stage, ["F"]), np.geomspace(0.01, 100 * np.pi, 200)
    >>> law = synthesise(loop, zero_phase_butterworth(2, 10.0, 0.01)).law()
    >>> new, in_all = (trial_noise(loop, omega, 0.02**2, law=law) for law in (None, law))
    >>> bool(in_all.rms() > new.rms())
    True
    """
    arguments.instance("loop", loop, CurrentTrialLoop)
    omega = arguments.increasing_frequencies("omega", omega, loop.Ts)
    n, m = len(omega), len(loop.outputs)
    response = frequency_response(whole_loop(loop, plant)[:m, :], omega)
    P, T = response[..., :m], response[..., -m:]
    psd = arguments.array("sensor_psd", sensor_psd, (...,))
    if psd.shape not in [(), (m,), (n, m)] or (psd < 0).any():
        raise ValueError(f"sensor_psd must be 0 or more, of shape (), ({m},) or ({n}, {m})")
    noise = np.broadcast_to(psd, (n, m))[..., None] * np.eye(m)
    measured, true = (_through(H, noise) for H in (np.eye(m) + T, T))
    learned = 0 * true
    if law is not None:
        arguments.instance("law", law, Law)
        check_match(loop=loop, law=law)
        learned = learned_noise(P, law, omega, measured)
    return TrialNoise(omega, loop.Ts, measured + learned, true + learned, learned)


def learned_noise(P, law: Law, omega, density) -> np.ndarray:
    """The solution Phi of Phi = M Phi M^H + (Q P L) Phi_x (Q P L)^H, at each frequency, (n, m, m).

    Phi_x is the `density` of the measured error; for one channel Phi_x |Q P L|^2 / (1 - |M|^2).
    """
    Q, L = (f.frequency_response(omega) for f in (law.Q, law.L))
    M = law.gain * convergence_matrix(P, Q, L) + (1 - law.gain) * np.eye(P.shape[1])
    if np.abs(np.linalg.eigvals(M)).max() >= 1:
        raise ValueError(
            "law does not converge: what noise does grows from trial to trial. Simulate a few "
            "trials with noise (run_trials), or bound sigma_max(M) below one (M_max of synthesise)"
        )
    learned = _through(law.gain * Q[:, None, None] * P @ L, density)
    for _ in range(DOUBLINGS):  # what one, two, four, ... trials have left
        learned, M = learned + _through(M, learned), M @ M
    return learned


def _through(H, density):
    """Spectral density of a signal behind H."""
    return H @ density @ H.conj().swapaxes(-2, -1)
