"""Do the trials converge, and how fast? Two numbers of M = Q (I - P L), on a grid.

The largest sigma_max(M) is the gamma of Lemma 1: below one the error converges *monotonically*, in
every trial by that factor at least. The largest spectral radius of M is never larger: below one the
error *converges*, though it may grow before. Both are about trials without ends.
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
    """How the trials converge, by M = Q (I - P L). Made by :func:`convergence`.

    For p plants `sigma` has the shape (p, n), and each other result the shape (p,). That of
    :meth:`.Synthesis.check` is for the worst of all plants, between the frequencies, too.
    """

    omega: np.ndarray  # (n,), rad/s
    sigma: np.ndarray  # (n,): sigma_max(M), by which the error shrinks there at least
    rate: float  # the gamma of Lemma 1: the largest of them
    at: float  # the frequency of the rate, rad/s; the lowest of those that are tied
    spectral_radius: float  # largest |eigenvalue of M|
    proven: bool = False  # whether the rate holds at all frequencies
    uncertain: bool = False  # whether P may be another, for which the trials diverge
    assumptions: tuple[str, ...] = ()  # what P and its radius rest on

    @property
    def monotone(self) -> bool:
        """Whether every trial brings the error nearer to its limit (Lemma 1)."""
        return bool(np.max(self.rate) < 1)

    @property
    def converges(self) -> bool:
        """Whether the trials surely converge, if not each of them comes nearer."""
        return self.monotone or (not self.uncertain and bool(np.max(self.spectral_radius) < 1))

    def mean(self, band=None) -> float:
        """Mean of sigma_max(M) over the logarithm of frequency, in a band (low, high) in rad/s.

        The sum in (39) on a logarithmic grid, divided by the number of its terms: designs on
        different grids can be compared. By trapezia, with corners at `omega` and the ends of the
        band; default: from the first to the last frequency.
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
            how = "converges, not monotonically"
        else:
            how = "diverges" if radius >= 1 else "need not converge"
        where = "at all frequencies" if self.proven else "not proven between samples"
        line = (
            f"{how}: sigma_max(M) is {rate:.4f} at most, at {at:.4g} rad/s ({where}), "
            f"|eigenvalue of M| {radius:.4f}"
        )
        if how == "diverges":  # slowly, where trials are short against it
            line += ", for trials that are long against the slowest mode"
        return "\n".join([line, *self.assumptions])


def convergence(P, Q, L: LearningOperator, omega=None) -> Convergence:
    """How fast the error converges from trial to trial: M = Q (I - P L) on a grid.

    With fewer inputs than outputs, how fast v does: M = Q (I - L P).

    Parameters
    ----------
    P : array_like, shape (n, p, m), a model, a loop, or a list of these
        As for :func:`ilctools.synthesise`; an array (plants, n, p, m) is several plants, too.
    Q : ZeroPhaseButterworth or array_like, shape (n,)
    L : LearningOperator
        The learning filter.
    omega : array_like, shape (n,), optional
        Increasing frequencies, rad/s, up to the Nyquist frequency. Default: those that
        :func:`ilctools.synthesise` would take.

    Returns
    -------
    Convergence
        `rate`, the gamma of Lemma 1, below one: the error converges monotonically.
        `spectral_radius` below one: it converges, but may grow before. Of one channel, the two are
        equal.

    See Also
    --------
    Synthesis.check : of a design, for another plant

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
        raise ValueError("P has a radius, for which a design answers: design.check(P)")
    check_match(P=response.signals, L=L)
    omega, responses = response.omega, response.P
    check_learning(L, "L", *responses.shape[:-3:-1])
    Q = lowpass_of(Q, omega).frequency_response(omega)
    several = isinstance(P, list | tuple) or np.ndim(P) == 4
    P = responses if several else responses[0]
    return from_responses(omega, P, Q, L.frequency_response(omega))


def from_responses(omega, P, Q, L) -> Convergence:
    """As :func:`convergence`, of frequency responses P (n, p, m) or (plants, n, p, m), Q and L."""
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
    """Mean over the logarithm of frequency, in the band, of what is known at `omega`."""
    low, high = band
    within = omega[(omega > low) & (omega < high)]
    place = np.log([low, *within, high])
    values = np.interp(place, np.log(np.maximum(omega, low / 2)), sigma)
    return np.trapezoid(values, place) / (place[-1] - place[0])
