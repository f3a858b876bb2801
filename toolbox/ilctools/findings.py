"""Findings against a design: a code with numbers; all their words are in this module."""

from dataclasses import dataclass
from typing import Any

FINDINGS = {
    # what fails
    "gap": "relative duality gap {value:.1e} > {limit:g}",
    "on the grid": "{claim.what}{place} = {value:.12g}, above {claim} on the grid",
    "everywhere": "{claim.what}{place} is {value:.12g}, above {claim}, at some frequency",
    "one or more": "sigma_max(M) {place}, not in omega, reaches {value:.9g}: Lemma 1 does not "
    "hold; add frequencies there, or synthesise with everywhere=True",
    "beyond": "sigma_max(M) {place} may reach {value:.4g}, with the size of P assumed there: "
    "Lemma 1 does not hold",
    # what warns
    "unmeasured": "Q is {value:.4g} {place}, where P is not known: no filter bounds M by {limit:g} "
    "there; lower the cut-off of Q, or measure further",
    "units": "outputs are in {place}, of which one counts as much as one of another: pass `scale`, "
    "what is equally large in each",
    "directions": "{place}: what is left has {value} directions, and is learned; the error in the "
    "others stays. Does each sensor show something of its own, and each input do something of its "
    "own? Channels in units that differ by millions need `scale`",
    "alike": "{place} the weakest direction of P has {value:.2g} of the gain of the strongest: are "
    "two sensors, or two inputs, nearly the same, or in other units? L inverts the difference, and "
    "noise with it. Leave one out, or pass `scale`",
    "lead": "the phase of P leads what its gain admits of any stable plant: is it of "
    "exp(-j omega t), then pass P.conj(), or in other units of omega?",
    "rest": "P differs from the identity by {value:.2g} {place}, where this loop integrates and "
    "has it: does each sensor answer, do actuators stay within limits, does this controller run?",
    "hertz": "{place}, just below 1 / (2 Ts) = {value:.6g}, as a table in Hz does: if it is in Hz, "
    "pass 2 pi omega, as omega is in rad/s",
    "sign": "P is near {value:g} {place}, where a loop that tracks its reference has 1: is the "
    "sign of P reversed?",
    "below": "sigma_max(M) may reach {value:.4g} {place}, where P is not known well enough: errors "
    "that slow may grow from trial to trial; measure P at lower frequencies, too",
    "narrow": "{place} decides the cut-off of Q: without that range it would be {value:.2g} rad/s "
    "instead of {limit:.2g} rad/s. If P is not known well enough there, record longer or larger "
    "moves; else pass Q with the higher cut-off, and look at the rate",
    "little": "Q with cut-off {value:.4g} rad/s, {place}: next to nothing is learned, as P is too "
    "uncertain there, or its plants differ: record longer or larger moves",
    "halved": "Q with cut-off {limit:.4g} rad/s, half of what P admits, because there the norm of "
    "a trial {place} is {value:.3g}: its ends might grow from trial to trial{remedy}",
    "ends": "Q with cut-off {limit:.4g} rad/s, half of what P admits: norm of a trial {place} "
    "{value:.3g}: its ends may grow from trial to trial{remedy}",
    "idle": "the filter leaves {value:.0%} of the error that counts",
    "between": "sigma_max(M) {place}, between the frequencies omega, reaches {value:.4g}, where "
    "M_max = {limit:g} bounds it: synthesise with everywhere=True, or a smaller L_max",
    "samples": "sigma_max(M) {place}, between the frequencies omega, may reach {value:.4g}: they "
    "show too little of P (is its phase in rad?): measure at more of them there, or with less "
    "noise, or synthesise with everywhere=True",
}


@dataclass(frozen=True)
class Finding:
    """A value beyond its limit; `code` is a key of FINDINGS."""

    code: str
    value: float
    limit: float
    place: str = ""  # which plant and frequency
    remedy: str = ""  # with its numbers, where these are known
    claim: Any = None  # the bound that the finding is about, with its name and what is bounded

    def __str__(self):
        return FINDINGS[self.code].format(**vars(self))
