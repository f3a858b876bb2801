"""The quadratic program for a change of w that needs less room than the law's own change.

The signal w drives P. The room of an output is its distance from its limit. The program minimises
the cost (7) of :mod:`.output_step`, and :mod:`.nearest` solves it. Limits of outputs are tightened
by a share theta of what the error of a plant's model may add to the output.
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

MOST_PLANTS = 3  # plants in a program: those of least share (6); (6) itself uses all plants


class Commands(NamedTuple):
    """Limits of commands, and the model from w, the signal that drives P, to the commands."""

    model: control.StateSpace  # from w to commands, in their own units
    ends: tuple[np.ndarray, np.ndarray]  # low and high of their change, (active, commands)

    def in_units(self, scale: Scale) -> "Commands":
        """Return these limits with w in units of `scale`."""
        P, S = self.model, np.diag(scale.v)
        return self._replace(model=control.ss(P.A, P.B @ S, P.C, P.D @ S, P.dt))


@dataclass(frozen=True, eq=False)
class Program:
    """The data of a program for the change of w; all values are in units of `scale`."""

    plants: Sequence[Plant]
    room: Room
    wanted: np.ndarray  # the law's change, (time, m)
    norm: Norm
    active: int  # number of samples in which the change may differ from `wanted`
    commands: Commands | None

    def cost(self, d) -> float:
        """Compute the cost (7) of a change d."""
        off = d - self.wanted
        return self.norm.size(self.plants[0].output(off), off)

    def change(self, spreads: Sequence[Spread], theta: float) -> np.ndarray:
        """Find the change of least cost within limits that are tightened by theta times the radii.

        The radii are taken from `spreads`. For each plant, a spread holds the least and the
        greatest change of y that the law's own change may cause. Raises a NotFound if there is no
        such change.
        """
        least = [self.room.share(spread).min() for spread in spreads]
        some = np.union1d(0, np.argsort(least)[:MOST_PLANTS])  # the nominal plant defines the cost
        asked = [(self.plants[k].model, _tightened(self.room, spreads[k], theta)) for k in some]
        if self.commands is not None:
            asked.append(self.commands)
        P, rows = _beside(asked)
        d, unit = self.wanted.copy(), np.abs(self.wanted).max()
        d[: self.active] += nearest(P, self.norm, len(d), self.active, rows, unit)
        return d


def _tightened(room: Room, spread: Spread, theta: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute the range in which outputs may differ from those predicted for the law's change."""
    margin = theta * spread.radius
    return margin - room.down - spread.middle, room.up - margin - spread.middle


def _beside(asked) -> tuple[control.StateSpace, list[Rows]]:
    """Join models with the same input into one model.

    Return the joined model with the outputs of the first model, and all limited rows.
    """
    models, ends = zip(*asked, strict=True)
    A, C = block_diag(*(P.A for P in models)), block_diag(*(P.C for P in models))
    B, D = np.vstack([P.B for P in models]), np.vstack([P.D for P in models])
    rows = np.split(np.arange(len(C)), np.cumsum([P.noutputs for P in models])[:-1])
    P = control.ss(A, B, C[rows[0]], D[rows[0]], models[0].dt)
    return P, [Rows(C[at], D[at], *limits) for at, limits in zip(rows, ends, strict=True)]
