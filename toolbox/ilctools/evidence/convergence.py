"""Do the trials converge, and how fast? Two numbers of M = Q (I - P L) give the answer.

M maps the error of one trial to the error of the next trial. Its largest sigma_max over the
frequencies is the gamma of Lemma 1 of the paper. If gamma is below one, the error converges
*monotonically*: each trial reduces the error at least by the factor gamma. The largest spectral
radius of M never exceeds gamma. If the spectral radius is below one, the error *converges*, but the
error may grow in the first trials. Both numbers hold for trials of infinite length, without ends.
"""

from dataclasses import dataclass

import numpy as np

from ilctools import arguments
from ilctools.filters import LearningOperator, check_learning
from ilctools.problem.lowpass import lowpass_of
from ilctools.problem.problem import convergence_matrix
from ilctools.response.door import response_of
from ilctools.signals import check_match
from ilctools.singular_values import largest_singular_values, tied


@dataclass(frozen=True, eq=False)
class Convergence:
    """How fast the trials converge: singular values and eigenvalues of M = Q (I - P L).

    :func:`convergence` returns this result. For a list of p plants, `sigma` has the shape (p, n),
    and `rate`, `at` and `spectral_radius` have the shape (p,). :meth:`.Synthesis.check` returns the
    result for the worst of all plants, whose rate also holds between the frequencies.
    """

    omega: np.ndarray  # (n,), rad/s
    sigma: np.ndarray  # (n,): sigma_max(M), the largest share of the error that one trial leaves
    rate: float  # the gamma of Lemma 1: the largest sigma
    at: float  # the frequency of the rate, rad/s; the lowest if several are tied
    spectral_radius: float  # largest |eigenvalue of M|
    proven: bool = False  # whether the rate holds at all frequencies
    # whether the true P may differ so much from the given P that the trials diverge
    uncertain: bool = False
    assumptions: tuple[str, ...] = ()  # on P and its radius, in words

    @property
    def monotone(self) -> bool:
        """Whether every trial brings the error nearer to its limit, by Lemma 1 of the paper."""
        return bool(np.max(self.rate) < 1)

    @property
    def converges(self) -> bool:
        """Whether it is certain that the trials converge.

        Single trials may still increase the error.
        """
        return self.monotone or (not self.uncertain and bool(np.max(self.spectral_radius) < 1))

    def mean(self, band=None) -> float:
        """Mean of sigma_max(M) over the logarithm of frequency, in a band (low, high) in rad/s.

        On a logarithmic grid, the mean is the sum in equation (39) of the paper, divided by the
        number of terms. Means can therefore be compared between designs on different grids. The
        integral is computed by the trapezoidal rule, with nodes at `omega` and at the ends of the
        band. Default: from the first to the last frequency of `omega`.
        """
        omega = self.omega
        band = omega[[0, -1]] if band is None else arguments.array("band", band, (2,))
        low, high = band
        if not omega[0] <= low < high <= omega[-1] or low <= 0:
            raise ValueError(
                f"band = {band.tolist()} must be two increasing frequencies above zero, within "
                f"omega, which goes from {omega[0]:.6g} to {omega[-1]:.6g} rad/s"
            )
        return np.apply_along_axis(log_mean, -1, self.sigma, omega, band)[()]

    def __repr__(self):
        rate, radius = np.max(self.rate), np.max(self.spectral_radius)
        at = np.ravel(self.at)[np.argmax(self.rate)]
        if self.monotone:
            how = "converges monotonically"
        elif self.converges:
            how = "converges, but not monotonically"
        else:
            how = "diverges" if radius >= 1 else "need not converge"
        where = "at all frequencies" if self.proven else "not proven between frequencies"
        line = (
            f"{how}: sigma_max(M) is at most {rate:.4f}, at {at:.4g} rad/s ({where}), and the "
            f"largest |eigenvalue of M| is {radius:.4f}"
        )
        if how == "diverges":  # short trials show this only slowly
            line += ", in trials that are long compared with the slowest mode"
        return "\n".join([line, *self.assumptions])


def convergence(P, Q, L: LearningOperator, omega=None) -> Convergence:
    """Find out how fast the error converges from trial to trial, by M = Q (I - P L) on a grid.

    M maps the error of one trial to the error of the next trial. If P has fewer inputs than
    outputs, the result says how fast the ILC signal v converges, by M = Q (I - L P).

    Parameters
    ----------
    P : array_like, shape (n, p, m), a model, a loop, or a list of these
        As for :func:`ilctools.synthesise`. An array of shape (plants, n, p, m) is also accepted as
        several plants.
    Q : ZeroPhaseButterworth or array_like, shape (n,)
        The low-pass filter Q, or its samples on `omega`.
    L : LearningOperator
        The learning filter.
    omega : array_like, shape (n,), optional
        Increasing frequencies, rad/s, up to the Nyquist frequency. Default: as in
        :func:`ilctools.synthesise`.

    Returns
    -------
    Convergence
        If `rate`, the gamma of Lemma 1 of the paper, is below one, the error converges
        monotonically. If `spectral_radius` is below one, the error converges, but may grow in the
        first trials. For one channel, the two numbers are equal.

    See Also
    --------
    Synthesis.check : the convergence of a design with another plant

    Examples
    --------
    >>> import control
    >>> from ilctools import LearningFilter, convergence, zero_phase_butterworth
    >>> P, L = control.ss(0.5, 0.5, 1, 0, 1.0), LearningFilter([[[0.8]]], Ts=1.0)
    >>> result = convergence(P, zero_phase_butterworth(2, 0.1, 1.0), L)
    >>> result.monotone, round(float(result.rate), 3)
    (True, 0.201)
    """
    arguments.instance("L", L, LearningOperator)
    response = response_of(P, omega, L.Ts, Q=Q)
    if response.radius is not None:
        raise ValueError(
            "P has a radius, which convergence cannot take into account: use design.check(P)"
        )
    check_match(P=response.signals, L=L)
    omega, responses = response.omega, response.P
    check_learning(L, "L", *responses.shape[:-3:-1])
    Q = lowpass_of(Q, omega).frequency_response(omega)
    several = isinstance(P, list | tuple) or np.ndim(P) == 4
    P = responses if several else responses[0]
    return from_responses(omega, P, Q, L.frequency_response(omega))


def from_responses(omega, P, Q, L) -> Convergence:
    """Compute the result of :func:`convergence` from the frequency responses of P, Q and L.

    P has the shape (n, p, m) or (plants, n, p, m).
    """
    M = convergence_matrix(P, Q, L)
    sigma = largest_singular_values(M.reshape(-1, *M.shape[-2:])).reshape(M.shape[:-2])
    radius = np.abs(np.linalg.eigvals(M)).max(axis=-1)
    return Convergence(
        omega,
        sigma,
        rate=sigma.max(axis=-1),
        at=np.asarray(omega)[tied(sigma.T).argmax(axis=0)],
        spectral_radius=radius.max(axis=-1),
    )


def log_mean(sigma, omega, band) -> float:
    """Return the mean of sigma, given at `omega`, over the logarithm of frequency in a band."""
    low, high = band
    within = omega[(omega > low) & (omega < high)]
    place = np.log([low, *within, high])
    values = np.interp(place, np.log(np.maximum(omega, low / 2)), sigma)
    return np.trapezoid(values, place) / (place[-1] - place[0])
