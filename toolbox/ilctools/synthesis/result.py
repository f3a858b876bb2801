"""The result of a synthesis: a filter with its certificate."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ilctools import labels
from ilctools.base import extended, in_units
from ilctools.evidence.certificate import Certificate, check
from ilctools.evidence.convergence import Convergence
from ilctools.evidence.margins import Margins
from ilctools.filters import Filter, ZeroPhaseButterworth
from ilctools.law.law import Law
from ilctools.law.output_limits import OutputLimits
from ilctools.law.plant_region import PlantRegion
from ilctools.problem.lowpass import SampledQ
from ilctools.problem.pose import pose
from ilctools.problem.problem import Problem
from ilctools.response.door import in_own_units, named, response_of
from ilctools.signals import check_match
from ilctools.singular_values import largest_singular_values
from ilctools.threads import on_one_thread


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A learning filter, with what was checked about it by singular values."""

    certificate: Certificate  # of optimality and bounds, independent of the solver

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.certificate.problem

    @cached_property
    def filter(self) -> Filter:
        """The learning filter L, for the plant's own channels in their units."""
        L, response = self.certificate.scaled_filter, self.problem.response
        if (directions := response.directions) is not None:
            L = extended(L, directions.U, directions.V)
        return in_units(L, response.scale.v, response.scale.y)

    @cached_property
    def _L(self) -> np.ndarray:
        return self.certificate.scaled_filter.frequency_response(self.omega)

    @property
    def sigma_M(self) -> np.ndarray:
        """Largest singular values of the nominal M at the design frequencies, shape (n,)."""
        return largest_singular_values(self.problem.M(self._L))

    @property
    def sigma_L(self) -> np.ndarray:
        """Largest singular values of L at the design frequencies, in units of `scale`, (n,)."""
        return largest_singular_values(self._L)

    @property
    def value(self) -> float:
        """The value of the objective."""
        return self.certificate.value

    @property
    def rate(self) -> float:
        """The largest sigma_max(M) of all plants: the gamma of Lemma 1."""
        return self.certificate.rate

    @property
    def margins(self) -> Margins:
        """By how much gain, delay and time scale of the plant may change, see :class:`Margins`."""
        return self.certificate.margins

    @property
    def Q(self) -> ZeroPhaseButterworth | Any:
        """The filter Q, if Q is a filter; else its samples at `omega`."""
        sampled = isinstance(self.problem.lowpass, SampledQ)
        return self.problem.Q if sampled else self.problem.lowpass

    @property
    def omega(self) -> np.ndarray:
        """The design frequencies, rad/s."""
        return self.problem.omega

    def law(self, rest: int = 0, gain: float = 1.0, limits=None, noise=None, model=None) -> Law:
        """The law (23) with Q and L of the design.

        The law keeps the P of the design. Trials are compared with it if their loop has no P.

        Parameters
        ----------
        rest, gain :
            As for :class:`ilctools.Law`.
        limits : dict, optional
            Lowest and highest value of commands and of outputs, by name. Each value is a number,
            one number for each sample (shape (time,)), or None for no limit. For commands see
            :class:`ilctools.Law`. Each plant within the radius of the design keeps the limits of
            outputs in every trial. Print the law's ``output_limits`` for the conditions. Without a
            radius, the limits of outputs hold for the model only.
        noise : dict, optional
            Bound on the non-repeating noise in one sample, for outputs with limits, by name. The
            law keeps twice this distance from the limits.
        model : control.StateSpace, optional
            A model of P, which limits of outputs need if P is known by samples. The distance of the
            model from the samples is added to their radius.
        """
        problem = self.problem
        if isinstance(problem.lowpass, SampledQ):
            raise ValueError(
                "Q = samples cannot be applied to a trial: pass synthesise a filter Q, such "
                "as zero_phase_butterworth(order, cutoff, Ts)"
            )
        region = in_own_units(problem.response)
        signals = problem.response.signals
        limits, kept = self._limits_by_kind(limits, noise, model)
        return Law(
            self.Q, self.filter, rest, gain, limits,
            region=region, labels=signals, output_limits=kept,
        )  # fmt: skip

    def _limits_by_kind(self, limits, noise, model):
        """Split limits into limits of commands, or None, and limits of outputs, or None."""
        outputs, inputs = ([str(name) for name in names] for names in self.problem.response.names)
        of_outputs = {}
        if isinstance(limits, dict):
            of_outputs = {name: ends for name, ends in limits.items() if name in outputs}
        if both := [name for name in of_outputs if name in inputs]:
            raise ValueError(
                f"limits[{both[0]!r}] is the name of an output and of an input: give this "
                "input of P another name"
            )
        if not of_outputs:
            if noise:
                raise ValueError(
                    f"noise = {noise!r} is for limits of outputs, but limits "
                    f"names none of the outputs {outputs}: leave noise out, or "
                    "add limits"
                )
            return limits, None
        of_commands = {name: limits[name] for name in limits if name not in of_outputs}
        region = PlantRegion.of(self.problem.response, model)
        return of_commands or None, OutputLimits(of_outputs, noise or {}, region)

    def check(self, P, omega=None, *, uncertainty=None) -> Convergence:
        """Compute the rate of the filter on another plant, and whether trials converge.

        Parameters
        ----------
        P : as for :func:`synthesise`
            One plant or several, with the channels and the sampling period of the design. For a
            loop of :func:`current_trial_loop` pass ``loop.around(plant)[:, loop.inputs]``, because
            `plant` alone has no feedback.
        omega : array_like, shape (n,), optional
            Frequencies, rad/s. Default: the frequencies of P, or else of the design.
        uncertainty
            As for :func:`synthesise`.

        Returns
        -------
        Convergence
            Print it. `rate` is the gamma of Lemma 1 for the worst plant. If `spectral_radius` is
            below one, trials converge even if the rate is above one. For another Q, see
            :func:`convergence`.
        """
        design = self.problem
        first, *_ = named(P).values()
        _, omega = labels.table_of("P", first, omega)
        if omega is None:
            omega = getattr(P, "omega", self.omega)
        Q, like = design.lowpass, design.response
        response = response_of(P, omega, design.Ts, uncertainty, Q=Q, like=like)
        problem = pose(response, Q, order=1, L_max=None, objective="peak")
        check_match(design=design.response.signals, P=response.signals)
        return on_one_thread(check)(problem, self.certificate.scaled_filter).convergence

    def __repr__(self):
        return repr(self.certificate)
