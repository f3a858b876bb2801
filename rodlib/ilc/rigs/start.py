"""Where trials start: from the same state, or what is learned in one does not hold in the next."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rodlib.ilc.trials.diagnosis import noise_std

NEAR = 0.02  # of the largest reference in the same unit, that a start may be off
SURE = 5.0  # standard deviations of the noise, likewise
STILL = 0.1  # of a trial, in which outputs that are back stand still
LONGEST = 2.0  # trials, that is waited for this


@dataclass(frozen=True, eq=False)
class Start:
    """Where the first trial started, and how near is near enough."""

    level: np.ndarray  # of the outputs
    tolerance: np.ndarray
    samples: int  # of a trial
    outputs: Sequence[str]
    units: Sequence[str]

    @classmethod
    def of(cls, y, reference, outputs, units) -> "Start":
        """That of the first trial, from its outputs and its reference, shape (time, output)."""
        size = np.abs(reference).max(axis=0)
        shared = [
            max(size[j] for j, unit in enumerate(units) if unit == own) for own in units
        ]
        noise = SURE * np.sqrt(2) * noise_std(y)  # both starts have it
        return cls(y[0], NEAR * np.array(shared) + noise, len(y), outputs, units)

    @property
    def window(self) -> int:
        """Samples in which the outputs stand still."""
        return max(2, round(STILL * self.samples))

    @property
    def longest(self) -> int:
        """Samples that are waited for it."""
        return max(self.window, round(LONGEST * self.samples))

    def back(self, y, held) -> bool:
        """Whether outputs (time, output) are back, or where they are held instead, and stay."""
        y = np.asarray(y[-self.window :])
        if len(y) < self.window:
            return False
        half = len(y) // 2
        still = (
            np.abs(y[:half].mean(axis=0) - y[-half:].mean(axis=0)) <= self.tolerance / 2
        )
        off = np.minimum(
            *(np.abs(y.mean(axis=0) - level) for level in (self.level, held))
        )
        return bool(np.all(still & (off <= self.tolerance / 2)))

    def missed(self, y) -> str | None:
        """How far the outputs (time, output) of another trial start from there, in words."""
        off = np.abs(y[0] - self.level)
        far = np.flatnonzero(off > self.tolerance)
        if not far.size:
            return None
        each = (
            f"{off[i]:.3g} {self.units[i]}".rstrip() + f" in {self.outputs[i]}"
            for i in far
        )
        return (
            f"it starts {', '.join(each)} from where the first trial did: what is learned holds "
            "for one start. Wait for longer, by pause, or bring the rig back, by its begin"
        )
