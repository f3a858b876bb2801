"""The law as JSON: in the metadata of a log, and in a file of its own."""

import json
from dataclasses import replace

import control
import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.base import RegularisedInverse
from ilctools.errors import MISUNDERSTOOD, reading, shortened
from ilctools.files import read_json, regular, write_whole
from ilctools.filters import LearningFilter, ZeroPhaseButterworth
from ilctools.law.law import Law
from ilctools.law.limits import named_limits
from ilctools.loop.notes import loop_note, loop_of, read_note
from ilctools.signals import Signals, check_match

FORMATS = ("rodlib law 1", "rodlib law 2")  # of the file; the second if L looks back or has a base
DEFAULTS = {"rest": 0, "step": 1.0, "actuators": {}}  # step: the learning gain
KEYS = ("Q", "L", *DEFAULTS)
ROUNDING = 1e-12  # of the sections, on another machine
BEGUN = "begun"  # the note that says that v of trial 1 was given
RESET = "reset"  # the note that says that there was none between trials, NO_RESET
NO_RESET = "none: a trial starts where the last one ended"


def law_notes(law: Law) -> dict:
    """A law as what JSON can hold, to the last digit; without L where that has no coefficients."""
    Q, L = law.Q, law.L
    notes = {"Q": {"order": Q.order, "cutoff": Q.cutoff, "ends": Q.ends}}
    if L is None:
        notes["L"] = None
    elif isinstance(L, LearningFilter):
        notes["L"] = {"coefficients": L.coefficients.tolist(), "ends": L.ends}
        if L.first != 1 or L.base is not None:
            notes["L"] |= {"first": L.first, "base": L.base and _base_notes(L.base)}
    others = {"rest": law.rest, "step": law.gain, "actuators": law.limits or {}}
    return notes | {key: value for key, value in others.items() if value != DEFAULTS[key]}


def _law_from(notes, Ts):
    """The law that :func:`law_notes` noted."""
    notes = DEFAULTS | notes
    Q = ZeroPhaseButterworth(Ts=Ts, **_with_keys(notes["Q"], "order cutoff ends"))
    if (L := notes["L"]) is not None:
        _with_keys(L, "coefficients ends", "coefficients ends first base")
        L = LearningFilter(Ts=Ts, **L | {"base": _base_from(L.get("base"), Ts)})
    return Law(Q, L, notes["rest"], notes["step"], notes["actuators"])


def _with_keys(notes, *layouts):
    """Notes, if their keys are those of one of the layouts: others would be without effect."""
    if {*notes} not in [{*keys.split()} for keys in layouts]:
        raise ValueError(f"{sorted(notes)} must be the keys {' or '.join(layouts)}")
    return notes


def _base_notes(base):
    """B as what JSON can hold: the model that it is of, or its coefficients."""
    if isinstance(base, LearningFilter):
        return {"taps": base.coefficients.tolist(), "from": base.first}
    return {
        "b": base.b,
        "scale": base.scale.tolist(),
        "P": {name: getattr(base.P, name).tolist() for name in "ABCD"},
    }


def _base_from(notes, Ts):
    """The base that :func:`_base_notes` noted."""
    if notes is None:
        return None
    if "taps" in _with_keys(notes, "taps from", "b scale P"):
        return LearningFilter(notes["taps"], Ts, first=notes["from"])
    _with_keys(notes["P"], "A B C D")
    P = control.ss(*(notes["P"][name] for name in "ABCD"), Ts)
    return RegularisedInverse(P, notes["b"], notes["scale"])


def with_law(trials: xr.Dataset, law: Law) -> xr.Dataset:
    """Note in the metadata which law (23) made the trials, and around which loop."""
    texts = {key: json.dumps(n, ensure_ascii=False) for key, n in law_notes(law).items()}
    if law.loop is not None:
        texts["loop"] = loop_note(law.loop)
    return trials.assign_attrs(texts)


def law_of(trials: xr.Dataset) -> Law | None:
    """The law noted in the metadata of a log, bound to the loop if that is noted, too.

    None if Q or L are not noted; a LogError if the notes cannot be understood, or are those of
    other signals.

    See Also
    --------
    load_law : the law of a file of its own
    replay : what it makes of the log

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
    >>> law_of(run).rest
    3
    """

    arguments.instance("trials", trials, xr.Dataset)
    if not {"Q", "L"} <= trials.attrs.keys():
        return None
    loop = loop_of(trials)
    with reading("law"):
        notes = {key: read_json(trials.attrs[key]) for key in KEYS if key in trials.attrs}
        law = _law_from(notes, trials.attrs["Ts"])
        check_match(log=Signals.of_log(trials), law=law)
        arguments.whole("rest", law.rest, 0, trials.sizes["time"] - 1)
        return law if loop is None else law.bound_to(loop)


def limits_of(trials: xr.Dataset) -> dict[str, tuple[float, ...]]:
    """What each actuator follows, by the name of its command, as noted in the metadata."""

    def read(note):
        return named_limits("actuators", note, None, slew=True)

    return read_note(trials, "actuators", read) or {}


def save_law(path, law: Law, note: str = "") -> None:
    """Write a law to a file, to the last digit; a law that is there is replaced as a whole.

    Parameters
    ----------
    path : path-like
        JSON: ``format``, ``Ts`` (s), ``Q`` (order, cutoff in rad/s, ends), ``L`` (coefficients of
        shape (m, m, order), ends; if it looks back or has a base, first and base: taps and from,
        or b, scale and the model P), if they are not the defaults ``rest``, ``step`` (the learning
        gain) and ``actuators`` (the limits), ``note``; and, for other languages, ``sections``,
        the second-order sections b0, b1, b2, 1, a1, a2 of the forward half of Q: docs/law.c.
        Other keys, and sections that are not those of Q, are refused where it is read.
    law : Law
        L must be a LearningFilter. The loop is not written.
    note : str
        What made it, for those who read the file.

    See Also
    --------
    load_law : to read it
    law_of : the law of a log

    Examples
    --------
    >>> from ilctools import Law, LearningFilter, load_law, save_law, zero_phase_butterworth
    >>> law = Law(zero_phase_butterworth(2, 0.1, 1.0), LearningFilter([[[0.5]]], Ts=1.0))
    >>> save_law("law.json", law, note="tried on Monday")
    >>> load_law("law.json").L.coefficients
    array([[[0.5]]])
    """
    path = arguments.path("path", path)
    arguments.instance("L", arguments.instance("law", law, Law).L, LearningFilter)
    arguments.instance("note", note, str)
    if path.is_file():  # raw data, say
        try:
            load_law(path)
        except ValueError:
            raise ValueError(
                f"path = {str(path)!r} is a file that is no law: choose another name, or remove it"
            ) from None
    notes = law_notes(law)
    content = {"format": FORMATS["first" in notes["L"]], "Ts": law.Ts, **notes, "note": note}
    content["sections"] = law.Q.sections.tolist()
    write_whole(path, json.dumps(content, ensure_ascii=False, indent=1) + "\n")


def load_law(path) -> Law:
    """Read a law of :func:`save_law`, as in ``record(rig, loop, load_law(path), reference)``.

    See Also
    --------
    save_law : to write it
    law_of : the law of a log

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
        content = read_json(regular(path).read_text(encoding="utf-8"))
        _with_keys(DEFAULTS | content, "format Ts Q L rest step actuators note sections")
        if content["format"] != FORMATS["first" in content["L"]]:
            raise ValueError(f"format {content['format']!r} is none of {FORMATS}")
        law = _law_from(content, content["Ts"])
        own = law.Q.sections
        sections = arguments.array("sections", content["sections"], own.shape)
        if not np.allclose(sections, own, ROUNDING, [0, 0, 0, 0, ROUNDING, ROUNDING]):
            raise ValueError("sections are not those of Q, which save_law writes anew")
    except (OSError, *MISUNDERSTOOD) as error:
        raise ValueError(
            shortened(
                f"path = {str(path)!r} is not a law of save_law: {error!r}. The law of a log is "
                "ilctools.law_of(load_log(path))"
            )
        ) from None
    # {} stands for no limits; a file without any leaves them to the rig
    return law if law.limits else replace(law, limits=None)
