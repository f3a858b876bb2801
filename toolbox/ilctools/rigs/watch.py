"""Warnings after a trial on a rig."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from ilctools.law.limits import CUT_OFF, commands_beyond
from ilctools.rigs.description import RigDescription
from ilctools.trials.diagnosis import diagnose
from ilctools.trials.learn import Part
from ilctools.trials.start import Start
from ilctools.warn import warn

OF_RIG = (  # what follows for the law if a rig has limits that the law does not know
    "; the rig saturated them, but the law does not know these limits: state them as limits of "
    "the law"
)
LATE_SAMPLE = 0.1  # sampling periods that a sample may be late or early
EACH_TRIAL = {"pause", "clock", "rig"}  # kinds of warnings in each trial; other kinds come once


def warn_once(texts: dict[str, str], kinds_warned_of: set[str]) -> None:
    """Give each warning that has a text, but most kinds of warnings only once.

    The kinds that were given are kept in `kinds_warned_of`.
    """
    for kind, text in texts.items():
        if text and kind not in kinds_warned_of:
            warn(text)
            kinds_warned_of |= {kind} - EACH_TRIAL


def start_of(about: RigDescription, first: Part) -> Start:
    """Return where the first trial started."""
    return Start.of(first["y"], first["reference"], about.loop)


def warnings_of(
    about: RigDescription, log: xr.Dataset, trials: Sequence[Part], late: Sequence[float]
) -> dict[str, str]:
    """Collect the warnings after the last of these trials, by kind.

    A kind without a warning has the text "". `late` has the number of seconds by which each sample
    of the last trial was early or late.
    """
    number, texts = len(trials), _beyond_limits(about, trials[-1])
    if about.law is not None:
        texts |= diagnose(log, about.law, first=number)
        texts["start"] = _another_start(about, trials)
    if off := [seconds for seconds in late if seconds > LATE_SAMPLE * about.Ts]:
        texts["clock"] = (
            f"{len(off)} samples were not on time; the largest deviation was {max(off):.3g} s"
        )
    return {kind: text and f"after trial {number}: {text}" for kind, text in texts.items()}


def _beyond_limits(about, trial):
    """State which commands exceed the limits of the law, or else the limits of the rig.

    If the limits are the rig's, the text adds that the law does not know these limits.
    """
    kind, limits, then = "rig", about.limits, OF_RIG
    if about.actuators:
        kind, limits, then = "limits", about.law.known_limits, CUT_OFF
    beyond = commands_beyond(about.loop.asked(trial), about.signals.commands, limits)
    return {kind: beyond and beyond + then}


def _another_start(about, trials):
    """State in words how far the last trial started from the start of the first trial."""
    first, last = trials[0], trials[-1]
    alike = np.array_equal(last["reference"][0], first["reference"][0])
    if about.goes_on or last is first or not alike:
        return ""
    start = start_of(about, first)
    return start.missed(last["y"]) or (about.law.L and start.away(last["reference"]))
