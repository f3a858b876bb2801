"""Within which bounds a learning filter is sought: each is a claim that its certificate must hold.

    sigma_max(M) <= M_max,    sigma_max(L) <= L_max,    sigma_max(L) <= gain above a frequency.

Who adds a bound adds a claim here. The solver asks :meth:`Bounds.limit_on_L` or for M_max; grid,
certificate and messages go through :attr:`Bounds.claims`, so that none of them can leave one out.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np


class Claim(NamedTuple):
    """One bound, as it was asked for."""

    name: str  # the argument of `synthesise`
    matrix: str  # "M" or "L", whose largest singular value is bounded
    limit: float
    lowest: float = 0.0  # rad/s, the frequency from which on it holds

    @property
    def what(self) -> str:
        """What is bounded, in words."""
        above = f" from {self.lowest:.4g} rad/s on" if self.lowest > 0 else ""
        return f"sigma_max({self.matrix}){above}"

    def holds_at(self, omega) -> np.ndarray:
        """At which frequencies it is a bound, (n,)."""
        return np.asarray(omega) >= self.lowest

    def __str__(self):
        if self.lowest > 0:
            return f"{self.name} = ({self.lowest:g}, {self.limit:g})"
        return f"{self.name} = {self.limit:g}"


@dataclass(frozen=True)
class Bounds:
    """All bounds of a problem."""

    M_max: float  # on sigma_max(M)
    L_max: float | None  # on sigma_max(L); None: there is none
    L_high: tuple[float, float] | None = None  # a frequency, rad/s, and the bound from there on
    everywhere: bool = False  # whether they hold between the frequencies, too

    @property
    def claims(self) -> tuple[Claim, ...]:
        """Each bound by itself."""
        claims = [Claim("M_max", "M", self.M_max)]
        if self.L_max is not None:
            claims.append(Claim("L_max", "L", self.L_max))
        if self.L_high is not None:
            lowest, limit = self.L_high
            claims.append(Claim("L_high", "L", limit, lowest))
        return tuple(claims)

    def on(self, matrix: str) -> list[Claim]:
        """The claims on M, or on L."""
        return [claim for claim in self.claims if claim.matrix == matrix]

    def limit_on_L(self, omega) -> np.ndarray:
        """The least of the limits on sigma_max(L) at each frequency, (n,); infinite if none is."""
        each = [np.where(claim.holds_at(omega), claim.limit, np.inf) for claim in self.on("L")]
        return np.min([np.full(len(omega), np.inf), *each], axis=0)

    def lowered(self, shrink: float, M: bool) -> "Bounds":
        """Limits times a number below one, for the values on a grid; M_max only if `M` says so."""
        return replace(
            self,
            M_max=self.M_max * (shrink if M else 1),
            L_max=self.L_max and self.L_max * shrink,
            L_high=self.L_high and (self.L_high[0], self.L_high[1] * shrink),
        )
