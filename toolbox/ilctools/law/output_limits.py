"""Limits of outputs that every trial keeps: their values, and what is guaranteed."""

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ilctools import arguments
from ilctools.law.error_bound import ErrorBound
from ilctools.law.nearest import Norm
from ilctools.law.output_program import Commands, Program
from ilctools.law.output_spread import Done, Plant, Room, Spread
from ilctools.law.output_step import Step, longest_step, regained
from ilctools.law.plant_region import PlantRegion

Limit = tuple[float | np.ndarray, float | np.ndarray]  # lowest and highest; infinite: none


@dataclass(frozen=True, eq=False)
class OutputLimits:
    """Limits of outputs, and what is known of the plant that is to keep them.

    ``design.law(limits=..., noise=...)`` makes this object. Print the object to see what it
    guarantees. :mod:`.output_step` describes how the limits are kept.

    Attributes
    ----------
    limits : dict
        Lowest and highest value of outputs by name, in their units. A value is a number, or has one
        entry for each sample.
    noise : dict
        A bound n by name of the output. In each sample, the part of the output that does not repeat
        from trial to trial is at most n.
    region : PlantRegion
        The models of the plant, with their radii.
    """

    limits: dict[str, Limit]
    noise: dict[str, float]
    region: PlantRegion

    def __post_init__(self):
        outputs = self.region.outputs
        limits = arguments.by_name("limits", self.limits, outputs)
        noise = arguments.by_name("noise", self.noise, outputs)
        vars(self).update(
            limits={name: _limit(f"limits[{name!r}]", ends) for name, ends in limits.items()},
            noise={
                name: arguments.not_negative(f"noise[{name!r}]", n) for name, n in noise.items()
            },
        )

    @cached_property
    def n(self) -> np.ndarray:
        """Bound n of the part of each output that does not repeat from trial to trial, (p,)."""
        return np.array([self.noise.get(name, 0.0) for name in self.region.outputs])

    def ends(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest values of all outputs, (time, p)."""
        ends = np.empty((2, samples, len(self.region.outputs)))
        ends[0], ends[1] = -np.inf, np.inf
        for i, name in enumerate(self.region.outputs):
            for end, value in zip(ends, self.limits.get(name, ()), strict=False):
                if np.ndim(value) and len(value) != samples:
                    raise ValueError(
                        f"limits[{name!r}] has {len(value)} samples, but a trial has {samples}"
                    )
                end[:, i] = value
        return ends[0], ends[1]

    def check_rest(self, reference) -> None:
        """Refuse limits that a trial exceeds at its start, the first sample of the reference."""
        low, high = self.ends(len(reference))
        for i, name in enumerate(self.region.outputs):
            rest, n = reference[0, i], self.n[i]
            if not low[0, i] + 2 * n <= rest <= high[0, i] - 2 * n:
                ends = ["changing" if np.ndim(end) else str(end) for end in self.limits[name]]
                raise ValueError(
                    f"limits[{name!r}] = ({', '.join(ends)}) leave no room at the start of "
                    f"a trial, where the reference is {rest:.6g}"
                    + (f", and the noise is {n:.6g}" if n else "")
                )

    def distance(self, y) -> np.ndarray:
        """Compute the least distance of outputs, (time, p), from their limits, (p,).

        If an output exceeds a limit, its distance is negative.
        """
        low, high = self.ends(len(y))
        return np.minimum(high - y, y - low).min(axis=0)

    def beyond(self, y) -> np.ndarray:
        """Compute the most by which outputs (time, p) exceed their limits, (p,)."""
        return np.maximum(-self.distance(y), 0)

    def room(self, y, noises: int) -> Room:
        """Compute the room of outputs y (time, p), in units of `scale`.

        The bound n is subtracted `noises` times, twice in (6) of :mod:`.output_step`.
        """
        low, high = self.ends(len(y))
        scale, n = self.region.scale.y, noises * self.n
        return Room((y - low - n) / scale, (high - n - y) / scale)

    def first_share(self, reference) -> float:
        """Compute the largest share of a reference (time, p) with which the limits hold.

        The limits hold for all plants of the region.
        """
        w = (reference - reference[0]) / self.region.scale.v
        room = self.room(np.broadcast_to(reference[0], reference.shape), 1)
        return min(room.share(plant.spread(w)).min() for plant in self.plants(len(w)))

    def safe_share(self, y) -> float:
        """Compute the share b of the last w with which the trial would have kept the limits.

        The trial begins at rest, and y (time, p) are its outputs. If no disturbance repeats, the
        share is correct for all linear plants. With the first sample y_0 of y, the condition at the
        upper limit is high - n >= y_0 + b (y + n - y_0).
        """
        moves, n, scale = y - y[0], self.n, self.region.scale.y
        spread = Spread((moves - n) / scale, (moves + n) / scale)
        return float(self.room(np.broadcast_to(y[0], y.shape), 1).share(spread).min())

    @lru_cache(maxsize=4)  # noqa: B019
    def plants(self, samples: int) -> list[Plant]:
        """Return all plants of the region, for trials of `samples` samples."""
        bounds = [ErrorBound(self.region.angles, radius, samples) for radius in self.region.radii]
        return [*map(Plant, self.region.models, bounds)]

    def step(
        self,
        wanted: np.ndarray,
        now: Done,
        past: Sequence[Done],
        norm: Norm,
        active: int,
        commands: Commands | None = None,
    ) -> Step | None:
        """Compute the change of w that keeps the limits of outputs, see :mod:`.output_step`.

        This change replaces the law's own change. After a trial in which an output exceeded a
        limit, the result may be None. None means that no change is found after which all limits
        hold for sure.

        Parameters
        ----------
        wanted : ndarray, shape (time, m)
            The law's change.
        now, past : Done, sequence of Done
            The trial that has just ended, and the trials before, in their order.
        norm : Norm
            The norm of (7) in :mod:`.output_step`, in units of `scale`.
        active : int
            Number of samples in which a program may choose the change. After these samples, v is
            zero.
        commands : Commands, optional
            Limits of commands, which hold for changes that programs find.
        """
        scale = self.region.scale
        if commands is not None:
            commands = commands.in_units(scale)
        plants, room = self.plants(len(wanted)), self.room(now.y, 2)
        program = Program(plants, room, wanted / scale.v, norm, active, commands)
        if self.beyond(now.y).any():
            change = regained(program)
            return None if change is None else Step(change * scale.v, 0.0, 0, 0.0, 0.0)
        done = [Done(w / scale.v, y / scale.y) for w, y in (now, *self._comparable(past))]
        step = longest_step(program, done[0], done[1:], self.n / scale.y)
        unit = scale.y[step.output]
        return step._replace(
            change=step.change * scale.v, room=step.room * unit, error=step.error * unit
        )

    def _comparable(self, past):
        """Return the last trial in which an output exceeded a limit, and all later trials.

        In earlier trials, conditions may have been different. If no output exceeded a limit, all
        trials are returned.
        """
        broken = [k for k, done in enumerate(past) if self.beyond(done.y).any()]
        return past[max(broken, default=0) :]

    @property
    def promise(self) -> str:
        """The guarantee in words: what is kept, and under which conditions."""
        lines = [self._promise_of(name) for name in self.limits]
        region = self.region
        if region.exact:
            some = "the model" if len(region.models) == 1 else "each of the models"
            lines.append(
                f"This holds for {some} only, and the error of the model is unknown: pass "
                "`uncertainty` to synthesise, or a measured P"
            )
        else:
            sure = (
                ", and the plant lies there with a probability of 99 %" if region.estimated else ""
            )
            lines.append(f"This holds for every stable linear plant within the radius{sure}")
        lines[-1] += (
            ". Conditions: trials start alike, disturbances repeat, and no actuator "
            "saturates. "
            + "; ".join(
                f"n = {self.noise.get(name, 0):.6g} bounds the non-repeating part of {name} in "
                "each sample, including noise"
                for name in self.limits
            )
        )
        return "\n".join(lines)

    def _promise_of(self, name):
        low, high = self.limits[name]
        stays, was = [], []
        for side, end, margin in (("below", high, " - 2 n"), ("above", low, " + 2 n")):
            if np.any(np.isfinite(end)):
                words = "its limit at each sample" if np.ndim(end) else f"{end:.6g}"
                stays.append(f"{side} {words}")
                was.append(stays[-1] + (margin if self.noise.get(name, 0) else ""))
        return (
            f"The measured {name} stays {' and '.join(stays)} in every trial that follows a trial "
            f"in which it was measured {' and '.join(was)}"
        )

    def __repr__(self):
        return self.promise


def _limit(name: str, ends) -> Limit:
    """Check the lowest and the highest value of an output.

    None stands for no limit.
    """
    if not (isinstance(ends, list | tuple | np.ndarray) and len(ends) == 2):
        raise ValueError(f"{name} = {reprlib.repr(ends)} must be two values, the lower limit first")
    low, high = (
        infinite if end is None else _end(name, end)
        for end, infinite in zip(ends, (-np.inf, np.inf), strict=True)
    )
    if np.ndim(low) and np.ndim(high) and len(low) != len(high):
        raise ValueError(
            f"{name} must have as many samples for the lower limit as for the "
            f"upper one, but has {len(low)} and {len(high)}"
        )
    if not np.all(low < high):
        raise ValueError(
            f"{name} = {reprlib.repr(ends)} must have a lower limit that is below the upper one"
        )
    return low, high


def _end(name, end):
    """Check one end of limits: a number, or one number for each sample."""
    end = np.asarray(end, dtype=float)
    if end.ndim > 1 or np.isnan(end).any():
        raise ValueError(
            f"{name} must hold None, a number, or one number for each sample, shape (time,)"
        )
    return end if end.ndim else float(end)
