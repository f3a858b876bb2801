"""Loops and laws as JSON: notes in the metadata of a log, and the file of a law.

A *note* is a piece of JSON. The note of an excitation is made by
:mod:`ilctools.measurement.excitation`.
"""

import json
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial

import control
import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.base import RegularisedInverse
from ilctools.errors import MISUNDERSTOOD, reading, shortened
from ilctools.files import keep_others, regular, write_whole
from ilctools.filters import Composition, Filter, LearningFilter, ZeroPhaseButterworth
from ilctools.law.law import Law
from ilctools.law.limits import LimitsOf, named_limits
from ilctools.law.output_limits import OutputLimits
from ilctools.law.plant_region import PlantRegion
from ilctools.loop.closed import ClosedLoop, CurrentTrialLoop, Loop
from ilctools.norm_optimal import NormOptimal
from ilctools.pooled import isometry
from ilctools.response.scale import Scale
from ilctools.signals import Signals, check_match

# Formats of the file. For the second see `is_newer`. The third is for different numbers of inputs
# and outputs. The fourth has limits of outputs.
LAW_FORMATS = ("rodlib law 1", "rodlib law 2", "rodlib law 3", "rodlib law 4")
# Defaults, which are not written to a file or a log. The key step is the learning gain, and
# actuators are the limits. Without a note of limits, a law from a file takes the limits of the rig.
# A log without such a note had no limits.
OF_FILE = {"rest": 0, "step": 1.0, "actuators": LimitsOf.RIG, "outputs": None}
OF_LOG = OF_FILE | {"actuators": {}}
LAW_KEYS = ("Q", "L", *OF_LOG)
BEGUN = "begun"  # key of the note that v of trial 1 was passed, or is not zero
RESET = "reset"  # key of the note NO_RESET, that there was no reset between trials
BETWEEN = "between"  # key of the note of what made v when the reference changed, instead of the law
NO_RESET = "none: a trial starts where the last one ended"
PARTS_OF_MODEL = (*"ABCD", "dt")  # matrices of a model, and its sampling period


def read_note(trials: xr.Dataset, key: str, read: Callable):
    """Read the note `key` of a log by the function `read`.

    If there is no such note, return None.
    """
    if key not in trials.attrs:
        return None
    with reading(key):
        return read(json.loads(trials.attrs[key]))


def text_of(notes, indent: int | None = None) -> str:
    """Return notes as JSON text, with all digits of numbers."""
    return json.dumps(notes, ensure_ascii=False, indent=indent, default=_plain)


def _plain(part):
    """Convert an array or a model into values that JSON can hold."""
    if not isinstance(part, control.StateSpace):
        return part.tolist()
    values = {name: getattr(part, name) for name in PARTS_OF_MODEL}
    return values | {"inputs": part.input_labels, "outputs": part.output_labels}


def model_from(note):
    """Make a model from the note that :func:`text_of` wrote."""
    if note is None:
        return None
    values = (note[name] for name in PARTS_OF_MODEL)
    return control.ss(*values, inputs=note["inputs"], outputs=note["outputs"])


def _fields_of(value):
    """Return the fields of a dataclass by name; a model stays a model."""
    return {part.name: getattr(value, part.name) for part in fields(value)}


def loop_note(loop: CurrentTrialLoop | ClosedLoop) -> str:
    """Return the fields of a loop as JSON text."""
    note = _fields_of(loop)
    if isinstance(loop, ClosedLoop) and loop.one_for_one:  # as in notes before there was a choice
        del note["references"], note["learned"]
    return text_of(note)


def with_loop(trials: xr.Dataset, loop: Loop | None) -> xr.Dataset:
    """Write the loop into the metadata of trials, if :func:`loop_of` can read such a loop."""
    ours = isinstance(loop, CurrentTrialLoop | ClosedLoop)
    return trials.assign_attrs(loop=loop_note(loop)) if ours else trials


def loop_of(trials: xr.Dataset) -> Loop | None:
    """Return the loop that is noted in the metadata of a log, with all digits, or None.

    None means that the log has no note of a loop. Raises a LogError if the note cannot be
    understood, or if it is for other signals or units.
    """

    def read(note):
        kind, plant = (CurrentTrialLoop, "plant") if "plant" in note else (ClosedLoop, "P")
        loop = kind(**note | {plant: model_from(note[plant])})
        check_match(loop=loop, log=Signals.of_log(trials))
        return loop

    return read_note(trials, "loop", read)


def is_newer(note: str) -> bool:
    """Whether a note needs the second format.

    This is the case if L looks back, has a base, or is not a filter.
    """
    return '"first":' in note or '"samples":' in note


def law_notes(law: Law, usual: dict = OF_FILE) -> dict:
    """Return a law as a dict with the keys of the law's file.

    Values that equal those in `usual` are left out. An L of a class that :func:`save_law` cannot
    write is also left out.
    """
    Q, L = law.Q, law.L
    notes = {"Q": {"order": Q.order, "cutoff": Q.cutoff, "ends": Q.ends}}
    if L is None or isinstance(L, Filter):
        notes["L"] = L and _filter_note(L)
    if isinstance(L, NormOptimal):
        notes["L"] = _fields_of(L)
    kept = law.output_limits and _limits_note(law.output_limits)
    others = {"rest": law.rest, "step": law.gain, "actuators": law.limits, "outputs": kept}
    return notes | {key: value for key, value in others.items() if value != usual[key]}


def _limits_note(kept):
    """Return the note of limits of outputs and of plants with their radii, in units of `scale`."""
    limits = {
        name: [None if np.all(np.isinf(end)) else end for end in ends]
        for name, ends in kept.limits.items()
    }
    return {"limits": limits, "noise": kept.noise, "region": _fields_of(kept.region)}


def _limits_from(note):
    """Make limits of outputs from the note of :func:`_limits_note`.

    If there is no note, return None.
    """
    if note is None:
        return None
    region = note["region"]
    region |= {
        "models": tuple(map(model_from, region["models"])),
        "angles": arguments.row("angles", region["angles"]),
        "radii": arguments.array("radii", region["radii"], ("plants", "frequencies")),
        "scale": Scale(*(arguments.row("scale", size) for size in region["scale"])),
    }
    return OutputLimits(note["limits"], note["noise"], PlantRegion(**region))


def _filter_note(L):
    """Return the note of a filter.

    Keys of newer formats are written only if they are needed.
    """
    B, K = (L.B, L.K) if isinstance(L, Composition) else (None, L)
    note = {"coefficients": K.coefficients, "ends": K.ends}
    if K.first == 1 and B is None:
        return note
    note |= {"first": K.first, "base": B and _base_note(B)}
    return note | {"K_first": False} if B and not L.K_first else note


def _base_note(B):
    """Return the note of a base B, see :mod:`ilctools.base`.

    The matrix E of the base is written only if :func:`_stacked` would not give the same E.
    """
    note = {"b": B.b, "scale": B.scale, "P": B.P}
    if not np.array_equal(B.E, _stacked(B.P)):
        note["E"] = B.E
    return note if np.array_equal(B.scale_y, B.scale) else note | {"scale_y": B.scale_y}


def _stacked(P):
    """Return the matrix E of a base for stacked square models P.

    If P is not a stack of square models, return None.
    """
    copies, rest = divmod(P.noutputs, P.ninputs)
    return None if rest else isometry(copies, P.ninputs)


def _law_from(Ts, Q, L, rest, step, actuators, outputs):
    """Make a law from the notes that :func:`law_notes` wrote."""
    L, kept = None if L is None else _filter_from(Ts, **L), _limits_from(outputs)
    return Law(ZeroPhaseButterworth(Ts=Ts, **Q), L, rest, step, actuators, output_limits=kept)


def _filter_from(Ts, base=None, K_first=True, **taps):
    if "samples" in taps:
        return NormOptimal(**taps | {"P": model_from(taps["P"])})
    K = LearningFilter(Ts=Ts, **taps)
    if base is None:
        return K
    P = model_from(base["P"])
    B = RegularisedInverse(**{"E": _stacked(P)} | base | {"P": P})
    return Composition(B, K, arguments.flag("K_first", K_first))


def with_law(trials: xr.Dataset, law: Law) -> xr.Dataset:
    """Write into the metadata which law made the trials, and around which loop."""
    made = replace(law, limits=law.known_limits)  # limits of a rig hold on that rig alone
    texts = {key: text_of(note) for key, note in law_notes(made, OF_LOG).items()}
    return with_loop(trials.assign_attrs(texts), law.loop)


def law_of(trials: xr.Dataset) -> Law | None:
    """Return the law that is noted in the metadata of a log, or None if Q or L is not noted.

    If the log also notes its loop, the law is bound to this loop. Raises a LogError if the notes
    cannot be understood, or if they are for other signals.

    See Also
    --------
    load_law : reads a law from a file of its own
    replay : runs the law on the log

    Examples
    --------
    >>> import numpy as np
    >>> from ilctools import ClosedLoop, Law, LearningFilter, law_of, record, zero_phase_butterworth
    >>> class Axis:  # simulated; yours talks to the drive
    ...     x = 0.0
    ...     def begin(self, trial):
    ...         self.x = 0.0
    ...     def read(self):
    ...         return [self.x]
    ...     def apply(self, w):
    ...         self.x += 0.2 * (w[0] - self.x)
    ...
    >>> loop = ClosedLoop(Ts=0.01, outputs=["x"], units={"x": "mm"})
    >>> Q = zero_phase_butterworth(2, 60.0, loop.Ts)
    >>> law = Law(Q, LearningFilter([[[0.9]]], loop.Ts), rest=3)
    >>> run = record(Axis(), loop, law, np.ones((50, 1)), trials=1)
    >>> noted = law_of(run)
    >>> noted and noted.rest
    3
    """
    arguments.instance("trials", trials, xr.Dataset)
    if not {"Q", "L"} <= trials.attrs.keys():
        return None
    loop = loop_of(trials)
    with reading("law"):
        notes = {key: json.loads(trials.attrs[key]) for key in LAW_KEYS if key in trials.attrs}
        law = _law_from(trials.attrs["Ts"], **OF_LOG | notes)
        check_match(log=Signals.of_log(trials), law=law)
        return law if loop is None else law.bound_to(loop)


def limits_of(trials: xr.Dataset) -> dict[str, tuple[float, float]]:
    """Return the limits of each actuator, by the name of its command, as noted in the metadata."""
    read = partial(named_limits, "actuators", names=None)
    return read_note(trials, "actuators", read) or {}


def save_law(path, law: Law, note: str = "") -> None:
    """Write a law to a file, with all digits of its numbers.

    If the file already holds a law, the file is replaced as a whole.

    Parameters
    ----------
    path : path-like
        A JSON file, whose keys are listed in the notes.
    law : Law
        L must be a LearningFilter, the B K of a design, or a NormOptimal. The loop is not written.
    note : str
        How the law was made, for those who read the file.

    See Also
    --------
    load_law : reads the file
    law_of : returns the law of a log

    Notes
    -----
    The file has the keys ``format``, ``Ts`` (s), ``Q`` (order, cutoff in rad/s, ends), ``L`` and
    ``note``. The key ``L`` holds coefficients of shape (m, p, order), and ends. If L looks back, or
    has the form B K with a base B, ``L`` also holds first and base. The value of base is null, or
    b, scale and the model P.

    These keys are written if they differ from the defaults: ``rest``, ``step`` (the learning gain),
    ``actuators`` (the limits) and ``outputs``. The key ``outputs`` holds limits of outputs, noise,
    and the plants within their radii. The actuators {} stand for no limits at all. Without the key
    ``actuators``, the limits are the rig's. Other keys are refused when the file is read.

    For other languages, the key ``sections`` holds the second-order sections b0, b1, b2, 1, a1, a2
    of the forward half of Q, see docs/law.c. Only docs/law.c checks that the sections belong to Q.
    If you change Q by hand, save the law again.

    Examples
    --------
    >>> from ilctools import Law, LearningFilter, load_law, save_law, zero_phase_butterworth
    >>> law = Law(zero_phase_butterworth(2, 0.1, 1.0), LearningFilter([[[0.5]]], Ts=1.0))
    >>> save_law("law.json", law, note="tried on Monday")
    >>> load_law("law.json").Q == law.Q
    True
    """
    path = arguments.path("path", path)
    arguments.instance("L", arguments.instance("law", law, Law).L, Filter | NormOptimal)
    arguments.instance("note", note, str)
    notes = law_notes(law)
    number = is_newer(text_of(notes)) if law.rows == law.columns else 2
    number = 3 if law.output_limits else number
    content = {"format": LAW_FORMATS[number], "Ts": law.Ts, **notes, "note": note}
    text = text_of(content | {"sections": law.Q.sections}, indent=1) + "\n"
    keep_others(path, text[: text.index("law")])  # other files, such as raw data
    write_whole(path, text)


def load_law(path) -> Law:
    """Read a law from a file of :func:`save_law`.

    The law can be used as in ``record(rig, loop, load_law(path), reference)``.

    See Also
    --------
    save_law : writes the file
    law_of : returns the law of a log

    Examples
    --------
    >>> from ilctools import Law, LearningFilter, load_law, save_law, zero_phase_butterworth
    >>> Q = zero_phase_butterworth(2, 0.1, 1.0)
    >>> save_law("law.json", Law(Q, LearningFilter([[[0.5]]], 1.0)))
    >>> law = load_law("law.json")
    >>> law.Q.cutoff, law.Ts
    (0.1, 1.0)
    """
    path = arguments.path("path", path)
    try:
        content = json.loads(regular(path).read_text(encoding="utf-8"))
        content = {key: content[key] for key in content if key not in ("note", "sections")}
        arguments.choice("format", content.pop("format"), LAW_FORMATS)
        return _law_from(**OF_FILE | content)
    except (OSError, *MISUNDERSTOOD) as error:
        raise ValueError(
            shortened(
                f"path = {str(path)!r} is not a law saved by save_law: {error!r}. For the law "
                "of a log, call ilctools.law_of(load_log(path))"
            )
        ) from None
