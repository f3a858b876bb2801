"""A plant on the workbench: what filters are designed for, and what trials with them follow."""

from dataclasses import dataclass, field

import numpy as np

from ilctools import arguments
from ilctools.loop.closed import Loop

TRIALS = 10


@dataclass(frozen=True, eq=False)
class Plant:
    """A loop on the workbench, with the task of the ten trials.

    Attributes
    ----------
    source : str
        The Python expression that makes `loop`, with `ilctools`, `rodlib` and `np` at hand.
    loop : CurrentTrialLoop or ClosedLoop
        What filters are designed for; with a model P.
    reference : array_like, shape (time, m), optional
        Default: within 950 samples all outputs go to one and back, and rest for 50.
    disturbance : array_like, shape (10, time, d), optional
        In the order of ``loop.disturbances``. Default: zero.
    choices : dict
        Settings to begin with, by name, where they are not the defaults of the synthesis.
    rest : int
        Samples at the end of a trial in which v is zero.
    """

    source: str
    loop: Loop
    reference: np.ndarray | None = None
    disturbance: np.ndarray | None = None
    choices: dict = field(default_factory=dict)
    rest: int = 15

    def __post_init__(self):
        arguments.instance("source", self.source, str)
        m = len(arguments.instance("loop", self.loop, Loop).outputs)
        if self.loop.P is None:
            raise ValueError("loop has no P, for which filters are designed: measure it, by shake")
        reference, disturbance = self.reference, self.disturbance
        if reference is None:
            phase = np.minimum(np.arange(1000) / 950, 1)
            reference = np.repeat(np.sin(np.pi * phase)[:, None] ** 2, m, axis=1)
        reference = arguments.array("reference", reference, ("time", m))
        if disturbance is not None:
            shape = TRIALS, len(reference), len(self.loop.disturbances)
            disturbance = arguments.array("disturbance", disturbance, shape)
        arguments.whole("rest", self.rest, 0, len(reference) - 1)
        vars(self).update(reference=reference, disturbance=disturbance)

    @property
    def unit(self) -> str:
        """The unit of the outputs, if they have one in common."""
        units = {self.loop.units[name] for name in self.loop.outputs}
        return units.pop() if len(units) == 1 else ""
