"""Plants on the workbench: what filters are designed for, and what their trials follow."""

import ast
import reprlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rodlib.ilc import LogError, arguments, load_log, measured_response, read_table
from rodlib.ilc.logs.notes import excitation_of, loop_of
from rodlib.ilc.logs.replay import replay
from rodlib.ilc.loop.closed import Loop
from rodlib.ilc.problem.problem import Problem
from rodlib.ilc.problem.responses import Measured

TRIALS = 10
REST = 15  # samples, of a trial whose reference ends at rest


@dataclass(frozen=True, eq=False)
class Plant:
    """What filters are designed for, and what ten trials with them follow."""

    source: (
        str  # the Python expression that makes `response`, with rodlib and np at hand
    )
    response: Loop | Measured  # what the synthesis is given
    reference: np.ndarray | None = (
        None  # shape (time, m); default: all to one, back, and a rest
    )
    disturbance: np.ndarray | None = (
        None  # shape (10, time, d), as loop.disturbances; default zero
    )
    order: int = (
        Problem.order
    )  # samples to look ahead at first; more than the plant's delay
    rest: int | None = (
        None  # samples at the end in which v is zero; default none, but with the
    )
    # default reference

    def __post_init__(self):
        arguments.instance("source", self.source, str)
        if not isinstance(self.response, Loop | Measured):
            raise ValueError(
                f"response = {reprlib.repr(self.response)} must be a loop, such as "
                "current_trial_loop makes, or a measured response"
            )
        if self.loop is None:
            raise ValueError(
                "response is a table without a period: control.frd(P, omega, Ts)"
            )
        if not self.measured and self.loop.P is None:
            raise ValueError(
                "response has no P, for which filters are designed: measure it, by shake"
            )
        arguments.whole("order", self.order, 1)
        m = len(self.loop.outputs)
        reference = self.reference
        rest = (REST if reference is None else 0) if self.rest is None else self.rest
        if reference is None:
            there_and_back = np.sin(np.pi * np.minimum(np.arange(1000) / 950, 1)) ** 2
            reference = np.repeat(there_and_back[:, None], m, axis=1)
        reference = arguments.array("reference", reference, ("time", m))
        object.__setattr__(self, "reference", reference)
        object.__setattr__(
            self, "rest", arguments.whole("rest", rest, 0, len(reference) - 1)
        )
        if self.disturbance is not None:
            shape = (TRIALS, len(reference), len(self.loop.disturbances))
            disturbance = arguments.array("disturbance", self.disturbance, shape)
            object.__setattr__(self, "disturbance", disturbance)

    @property
    def measured(self) -> bool:
        """Whether the response was measured, and brings a radius of its own."""
        return isinstance(self.response, Measured)

    @property
    def loop(self) -> Loop:
        """The loop whose model the trials are simulated with, if it has one."""
        return self.response.loop if self.measured else self.response

    @property
    def unit(self) -> str:
        """The unit of the outputs, if they have one in common."""
        units = {self.loop.units[name] for name in self.loop.outputs}
        return units.pop() if len(units) == 1 else ""

    def size(self, omega) -> np.ndarray:
        """||P||, the largest singular value, at `omega` (rad/s)."""
        known = self.response
        P = known.on(omega)[0] if self.measured else known.frequency_response(omega)
        return np.linalg.norm(P, 2, axis=(1, 2))


@dataclass(frozen=True, eq=False)
class Family:
    """Plants that differ in a few numbers, each of which gets a knob."""

    make: Callable[..., Plant]  # of the parameters, by keyword
    parameters: dict[
        str, tuple[float, str]
    ]  # by name: what each is at first, and its unit


def plant_of_file(path, columns: str = "") -> Plant:
    """A loop that was recorded, with its last trial again; any other record, as measured.

    Of a table, `columns` is what :func:`rodlib.read_table` is told beside the path, as Python, such
    as ``time="t", outputs={"T1": "Temperature"}``; a log needs none.
    """
    path = str(arguments.path("path", path))
    if arguments.instance("columns", columns, str).strip():
        source = f"rodlib.read_table({path!r}, {columns.strip()})"
        try:
            log = read_table(path, **_keywords(columns))
        except (
            TypeError,
            SyntaxError,
        ) as error:  # of keywords that it has not, or is not given
            raise ValueError(
                f"columns = {columns!r} cannot be understood: {error}"
            ) from None
    else:
        log, source = load_log(path), f"rodlib.load_log({path!r})"
    try:
        if excitation_of(log) is not None or loop_of(log) is None:
            return Plant(f"rodlib.measured_response({source})", measured_response(log))
        replayed = replay(log)
        again = np.repeat(replayed.disturbance[-1:], TRIALS, axis=0)
        reference = replayed.trials.reference.values[-1]
        source = f"rodlib.loop_of({source})"
        return Plant(
            source,
            replayed.loop,
            reference,
            again,
            rest=replayed.law.rest if replayed.law else 0,
        )
    except ValueError as error:
        raise LogError(f"{path}: {error}") from None


def _keywords(text):
    """What a call is told by keyword; nothing is called."""
    call = ast.parse(f"read_table({text.strip()})", mode="eval").body
    if (
        not isinstance(call, ast.Call)
        or call.args
        or any(k.arg is None for k in call.keywords)
    ):
        raise SyntaxError('write time="...", outputs={"...": "..."}')
    try:
        return {
            keyword.arg: ast.literal_eval(keyword.value) for keyword in call.keywords
        }
    except ValueError:
        raise SyntaxError("each must be a text, a number or a dict of them") from None
