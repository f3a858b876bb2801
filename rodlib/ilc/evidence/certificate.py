"""What is known about a learning filter, by evidence independent of the solver."""

from dataclasses import dataclass

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.evidence.convergence import from_responses, log_mean
from rodlib.ilc.evidence.findings import findings, useless
from rodlib.ilc.evidence.finite import trial_norm
from rodlib.ilc.evidence.optimality import lower_bound
from rodlib.ilc.evidence.peak import (
    Peak,
    estimated_peaks,
    highest,
    learning_model,
    peak_beyond,
    peak_gain,
    proven_peaks,
)
from rodlib.ilc.evidence.robustness import WorstCase, worst_case
from rodlib.ilc.filters import LearningFilter
from rodlib.ilc.problem.problem import (
    MOST_GAIN,
    Problem,
    Solution,
    largest_singular_values,
)

# Relative duality gap, and relative violation of a bound on the grid, that are accepted.
GAP = 1e-6
VIOLATION = 1e-9
# Share of 1 - sigma_max(M) that splines may miss: a narrow resonance shows little on its flanks.
COARSE = 0.25
BETWEEN = (
    1e-7  # relative violation between the frequencies, where the bounds hold there, too
)
NAMED = 4  # of those that are tied as the worst, so many are named


@dataclass(frozen=True)
class Certificate:
    """What is known about a learning filter, by evidence independent of the solver."""

    problem: Problem
    value: float  # the objective reached
    lower_bound: float  # what no such filter within the bounds can go below
    nominal: (
        np.ndarray
    )  # (n,): sigma_max(M) of the nominal plant at the design frequencies
    worst: (
        WorstCase  # of all plants, within the radius, at each of the design frequencies
    )
    peak: Peak  # over all frequencies, without the radius, which is not known between the samples
    exact: Peak | None  # of the plants that are models, if Q is one, too
    estimated: (
        int  # for so many of the others, the worst on the grid, there is an estimate
    )
    beyond: Peak | None  # above the last sample, of the size that is assumed there
    grid_L: float  # peak of sigma_max(L) on the design grid
    passed_L: float  # the largest share of its bound that sigma_max(L) has there
    all_L: float  # an upper bound of it, to 1e-8, for all frequencies
    tolerances: tuple[float, float] = (GAP, VIOLATION)  # that are accepted
    trial: float = np.nan  # 2-norm of the map of one finite trial, if asked for
    samples: int | None = None  # length of that trial
    rest: int = 0  # of it, in which v is held at zero
    findings: tuple[str, ...] = ()  # why the problem itself may be badly chosen
    within: float = (
        np.nan
    )  # rate where commands have limits, by a :class:`rodlib.Law` with limits
    basis: tuple[
        str, ...
    ] = ()  # what P and its radius rest on, and where they are of no use

    @property
    def grid_M(self) -> float:
        """Peak of sigma_max(M) on the design grid, the largest of all plants within the radius."""
        return self.worst.sigma.max()

    @property
    def all_M(self) -> float:
        """Peak of sigma_max(M) over all frequencies, to 1e-8; an estimate if it is not proven."""
        return self.peak.sigma

    @property
    def mean_M(self) -> float:
        """Mean of sigma_max(M) of the nominal plant over the band, see :meth:`Convergence.mean`."""
        problem = self.problem
        design = np.isin(problem.omega, problem.design.omega)
        return float(
            log_mean(self.nominal[design], problem.omega[design], problem.band)
        )

    @property
    def proven(self) -> bool:
        """False if P or Q were given as samples: between them `all_M` is read off splines."""
        return not self.estimated

    @property
    def gap(self) -> float:
        """Distance of value and lower bound, relative to :meth:`rodlib.ilc.Problem.unit`."""
        return (self.value - self.lower_bound) / self.problem.unit(self.value)

    @property
    def unseen(self) -> Peak | None:
        """The highest peak of the models, if it is one or more, where omega does not see it."""
        return self.exact if self.exact and self.exact.sigma >= 1 else None

    @property
    def failures(self) -> list[str]:
        """What speaks against the filter; empty if it holds."""
        (gap, violation), M_max, L_max = (
            self.tolerances,
            self.problem.M_max,
            self.problem.L_max,
        )
        high_L = L_max is not None and self.grid_L > L_max * (1 + violation)
        where = f" at its worst ({self._where})" if self.problem.robust else ""
        tests = {
            f"relative duality gap {self.gap:.1e} > {gap:g}": self.gap > gap,
            f"sigma_max(M){where} = {self.grid_M:.12g} > M_max = {M_max} on the grid": (
                self.grid_M > M_max * (1 + violation)
            ),
            f"sigma_max(L) = {self.grid_L:.12g} > L_max = {L_max} on the grid": high_L,
            f"sigma_max(L) is {self.passed_L:.12g} times what bounds it between or above the "
            "frequencies omega": self.passed_L > 1 + violation and not high_L,
        }
        if self.problem.everywhere:
            most = 1 + violation + BETWEEN
            high_M = self.exact is not None and self.exact.sigma > M_max * most
            high_L = L_max is not None and self.all_L > L_max * most
            passed = (
                f"sigma_max(M) is {self.all_M:.12g}, sigma_max(L) {self.all_L:.12g}"
            )
            tests[f"{passed} at some frequency, above the bounds"] = high_M or high_L
        if at := self.unseen:
            where = f"{at.sigma:.9g} at {at.omega:.6g} rad/s"
            reached = f"sigma_max(M){self._whose(at)} reaches {where}"
            tests[
                f"{reached}, not in omega: Lemma 1 does not hold; add frequencies there"
            ] = True
        if self.beyond and not self.problem.findings:
            reached = f"{self._above}, may reach {self.beyond.sigma:.4g}: Lemma 1 does not hold"
            tests[reached] = self.beyond.sigma >= 1
        return [text for text, failed in tests.items() if failed]

    @property
    def warnings(self) -> list[str]:
        """What speaks against the problem, and against what is said between the samples."""
        margin, missed = 1 - self.all_M, self.peak.missed
        warned = [*self.findings]
        if not self.proven and margin <= 0:
            warned.append(
                f"sigma_max(M){self._whose(self.peak)} may reach {self.all_M:.4g} at "
                f"{self.peak.omega:.4g} rad/s, between the samples, where Lemma 1 would not "
                "hold; measure there, or smooth samples that scatter"
            )
        elif not self.proven and missed > COARSE * margin:
            warned.append(
                f"the samples are too coarse: splines miss M by {missed:.2g} at samples left out, "
                f"and 1 - sigma_max(M) is {margin:.2g}; measure at more frequencies"
            )
        return warned

    @property
    def _nyquist(self):
        return np.pi / self.problem.Ts

    @property
    def _several(self):
        return len(self.problem.plants) > 1

    def _whose(self, peak):
        """Of which plant a peak is, for the messages."""
        return f" of plant {peak.plant}" if self._several else ""

    @property
    def _where(self):
        """The plants and frequencies of the peak on the grid."""
        pairs = [
            f"{f'plant {number} ' if self._several else ''}at {self.problem.omega[k]:.4g}"
            for number, k in self.worst.tied
        ]
        more = f" and {len(pairs) - NAMED} more" if len(pairs) > NAMED else ""
        return f"{', '.join(pairs[:NAMED])} rad/s{more}"

    @property
    def _above(self):
        """Where M is bounded by what is assumed, for the messages."""
        last = self.problem.design.omega[-1]
        return f"sigma_max(M) above {last:.4g} rad/s, with the size of P assumed there"

    def _table(self):
        """Bounds and peaks of M and L."""
        M_max, L_max = self.problem.M_max, self.problem.L_max
        known = self.proven and self.problem.radius is None
        rows = [
            ("", "sigma_max(M)", "sigma_max(L)"),
            ("bound", f"{M_max:g}", "none" if L_max is None else f"{L_max:g}"),
            ("on the design grid", f"{self.grid_M:.8f}", f"{self.grid_L:.7g}"),
            ("  of the nominal plant", f"{self.worst.peaks[0]:.8f}", ""),
            ("over all frequencies", f"{self.all_M:.8f}" if known else "not known",
             f"{self.all_L:.7g}"),
        ]  # fmt: skip
        if not self.problem.robust:
            del rows[3]
        return ["{:<22}{:>14}{:>14}".format(*row).rstrip() for row in rows]

    def _on_the_grid(self):
        """The worst plants and frequencies, if there is a choice."""
        if not self.problem.robust:
            return []
        radius = self.problem.radius is not None
        of = f" of {len(self.problem.plants)} plants" if self._several else ""
        within = " within the radius" if radius else ""
        lines = [f"worst{of}{within} on the design grid: {self._where}"]
        if radius:
            reached = self.worst.attained[[k for _, k in self.worst.tied]].max()
            lines.append(
                f"a plant within the radius reaches {reached:.8f} there; between the samples the "
                "radius is not known"
            )
        return lines

    def _between_the_samples(self):
        """What is not in the table of M between the design frequencies."""
        without = " without the radius" if self.problem.radius is not None else ""
        if self.proven:
            line = f"sigma_max(M) over all frequencies{without}: {self.all_M:.8f}"
            return [line] if without else []
        low, high = self.problem.design.omega[[0, -1]]
        estimated = self.estimated
        of = f" for the {estimated} sampled plants that are worst on the grid"
        unknown = [f"below {low:.4g} rad/s"] if low > 0 else []
        if self.beyond is None and high < self._nyquist * (1 - 1e-9):
            unknown.append(f"above {high:.4g} rad/s")
        return [
            f"sigma_max(M){without} from {low:.4g} to {high:.4g} rad/s, between the samples: "
            f"{self.all_M:.4f}, estimated{of if estimated < len(self.problem.plants) else ''}",
            *(
                [f"{self._above}: {self.beyond.sigma:.4f} at most"]
                if self.beyond
                else []
            ),
            f"sigma_max(M) unknown: {', '.join([*unknown, 'at resonances that no sample shows'])}",
        ]

    def __repr__(self):
        problem = self.problem
        compared = (
            "" if problem.L_max else f" with a gain of Q P L up to {MOST_GAIN:.0e}"
        )
        lines = [
            *self._table(),
            *self._on_the_grid(),
            *self._between_the_samples(),
            *["bounds asked for at every frequency, not on the grid only"]
            * problem.everywhere,
            f"objective {self.value:.7g}, no {problem.structure} filter of order {problem.order}"
            f"{compared} below {self.lower_bound:.7g}",
        ]
        if problem.objective == "sum" and 0 < problem.band[0] < problem.band[1]:
            lines.append(f"mean of sigma_max(M) over the band: {self.mean_M:.4f}")
        if self.samples:
            rest = f", the last {self.rest} at rest" if self.rest else ""
            lines.append(
                f"norm of one trial of {self.samples} samples{rest}: {self.trial:.4f}"
            )
        promise = "no rate" if self.within >= 1 else f"a rate of {self.within:.4f}"
        lines.append(f"where commands have limits: {promise}, without ends")
        lines += [*self.basis, *(f"WARNING: {text}" for text in self.warnings)]
        return "\n".join([*lines, *(f"FAILS: {text}" for text in self.failures)])


def certify(
    problem: Problem,
    solution: Solution,
    tolerances: tuple[float, float] = (GAP, VIOLATION),
    samples: int | None = None,
    rest: int = 0,
) -> Certificate:
    """Find out what is true of a filter; nothing of the solution is trusted."""
    L = LearningFilter(solution.coefficients, problem.Ts)  # in units of scale, as P is
    response = L.frequency_response(problem.omega_L)
    sigma_M = largest_singular_values(problem.M(response))
    worst = worst_case(problem, L)
    value = problem.value(sigma_M, worst.sigma)
    exact, estimated = (
        proven_peaks(problem, L),
        estimated_peaks(problem, L, worst.peaks),
    )
    return Certificate(
        problem,
        value,
        lower_bound(problem, solution.U, solution.V, solution.cuts),
        sigma_M,
        worst,
        highest([*exact, *estimated]),
        highest(exact),
        len(estimated),
        peak_beyond(problem, L),
        largest_singular_values(response).max(),
        problem.passed_L(response),
        peak_gain(learning_model(L))[0],
        tolerances=tolerances,
        trial=np.nan
        if samples is None
        else trial_norm(*problem.model, L, samples, rest=rest)[0],
        samples=samples,
        rest=rest,
        findings=tuple(findings(problem, value)),
        within=_within(problem, solution),
        basis=(*problem.basis, *problem.assumed, *useless(problem)),
    )


def _within(problem, solution):
    """Rate where commands have limits: of the nominal plant, on the grid, in the plant's units."""
    design, scale = problem.design, problem.scale
    P = design.P * scale[:, None] / scale
    L = problem.filter(solution.coefficients).frequency_response(design.omega)
    return float(from_responses(design.omega, P, design.Q, L).within())


def checked_trial(
    problem: Problem, samples: int | None, rest: int
) -> tuple[int | None, int]:
    """Length of a trial and of the rest at its end; a ValueError if it has no norm."""
    if samples is not None:
        samples = arguments.whole("samples", samples, 2)
        if problem.model is None:
            raise ValueError(
                f"samples = {samples} asks for the norm of a trial, which needs P and Q as models"
            )
    return samples, arguments.whole("rest", rest, 0, (samples or 1) - 1)
