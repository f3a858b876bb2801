"""Where trials start: from the same state, or what is learned in one does not hold in the next."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ilctools.loop.closed import Loop
from ilctools.trials.rms import noise_std
from ilctools.units import by_unit, with_unit

NEAR_START = 0.02  # of the largest reference in the same unit, that a start may be off
SURE = 5.0  # standard deviations of the noise, likewise


@dataclass(frozen=True, eq=False)
class Start:
    """Where the first trial started, and how near is near enough."""

    level: np.ndarray  # of the outputs
    tolerance: np.ndarray
    labels: Sequence[str]  # of the outputs, with their units

    @classmethod
    def of(cls, y, reference, loop: Loop) -> "Start":
        """That of the first trial, from its outputs and its reference, shape (time, output)."""
        noise = SURE * np.sqrt(2) * noise_std(y)  # both starts have it
        tolerance = NEAR_START * largest_by_unit(reference, loop) + noise
        labels = [with_unit(name, loop.units[name]) for name in loop.outputs]
        return cls(y[0], tolerance, labels)

    def near(self, y, held) -> bool:
        """Whether outputs, shape (output,), are there, or where they are held instead."""
        off = np.abs(y - [self.level, held]).min(axis=0)
        return bool(np.all(off <= self.tolerance))

    def missed(self, y) -> str:
        """How far the outputs (time, output) of another trial start from there, in words."""
        words = self._distance(y)
        return words and (
            f"it starts {words} from where the first trial did: what is learned holds for one "
            "start. Wait for longer, by pause, or bring the rig back, by its begin"
        )

    def away(self, reference) -> str:
        """How far the reference (time, output) of a trial that learns starts from there."""
        words = self._distance(reference)
        return words and (
            f"the reference starts {words} from where trials do, an error that no v mends: let it "
            "begin there"
        )

    def _distance(self, signal):
        off = np.abs(signal[0] - self.level)
        far = zip(self.labels, off, off > self.tolerance, strict=True)
        return ", ".join(f"{size:.3g} in {label}" for label, size, is_far in far if is_far)


def largest_by_unit(reference, loop: Loop) -> np.ndarray:
    """Largest reference (time, output) of all outputs in the same unit, for each output."""
    units, sizes = [loop.units[n] for n in loop.outputs], np.abs(reference).max(axis=0)
    groups = by_unit(units)
    return np.array([sizes[groups[unit]].max() for unit in units])
