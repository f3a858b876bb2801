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
    """A designed learning filter with its certificate. Print it to see how fast trials converge."""

    certificate: Certificate  # proves bounds and optimality without the solver

    @property
    def problem(self) -> Problem:
        """The design problem, with plants, Q, bounds and chosen defaults."""
        return self.certificate.problem

    @cached_property
    def filter(self) -> Filter:
        """The learning filter L, for the plant's channels in their own units."""
        L, response = self.certificate.scaled_filter, self.problem.response
        if (directions := response.directions) is not None:
            L = extended(L, directions.U, directions.V)
        return in_units(L, response.scale.v, response.scale.y)

    @cached_property
    def _L(self) -> np.ndarray:
        return self.certificate.scaled_filter.frequency_response(self.omega)

    @property
    def sigma_M(self) -> np.ndarray:
        """sigma_max(M) of the nominal plant at the design frequencies, shape (n,)."""
        return largest_singular_values(self.problem.M(self._L))

    @property
    def sigma_L(self) -> np.ndarray:
        """sigma_max(L) at the design frequencies, in units of `scale`, shape (n,)."""
        return largest_singular_values(self._L)

    @property
    def value(self) -> float:
        """The value of the objective (39) or (45) for this filter."""
        return self.certificate.value

    @property
    def rate(self) -> float:
        """The largest sigma_max(M) of all plants: the gamma of Lemma 1 of the paper."""
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
        """Return the law (23), v_{k+1} = Q (v_k + L e_k), with Q and L of the design.

        The law stores the P of the design. If the loop of a trial has no P, trials are compared
        with the stored P.

        Parameters
        ----------
        rest, gain :
            As for :class:`ilctools.Law`.
        limits : dict, optional
            Lowest and highest value of commands and of outputs, by name. Each value is a number, an
            array with one number for each sample, or None for no limit. For limits of commands, see
            :class:`ilctools.Law`. Each plant within the radius of the design keeps the limits of
            outputs in every trial. To see the conditions of this guarantee, print the law's
            ``output_limits``. If the design has no radius, limits of outputs hold only if the model
            is exact.
        noise : dict, optional
            Bound on the non-repeating noise in one sample, by name, for outputs with limits. The
            law keeps a distance of twice this bound from the limits.
        model : control.StateSpace, optional
            A model of P. Limits of outputs need a model if P is known by samples. The distance of
            the model from the samples is added to the radius of the samples.
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
        """Split limits into limits of commands and limits of outputs.

        Each of the two results may be None.
        """
        outputs, inputs = ([str(name) for name in names] for names in self.problem.response.names)
        given = limits if isinstance(limits, dict) else {}
        of_outputs = {name: ends for name, ends in given.items() if name in outputs}
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
        of_commands = {name: ends for name, ends in given.items() if name not in outputs}
        region = PlantRegion.of(self.problem.response, model)
        return of_commands or None, OutputLimits(of_outputs, noise or {}, region)

    def check(self, P, omega=None, *, uncertainty=None) -> Convergence:
        """Compute how fast trials with the designed Q and L converge on another plant.

        Parameters
        ----------
        P : as for :func:`synthesise`
            One or several plants, with the channels and the sampling period of the design. If the
            design is for a loop of :func:`current_trial_loop`, pass
            ``loop.around(plant)[:, loop.inputs]``, because `plant` alone has no feedback.
        omega : array_like, shape (n,), optional
            Frequencies, rad/s. Default: the frequencies of P, or else of the design.
        uncertainty : as for :func:`synthesise`
            Radius around each plant.

        Returns
        -------
        Convergence
            The result, which can be printed. `rate` is the gamma of Lemma 1 of the paper for the
            worst plant. If `rate` is below one, the error decreases in each trial. If only
            `spectral_radius` is below one, trials converge, but the error may grow at first. For
            another Q, use :func:`convergence`.
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
