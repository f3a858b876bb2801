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

from ilctools.law.nearest import Norm, Rows, nearest
from ilctools.law.output_spread import Plant, Room, Spread
from ilctools.response.scale import Scale

MOST_PLANTS = 3  # plants in a program: those of least share (6); (6) itself uses all plants


class Commands(NamedTuple):
    """Limits of commands, and the model from w, the signal that drives P, to the commands."""

    model: control.StateSpace  # from w to commands, in their own units
    # low and high of their change, (time, commands), infinite in the rest
    ends: tuple[np.ndarray, np.ndarray]

    def in_units(self, scale: Scale) -> "Commands":
        """Return these limits with w in units of `scale`."""
        return self._replace(model=self.model * np.diag(scale.v))


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
        models = [self.plants[k].model for k in some]
        ends = [_tightened(self.room, spreads[k], theta) for k in some]
        if self.commands is not None:
            models.append(self.commands.model)
            ends.append(self.commands.ends)
        low, high = map(np.hstack, zip(*ends, strict=True))
        # one model with the outputs of all; all models have the same input
        P = control.append(*models) * np.tile(np.eye(models[0].ninputs), (len(models), 1))
        rows, nominal = Rows(P.C, P.D, low, high), P[: models[0].noutputs, :]
        d, unit = self.wanted.copy(), np.abs(self.wanted).max()
        d[: self.active] += nearest(nominal, self.norm, len(d), self.active, rows, unit)
        return d


def _tightened(room: Room, spread: Spread, theta: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute the range in which outputs may differ from those predicted for the law's change."""
    margin = theta * spread.radius
    return margin - room.down - spread.middle, room.up - margin - spread.middle
