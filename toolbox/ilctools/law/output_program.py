"""The program whose solution needs less of a limit than the law's own change: (7), :mod:`.nearest`.

Limits of outputs are tightened by a share theta of what the error of a plant may add.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import control
import numpy as np
from scipy.linalg import block_diag

from ilctools.law.nearest import Norm, Rows, nearest
from ilctools.law.output_spread import Plant, Room, Spread
from ilctools.response.scale import Scale

MOST_PLANTS = 3  # of a list in a program: those that leave least room; (6) takes all


class Commands(NamedTuple):
    """Limits of commands, which follow from what drives P as the outputs of a model do."""

    model: control.StateSpace  # from w to commands, in their own units
    ends: tuple[np.ndarray, np.ndarray]  # low and high of their change, (active, commands)

    def in_units(self, scale: Scale) -> "Commands":
        """With w in units of `scale`."""
        P, S = self.model, np.diag(scale.v)
        return self._replace(model=control.ss(P.A, P.B @ S, P.C, P.D @ S, P.dt))


@dataclass(frozen=True, eq=False)
class Program:
    """What a change of w is to do; all in units of `scale`."""

    plants: Sequence[Plant]
    room: Room
    wanted: np.ndarray  # the law's change, (time, m)
    norm: Norm
    active: int  # samples before the rest, in which the change may be another
    commands: Commands | None

    def cost(self, d) -> float:
        """(7)."""
        off = d - self.wanted
        return self.norm.size(self.plants[0].output(off), off)

    def change(self, spreads: Sequence[Spread], theta: float) -> np.ndarray:
        """The cheapest change within limits that are tightened by theta of these spreads' radii.

        They are those of the law's change, of each plant. Raises a NotFound.
        """
        least = [self.room.share(spread).min() for spread in spreads]
        some = np.union1d(0, np.argsort(least)[:MOST_PLANTS])  # the nominal one has the cost
        asked = [(self.plants[k].model, _tightened(self.room, spreads[k], theta)) for k in some]
        if self.commands is not None:
            asked.append(self.commands)
        P, rows = _beside(asked)
        d, unit = self.wanted.copy(), np.abs(self.wanted).max()
        d[: self.active] += nearest(P, self.norm, len(d), self.active, rows, unit)
        return d


def _tightened(room: Room, spread: Spread, theta: float) -> tuple[np.ndarray, np.ndarray]:
    """From where to where outputs may move from what is expected of the law's change."""
    margin = theta * spread.radius
    return margin - room.down - spread.middle, room.up - margin - spread.middle


def _beside(asked) -> tuple[control.StateSpace, list[Rows]]:
    """Models of one input as one, with the first one's outputs, and the rows of each, limited."""
    models, ends = zip(*asked, strict=True)
    A, C = block_diag(*(P.A for P in models)), block_diag(*(P.C for P in models))
    B, D = np.vstack([P.B for P in models]), np.vstack([P.D for P in models])
    rows = np.split(np.arange(len(C)), np.cumsum([P.noutputs for P in models])[:-1])
    P = control.ss(A, B, C[rows[0]], D[rows[0]], models[0].dt)
    return P, [Rows(C[at], D[at], *limits) for at, limits in zip(rows, ends, strict=True)]
