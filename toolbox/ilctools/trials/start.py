"""Check where trials start: with different initial states, learning from a trial does not help.

The module compares the first outputs and the first references of later trials with the outputs at
which the first trial started.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ilctools.loop.closed import Loop
from ilctools.trials.rms import noise_std
from ilctools.units import by_unit, with_unit

NEAR_START = 0.02  # allowed distance of a start, as a share of the largest reference in its unit
SURE = 5.0  # the distance may be larger by so many standard deviations of the noise


@dataclass(frozen=True, eq=False)
class Start:
    """Where the first trial started, and how near another start must be."""

    level: np.ndarray  # values of the outputs
    tolerance: np.ndarray
    labels: Sequence[str]  # names of the outputs, with their units

    @classmethod
    def of(cls, y, reference, loop: Loop) -> "Start":
        """Take the start of the first trial from its outputs and its reference.

        Both signals have the shape (time, output).
        """
        noise = SURE * np.sqrt(2) * noise_std(y)  # both starts are noisy
        tolerance = NEAR_START * largest_by_unit(reference, loop) + noise
        labels = [with_unit(name, loop.units[name]) for name in loop.outputs]
        return cls(y[0], tolerance, labels)

    def near(self, y, held) -> bool:
        """Whether outputs, shape (output,), are near the first start, or near the values `held`."""
        off = np.abs(y - [self.level, held]).min(axis=0)
        return bool(np.all(off <= self.tolerance))

    def missed(self, y) -> str:
        """Say in words how far the outputs (time, output) of another trial are from this start."""
        words = self._distance(y)
        return words and (
            f"this trial starts {words} away from where the first trial started, but the "
            "learned v holds for one start only: wait for longer, by pause, or bring the rig "
            "back, by its begin"
        )

    def away(self, reference) -> str:
        """Say in words how far the reference (time, output) of a trial begins from this start."""
        words = self._distance(reference)
        return words and (
            f"the reference starts {words} away from where trials start, which is an error "
            "that no v can remove: let the reference begin where trials start"
        )

    def _distance(self, signal):
        off = np.abs(signal[0] - self.level)
        far = zip(self.labels, off, off > self.tolerance, strict=True)
        return ", ".join(f"{size:.3g} in {label}" for label, size, is_far in far if is_far)


def largest_by_unit(reference, loop: Loop) -> np.ndarray:
    """For each output, return the largest reference (time, output) of all outputs in its unit."""
    units, sizes = [loop.units[n] for n in loop.outputs], np.abs(reference).max(axis=0)
    groups = by_unit(units)
    return np.array([sizes[groups[unit]].max() for unit in units])
