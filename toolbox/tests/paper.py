"""The 2 x 2 loop that the method was published for, and the choices of its design."""

import json
from pathlib import Path

from ilctools.law.notes import model_from
from ilctools.loop.closed import CurrentTrialLoop

NOTE = json.loads(Path(__file__).with_name("paper-loop.json").read_text(encoding="utf-8"))


def paper_loop() -> CurrentTrialLoop:
    """Ten states, heat flows Q1 and Q3 (W), temperatures y1 and y2 (K), 1 s."""
    return CurrentTrialLoop(**NOTE | {"plant": model_from(NOTE["plant"])})


def paper_choices(**changes) -> dict:
    """Of the learning filter (39)."""
    choices = {"order": 10, "M_max": 0.9, "L_max": 50.0, "band": (1e-4, 0.02)}
    return choices | {"structure": "diagonal"} | changes
