"""What made the trials, noted in the metadata as JSON: the law or the excitation, the loop."""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from types import MappingProxyType

import control
import numpy as np
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.filters import (
    LearningFilter,
    LearningOperator,
    ZeroPhaseButterworth,
    zero_phase_butterworth,
)
from rodlib.ilc.laboratory import actuators
from rodlib.ilc.laboratory import units as pints
from rodlib.ilc.laboratory.excitation import Excitation
from rodlib.ilc.laboratory.layout import read_json
from rodlib.ilc.laboratory.tables import LogError
from rodlib.ilc.loop import CurrentTrialLoop

MADE_BY = ("Q", "L", "rest", "step", "excitation", "loop")  # the keys of all notes
MISUNDERSTOOD = (KeyError, TypeError, ValueError, RecursionError)  # what a note may lead to


def with_law(
    trials: xr.Dataset,
    Q: ZeroPhaseButterworth,
    L: LearningOperator | None,
    rest: int = 0,
    loop: CurrentTrialLoop | None = None,
    step: float = 1.0,
) -> xr.Dataset:
    """Note in the metadata which ILC law (23) made the trials, and around which loop.

    `rest` is the number of samples at the end of a trial in which v was held at zero, `step` the
    share of the way that v went, both as in :func:`rodlib.update`. Of a learning operator that is
    no :class:`rodlib.LearningFilter` nothing is noted.
    """
    arguments.instance("trials", trials, xr.Dataset)
    arguments.instance("Q", Q, ZeroPhaseButterworth)
    if L is not None:
        arguments.instance("L", L, LearningOperator)
    law = notes_of_law(Q, L if isinstance(L, LearningFilter) else None)
    if L is not None and not isinstance(L, LearningFilter):
        del law["L"]
    notes = {name: json.dumps(note) for name, note in law.items()}
    rest = arguments.whole("rest", rest, 0)
    if rest:
        notes["rest"] = json.dumps(rest)
    step = arguments.share("step", step)
    if step != 1:
        notes["step"] = json.dumps(step)
    if loop is not None:
        notes["loop"] = _note_of(arguments.instance("loop", loop, CurrentTrialLoop))
    return trials.assign_attrs(notes)


def with_excitation(
    trials: xr.Dataset,
    excitation: Excitation,
    loop: CurrentTrialLoop,
    limits: Mapping[str, list[float]] = MappingProxyType({}),
) -> xr.Dataset:
    """Note in the metadata which excitation made the trials, one experiment each, of which loop.

    `limits` are the lowest and highest command that an actuator follows, by name.
    """
    notes = {"excitation": json.dumps(asdict(excitation)), "loop": _note_of(loop)}
    if limits:
        notes["actuators"] = json.dumps(dict(limits), ensure_ascii=False)
    return trials.assign_attrs(notes)


def actuators_of(trials: xr.Dataset) -> dict[str, list[float]]:
    """Limits of the actuators, by name, as noted in the metadata; those it does not say, left out.

    Raises
    ------
    LogError
        If the note is there but cannot be understood.
    """
    try:
        note = read_json(trials.attrs.get("actuators", "{}"))
        return actuators.checked("actuators", note, trials.control.values.tolist())
    except MISUNDERSTOOD as error:
        raise LogError(f"metadata: actuators cannot be understood: {error}") from None


def excitation_of(trials: xr.Dataset) -> Excitation | None:
    """The excitation noted in the metadata of a log; None if it does not say.

    Raises
    ------
    LogError
        If the note is there but cannot be understood, or is that of other trials.
    """
    if "excitation" not in trials.attrs:
        return None
    try:
        excitation = Excitation(**read_json(trials.attrs["excitation"]))
        arguments.one_period(log=trials.attrs["Ts"], excitation=excitation.Ts)
    except MISUNDERSTOOD as error:
        raise LogError(f"metadata: excitation cannot be understood: {error!r}") from None
    return excitation


def law_of(trials: xr.Dataset) -> tuple[ZeroPhaseButterworth, LearningFilter | None] | None:
    """The filters Q and L noted in the metadata of a log; None if it does not say.

    Raises
    ------
    LogError
        If the notes are there but cannot be understood, or L is for another number of channels.
    """
    arguments.instance("trials", trials, xr.Dataset)
    if "Q" not in trials.attrs or "L" not in trials.attrs:
        return None
    try:
        m = trials.sizes["channel"]
        notes = {name: read_json(trials.attrs[name]) for name in "QL"}
        Q, L = law_of_notes(notes, trials.attrs["Ts"])
        if L is not None:
            arguments.array("coefficients", L.coefficients, (m, m, "order"))
        return Q, L
    except MISUNDERSTOOD as error:
        raise LogError(f"metadata: Q or L cannot be understood: {error!r}") from None


def notes_of_law(Q: ZeroPhaseButterworth, L: LearningFilter | None) -> dict:
    """Q and L as what JSON can hold, to the last digit."""
    return {
        "Q": {"order": Q.order, "cutoff": Q.cutoff, "ends": Q.ends},
        "L": L and {"coefficients": L.coefficients.tolist(), "ends": L.ends},
    }


def law_of_notes(notes: Mapping, Ts) -> tuple[ZeroPhaseButterworth, LearningFilter | None]:
    """The filters of such notes; one of :data:`MISUNDERSTOOD` if they are none."""
    Q, L = notes["Q"], notes["L"]
    Q = zero_phase_butterworth(Q["order"], Q["cutoff"], Ts, ends=Q["ends"])
    return Q, None if L is None else LearningFilter(L["coefficients"], Ts, L["ends"])


def rest_of(trials: xr.Dataset) -> int:
    """Samples at the end of a trial in which v was held at zero, as noted in the metadata.

    Raises
    ------
    LogError
        If the note is no whole number below the length of a trial.
    """
    arguments.instance("trials", trials, xr.Dataset)
    try:
        note = read_json(trials.attrs.get("rest", "0"))
        return arguments.whole("rest", note, 0, trials.sizes.get("time", 1) - 1)
    except MISUNDERSTOOD as error:
        raise LogError(f"metadata: rest cannot be understood: {error}") from None


def step_of(trials: xr.Dataset) -> float:
    """The step of :func:`rodlib.update` from each trial to the next, as noted in the metadata.

    Raises
    ------
    LogError
        If the note is no number in (0, 1].
    """
    arguments.instance("trials", trials, xr.Dataset)
    try:
        return arguments.share("step", read_json(trials.attrs.get("step", "1")))
    except MISUNDERSTOOD as error:
        raise LogError(f"metadata: step cannot be understood: {error}") from None


def loop_of(trials: xr.Dataset) -> CurrentTrialLoop | None:
    """The loop noted in the metadata of a log, to the last digit; None if it does not say.

    Raises
    ------
    LogError
        If the note is there but cannot be understood, or is that of other signals.
    """
    arguments.instance("trials", trials, xr.Dataset)
    if "loop" not in trials.attrs:
        return None
    try:
        note = read_json(trials.attrs["loop"])
        loop = CurrentTrialLoop(**note | {"plant": _rebuilt(note["plant"])})
        names = (loop.outputs, loop.controls)
        arguments.one_period(log=trials.attrs["Ts"], loop=loop.Ts)
        other = _in_other_units(trials, loop.units)
    except MISUNDERSTOOD as error:
        raise LogError(f"metadata: loop cannot be understood: {error!r}") from None
    recorded = (trials.output.values.tolist(), trials.control.values.tolist())
    if names != recorded:
        raise LogError(f"metadata: loop has the signals {names}, but the log {recorded}")
    if other:
        raise LogError(f"metadata: loop has other units than the log: load it with units={other}")
    return loop


def _in_other_units(trials, units):
    """Those of `units` that are not the log's; an empty one is not known, and may be any."""
    other = {}
    for role in ("output", "control", "source"):
        if role in trials.coords:
            names, own = trials[role].values.tolist(), trials[f"{role}_unit"].values.tolist()
            for name, unit in zip(names, own, strict=True):
                wanted = units.get(name, "")
                if wanted and unit and pints.unit(name, wanted) != pints.unit(name, unit):
                    other[name] = wanted
    return other


def _note_of(loop):
    parts = {part.name: _plain(getattr(loop, part.name)) for part in fields(loop)}
    return json.dumps(parts, ensure_ascii=False)


def _plain(part):
    if isinstance(part, control.StateSpace):
        matrices = {name: getattr(part, name).tolist() for name in "ABCD"}
        return matrices | {
            "dt": part.dt, "inputs": part.input_labels, "outputs": part.output_labels
        }  # fmt: skip
    return part.tolist() if isinstance(part, np.ndarray) else part


def _rebuilt(plant):
    A, B, C, D = (arguments.array(f"plant.{name}", plant[name], (...,)) for name in "ABCD")
    return control.ss(A, B, C, D, plant["dt"], inputs=plant["inputs"], outputs=plant["outputs"])
