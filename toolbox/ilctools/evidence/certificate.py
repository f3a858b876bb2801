"""What is known about a learning filter, by evidence independent of the solver.

:func:`check` says what a filter does to all plants of a problem, that of its design or another one.
:func:`certify` adds how far the filter is from the optimum of its design.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ilctools.evidence.convergence import Convergence, from_responses, log_mean
from ilctools.evidence.margins import Margins, margins
from ilctools.evidence.optimality import lower_bound, relief
from ilctools.evidence.peak import CLOSE, Peak, estimated_peaks, highest, peak_of_L, proven_peaks
from ilctools.evidence.prediction import predicted_rms
from ilctools.evidence.robustness import WorstCase, worst_case
from ilctools.filters import LearningFilter
from ilctools.problem.defaults import lead
from ilctools.problem.problem import K_MAX, MOST_GAIN, Problem, Solution, convergence_matrix
from ilctools.response.roughness import scatter_warnings
from ilctools.singular_values import TIED, largest_singular_values

# Relative duality gap, and relative violation of a bound on the grid, that are accepted;
GAP = 1e-6
VIOLATION = 1e-9
# Share of 1 - M_max by which M may pass its bound between the frequencies without a warning; of
# samples, of 1 - sigma_max(M) at the frequencies
COARSE = 0.25
NAMED = 4  # of those that are tied as the worst, so many are named
FINE = 2000  # frequencies of the mean over the band
PASSED_L = 1.01  # times L_max, between the frequencies
CHOSEN = "chosen: ", "L = B"  # how what is no assumption begins: in the details
LEAD = 0.5  # of P's phase in the mean, rad, from which on its sign is taken to be wrong
DEAF = 1e-3  # of P L, where P passes nothing
IDLE = 0.9  # share of the error in the band from which on learning counts as idle


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is known about a learning filter, by evidence independent of the solver."""

    problem: Problem
    filter: LearningFilter  # in units of scale, as P is
    value: float  # the objective reached
    worst: WorstCase  # of all plants, within the radius, at each of the frequencies
    # Peaks over all frequencies, without the radius: of the plants that are models, if Q is one,
    # too; and between the frequencies of omega, within the radius, and of samples.
    exact: list[Peak]
    estimated: list[Peak]
    beyond: Peak | None  # above the last sample, of the size that is assumed there
    grid_L: float  # peak of sigma_max(L) on the grid
    lower_bound: float = np.nan  # what no such filter within the bounds can go below
    relief: float = np.nan  # of the optimum, relative, by a relative increase of L_max: convex

    @property
    def grid_M(self) -> float:
        """Peak of sigma_max(M) on the grid, the largest of all plants within the radius."""
        return self.worst.sigma.max()

    @property
    def peak(self) -> Peak:
        """The highest over all frequencies."""
        return highest([*self.exact, *self.estimated])

    @property
    def all_M(self) -> float:
        """An upper bound of sigma_max(M), to CLOSE; an estimate if it is not proven."""
        return self.peak.sigma

    @cached_property
    def all_L(self) -> float:
        """An upper bound of sigma_max(L), to CLOSE, for all frequencies."""
        return peak_of_L(self.filter)[0]

    @property
    def proven(self) -> bool:
        """False if P or Q are samples, or there is a radius: `all_M` is then of a dense grid."""
        return not self.estimated

    @property
    def highest_peak(self) -> Peak:
        """The highest of all that is proven, estimated or assumed, whatever the place."""
        plant, at = self.worst.tied[0]
        peaks = [Peak(self.grid_M, self.problem.omega[at], plant), *self.exact, *self.estimated]
        return highest(peaks if self.beyond is None else [*peaks, self.beyond])

    @property
    def rate(self) -> float:
        """The largest sigma_max(M): the gamma of Lemma 1."""
        return float(self.highest_peak.sigma)

    @property
    def convergence(self) -> Convergence:
        """Do the trials converge, on the worst of all plants?"""
        problem, beyond, L = self.problem, self.beyond, self.filter
        response = L.frequency_response(problem.omega)
        on_grid = from_responses(problem.omega, problem.plants, problem.Q, response)
        radii = [on_grid.spectral_radius.max()]
        for peak in self.exact:  # between the frequencies, too
            at = [peak.omega]
            P, _ = problem.response.anywhere(peak.plant, at)
            Q = problem.lowpass.frequency_response(at)
            radii.append(from_responses(at, P, Q, L.frequency_response(at)).spectral_radius)
        return replace(
            on_grid,
            sigma=self.worst.sigma,
            gamma=self.rate,
            at=float(self.highest_peak.omega),
            spectral_radius=float(max(radii)),
            proven=self.proven,
            uncertain=problem.design.radius is not None
            or (beyond is not None and beyond.sigma >= 1),
            assumptions=self.assumptions,
        )

    @property
    def mean_M(self) -> float:
        """Of the nominal plant, see :meth:`.Convergence.mean`; NaN without a band."""
        design = self.problem.design
        low, high = design.band or (0, 0)
        if low <= 0:
            return np.nan
        omega, P, Q = design.omega, design.P, design.Q
        if design.proven:  # trapezia between coarse frequencies are not enough
            omega = np.union1d(omega, np.geomspace(low, high, FINE))
            P, _ = design.response.anywhere(0, omega)
            Q = design.lowpass.frequency_response(omega)
        M = convergence_matrix(P, Q, self.filter.frequency_response(omega))
        return float(log_mean(largest_singular_values(M), omega, design.band))

    @cached_property
    def margins(self) -> Margins:
        """How far the plant may be off before monotone convergence is lost."""
        return margins(self.problem, self.filter)

    @property
    def predicted(self) -> dict[int, float] | None:
        """RMS of the error in some trials, for the reference of the design; None without one."""
        return None if self.problem.band else predicted_rms(self.problem, self.filter)

    @property
    def gap(self) -> float:
        """Distance of value and lower bound, relative to :meth:`.Problem.unit`."""
        return (self.value - self.lower_bound) / self.problem.unit(self.value)

    @property
    def unseen(self) -> Peak | None:
        """The highest peak of the models, if it is one or more, where omega does not see it."""
        peak = highest(self.exact)
        return peak if peak and peak.sigma >= 1 and not self.deaf else None

    @cached_property
    def deaf(self) -> bool:
        """Whether the highest peak is where P passes nothing, and M is |Q| for any L."""
        peak = highest(self.exact)
        if not peak or peak.sigma < 1 - DEAF:
            return False
        P, _ = self.problem.response.anywhere(peak.plant, [peak.omega])
        Q = self.problem.lowpass.frequency_response([peak.omega])
        passed = np.linalg.svd(P[0])[1][-1] * self.all_L
        return bool(passed < DEAF and peak.sigma <= Q[0] * (1 + CLOSE))

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What P and its radius rest on, and where they are of no use."""
        deaf = []
        if self.deaf:
            deaf.append(
                f"P passes nothing at {highest(self.exact).omega:.4g} rad/s: M is |Q| there for "
                f"any L, and the error stays; at the frequencies omega it is {self.grid_M:.4g}"
            )
        return (*self.problem.assumptions, *deaf, *_unusable(self.problem.design))

    @property
    def failures(self) -> list[str]:
        """What does not hold; empty if all does."""
        return list(self._failures())

    def _failures(self) -> Iterator[str]:
        problem = self.problem
        M_max, L_max = problem.design.M_max, problem.design.L_max
        if self.gap > GAP:
            yield f"relative duality gap {self.gap:.1e} > {GAP:g}"
        if self.grid_M > M_max * (1 + VIOLATION):
            where = f" at its worst ({self._where()})" if problem.robust else ""
            yield f"sigma_max(M){where} = {self.grid_M:.12g} > M_max = {M_max} on the grid"
        if L_max is not None and self.grid_L > L_max * (1 + VIOLATION):
            yield f"sigma_max(L) = {self.grid_L:.12g} > L_max = {L_max} on the grid"
        if problem.everywhere:
            limit = 1 + CLOSE
            if self.all_M > M_max * limit or (L_max or np.inf) * limit < self.all_L:
                yield (
                    f"sigma_max(M) is {self.all_M:.12g}, sigma_max(L) {self.all_L:.12g} at some "
                    "frequency, above the bounds"
                )
        if peak := self.unseen:
            yield (
                f"sigma_max(M){self._whose(peak)} reaches {peak.sigma:.9g} at {peak.omega:.6g} "
                "rad/s, not in omega: Lemma 1 does not hold; add frequencies there, or "
                "synthesise with everywhere=True"
            )
        if self.beyond and self.beyond.sigma >= 1 and not problem.findings:
            size = f"{self.beyond.sigma:.4g}"
            yield f"{self._above()}, may reach {size}: Lemma 1 does not hold"

    @property
    def warnings(self) -> list[str]:
        """What speaks against the problem, and against what is said between the samples."""
        problem, design = self.problem, self.problem.design
        texts = [*problem.findings]
        if design.response.models[0] is None and design.radius is None:
            texts += scatter_warnings(design.omega, design.P, design.Q)
        if design.response.models[0] is None and lead(design.P, design.omega, design.Ts) > LEAD:
            texts.append(
                "the phase of P leads what its gain admits of any stable plant: is it of "
                "exp(-j omega t), then pass P.conj(), in other units of omega, or |P| alone?"
            )
        if problem.objective == "sum" and self.value > IDLE * problem.idle:
            share = self.value / problem.idle
            where = "in the band" if problem.band else "for this reference"
            texts.append(f"the filter leaves {share:.0%} of the error {where}")
        whose = f"sigma_max(M){self._whose(self.peak)}"
        place = f"{self.all_M:.4g} at {self.peak.omega:.4g} rad/s, between the"
        M_max = problem.design.M_max
        passed = self.all_M - M_max > COARSE * (1 - M_max)
        if self.proven and passed and not self.failures and not self.deaf:
            texts.append(
                f"{whose} reaches {place} frequencies omega, where M_max = {M_max:g} "
                "bounds it: synthesise with everywhere=True, or "
                f"{'an' if problem.L_max is None else 'a smaller'} L_max"
            )
        elif not self.proven and self.all_M - self.grid_M > COARSE * (1 - self.grid_M):
            texts.append(
                f"{whose} may reach {place} frequencies omega, which show too little of P: measure "
                "at more of them there, or with less noise, or synthesise with everywhere=True"
            )
        return texts

    def _whose(self, peak):
        """Of which plant a peak is."""
        return f" of plant {peak.plant}" if len(self.problem.plants) > 1 else ""

    def _where(self):
        """The plants and frequencies of the peak on the grid."""
        omega = self.problem.omega
        places = []
        for plant, k in self.worst.tied:
            of = f"plant {plant} " if len(self.problem.plants) > 1 else ""
            places.append(f"{of}at {omega[k]:.4g}")
        text = f"{', '.join(places[:NAMED])} rad/s"
        if len(places) > NAMED:
            text += f" and {len(places) - NAMED} more"
        return text

    def _above(self):
        """Where M is bounded by what is assumed."""
        last = self.problem.design.omega[-1]
        return f"sigma_max(M) above {last:.4g} rad/s, with the size of P assumed there"

    def __repr__(self):
        rate = f"rate at most {self.rate:.4f}{self._whom()}, {self._coverage()}"
        lines = [f"{rate}; largest near {float(f'{self._near():.2g}'):g} rad/s", self._reached()]
        lines += [repr(self.margins)] if self.rate < 1 or self.deaf else []
        texts = [text for text in self.assumptions if not text.startswith(CHOSEN)]
        lines += ["; ".join(texts).replace("; assumed: ", "; ")] if texts else []
        return "\n".join([*lines, *self._mean(), *self._against()])

    @property
    def details(self) -> str:
        """All that is known, for print: the table of M and L, the worst plants, the optimum."""
        lines = [*self._table(), *self._of_worst(), *self._between(), *self._of_value()]
        return "\n".join([*lines, *self._mean(), *self.assumptions, *self._against()])

    def _against(self) -> Iterator[str]:
        """Warnings and failures."""
        yield from (f"WARNING: {text}" for text in self.warnings)
        yield from (f"FAILS: {text}" for text in self.failures)

    def _whom(self):
        """For which plants the rate is."""
        count = len(self.problem.plants)
        of = f" of {count} plants" if count > 1 else ""
        if self.problem.design.radius is not None:
            return f" for every plant within the radius{of}"
        return f" for each{of}" if of else ""

    def _near(self):
        """The lowest frequency at which M is within a percent of the rate."""
        near = self.problem.omega[self.worst.sigma >= 0.99 * self.rate]
        return near.min() if near.size else self.highest_peak.omega

    def _coverage(self):
        """At which frequencies the rate is known."""
        if self.proven:
            return "proven at all frequencies"
        return f"at all frequencies {_span(self.problem.design.omega)}"

    def _mean(self) -> Iterator[str]:
        """The RMS predicted for a reference, or the mean rate in a band, if there is one."""
        problem = self.problem
        nominal = " of the nominal plant" if problem.robust else ""
        if self.predicted:
            trials = [f"{rms:.3g} in trial {k}" for k, rms in self.predicted.items()]
            yield (
                f"predicted RMS of the error{nominal}: {', '.join(trials)}, for this reference, "
                "without noise, and without what the two ends of a trial add, which counts if it "
                "is not long against the settling time"
            )
        elif problem.objective == "sum" and np.isfinite(self.mean_M):
            mean = f"{self.mean_M:.4f}" if self.mean_M >= 1e-4 else "below 0.0001"
            mean += f", {_span(problem.band)}"
            yield f"mean of sigma_max(M){nominal} over the band: {mean}"

    def _reached(self):
        """Which bounds limit the optimum; without them, no other than the filter's size."""
        problem, bounds = self.problem, []
        if not np.isfinite(self.lower_bound):
            return "L = B by its formula, K = 1: nothing was optimised"
        if problem.objective == "sum" and self.grid_M > problem.M_max * (1 - TIED):
            bounds.append(f"M_max = {problem.design.M_max:g}")
        if problem.L_max is not None and self.grid_L > problem.L_max * (1 - TIED):
            bounds.append(f"L_max = {problem.design.L_max:g}")
            if self.all_L > PASSED_L * problem.design.L_max:
                bounds[-1] += f", {self.all_L:.3g} between the frequencies,"
            if self.value >= problem.unit(0):  # below, rounding decides
                share = min(self.relief / 10, 1)
                bounds[-1] += f" (10 % more would lower the objective by {share:.1%} at most)"
        size = f"order = {problem.order}"
        if problem.base is not None:
            size += " of K in L = B K, by convex optimisation"
        if problem.base is None and problem.order < problem.delay:
            size += f" (P lags by {problem.delay} samples at the cut-off)"
        if problem.structure == "diagonal" and problem.channels > 1:
            size += ", diagonal"
        return f"limited by {', '.join([*bounds, size])}"

    def _table(self) -> Iterator[str]:
        """Bounds and peaks of M and L."""
        problem = self.problem
        M_max, L_max = problem.design.M_max, problem.design.L_max
        all_M = f"{self.all_M:.6f}" if self.proven else "not proven"
        rows = [
            ("", "sigma_max(M)", "sigma_max(L)"),
            ("bound", f"{M_max:g}", "none" if L_max is None else f"{L_max:g}"),
            ("on the design grid", f"{self.grid_M:.8f}", f"{self.grid_L:.7g}"),
        ]
        if problem.robust:
            rows.append(("  of the nominal plant", f"{self.worst.peaks[0]:.8f}", ""))
        rows.append(("over all frequencies", all_M, f"{self.all_L:.6g}"))
        for title, M, L in rows:
            yield f"{title:<22}{M:>14}{L:>14}".rstrip()

    def _of_worst(self) -> Iterator[str]:
        """The worst plants and frequencies, if there is a choice."""
        if self.problem.robust:
            yield f"worst{self._whom()} on the design grid: {self._where()}"

    def _between(self) -> Iterator[str]:
        """What is not in the table of M between the design frequencies."""
        problem, omega = self.problem, self.problem.design.omega
        if self.proven:
            return
        within = "" if problem.design.radius is None else " within the radius"
        if self.exact:
            sigma = highest(self.exact).sigma
            yield f"sigma_max(M) of the models alone over all frequencies, proven: {sigma:.6f}"
        sigma = highest(self.estimated).sigma
        yield f"sigma_max(M){within} {_span(omega)}, on a dense grid: {sigma:.4f}, estimated"
        unknown = [f"below {omega[0]:.4g} rad/s"] if omega[0] > 0 else []
        if self.beyond:
            yield f"{self._above()}: {self.beyond.sigma:.4f} at most"
        elif omega[-1] < np.pi / problem.Ts * (1 - 1e-9):
            unknown.append(f"above {omega[-1]:.4g} rad/s")
        if len(self.exact) < len(problem.plants):
            unknown.append("at resonances that no sample shows")
        if unknown:
            yield f"sigma_max(M){within} unknown: {', '.join(unknown)}"

    def _of_value(self) -> Iterator[str]:
        """The objective, and how much better another filter could be."""
        problem = self.problem
        if problem.everywhere:
            yield "bounds asked for at every frequency, not on the grid only"
        if not np.isfinite(self.lower_bound):
            yield f"objective {self.value:.7g}; L = B was not optimised for it"
            return
        gain = "" if problem.L_max else f" with a gain of Q P L up to {MOST_GAIN:.0e}"
        if problem.base is not None:
            gain = f" with this B, of a K whose gain is {K_MAX:g} at most,"
        lower = problem.stated is not None and len(problem.omega) > len(problem.design.omega)
        kept = ", of those whose bounds are kept lower at omega for what lies between and above"
        yield (
            f"objective {self.value:.7g}, no {problem.structure} filter of order {problem.order}"
            f"{gain} below {self.lower_bound:.7g}{kept if lower else ''}"
        )


def _unusable(problem: Problem) -> Iterator[str]:
    """Where P is not known well enough for any learning."""
    omega = problem.omega[problem.unusable]
    if omega.size:
        yield (
            f"nothing can be learned at {omega.size} frequencies {_span(omega)}, where the "
            "uncertainty ball contains singular plants; |Q|, below which sigma_max(M) cannot be, "
            f"is up to {np.abs(problem.Q[problem.unusable]).max():.4g} there"
        )


def _span(omega):
    """The first and the last of some frequencies."""
    return f"from {omega[0]:.4g} to {omega[-1]:.4g} rad/s"


def check(problem: Problem, L: LearningFilter) -> Certificate:
    """Find out what a filter, in units of `scale`, does to the plants of a problem."""
    response, worst = L.frequency_response(problem.omega), worst_case(problem, L)
    estimated, beyond = estimated_peaks(problem, L, worst.sigma.max())
    return Certificate(
        problem,
        L,
        value=problem.value(largest_singular_values(problem.M(response)), worst.sigma),
        worst=worst,
        exact=proven_peaks(problem, L),
        estimated=estimated,
        beyond=beyond,
        grid_L=largest_singular_values(response).max(),
    )


def certify(problem: Problem, solution: Solution) -> Certificate:
    """Find out what is true of a filter; nothing of the solution is trusted."""
    found = check(problem, problem.learned(solution))
    U, V, cuts = solution.U, solution.V, solution.cuts
    return replace(
        found,
        lower_bound=lower_bound(problem, U, V, cuts),
        relief=relief(problem, found.value, U, V, cuts),
    )
