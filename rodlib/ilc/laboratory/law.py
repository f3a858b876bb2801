"""The filters of the ILC law (23) in a file: from a design to :func:`rodlib.record`."""

import json

from rodlib.ilc import arguments
from rodlib.ilc.files import write_whole
from rodlib.ilc.filters import LearningFilter, ZeroPhaseButterworth
from rodlib.ilc.laboratory.log import read_json
from rodlib.ilc.laboratory.notes import (
    MISUNDERSTOOD,
    filter_of,
    learning_filter_of,
    notes_of_law,
)

FORMAT = "rodlib law 1"


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

    Raises
    ------
    ValueError
        If an argument is something else, or the filters have different sampling periods.
    """
    path = arguments.path("path", path)
    arguments.instance("Q", Q, ZeroPhaseButterworth)
    arguments.instance("L", L, LearningFilter)
    arguments.instance("note", note, str)
    arguments.one_period(Q=Q.Ts, L=L.Ts)
    content = {"format": FORMAT, "Ts": Q.Ts, **notes_of_law(Q, L), "note": note}
    write_whole(path, json.dumps(content, ensure_ascii=False, indent=1) + "\n")


def load_law(path) -> tuple[ZeroPhaseButterworth, LearningFilter]:
    """Read Q and L, as in ``record(rig, loop, *load_law(path), reference)``.

    Parameters
    ----------
    path : path-like
        Written by :func:`save_law`.

    Returns
    -------
    tuple of ZeroPhaseButterworth and LearningFilter

    Raises
    ------
    ValueError
        If the file is none of these, or cannot be understood; an OSError if it cannot be read.
    """
    path = arguments.path("path", path)
    try:
        content = read_json(path.read_text(encoding="utf-8"))
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']!r} is not {FORMAT!r}")
        L = learning_filter_of(content["L"], content["Ts"])
        return filter_of(content["Q"], content["Ts"]), arguments.instance("L", L, LearningFilter)
    except MISUNDERSTOOD as error:
        raise ValueError(f"path = {str(path)!r} is no law of save_law: {error!r}") from None
