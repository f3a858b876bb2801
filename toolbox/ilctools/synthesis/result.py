"""What comes of a synthesis: a filter with what is known about it, or why there is none."""

import reprlib
from dataclasses import dataclass
from typing import Any

import control
import numpy as np

from ilctools.evidence.certificate import Certificate, check
from ilctools.evidence.convergence import Convergence
from ilctools.evidence.margins import Margins
from ilctools.filters import Filter, ZeroPhaseButterworth
from ilctools.law.law import Law
from ilctools.problem.lowpass import SampledQ
from ilctools.problem.pose import pose
from ilctools.problem.problem import Problem, Solution
from ilctools.response.door import in_own_units
from ilctools.signals import check_match
from ilctools.threads import on_one_thread


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A learning filter and what was checked about it, from singular values."""

    filter: Filter
    problem: Problem  # as stated
    certificate: Certificate  # of optimality and bounds, independent of the solver
    sigma_M: np.ndarray  # (n,): largest singular values of M at the design frequencies
    sigma_L: np.ndarray  # and of L
    solution: Solution  # of the solver, on which nothing relies

    @property
    def value(self) -> float:
        """The objective."""
        return self.certificate.value

    @property
    def rate(self) -> float:
        """The largest sigma_max(M) of all plants: the gamma of Lemma 1."""
        return self.certificate.rate

    @property
    def margins(self) -> Margins:
        """How far the plant may be off before monotone convergence is lost: gain, delay, time."""
        return self.certificate.margins

    @property
    def Q(self) -> ZeroPhaseButterworth | Any:
        """The filter Q, if it is one; else its samples at `omega`."""
        sampled = isinstance(self.problem.lowpass, SampledQ)
        return self.problem.Q if sampled else self.problem.lowpass

    @property
    def Ts(self) -> float:
        """The sampling period, s."""
        return self.problem.Ts

    @property
    def omega(self) -> np.ndarray:
        """The design frequencies, rad/s."""
        return self.problem.omega

    @property
    def M(self) -> control.FrequencyResponseData:
        """M = Q (I - P L) at `omega`, of the channels divided by the problem's `scale`.

        As are P and L: as python-control has them, without a sampling period, since of samples
        with one it draws nothing. The picture is ``control.singular_values_response(M).plot()``.
        """
        return self._frd("M", self.problem.M(self.problem.L(self.solution)))

    @property
    def L(self) -> control.FrequencyResponseData:
        """L at `omega`; of others, in the plant's units, ask `filter`."""
        return self._frd("L", self.problem.L(self.solution))

    @property
    def P(self) -> control.FrequencyResponseData:
        """P of the nominal plant at `omega`."""
        return self._frd("P", self.problem.P)

    def plot(self, **options) -> control.ControlPlot:
        """Draw the singular values of M and L over frequency, as python-control does.

        `options` are those of ``control.singular_values_plot``: `ax`, `dB`, `Hz`, ... With bounds,
        coefficients and trials.
        """
        try:
            return control.singular_values_response([self.M, self.L]).plot(**options)
        except (AttributeError, TypeError) as error:
            raise ValueError(
                f"options = {reprlib.repr(options)} must be those of control.singular_values_plot: "
                f"{error}"
            ) from None

    def _frd(self, name, response):
        return control.frd(np.moveaxis(response, 0, -1), self.omega, None, name=name)

    def law(self, rest: int = 0, gain: float = 1.0, limits=None) -> Law:
        """The law (23) with Q and L of the design; for the others see :class:`ilctools.Law`.

        If P was not one model, the law keeps what was known of it: trials are judged by that.
        """
        problem, region = self.problem, None
        if isinstance(problem.lowpass, SampledQ):
            raise ValueError(
                "Q = samples cannot be applied to a trial: synthesise with Q as a filter"
            )
        if problem.robust or problem.response.sampled:
            region = in_own_units(problem.response)
        signals = problem.response.signals
        return Law(self.Q, self.filter, rest, gain, limits, region=region, labels=signals)

    def check(self, P, omega=None, *, uncertainty=None) -> Convergence:
        """What the filter does on another plant: the rate, and does it converge?

        Parameters
        ----------
        P : as for :func:`synthesise`
            One plant or several, with the channels and the sampling period of the design; of a loop
            that was designed here ``loop.around(plant)``, since `plant` alone has no feedback.
        omega : array_like, shape (n,), optional
            Frequencies, rad/s. Default: those of P, if it has some, else those of the design.
        uncertainty
            As for :func:`synthesise`.

        Returns
        -------
        Convergence
            Print it. `gamma` is the rate of Lemma 1, the worst of all plants; `spectral_radius`
            below one says that the trials converge all the same. For another Q than that of the
            design: :func:`rate`.
        """
        design, Q = self.problem, self.Q
        if omega is None:
            omega = getattr(P, "omega", self.omega)
        if isinstance(design.lowpass, SampledQ) and not (
            np.shape(omega) == Q.shape and np.allclose(omega, self.omega, rtol=1e-9, atol=0)
        ):
            raise ValueError(
                "omega must be the design frequencies, at which alone the samples of Q are "
                "known: synthesise with Q as a filter, or ask rate(P, Q, L, omega)"
            )
        problem = pose(
            P,
            Q,
            omega,
            design.Ts,
            order=1,
            L_max=None,
            objective="peak",
            uncertainty=uncertainty,
            scale=design.scale if np.any(design.scale != 1) else None,
        )
        if problem.channels != design.channels:
            raise ValueError(
                f"P has {problem.channels} channels, but the filter has {design.channels}"
            )
        check_match(design=design.response.signals, P=problem.response.signals)
        return on_one_thread(check)(problem, self.certificate.filter).convergence

    def __repr__(self):
        return repr(self.certificate)
