"""What is known about a learning filter, by evidence independent of the solver.

:func:`check` says what a filter does to all plants of a problem, that of its design or another one.
:func:`certify` adds how far the filter is from the optimum of its design.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ilctools.evidence.convergence import Convergence, from_responses, log_mean
from ilctools.evidence.finite import trial_norm
from ilctools.evidence.margins import Margins, margins
from ilctools.evidence.optimality import lower_bound
from ilctools.evidence.peak import CLOSE, Peak, estimated_peaks, highest, peak_of_L, proven_peaks
from ilctools.evidence.prediction import predicted_rms
from ilctools.evidence.robustness import WorstCase, worst_case
from ilctools.filters import Filter
from ilctools.findings import Finding
from ilctools.problem.defaults import lead
from ilctools.problem.lowpass import SampledQ
from ilctools.problem.problem import K_MAX, MOST_GAIN, Problem, Solution, convergence_matrix
from ilctools.singular_values import TIED, largest_singular_values

# Relative duality gap, and relative violation of a bound on the grid, that are accepted;
GAP = 1e-6
VIOLATION = 1e-9
# Share of 1 - M_max by which M may pass its bound between the frequencies without a warning; of
# samples, of 1 - sigma_max(M) at the frequencies
COARSE = 0.25
FINE = 2000  # frequencies of the mean over the band
LEAD = 0.5  # of P's phase in the mean, rad, from which on its sign is taken to be wrong
DEAF = 1e-3  # of P L, where P passes nothing
SETTLED = 0.02  # of a disturbance
SHORTEST, LONGEST = 50, 1000  # samples of a trial; longer ones of several plants take seconds
IDLE = 0.9  # share of the error in the band from which on learning counts as idle


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is known about a learning filter, by evidence independent of the solver."""

    problem: Problem  # as stated
    grid: Problem  # at all frequencies at which it needed bounds
    filter: Filter  # in units of scale, as P is
    value: float  # the objective reached
    worst: WorstCase  # of all plants, within the radius, at each frequency of the grid
    # Peaks over all frequencies, without the radius: of the plants that are models, if Q is one,
    # too; and between the frequencies of omega, within the radius, and of samples.
    exact: list[Peak]
    estimated: list[Peak]
    beyond: Peak | None  # above the last sample, of the size that is assumed there
    grid_L: float  # peak of sigma_max(L) on the grid
    lower_bound: float = np.nan  # what no such filter within the bounds can go below

    @property
    def grid_M(self) -> float:
        """Peak of sigma_max(M) on the grid, the largest of all plants within the radius."""
        return self.worst.sigma.max()

    @property
    def on_grid(self) -> Peak:
        """The highest on the grid."""
        plant, at = self.worst.tied[0]
        return Peak(self.grid_M, self.grid.omega[at], plant)

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
        peaks = [self.on_grid, *self.exact, *self.estimated]
        return highest(peaks if self.beyond is None else [*peaks, self.beyond])

    @property
    def rate(self) -> float:
        """The largest sigma_max(M): the gamma of Lemma 1."""
        return float(self.highest_peak.sigma)

    @property
    def convergence(self) -> Convergence:
        """Do the trials converge, on the worst of all plants?"""
        problem, grid, beyond, L = self.problem, self.grid, self.beyond, self.filter
        response = L.frequency_response(grid.omega)
        on_grid = from_responses(grid.omega, grid.plants, grid.Q, response)
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
            uncertain=problem.radius is not None or (beyond is not None and beyond.sigma >= 1),
            assumptions=self.assumptions,
        )

    @property
    def mean_M(self) -> float:
        """Of the nominal plant, see :meth:`.Convergence.mean`; NaN without a band."""
        problem = self.problem
        low, high = problem.objective.band or (0, 0)
        if low <= 0:
            return np.nan
        omega = problem.omega
        if problem.proven:  # trapezia between coarse frequencies are not enough
            omega = np.union1d(omega, np.geomspace(low, high, FINE))
        (P, _), Q = problem.response.anywhere(0, omega), problem.lowpass.frequency_response(omega)
        M = convergence_matrix(P, Q, self.filter.frequency_response(omega))
        return float(log_mean(largest_singular_values(M), omega, (low, high)))

    @cached_property
    def margins(self) -> Margins:
        """How far the plant may be off before monotone convergence is lost."""
        return margins(self.problem, self.filter)

    @property
    def predicted(self) -> dict[int, float] | None:
        """RMS of the error in some trials, for the reference of the design; None without one."""
        return None if self.problem.objective.band else predicted_rms(self.problem, self.filter)

    @property
    def gap(self) -> float:
        """Distance of value and lower bound, relative to :meth:`.Problem.unit`."""
        return (self.value - self.lower_bound) / self.grid.unit(self.value)

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
        if not self.deaf:
            return self.problem.assumptions
        at = highest(self.exact).omega
        return (
            *self.problem.assumptions,
            f"P passes nothing at {at:.4g} rad/s: M is |Q| there for any L, and the error stays; "
            f"at the frequencies omega it is {self.grid_M:.4g}",
        )

    @property
    def failures(self) -> list[Finding]:
        """What does not hold; empty if all does."""
        problem, peak, beyond = self.problem, highest(self.exact), self.beyond
        on_grid, anywhere = 1 + VIOLATION, 1 + CLOSE
        M_max, L_max = problem.M_max, problem.L_max or np.inf
        claims = [
            (1, Finding("gap", self.gap, GAP)),
            (on_grid, Finding("M", self.grid_M, M_max, self._place(self.on_grid))),
            (on_grid, Finding("L", self.grid_L, L_max)),
        ]
        if problem.bounds.everywhere:
            at = self._place(self.peak)
            claims.append((anywhere, Finding("M everywhere", self.all_M, M_max, at)))
            claims.append((anywhere, Finding("L everywhere", self.all_L, L_max)))
        found = [claim for tolerance, claim in claims if claim.value > claim.limit * tolerance]
        if peak and peak.sigma >= 1 and not self.deaf:
            found.append(Finding("one or more", peak.sigma, 1, self._place(peak)))
        if beyond and beyond.sigma >= 1 and not problem.findings:
            found.append(Finding("beyond", beyond.sigma, 1, self._place(beyond)))
        return found

    @property
    def warnings(self) -> list[Finding]:
        """What speaks against the problem, and against what is said between the samples."""
        problem, response, peak = self.problem, self.problem.response, self.peak
        found, M_max = [*problem.findings], problem.M_max
        omega, P, sampled = response.omega, response.P[0], response.models[0] is None
        if sampled and (ahead := lead(P, omega, response.Ts)) > LEAD:
            found.append(Finding("lead", ahead, LEAD))
        if problem.objective.kind == "sum" and self.value > IDLE * problem.idle:
            found.append(Finding("idle", self.value / problem.idle, IDLE))
        code, known = ("between", M_max) if self.proven else ("samples", self.grid_M)
        passed = peak.sigma - known > COARSE * (1 - known)
        if passed and not (self.proven and (self.failures or self.deaf)):
            found.append(Finding(code, peak.sigma, known, self._place(peak)))
        return found

    def _place(self, peak):
        """Where a peak is, and of which plant."""
        of_plant = f"of plant {peak.plant} at " if len(self.problem.plants) > 1 else "at "
        return f"{of_plant}{peak.omega:.4g} rad/s"

    @property
    def trial_length(self) -> int:
        """Samples of a trial with two ends of its own: ten times as long as the plants settle."""
        models = self.problem.response.models
        slowest = max(np.abs(P.poles()).max(initial=0) for P in models)
        settled = np.log(SETTLED) / np.log(np.clip(slowest, SETTLED, 1 - 1e-9))
        return int(min(10 * settled + SHORTEST, LONGEST / self.problem.channels))

    @cached_property
    def norm(self) -> float:
        """The largest norm of such a trial of the plants; NaN unless they and Q are models."""
        problem = self.problem
        if None in problem.response.models or isinstance(problem.lowpass, SampledQ):
            return np.nan
        trial = problem.lowpass, self.filter, self.trial_length
        return max(trial_norm(P, *trial)[0] for P in problem.response.models)

    @property
    def gains(self) -> str:
        """The cut-off of Q, the gain of L and the norm of a trial, in words."""
        text = f"Q's cut-off {self.problem.lowpass.cutoff:.4g} rad/s, sigma_max(L) {self.all_L:.3g}"
        if np.isnan(self.norm):
            return text
        return f"{text}, norm of a trial of {self.trial_length} samples {self.norm:.3g}"

    def __repr__(self):
        near = self.grid.omega[self.worst.sigma >= 0.99 * self.rate]
        at = near.min() if near.size else self.highest_peak.omega
        where = ", proven" if self.proven else f" {_span(self.problem.omega)}, estimated"
        lines = [
            f"rate at most {self.rate:.4f}{self._whom()}, at all frequencies{where}; largest "
            f"near {float(f'{at:.2g}'):g} rad/s",
            *([repr(self.margins)] if self.rate < 1 or self.deaf else []),
            self.gains,
            "; ".join([self._reached(), *self._mean()]),
        ]
        chosen, rests_on = self.problem.chosen, self.assumptions[len(self.problem.chosen) :]
        known = [text for text in rests_on if not text.startswith("assumed: ")]
        lines += ["chosen: " + "; ".join(chosen).replace("chosen: ", "")] if chosen else []
        lines += ["; ".join([*known, "assumptions: .certificate.details"])] if rests_on else []
        return "\n".join([*lines, *self._against()])

    @property
    def details(self) -> str:
        """All that is known, for print: bounds, peaks, and the optimum; on what it rests."""
        problem, M, L = self.problem, f"sigma_max(M){self._whom()}", "sigma_max(L)"
        first, last = problem.omega[[0, -1]]
        facts = {
            "M_max": problem.M_max,
            f"{M}, on the design grid: {self._place(self.on_grid)}": self.grid_M,
            "the same of the nominal plant": self.worst.peaks[0] if problem.robust else None,
            f"{M}, at all frequencies, of models alone, proven": highest(self.exact),
            f"{M}, {_span(problem.omega)}, on a dense grid, estimated": highest(self.estimated),
            f"{M} at most, above {last:.4g} rad/s, assumed": self.beyond,
            "L_max": problem.L_max,
            f"{L} on the design grid": self.grid_L,
            f"{L} at all frequencies": self.all_L,
            "objective": self.value,
            self._optimum(): None if np.isnan(self.lower_bound) else self.lower_bound,
        }
        values = {text: getattr(fact, "sigma", fact) for text, fact in facts.items()}
        lines = [f"{value:<11.7g}{text}" for text, value in values.items() if value is not None]
        if problem.response.sampled:
            lines.append(f"unknown: below {first:.4g} rad/s, at resonances that no sample shows")
        return "\n".join([*lines, *self._mean(), *self.assumptions, *self._against()])

    def _against(self) -> list[str]:
        """Warnings and failures."""
        warnings = [f"WARNING: {found}" for found in self.warnings]
        return warnings + [f"FAILS: {found}" for found in self.failures]

    def _whom(self):
        """For which plants the rate is."""
        count = len(self.problem.plants)
        of = f" of {count} plants" if count > 1 else ""
        if self.problem.radius is not None:
            return f" for every plant within the radius{of}"
        return f" for each{of}" if of else ""

    def _mean(self) -> list[str]:
        """The RMS predicted for a reference, or the mean rate in a band, if there is one."""
        problem = self.problem
        nominal = " of the nominal plant" if problem.robust else ""
        if self.predicted:
            trials = [f"{rms:.3g} in trial {k}" for k, rms in self.predicted.items()]
            return [
                f"predicted RMS of the error{nominal}: {', '.join(trials)}, for this reference, "
                "without noise and the ends of a trial, which count if it is not long"
            ]
        if problem.objective.kind != "sum" or np.isnan(self.mean_M):
            return []
        mean = f"{self.mean_M:.4f}" if self.mean_M >= 1e-4 else "below 0.0001"
        return [
            f"mean of sigma_max(M){nominal} over the band: {mean}, {_span(problem.objective.band)}"
        ]

    def _reached(self):
        """Which bounds limit the optimum; without them, no other than the filter's size."""
        problem, grid, bounds = self.problem, self.grid, []
        if np.isnan(self.lower_bound):
            return "L = B by its formula, K = 1: nothing was optimised"
        if problem.objective.kind == "sum" and self.grid_M > grid.M_max * (1 - TIED):
            bounds.append(f"M_max = {problem.M_max:g}")
        if problem.L_max is not None and self.grid_L > grid.L_max * (1 - TIED):
            bounds.append(f"L_max = {problem.L_max:g}")
        size = f"order = {problem.order}"
        if problem.base is not None:
            size += " of K in L = B K, by convex optimisation"
        elif problem.order < problem.delay:
            size += f" (P lags by {problem.delay} samples at the cut-off)"
        if problem.structure == "diagonal" and problem.channels > 1:
            size += ", diagonal"
        return f"limited by {', '.join([*bounds, size])}"

    def _optimum(self):
        """What no other filter can go below, in words."""
        problem = self.problem
        gain = "" if problem.L_max else f" with a gain of Q P L up to {MOST_GAIN:.0e}"
        if problem.base is not None:
            gain = f" with this B, of a K whose gain is {K_MAX:g} at most,"
        lower = len(self.grid.omega) > len(problem.omega)
        kept = ", of those whose bounds are kept lower at omega for what lies between and above"
        return (
            f"lower bound of the objective, of any {problem.structure} filter of order "
            f"{problem.order}{gain}{kept if lower else ''}"
        )


def _span(omega):
    """The first and the last of some frequencies."""
    return f"from {omega[0]:.4g} to {omega[-1]:.4g} rad/s"


def check(problem: Problem, L: Filter, grid: Problem | None = None) -> Certificate:
    """Find out what a filter, in units of `scale`, does to the plants of a problem.

    `grid` is the problem at further frequencies, too.
    """
    grid = grid or problem
    response, worst = L.frequency_response(grid.omega), worst_case(grid, L)
    estimated, beyond = estimated_peaks(problem, L, worst.sigma.max())
    return Certificate(
        problem,
        grid,
        L,
        value=grid.objective.value(largest_singular_values(grid.M(response)), worst.sigma),
        worst=worst,
        exact=proven_peaks(problem, L),
        estimated=estimated,
        beyond=beyond,
        grid_L=largest_singular_values(response).max(),
    )


def certify(problem: Problem, grid: Problem, solution: Solution) -> Certificate:
    """Find out what is true of a filter; nothing of the solution is trusted."""
    bound = lower_bound(grid, solution.U, solution.V, solution.cuts)
    certificate = check(problem, problem.scaled_filter(solution.coefficients), grid)
    return replace(certificate, lower_bound=bound)
