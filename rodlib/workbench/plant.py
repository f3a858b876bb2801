"""A plant on the workbench: what filters are designed for, and what trials with them follow."""

from dataclasses import dataclass, field

import numpy as np

from ilctools import arguments, load_log, measured_response
from ilctools.logs.replay import replay
from ilctools.loop.closed import Loop
from ilctools.loop.notes import LogError, loop_of
from ilctools.measurement.excitation import excitation_of
from ilctools.problem.responses import Measured

TRIALS = 10
REST = 15  # samples


@dataclass(frozen=True, eq=False)
class Plant:
    """A loop or a measured response on the workbench, with the task of the ten trials.

    Attributes
    ----------
    source : str
        The Python expression that makes `response`, with `rodlib` and `np` at hand.
    response : CurrentTrialLoop, ClosedLoop, MeasuredResponse or another measured response
        What filters are designed for.
    reference : array_like, shape (time, m), optional
        Default: all outputs go to one and back, and rest.
    disturbance : array_like, shape (10, time, d), optional
        In the order of ``loop.disturbances``. Default: zero.
    choices : dict
        Settings to begin with, by name, where they are not the defaults of the synthesis.
    rest : int
        Samples at the end of a trial in which v is zero.
    """

    source: str
    response: Loop | Measured
    reference: np.ndarray | None = None
    disturbance: np.ndarray | None = None
    choices: dict = field(default_factory=dict)
    rest: int = REST

    def __post_init__(self):
        arguments.instance("source", self.source, str)
        arguments.instance("response", self.response, Loop | Measured)
        if self.loop is None:
            raise ValueError("response is a table without a period: control.frd(P, omega, Ts)")
        if not self.measured and self.loop.P is None:
            raise ValueError(
                "response has no P, for which filters are designed: measure it, by shake"
            )
        arguments.instance("choices", self.choices, dict)
        m, reference = len(self.loop.outputs), self.reference
        if reference is None:
            reference = np.repeat(_there_and_back()[:, None], m, axis=1)
        reference = arguments.array("reference", reference, ("time", m))
        rest = arguments.whole("rest", self.rest, 0, len(reference) - 1)
        disturbance = self.disturbance
        if disturbance is not None:
            shape = TRIALS, len(reference), len(self.loop.disturbances)
            disturbance = arguments.array("disturbance", disturbance, shape)
        vars(self).update(reference=reference, disturbance=disturbance, rest=rest)

    @property
    def measured(self) -> bool:
        """Whether the response was measured; it then has its own uncertainty."""
        return isinstance(self.response, Measured)

    @property
    def loop(self) -> Loop:
        """The loop; trials are simulated if it has a model P."""
        return self.response.loop if self.measured else self.response

    @property
    def unit(self) -> str:
        """The unit of the outputs, if they have one in common."""
        units = {self.loop.units[name] for name in self.loop.outputs}
        return units.pop() if len(units) == 1 else ""

    def frequency_response(self, omega) -> np.ndarray:
        """The nominal response at `omega` (rad/s), shape (n, m, m)."""
        if self.measured:
            return self.response.on(omega)[0]
        return self.response.frequency_response(omega)


def plant_of_file(path) -> Plant:
    """A recorded loop, with the task of its last trial; or what an excitation measured."""
    path = str(arguments.path("path", path))
    log, source = load_log(path), f"ilctools.load_log({path!r})"
    try:
        if excitation_of(log) is not None or loop_of(log) is None:
            return Plant(f"ilctools.measured_response({source})", measured_response(log))
        task = replay(log)
        return Plant(
            f"ilctools.replay({source}).loop",
            task.loop,
            reference=task.trials.reference.values[-1],
            disturbance=np.repeat(task.disturbance[-1:], TRIALS, axis=0),
            rest=0 if task.law is None else task.law.rest,
        )
    except ValueError as error:
        raise LogError(f"{path}: {error}") from None


def _there_and_back():
    """From zero to one and back within 950 samples, and 50 at rest."""
    return np.sin(np.pi * np.minimum(np.arange(1000) / 950, 1)) ** 2
