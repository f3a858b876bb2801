"""The certificate of a learning filter: facts about the filter, computed without the solver.

:func:`check` evaluates a filter on all plants of a problem. The filter may have been designed for
this problem or for another problem. :func:`certify` also computes by how much the objective of the
filter can exceed the optimum of its design problem.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ilctools.evidence import report
from ilctools.evidence.convergence import Convergence, from_responses, log_mean
from ilctools.evidence.finite import SettledTrial, settled_trial
from ilctools.evidence.margins import Margins, margins
from ilctools.evidence.optimality import lower_bound
from ilctools.evidence.peak import (
    BELOW,
    DEAF,
    PEAK_TOLERANCE,
    Peak,
    dense_grid,
    highest,
    peak_of_L,
    peaks_of_M,
)
from ilctools.evidence.robustness import WorstCase, worst_case
from ilctools.filters import Filter
from ilctools.findings import Finding
from ilctools.problem.bounds import Claim
from ilctools.problem.lowpass import SampledQ
from ilctools.problem.plausible import doubts
from ilctools.problem.problem import Problem, Solution
from ilctools.problem.reference import predicted_rms
from ilctools.singular_values import largest_singular_values

# Largest relative duality gap, and largest relative violation of a bound on the grid, that pass
GAP_ACCEPTED = 1e-6
VIOLATION_ACCEPTED = 1e-9
BELOW_ONE = np.nextafter(1, 0)  # with a rate of one, the error need not decrease in each trial
# Share of 1 - M_max by which sigma_max(M) may exceed M_max between the frequencies of omega without
# a warning. If P is known by samples, the largest sigma_max(M) on the grid replaces M_max.
ROOM_PASSED = 0.25
FREQUENCIES_OF_MEAN = 2000  # for the mean of sigma_max(M) over the band
# Ratio of the smallest to the largest singular value of P, at frequencies up to the cut-off. If the
# ratio is below this number, the weakest direction may be the difference between two sensors that
# measure nearly the same signal.
ALIKE = 3e-3
# Learning counts as idle if one trial leaves more than this share of the error in the band.
IDLE_FROM = 0.9


@dataclass(frozen=True, eq=False)
class Certificate:
    """Rate, margins and gains of a learning filter, computed independently of the solver.

    Print a certificate to see the rate, the margins and the gains. :attr:`details` has the numbers
    behind this text. The certificate uses M = Q (I - P L), which maps the error of one trial to the
    error of the next trial. The grid consists of the design frequencies omega and all other
    frequencies at which the solver needed bounds.
    """

    problem: Problem  # as the user stated it
    problem_on_grid: Problem  # the problem at all frequencies at which the solver needed bounds
    scaled_filter: Filter  # L in units of `scale`, see :mod:`ilctools.response.scale`
    value: float  # of the objective
    worst: WorstCase  # sigma_max(M) on the grid, the largest over all plants and the radius
    # highest sigma_max(M), by the way in which it is known, see :func:`.peaks_of_M`
    peaks: dict[str, Peak]
    sigma_L: np.ndarray  # sigma_max(L) at each frequency of the grid
    # of the objective, for all filters of this structure and order that meet the bounds
    lower_bound: float = np.nan

    @property
    def grid_M(self) -> float:
        """The largest sigma_max(M) on the grid, for all plants and all errors within the radius."""
        return self.peaks["on the grid"].sigma

    def on_grid(self, claim: Claim) -> float:
        """Return the largest sigma_max of M or of L on the grid.

        The claim says which of the two matrices it bounds.
        """
        if claim.matrix == "M":
            return self.grid_M
        return float(self.sigma_L[claim.holds_at(self.problem_on_grid.omega)].max(initial=0))

    def anywhere(self, claim: Claim) -> float:
        """Return the largest sigma_max of M or of L over all frequencies.

        The claim says which of the two matrices it bounds.
        """
        if claim.matrix == "M":
            return self.all_M
        return peak_of_L(self.scaled_filter, claim.lowest)[0] if claim.lowest else self.all_L

    @property
    def peak(self) -> Peak:
        """The highest peak of sigma_max(M) over all frequencies at which P is known."""
        return self._highest_without("assumed", BELOW)

    def _highest_without(self, *ways):
        return highest([peak for how, peak in self.peaks.items() if how not in ways])

    @property
    def all_M(self) -> float:
        """An upper bound on sigma_max(M) over all frequencies.

        If `proven` is False, the bound is only estimated. A proven bound exceeds the peak of
        sigma_max(M) by at most a fraction PEAK_TOLERANCE of the peak.
        """
        return self.peak.sigma

    @cached_property
    def all_L(self) -> float:
        """An upper bound on sigma_max(L) over all frequencies.

        The bound exceeds the peak of sigma_max(L) by at most a fraction PEAK_TOLERANCE of the peak.
        """
        return peak_of_L(self.scaled_filter)[0]

    @property
    def proven(self) -> bool:
        """Whether `all_M` is proven.

        If P has a radius, or if P or Q is a table, `all_M` is an estimate.
        """
        return "estimated" not in self.peaks

    @property
    def highest_peak(self) -> Peak:
        """The highest peak of sigma_max(M) at any frequency.

        This peak may be proven, estimated or assumed.
        """
        return self._highest_without()

    @property
    def rate(self) -> float:
        """The largest sigma_max(M), which is the gamma of Lemma 1 of the paper."""
        return float(self.highest_peak.sigma)

    @property
    def convergence(self) -> Convergence:
        """Whether the trials converge for the worst of all plants, and how fast.

        The spectral radius of M is computed for the plants themselves, without the radius around
        each plant. It is computed at the frequencies of the problem, at the peaks of sigma_max(M),
        and on a dense grid.
        """
        problem = self.problem
        peaks, plants = [peak.omega for peak in self.peaks.values()], range(len(problem.plants))
        grids = [dense_grid(problem.response, k, self.scaled_filter) for k in plants]
        omega = np.concatenate([problem.omega, peaks, *grids])
        own = self._at(omega, plants)
        # the eigenvalues contain neither the error of the splines nor what is assumed about P
        # outside its samples
        largest = max(1, own.sigma.max() * (1 + PEAK_TOLERANCE))
        least = {"estimated": largest, "assumed": 1, BELOW: 1}
        unknown = [self.peaks[how].sigma >= least[how] for how in least.keys() & self.peaks]
        return Convergence(
            problem.omega,
            self.worst.sigma,
            rate=self.rate,
            at=float(self.highest_peak.omega),
            spectral_radius=float(own.spectral_radius.max()),
            proven=self.proven,
            uncertain=problem.radius is not None or any(unknown),
            assumptions=tuple(map(str, problem.assumptions)),
        )

    def _at(self, omega, plants):
        """Compute the convergence at any frequencies, for the plants with the numbers `plants`."""
        problem = self.problem
        P = np.array([problem.response.anywhere(k, omega)[0] for k in plants])
        Q, L = (f.frequency_response(omega) for f in (problem.lowpass, self.scaled_filter))
        return from_responses(omega, P, Q, L)

    @property
    def mean_M(self) -> float:
        """Mean of sigma_max(M) over the band of the objective, for the nominal plant.

        The mean is defined in :meth:`.Convergence.mean`. If the objective has no band of
        frequencies, the mean is NaN.
        """
        band, omega = self.problem.objective.band, self.problem.omega
        if band is None or band[0] <= 0:
            return np.nan
        if self.problem.proven:  # trapezia over coarse frequencies are inaccurate
            omega = np.union1d(omega, np.geomspace(*band, FREQUENCIES_OF_MEAN))
        return float(log_mean(self._at(omega, [0]).sigma[0], omega, band))

    @cached_property
    def margins(self) -> Margins:
        """By how much the plant may change before monotone convergence is lost."""
        return margins(self.problem, self.scaled_filter)

    @cached_property
    def predicted(self) -> dict[int, float] | None:
        """Predicted RMS of the error in each trial, see :func:`.predicted_rms`.

        The prediction is None if the problem has no reference.
        """
        if self.problem.objective.first_error is None:
            return None
        return predicted_rms(self.problem, self.scaled_filter)

    @property
    def gap(self) -> float:
        """The objective minus its lower bound, divided by :meth:`.Problem.gap_scale`."""
        return (self.value - self.lower_bound) / self.problem_on_grid.gap_scale(self.value)

    @property
    def failures(self) -> list[Finding]:
        """The claims that do not hold, as a list of findings."""
        problem = self.problem
        rooms = {"on the grid": 1 + VIOLATION_ACCEPTED}
        if problem.bounds.everywhere:
            rooms["everywhere"] = 1 + PEAK_TOLERANCE
        judged = [(1, Finding("gap", self.gap, GAP_ACCEPTED))]  # (factor on the limit, finding)
        for code, room in rooms.items():
            judged += [(room, self._judged(code, claim)) for claim in problem.bounds.claims]
        codes = {"proven": "one or more"} | ({} if problem.findings else {"assumed": "beyond"})
        for how in codes.keys() & self.peaks:
            peak = self.peaks[how]
            judged.append((BELOW_ONE, Finding(codes[how], peak.sigma, 1, self.place(peak))))
        return [found for times, found in judged if found.value > found.limit * times]

    def _judged(self, code, claim) -> Finding:
        """Return a finding that compares the limit of a claim with the largest value.

        The value is taken on the grid, or over all frequencies, as `code` says.
        """
        value = self.on_grid(claim) if code == "on the grid" else self.anywhere(claim)
        of_M = claim.matrix == "M"
        place = f" {self.place(self.peaks.get(code, self.peak))}" if of_M else ""
        return Finding(code, value, claim.limit, place, claim=claim)

    @property
    def warnings(self) -> list[Finding]:
        """Findings about weak points of the problem, and about peaks between its frequencies."""
        problem, response, peak = self.problem, self.problem.response, self.peak
        found = [*problem.findings, *problem.costs, *_alike(problem), *doubts(response)]
        below = self.peaks.get(BELOW)
        if below is not None and below.sigma > BELOW_ONE:
            place = f"below {problem.omega[0]:.4g} rad/s"
            found.append(Finding("below", below.sigma, 1, place))
        if problem.objective.kind == "sum" and self.value > IDLE_FROM * problem.idle:
            found.append(Finding("idle", self.value / problem.idle, IDLE_FROM))
        code, known = ("between", problem.M_max) if self.proven else ("samples", self.grid_M)
        passed = peak.sigma - known > ROOM_PASSED * (1 - known)
        if passed and not (self.proven and (self.failures or DEAF in self.peaks)):
            found.append(Finding(code, peak.sigma, known, self.place(peak)))
        return found

    def place(self, peak):
        """Say in words at which frequency a peak is, and to which plant the peak belongs."""
        of_plant = f"of plant {peak.plant} " if len(self.problem.plants) > 1 else ""
        return f"{of_plant}at {peak.omega:.4g} rad/s"

    @cached_property
    def settled_trial(self) -> SettledTrial:
        """The largest norm of a long trial among the plants.

        If a plant or Q is not a model, the value is NaN.

        The norm of a trial is the largest factor by which one trial can increase the distance of v
        from its limit, see :func:`.trial_norm`.
        """
        problem = self.problem
        if problem.response.sampled or isinstance(problem.lowpass, SampledQ):
            return SettledTrial(0, np.nan)
        return settled_trial(problem.response.models, problem.lowpass, self.scaled_filter)

    def __repr__(self):
        return report.printed(self)

    @property
    def details(self) -> str:
        """A table of the numbers behind the certificate, and the assumptions.

        The numbers are printed with so few digits that all processors give the same text. The peaks
        of sigma_max(M) are the largest values over all plants within the radius. A peak is known in
        one of these ways:

        - *on the grid*: the grid contains omega and all other frequencies that needed bounds;
        - *proven*: the peak holds at all frequencies, for plants that are models, without a radius;
        - *where P passes nothing*: the peak is proven, but sigma_max(M) is |Q| there for any L,
          because P has no gain;
        - *estimated*: from a dense grid between the first and the last frequency of omega;
        - *assumed*: below the first sample of P, or above the last sample.

        A resonance that no sample shows is not taken into account.

        The lower bound of the objective holds for any filter of this structure and order that meets
        the bounds on the grid. The limits on the grid are lower than the stated limits, so that the
        stated limits also hold between the frequencies of the grid and above the last of these
        frequencies. If L = B K with the `base` B, the lower bound holds for this B and any filter K
        with a gain of at most `K_MAX`. Without L_max, the lower bound holds for all L with which
        the gain of Q P L is at most `MOST_GAIN`, see :mod:`.problem.problem`. If the filter was not
        optimised, the lower bound is NaN.
        """
        return report.details(self)

    @property
    def rate_above(self) -> float:
        """The rate without peaks below the first sample of P, where P is only assumed."""
        return self._highest_without(BELOW).sigma


def _alike(problem):
    """Yield a finding if P has far less gain in one direction than in another.

    Only frequencies up to the cut-off count.
    """
    cutoff = problem.lowpass.cutoff
    below = problem.omega <= max(cutoff, problem.omega[0])
    values = np.linalg.svdvals(problem.P[below])
    share = (values[:, -1] / values[:, 0]).max()
    if share < ALIKE:
        yield Finding("alike", share, ALIKE, f"up to {cutoff:.4g} rad/s")


def check(
    problem: Problem, L: Filter, grid: Problem | None = None, lower_bound: float = np.nan
) -> Certificate:
    """Certify a learning filter L, given in units of `scale`, on the plants of a problem.

    `grid` is the same problem with additional frequencies. Default: the problem itself.
    `lower_bound` is a lower bound on the objective, if one is known.
    """
    grid = grid or problem
    response, worst = L.frequency_response(grid.omega), worst_case(grid, L)
    on_grid = Peak(worst.sigma.max(), grid.omega[worst.frequency], worst.plant)
    return Certificate(
        problem,
        grid,
        scaled_filter=L,
        value=grid.objective.value(largest_singular_values(grid.M(response)), worst.sigma),
        worst=worst,
        peaks={"on the grid": on_grid} | peaks_of_M(problem, L, on_grid.sigma),
        sigma_L=largest_singular_values(response),
        lower_bound=lower_bound,
    )


def certify(problem: Problem, grid: Problem, solution: Solution) -> Certificate:
    """Certify the filter of a solution.

    The multipliers of the solution are used only for the lower bound on the objective.
    """
    bound = lower_bound(grid, solution.U, solution.V, solution.cuts)
    return check(problem, problem.scaled_filter(solution.coefficients), grid, bound)
