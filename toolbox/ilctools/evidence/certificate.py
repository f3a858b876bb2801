"""The certificate of a learning filter: what is known about it, independent of the solver.

:func:`check` evaluates a filter on all plants of a problem. The problem is the one of its design,
or another one. :func:`certify` also finds how far the filter is from the optimum of its design.
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

# Relative duality gap, and relative violation of a bound on the grid, that are accepted
GAP_ACCEPTED = 1e-6
VIOLATION_ACCEPTED = 1e-9
BELOW_ONE = np.nextafter(1, 0)  # trials with a rate of one are not monotone
# Share of 1 - M_max by which M may exceed its bound between the frequencies without a warning.
# For samples, the share is taken of 1 - sigma_max(M) at the frequencies.
ROOM_PASSED = 0.25
FREQUENCIES_OF_MEAN = 2000  # frequencies of the mean over the band
# The weakest direction of P, as a share of the strongest, at frequencies up to the cut-off. Below
# this share, the weakest may be a difference of two sensors that are nearly the same.
ALIKE = 3e-3
IDLE_FROM = 0.9  # remaining share of the error in the band, above which learning counts as idle


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is known about a learning filter, by evidence independent of the solver.

    A certificate prints what a user asks first. :attr:`details` has the numbers behind this text.
    """

    problem: Problem  # as stated
    problem_on_grid: Problem  # at all frequencies at which bounds were needed
    scaled_filter: Filter  # in units of scale, as P is
    value: float  # the objective reached
    worst: WorstCase  # over all plants and the radius, at each frequency of the grid
    peaks: dict[str, Peak]  # highest sigma_max(M), by the way it is known, see peaks_of_M
    sigma_L: np.ndarray  # sigma_max(L) at each frequency of the grid
    lower_bound: float = np.nan  # of the objective, for all such filters within the bounds

    @property
    def grid_M(self) -> float:
        """The largest sigma_max(M) on the grid, over all plants within the radius."""
        return self.peaks["on the grid"].sigma

    def on_grid(self, claim: Claim) -> float:
        """Return the largest value on the grid of what a claim bounds."""
        if claim.matrix == "M":
            return self.grid_M
        return float(self.sigma_L[claim.holds_at(self.problem_on_grid.omega)].max(initial=0))

    def anywhere(self, claim: Claim) -> float:
        """Return the largest value over all frequencies of what a claim bounds."""
        if claim.matrix == "M":
            return self.all_M
        return peak_of_L(self.scaled_filter, claim.lowest)[0] if claim.lowest else self.all_L

    @property
    def peak(self) -> Peak:
        """The highest peak over all frequencies at which P is known."""
        return self._highest_without("assumed", BELOW)

    def _highest_without(self, *ways):
        return highest([peak for how, peak in self.peaks.items() if how not in ways])

    @property
    def all_M(self) -> float:
        """An upper bound on sigma_max(M), to PEAK_TOLERANCE; an estimate if not proven."""
        return self.peak.sigma

    @cached_property
    def all_L(self) -> float:
        """An upper bound on sigma_max(L) over all frequencies, to PEAK_TOLERANCE."""
        return peak_of_L(self.scaled_filter)[0]

    @property
    def proven(self) -> bool:
        """Whether `all_M` is proven. With samples or a radius, it comes from a dense grid."""
        return "estimated" not in self.peaks

    @property
    def highest_peak(self) -> Peak:
        """The highest peak at any frequency, whether proven, estimated or assumed."""
        return self._highest_without()

    @property
    def rate(self) -> float:
        """The largest sigma_max(M), which is the gamma of Lemma 1."""
        return float(self.highest_peak.sigma)

    @property
    def convergence(self) -> Convergence:
        """Whether and how fast the trials converge on the worst of all plants.

        The spectral radius is computed for the plants themselves, without their radius. Its
        frequencies are those of the problem, the peaks and a dense grid.
        """
        problem = self.problem
        peaks, plants = [peak.omega for peak in self.peaks.values()], range(len(problem.plants))
        grids = [dense_grid(problem.response, k, self.scaled_filter) for k in plants]
        omega = np.concatenate([problem.omega, peaks, *grids])
        own = self._at(omega, plants)
        # the eigenvalues do not include what splines may miss, nor what is assumed beyond
        least = {
            "estimated": max(1, own.sigma.max() * (1 + PEAK_TOLERANCE)),
            "assumed": 1,
            BELOW: 1,
        }
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
        """The convergence for some plants, given by number, at any frequencies."""
        problem = self.problem
        P = np.array([problem.response.anywhere(k, omega)[0] for k in plants])
        Q, L = (f.frequency_response(omega) for f in (problem.lowpass, self.scaled_filter))
        return from_responses(omega, P, Q, L)

    @property
    def mean_M(self) -> float:
        """Mean of sigma_max(M) for the nominal plant, see :meth:`.Convergence.mean`.

        The mean is NaN without a band.
        """
        band, omega = self.problem.objective.band, self.problem.omega
        if band is None or band[0] <= 0:
            return np.nan
        if self.problem.proven:  # trapezia between coarse frequencies are not enough
            omega = np.union1d(omega, np.geomspace(*band, FREQUENCIES_OF_MEAN))
        return float(log_mean(self._at(omega, [0]).sigma[0], omega, band))

    @cached_property
    def margins(self) -> Margins:
        """By how much the plant may change before monotone convergence is lost."""
        return margins(self.problem, self.scaled_filter)

    @cached_property
    def predicted(self) -> dict[int, float] | None:
        """Predicted RMS of the error by trial, see :func:`.predicted_rms`.

        None without a reference.
        """
        return (
            None if self.problem.objective.band else predicted_rms(self.problem, self.scaled_filter)
        )

    @property
    def gap(self) -> float:
        """Distance from the lower bound to the value, relative to :meth:`.Problem.gap_scale`."""
        return (self.value - self.lower_bound) / self.problem_on_grid.gap_scale(self.value)

    @property
    def failures(self) -> list[Finding]:
        """The claims that do not hold; empty if all hold."""
        problem = self.problem
        rooms = {"on the grid": 1 + VIOLATION_ACCEPTED}
        if problem.bounds.everywhere:
            rooms["everywhere"] = 1 + PEAK_TOLERANCE
        judged = [(1, Finding("gap", self.gap, GAP_ACCEPTED))]  # (times the limit allowed, finding)
        for code, room in rooms.items():
            judged += [(room, self._judged(code, claim)) for claim in problem.bounds.claims]
        codes = {"proven": "one or more"} | ({} if problem.findings else {"assumed": "beyond"})
        for how in codes.keys() & self.peaks:
            peak = self.peaks[how]
            judged.append((BELOW_ONE, Finding(codes[how], peak.sigma, 1, self.place(peak))))
        return [found for times, found in judged if found.value > found.limit * times]

    def _judged(self, code, claim) -> Finding:
        """A claim with the largest value of what it bounds, on the grid or everywhere."""
        value = self.on_grid(claim) if code == "on the grid" else self.anywhere(claim)
        place = ""
        if claim.matrix == "M":
            place = " " + self.place(self.peaks.get(code, self.peak))
        return Finding(code, value, claim.limit, place, claim=claim)

    @property
    def warnings(self) -> list[Finding]:
        """The findings against the problem, and against the bounds between the samples."""
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
        """Say in words where a peak is, and to which plant it belongs."""
        of_plant = f"of plant {peak.plant} at " if len(self.problem.plants) > 1 else "at "
        return f"{of_plant}{peak.omega:.4g} rad/s"

    @cached_property
    def settled_trial(self) -> SettledTrial:
        """A long trial, and its largest norm over the plants; NaN unless P and Q are models."""
        problem = self.problem
        if problem.response.sampled or isinstance(problem.lowpass, SampledQ):
            return SettledTrial(0, np.nan)
        return settled_trial(problem.response.models, problem.lowpass, self.scaled_filter)

    def __repr__(self):
        return report.printed(self)

    @property
    def details(self) -> str:
        """A table of the numbers behind the certificate, and the assumptions.

        The numbers have as many digits as all processors agree on. The peaks of sigma_max(M) are
        for all plants within the radius. A peak is one of these:

        - *on the grid*, which contains omega and all other frequencies that needed bounds;
        - *proven* at all frequencies, for the plants that are models, without the radius;
        - *where P passes nothing*: proven as well, but M is |Q| there for any L;
        - *estimated* on a dense grid, from the first to the last frequency of omega;
        - *assumed* below the first sample and above the last one.

        Nothing is known of resonances that no sample shows.

        The lower bound of the objective holds for any filter of this structure and order that
        keeps the bounds on the grid. The limits on the grid are lower than the stated ones, to
        cover the frequencies between and above. With `base`, the lower bound holds for any K with
        this B and a gain of at most `K_MAX`. Without L_max, it holds up to a gain of `MOST_GAIN` of
        Q P L, see :mod:`.problem.problem`. The lower bound is NaN if nothing was optimised.
        """
        return report.details(self)

    @property
    def rate_above(self) -> float:
        """The rate without what is assumed below the first sample."""
        return self._highest_without(BELOW).sigma


def _alike(problem):
    """Find out if a direction of P is far weaker than another at all omega up to the cut-off."""
    cutoff = problem.lowpass.cutoff
    below = problem.omega <= max(cutoff, problem.omega[0])
    values = np.linalg.svd(problem.P[below], compute_uv=False)
    share = (values[:, -1] / values[:, 0]).max()
    if share < ALIKE:
        yield Finding("alike", share, ALIKE, f"up to {cutoff:.4g} rad/s")


def check(
    problem: Problem, L: Filter, grid: Problem | None = None, lower_bound: float = np.nan
) -> Certificate:
    """Evaluate a learning filter, in units of `scale`, on the plants of a problem.

    `grid` is the same problem at further frequencies, too. Default: the problem itself.
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
    """Certify the filter of a solution without trusting anything else in the solution."""
    bound = lower_bound(grid, solution.U, solution.V, solution.cuts)
    return check(problem, problem.scaled_filter(solution.coefficients), grid, bound)
