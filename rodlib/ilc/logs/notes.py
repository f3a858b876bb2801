"""What made the trials, as JSON: the law or the excitation, and the loop.

All of it is noted in the metadata of a log; a law stands in a file of its own, too.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields

import control
import numpy as np
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.files import read_json, write_whole
from rodlib.ilc.filters import (
    LearningFilter,
    LearningOperator,
    ZeroPhaseButterworth,
    check_Q,
)
from rodlib.ilc.law.actuators import named_limits
from rodlib.ilc.logs.format import LogError
from rodlib.ilc.loop.closed import ClosedLoop, CurrentTrialLoop, Loop, check_loop
from rodlib.ilc.measurement.excitation import Excitation

FORMAT = "rodlib law 1"  # of the file
LAW = ("Q", "L", "rest", "step", "actuators")  # the keys of the notes of a law
MADE_BY = (*LAW, "excitation", "loop")  # and of all
EARLIER, BEGUN = (
    "earlier laws",
    "begun",
)  # laws that held before; whether v of trial 1 was given
MISUNDERSTOOD = (
    KeyError,
    TypeError,
    ValueError,
    RecursionError,
)  # what a note may lead to


def with_law(
    trials: xr.Dataset,
    Q: ZeroPhaseButterworth,
    L: LearningOperator | None,
    rest: int = 0,
    loop: Loop | None = None,
    step: float = 1.0,
    followed: Mapping[str, tuple[float, ...]] | None = None,
) -> xr.Dataset:
    """Note which ILC law (23) made the trials, around which loop, and within which limits.

    Of L, only coefficients.
    """
    arguments.instance("trials", trials, xr.Dataset)
    check_Q(Q)
    if L is not None:
        arguments.instance("L", L, LearningOperator)
    named = L is None or isinstance(L, LearningFilter)
    law = notes_of_law(Q, L if named else None)
    notes = {
        name: json.dumps(note) for name, note in law.items() if named or name != "L"
    }
    if rest := arguments.whole("rest", rest, 0):
        notes["rest"] = json.dumps(rest)
    if (step := arguments.share("step", step)) != 1:
        notes["step"] = json.dumps(step)
    if loop is not None:
        notes["loop"] = _note_of(check_loop(loop))
    names = [] if loop is None else loop.commands
    followed = named_limits("followed", followed, names, rated=True)
    return trials.assign_attrs(notes | _note_of_actuators(followed))


def _note_of_actuators(followed):
    return {"actuators": json.dumps(followed, ensure_ascii=False)} if followed else {}


def with_excitation(
    trials: xr.Dataset,
    excitation: Excitation,
    loop: Loop,
    followed: Mapping[str, tuple[float, ...]] | None = None,
) -> xr.Dataset:
    """Note which excitation made the trials, of which loop, and what its actuators follow."""
    notes = {"excitation": json.dumps(asdict(excitation)), "loop": _note_of(loop)}
    return trials.assign_attrs(notes | _note_of_actuators(followed))


def _noted(trials, key, read: Callable, default=None):
    """What `read` makes of the note `key` of a log; `default` if it is not there."""
    arguments.instance("trials", trials, xr.Dataset)
    if key not in trials.attrs:
        return default
    try:
        return read(read_json(trials.attrs[key]))
    except MISUNDERSTOOD as error:
        raise LogError(f"metadata: {key} cannot be understood: {error!r}") from None


def actuators_of(trials: xr.Dataset) -> dict[str, tuple[float, ...]]:
    """What each actuator follows, by the name of its command, of those that are noted."""

    def read(note):
        loop = loop_of(trials)
        names = trials.control.values.tolist() if "control" in trials.coords else []
        names += [] if loop is None else [n for n in loop.commands if n not in names]
        return named_limits("actuators", note, names, rated=True)

    return _noted(trials, "actuators", read, {})


def excitation_of(trials: xr.Dataset) -> Excitation | None:
    """The excitation noted in the metadata of a log; None if it does not say."""

    def read(note):
        excitation = Excitation(**note)
        arguments.one_period(log=trials.attrs["Ts"], excitation=excitation.Ts)
        return excitation

    return _noted(trials, "excitation", read)


def law_of(
    trials: xr.Dataset,
) -> tuple[ZeroPhaseButterworth, LearningFilter | None] | None:
    """The filters Q and L noted in the metadata of a log; None if it does not say."""

    def read(note):
        L = _learning_filter_of(note, trials.attrs["Ts"])
        if L is not None:
            m = trials.sizes["channel"]
            arguments.array("coefficients", L.coefficients, (m, m, "order"))
        return L

    Q = _noted(trials, "Q", lambda note: _filter_of(note, trials.attrs["Ts"]))
    L = _noted(trials, "L", read)
    return None if Q is None or "L" not in trials.attrs else (Q, L)


def notes_of_law(Q: ZeroPhaseButterworth, L: LearningFilter | None) -> dict:
    """Q and L as what JSON can hold, to the last digit."""
    return {
        "Q": {"order": Q.order, "cutoff": Q.cutoff, "ends": Q.ends},
        "L": L and {"coefficients": L.coefficients.tolist(), "ends": L.ends},
    }


def _filter_of(note: Mapping, Ts) -> ZeroPhaseButterworth:
    return ZeroPhaseButterworth(note["order"], note["cutoff"], Ts, note["ends"])


def _learning_filter_of(note: Mapping | None, Ts) -> LearningFilter | None:
    return (
        None if note is None else LearningFilter(note["coefficients"], Ts, note["ends"])
    )


def rest_of(trials: xr.Dataset) -> int:
    """Samples at the end of a trial in which v was held at zero, as noted in the metadata."""
    arguments.instance("trials", trials, xr.Dataset)
    longest = trials.sizes.get("time", 1) - 1
    return _noted(
        trials, "rest", lambda note: arguments.whole("rest", note, 0, longest), 0
    )


def step_of(trials: xr.Dataset) -> float:
    """The step of :func:`rodlib.update` from each trial to the next, as noted in the metadata."""
    return _noted(trials, "step", lambda note: arguments.share("step", note), 1.0)


def earlier_laws_of(trials: xr.Dataset) -> list[tuple[int, xr.Dataset]]:
    """The laws that held before another one, each by its notes, and up to which trial."""

    def read(note):
        laws = []
        for law in note:
            until = arguments.whole("trials", law["trials"], 1)
            notes = {key: json.dumps(law[key]) for key in LAW if key in law}
            kept = {key: n for key, n in trials.attrs.items() if key not in LAW}
            laws.append(
                (until, trials.assign_attrs().drop_attrs().assign_attrs(kept | notes))
            )
        return laws

    return _noted(trials, EARLIER, read, [])


def loop_of(trials: xr.Dataset) -> Loop | None:
    """The loop noted in the metadata of a log, to the last digit; None if it does not say.

    If the note cannot be understood, or is that of other signals or units, a LogError says so.
    """

    def read(note):
        kind, key = (
            (CurrentTrialLoop, "plant") if "plant" in note else (ClosedLoop, "P")
        )
        loop = kind(**note | {key: _model_of(key, note[key])})
        arguments.one_period(log=trials.attrs["Ts"], loop=loop.Ts)
        return loop

    loop = _noted(trials, "loop", read)
    if loop is None:
        return None
    for role, names in (
        ("output", loop.outputs),
        ("control", loop.controls),
        ("source", ()),
    ):
        own = trials[role].values.tolist() if role in trials.coords else []
        if role != "source" and names != own:
            raise LogError(f"metadata: loop has the {role}s {names}, but the log {own}")
        units = trials[f"{role}_unit"].values.tolist() if own else []
        for name, unit in zip(own, units, strict=True):
            wanted = loop.units.get(name, "")
            if wanted and unit and wanted != unit:  # an empty one is not known
                raise LogError(
                    f"metadata: loop has {name} in {wanted!r}, but the log in {unit!r}"
                )
    return loop


def _note_of(loop):
    parts = {part.name: getattr(loop, part.name) for part in fields(loop)}
    for key, part in parts.items():
        if isinstance(part, control.StateSpace):
            names = {"inputs": part.input_labels, "outputs": part.output_labels}
            parts[key] = (
                {name: getattr(part, name) for name in "ABCD"} | {"dt": part.dt} | names
            )
    return json.dumps(parts, ensure_ascii=False, default=np.ndarray.tolist)


def _model_of(key, note):
    """A model that :func:`_note_of` noted."""
    if note is None:
        return None
    A, B, C, D = (
        arguments.array(f"{key}.{name}", note[name], (...,)) for name in "ABCD"
    )
    names = {"inputs": note["inputs"], "outputs": note["outputs"]}
    return control.ss(A, B, C, D, note["dt"], **names)


def save_law(path, Q: ZeroPhaseButterworth, L: LearningFilter, note: str = "") -> None:
    """Write Q and L to a file, to the last digit; it is replaced as a whole or not at all.

    Parameters
    ----------
    path : path-like
        JSON: ``format``, ``Ts`` (s), ``Q`` (order, cutoff in rad/s, ends), ``L`` (coefficients of
        shape (m, m, order), ends) and ``note``.
    Q, L : ZeroPhaseButterworth, LearningFilter
    note : str
        What made them, for those who read the file.
    """
    path = arguments.path("path", path)
    check_Q(Q)
    arguments.instance("L", L, LearningFilter)
    arguments.instance("note", note, str)
    arguments.one_period(Q=Q.Ts, L=L.Ts)
    content = {"format": FORMAT, "Ts": Q.Ts, **notes_of_law(Q, L), "note": note}
    write_whole(path, json.dumps(content, ensure_ascii=False, indent=1) + "\n")


def load_law(path) -> tuple[ZeroPhaseButterworth, LearningFilter]:
    """Read Q and L of :func:`save_law`, as in ``record(rig, loop, *load_law(path), reference)``."""
    path = arguments.path("path", path)
    text = path.read_text(encoding="utf-8")
    if text.startswith("#"):
        raise ValueError(
            f"path = {str(path)!r} is no law but a table: of a trial log, its law is "
            "rodlib.ilc.law_of(load_log(path))"
        )
    try:
        content = read_json(text)
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']!r} is not {FORMAT!r}")
        L = _learning_filter_of(content["L"], content["Ts"])
        return _filter_of(content["Q"], content["Ts"]), arguments.instance(
            "L", L, LearningFilter
        )
    except MISUNDERSTOOD as error:
        raise ValueError(
            f"path = {str(path)!r} is no law of save_law: {error!r}"
        ) from None
