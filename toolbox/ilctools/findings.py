"""Findings of the checks of a design. A finding has a code and numbers; FINDINGS has the texts."""

from dataclasses import dataclass
from typing import Any

FINDINGS = {
    # what fails
    "gap": "the relative duality gap is {value:.1e}, above the accepted {limit:g}",
    "on the grid": "{claim.what}{place} is {value:.12g} on the grid, above {claim}",
    "everywhere": "{claim.what}{place} is {value:.12g}, above {claim}, which was to hold at "
    "every frequency",
    "one or more": "sigma_max(M) {place}, which is not in omega, reaches {value:.9g}: "
    "monotone convergence (Lemma 1) is not guaranteed. Add frequencies there, "
    "or synthesise with everywhere=True",
    "beyond": "sigma_max(M) {place} may reach {value:.4g}, if P is as large there as assumed: "
    "monotone convergence (Lemma 1) is not guaranteed",
    # what warns
    "unmeasured": "Q is {value:.4g} {place}, where P is not known, so that no filter can "
    "bound sigma_max(M) by {limit:g} there: lower the cut-off of Q, or measure "
    "P up to a higher frequency",
    "units": "the outputs are in {place}, and the design treats an error of one unit in each "
    "of them as equally large: pass `scale`, the amounts that are equally large in "
    "each signal",
    "directions": "{place}. The number of directions that remain is {value}; L learns in "
    "these, and the error in the others remains. Does each sensor measure "
    "something of its own, and does each input have an effect of its own? "
    "Channels in units that differ by a factor of millions need `scale`",
    "alike": "{place}, the weakest direction of P has {value:.2g} times the gain of the "
    "strongest: are two sensors, or two inputs, nearly the same, or in different "
    "units? L inverts the small difference, and amplifies its noise. Leave one of "
    "them out, or pass `scale`",
    "lead": "the phase of P leads by more than any stable plant with this gain allows: if P "
    "was computed with exp(-j omega t), pass P.conj(); otherwise check the unit of "
    "omega",
    "rest": "P differs from the identity by {value:.2g} {place}, where P should be the "
    "identity because this loop integrates: does each sensor respond, do the "
    "actuators stay within their limits, and does this controller run?",
    "hertz": "{place}, just below 1 / (2 Ts) = {value:.6g}, where a table in Hz would end: if "
    "omega is in Hz, pass 2 pi omega, because omega must be in rad/s",
    "sign": "P is near {value:g} {place}, but the P of a loop that tracks its reference is "
    "near 1 there: is the sign of P reversed?",
    "below": "sigma_max(M) may reach {value:.4g} {place}, where P is not known well enough: "
    "such slow errors may grow from trial to trial. Measure P at lower frequencies, "
    "too",
    "narrow": "{place} decides the cut-off of Q, which is {limit:.2g} rad/s; without that "
    "range it would be {value:.2g} rad/s. If P is not known well enough there, "
    "record for longer or with larger moves. Otherwise pass a Q with the higher "
    "cut-off, and check the rate",
    "little": "the cut-off of Q is only {value:.4g} rad/s, {place}: almost nothing is "
    "learned, because P is too uncertain there, or the plants differ too much. "
    "Record for longer, or with larger moves",
    "halved": "the cut-off of Q is {limit:.4g} rad/s, half of what P admits, because with "
    "the full cut-off trial_norm is {value:.3g} for a trial {place}: the errors at the ends of "
    "a trial might then grow from trial to trial{remedy}",
    "ends": "the cut-off of Q is {limit:.4g} rad/s, half of what P admits, and trial_norm is "
    "still {value:.3g} for a trial {place}: the errors at the ends of a trial may "
    "grow from trial to trial{remedy}",
    "idle": "almost nothing is learned: the filter leaves {value:.0%} of the error that the "
    "objective counts",
    "between": "sigma_max(M) {place}, between the frequencies omega, reaches {value:.4g}, "
    "above M_max = {limit:g}: synthesise with everywhere=True, or with a smaller "
    "L_max",
    "samples": "sigma_max(M) {place}, between the frequencies omega, may reach {value:.4g}, "
    "because they describe P too coarsely there: measure P at more frequencies, or "
    "with less noise, or synthesise with everywhere=True. Is the phase of P in "
    "rad?",
}


@dataclass(frozen=True)
class Finding:
    """A checked value that exceeds its limit; `code` is a key of FINDINGS."""

    code: str
    value: float
    limit: float
    place: str = ""  # which plant and frequency
    remedy: str = ""  # with its numbers, where these are known
    claim: Any = None  # the bound that the finding is about, with its name and what is bounded

    def __str__(self):
        return FINDINGS[self.code].format(**vars(self))
