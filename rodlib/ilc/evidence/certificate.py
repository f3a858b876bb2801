"""What is known about a learning filter, by evidence independent of the solver."""

from dataclasses import dataclass

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.evidence.doubts import doubts, useless
from rodlib.ilc.evidence.finite_trial import trial_norm
from rodlib.ilc.evidence.models import learning_model
from rodlib.ilc.evidence.noise import accumulated
from rodlib.ilc.evidence.optimality import lower_bound
from rodlib.ilc.evidence.peak import highest_peak, peak_gain
from rodlib.ilc.evidence.robustness import by_entries, worst_case
from rodlib.ilc.filters import LearningFilter
from rodlib.ilc.problem import LARGEST, Problem, Solution, largest_singular_values

# Relative duality gap, and relative violation of a bound on the grid, that are accepted.
GAP = 1e-6
VIOLATION = 1e-9
# Share of 1 - sigma_max(M) that splines may miss: a narrow resonance shows little on its flanks.
COARSE = 0.25
NAMED = 4  # of those that are tied as the worst, so many are named
LOUD = 1.5  # times the bound on L that its peak may reach off the grid, unless there is a warning


@dataclass(frozen=True)
class Robustness:
    """What the certificate of a design for several plants, or for a radius, says beside.

    Attributes
    ----------
    plants : int
        Their number, with the nominal one, which is number 0.
    radius : str
        "" without one, "norm" or "entries".
    nominal : float
        Peak of sigma_max(M) of the nominal plant on the design grid.
    worst : tuple of (int, float)
        Plants and frequencies (rad/s) of the peak of all on the grid: each that is tied.
    attained : float
        The largest sigma_max(M) there that a plant within the radius was found to reach.
    peak : int
        Number of the plant whose peak over all frequencies is the highest, Delta = 0.
    estimated : int
        For how many sampled plants that peak was estimated, the worst ones on the grid.
    """

    plants: int
    radius: str
    nominal: float
    worst: tuple[tuple[int, float], ...]
    attained: float
    peak: int
    estimated: int

    @property
    def where(self) -> str:
        """The plants and frequencies of the peak on the grid."""
        many = self.plants > 1
        places = [
            f"{f'plant {number} ' if many else ''}at {omega:.4g}" for number, omega in self.worst
        ]
        more = f" and {len(places) - NAMED} more" if len(places) > NAMED else ""
        return f"{', '.join(places[:NAMED])} rad/s{more}"

    @property
    def lines(self) -> list[str]:
        """For the table."""
        of = f" of {self.plants} plants" if self.plants > 1 else ""
        within = " within the radius" if self.radius else ""
        lines = [f"worst{of}{within} on the design grid: {self.where}"]
        if self.radius:
            lines.append(
                f"a plant within the radius reaches {self.attained:.8f} there; between the samples "
                "the radius is not known"
            )
        return lines

    @property
    def looked_at(self) -> str:
        """Which plants an estimate between the samples is about."""
        if self.estimated == self.plants:
            return ""
        return f" for the {self.estimated} sampled plants that are worst on the grid"


@dataclass(frozen=True)
class Certificate:
    """What is known about a learning filter, by evidence independent of the solver.

    Attributes
    ----------
    structure, order : str, int
        Of the learning filter, "diagonal" or "full", and how many samples it looks ahead.
    value, lower_bound : float
        The objective reached, and what no such filter within the bounds can go below.
    idle : float
        The objective without learning, L = 0.
    M_max, L_max : float, float or None
        The bounds.
    grid_M, grid_L : float
        Peaks of sigma_max(M), sigma_max(L) on the design grid.
    all_M, all_L : float
        Upper bounds, to 1e-8, of the peaks over all frequencies; see `proven`.
    place : float
        Frequency of `all_M`, rad/s.
    proven : bool
        False if P or Q were given as samples: `all_M` is then an estimate from splines, for the
        frequencies from the first to the last sample. All others remain unknown.
    sampled, nyquist : (float, float), float
        First and last design frequency, and pi / Ts, rad/s.
    missed : float
        By how much such splines miss M, in its largest singular value, at samples that are left
        out; infinite for fewer than four samples, NaN if proven.
    tolerances : (float, float)
        Relative duality gap, and violation of a bound on the grid, that are accepted.
    trial : float
        2-norm of the map of one finite trial, :func:`trial_norm`; NaN if not asked for.
    samples : int or None
        Length of that trial.
    rest : int
        Number of samples at its end in which v is held at zero.
    doubts : tuple of str
        Why the problem itself may be badly chosen.
    robust : Robustness or None
        For several plants or a radius. `grid_M` and `all_M` are then the largest of all plants;
        `grid_M` is that within the radius, too, whose size between the samples is not known.
    noise : float
        What of the value is the cost of noise; zero if that was not asked for.
    new, learned : float
        RMS, in units of `scale`, of what is new in the measured outputs of a trial, and of what
        learning has made of that in all trials before, for the nominal plant; zero without noise.
    basis : tuple of str
        What P and its radius rest on, if they were measured, and where they are of no use.
    """

    structure: str
    order: int
    value: float
    lower_bound: float
    idle: float
    M_max: float
    L_max: float | None
    grid_M: float
    grid_L: float
    all_M: float
    all_L: float
    place: float
    sampled: tuple[float, float]
    nyquist: float
    proven: bool = True
    missed: float = np.nan
    tolerances: tuple[float, float] = (GAP, VIOLATION)
    trial: float = np.nan
    samples: int | None = None
    rest: int = 0
    doubts: tuple[str, ...] = ()
    robust: Robustness | None = None
    noise: float = 0.0
    new: float = 0.0
    learned: float = 0.0
    basis: tuple[str, ...] = ()

    @property
    def gap(self) -> float:
        """Distance of value and lower bound, relative to the value.

        Below a thousandth of the objective without learning, it is relative to that: a billionth
        of the objective without learning is as good as nothing.
        """
        return (self.value - self.lower_bound) / max(self.value, 1e-3 * self.idle)

    @property
    def failures(self) -> list[str]:
        """What speaks against the filter; empty if it holds."""
        gap, violation = self.tolerances
        where = f" at its worst ({self.robust.where})" if self.robust else ""
        tests = {
            f"relative duality gap {self.gap:.1e} > {gap:g}": self.gap > gap,
            f"sigma_max(M){where} = {self.grid_M:.12g} > M_max = {self.M_max} on the grid": (
                self.grid_M > self.M_max * (1 + violation)
            ),
            f"sigma_max(L) = {self.grid_L:.12g} > L_max = {self.L_max} on the grid": (
                self.L_max is not None and self.grid_L > self.L_max * (1 + violation)
            ),
            f"sigma_max(M){self._whose} reaches {self.all_M:.9g} at {self.place:.6g} rad/s, not in "
            "omega: "
            "Lemma 1 does not hold; add frequencies there": self.proven and self.all_M >= 1,
        }
        return [text for text, failed in tests.items() if failed]

    @property
    def warnings(self) -> list[str]:
        """What speaks against the problem, and against what is said between the samples."""
        margin = 1 - self.all_M
        too_coarse = margin > 0 and self.missed > COARSE * margin
        tests = {
            f"sigma_max(M){self._whose} may reach {self.all_M:.4g} at {self.place:.4g} rad/s, "
            "between the samples, where Lemma 1 would not hold; measure there, or smooth samples "
            "that scatter": margin <= 0,
            f"the samples are too coarse: splines miss M by {self.missed:.2g} at samples left out, "
            f"and 1 - sigma_max(M) is {margin:.2g}; measure at more frequencies": too_coarse,
        }
        coarse = [text for text, warned in tests.items() if warned and not self.proven]
        if self.L_max is not None and self.all_L > LOUD * self.L_max:
            coarse.append(
                f"sigma_max(L) reaches {self.all_L:.4g} off the design frequencies, where nothing "
                f"holds it to {self.L_max:.4g}; add frequencies, up to {self.nyquist:.4g} rad/s"
            )
        return [*self.doubts, *coarse]

    @property
    def unknown(self) -> str:
        """The frequencies at which nothing is known of M if P or Q were given as samples."""
        low, high = self.sampled
        parts = [f"below {low:.4g} rad/s"] if low > 0 else []
        parts += [f"above {high:.4g} rad/s"] if high < self.nyquist * (1 - 1e-9) else []
        return ", ".join([*parts, "at resonances that no sample shows"])

    @property
    def _whose(self):
        """Of which plant `all_M` is, for the messages."""
        several = self.robust and self.robust.plants > 1
        return f" of plant {self.robust.peak}" if several else ""

    def __repr__(self):
        robust = self.robust
        within = " without the radius" if robust and robust.radius else ""
        bound = "none" if self.L_max is None else f"{self.L_max:g}"
        rows = [
            ("", "sigma_max(M)", "sigma_max(L)"),
            ("bound", f"{self.M_max:g}", bound),
            ("on the design grid", f"{self.grid_M:.8f}", f"{self.grid_L:.7g}"),
            (
                "over all frequencies",
                f"{self.all_M:.8f}" if self.proven and not within else "not known",
                f"{self.all_L:.7g}",
            ),
        ]
        if robust:
            rows.insert(3, ("  of the nominal plant", f"{robust.nominal:.8f}", ""))
        lines = ["{:<22}{:>14}{:>14}".format(*row).rstrip() for row in rows]
        if robust:
            lines += robust.lines
        if self.proven and within:
            lines.append(f"sigma_max(M) over all frequencies{within}: {self.all_M:.8f}")
        if not self.proven:
            low, high = self.sampled
            lines += [
                f"sigma_max(M){within} from {low:.4g} to {high:.4g} rad/s, between the samples: "
                f"{self.all_M:.4f}, estimated{robust.looked_at if robust else ''}",
                f"sigma_max(M) unknown: {self.unknown}",
            ]
        compared = "" if self.L_max is not None else f" with a gain of Q P L up to {LARGEST:.0e}"
        lines.append(
            f"objective {self.value:.8g}, no {self.structure} filter of order {self.order}"
            f"{compared} below {self.lower_bound:.8g}"
        )
        if self.noise:
            lines += [
                f"of which the cost of noise: {self.noise:.4g}",
                f"RMS of the measured error, converged, from noise: "
                f"{np.hypot(self.new, self.learned):.4g}; {self.new:.4g} are new in each trial, "
                f"{self.learned:.4g} are learned",
            ]
        if self.samples:
            rest = f", the last {self.rest} at rest" if self.rest else ""
            lines.append(f"norm of one trial of {self.samples} samples{rest}: {self.trial:.4f}")
        lines += self.basis
        lines += [f"WARNING: {text}" for text in self.warnings]
        return "\n".join([*lines, *(f"FAILS: {text}" for text in self.failures)])


def certify(
    problem: Problem,
    solution: Solution,
    tolerances: tuple[float, float] = (GAP, VIOLATION),
    samples: int | None = None,
    rest: int = 0,
) -> Certificate:
    """Find out what is true of a filter.

    Parameters
    ----------
    problem : Problem
    solution : Solution
        Only its coefficients and multipliers are used, and neither is trusted.
    tolerances : (float, float)
        Relative duality gap, and violation of a bound on the grid, that are accepted.
    samples : int, optional
        Length of a trial whose norm is wanted.
    rest : int
        Samples at its end in which v is held at zero.

    Returns
    -------
    Certificate

    Raises
    ------
    ValueError
        If an argument is something else, or the norm of a trial is wanted without models.
    """
    arguments.instance("problem", problem, Problem)
    arguments.instance("solution", solution, Solution)
    tolerances = tuple(arguments.array("tolerances", tolerances, (2,)).tolist())
    samples, rest = checked_trial(problem, samples, rest)
    L = LearningFilter(solution.coefficients, problem.Ts)  # in units of scale, as P is
    response = L.frequency_response(problem.omega)
    sigma_M = largest_singular_values(problem.M(response))
    worst = worst_case(problem, L)
    noise = problem.cost_of_noise(response)
    new, learned = _rms_of_noise(problem, response)
    value = problem.value(sigma_M, worst.sigma) + noise
    peak = highest_peak(problem, L, np.argsort(-worst.peaks, kind="stable"))
    return Certificate(
        structure=problem.structure,
        order=problem.order,
        value=value,
        lower_bound=lower_bound(problem, solution.U, solution.V, solution.cuts, response),
        idle=problem.idle,
        M_max=problem.M_max,
        L_max=problem.L_max,
        grid_M=worst.sigma.max(),
        grid_L=largest_singular_values(response).max(),
        all_M=peak.sigma,
        all_L=peak_gain(learning_model(L))[0],
        place=peak.omega,
        sampled=(problem.omega[0], problem.omega[-1]),
        nyquist=np.pi / problem.Ts,
        proven=peak.proven,
        missed=peak.missed,
        tolerances=tolerances,
        trial=np.nan if samples is None else trial_norm(*problem.model, L, samples, rest=rest)[0],
        samples=samples,
        rest=rest,
        doubts=tuple(doubts(problem, value)),
        robust=_robustness(problem, sigma_M, worst, peak) if problem.robust else None,
        noise=noise,
        new=new,
        learned=learned,
        basis=(*problem.basis, *useless(problem)),
    )


def checked_trial(problem: Problem, samples: int | None, rest: int) -> tuple[int | None, int]:
    """Length of a trial and of the rest at its end; a ValueError if it has no norm."""
    if samples is not None:
        samples = arguments.whole("samples", samples, 2)
        if problem.model is None:
            raise ValueError(
                f"samples = {samples} asks for the norm of a trial, which needs P and Q as models"
            )
    return samples, arguments.whole("rest", rest, 0, (samples or 1) - 1)


def _rms_of_noise(problem, L):
    """RMS of what is new in a trial, and of what is learned of it, converged."""
    if problem.noise is None:
        return 0.0, 0.0
    share = problem.noise * (1 - problem.M_max**2)  # of each frequency in the variance
    M = problem.M(L)
    if np.abs(np.linalg.eigvals(M)).max() >= 1:
        return np.sqrt(share.sum()), np.inf
    QPL = problem.Q[:, None, None] * problem.P @ L
    learned = accumulated(M, QPL * share[:, None] @ QPL.conj().swapaxes(1, 2))
    return np.sqrt(share.sum()), np.sqrt(np.einsum("nii->", learned).real)


def _robustness(problem, sigma_M, worst, peak):
    at = [frequency for _, frequency in worst.tied]
    radius = "" if problem.radius is None else "entries" if by_entries(problem) else "norm"
    return Robustness(
        plants=1 + len(problem.others),
        radius=radius,
        nominal=sigma_M.max(),
        worst=tuple((plant, float(problem.omega[frequency])) for plant, frequency in worst.tied),
        attained=worst.attained[at].max(),
        peak=int(peak.plant),
        estimated=peak.estimated,
    )
