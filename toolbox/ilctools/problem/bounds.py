"""The bounds on a learning filter, each of which is a claim that the certificate checks.

    sigma_max(M) <= M_max,    sigma_max(L) <= L_max,    sigma_max(L) <= gain above a frequency.

The third bound holds at and above a frequency that the user chooses. To add a kind of bound, add a
claim to :attr:`Bounds.claims`. The solver uses :meth:`Bounds.limit_on_L` and M_max. The grid, the
certificate and the messages loop over all claims, so that no claim can be left out.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np


class Claim(NamedTuple):
    """One bound on sigma_max(M) or sigma_max(L), as the user stated it."""

    name: str  # of the argument of `synthesise` that states the bound
    matrix: str  # "M" or "L", whose largest singular value is bounded
    limit: float  # the largest allowed singular value
    lowest: float = 0.0  # rad/s: the bound holds from this frequency on

    @property
    def what(self) -> str:
        """The singular value that is bounded, in words."""
        above = f" from {self.lowest:.4g} rad/s on" if self.lowest > 0 else ""
        return f"sigma_max({self.matrix}){above}"

    def holds_at(self, omega) -> np.ndarray:
        """Return a mask of the frequencies at which the bound holds, (n,)."""
        return np.asarray(omega) >= self.lowest

    def __str__(self):
        if self.lowest > 0:
            return f"{self.name} = ({self.lowest:g}, {self.limit:g})"
        return f"{self.name} = {self.limit:g}"


@dataclass(frozen=True)
class Bounds:
    """All bounds of a design problem."""

    M_max: float  # on sigma_max(M)
    L_max: float | None  # on sigma_max(L); None: L has no such bound
    L_high: tuple[float, float] | None = None  # a frequency, rad/s, and the bound from there on
    everywhere: bool = False  # whether the bounds also hold between the frequencies

    @property
    def claims(self) -> tuple[Claim, ...]:
        """The bounds as claims, one claim for each bound."""
        claims = [Claim("M_max", "M", self.M_max)]
        if self.L_max is not None:
            claims.append(Claim("L_max", "L", self.L_max))
        if self.L_high is not None:
            lowest, limit = self.L_high
            claims.append(Claim("L_high", "L", limit, lowest))
        return tuple(claims)

    def on(self, matrix: str) -> list[Claim]:
        """Return the claims on M, or on L."""
        return [claim for claim in self.claims if claim.matrix == matrix]

    def limit_on_L(self, omega) -> np.ndarray:
        """Return the least limit on sigma_max(L) at each frequency, (n,).

        If there is no limit at a frequency, the value is inf.
        """
        each = [np.where(claim.holds_at(omega), claim.limit, np.inf) for claim in self.on("L")]
        return np.min([np.full(len(omega), np.inf), *each], axis=0)

    def lowered(self, shrink: float, M: bool) -> "Bounds":
        """Return bounds whose limits are multiplied by `shrink`.

        M_max is multiplied only if `M` is true.
        """
        return replace(
            self,
            M_max=self.M_max * (shrink if M else 1),
            L_max=self.L_max and self.L_max * shrink,
            L_high=self.L_high and (self.L_high[0], self.L_high[1] * shrink),
        )
