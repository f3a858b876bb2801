"""The laboratory: experiments on a rig, trial by trial, and the logs that they leave.

What runs an experiment knows a rig by its Protocol only; the virtual rig is one that fits.
"""

from rodlib.ilc.laboratory.controlled_rig import Controller, Rig, RigError
from rodlib.ilc.laboratory.excitation import Excitation, multisine
from rodlib.ilc.laboratory.experiment import record, shake
from rodlib.ilc.laboratory.log import LogError, load_log, save_log
from rodlib.ilc.laboratory.measurement import MeasuredResponse, expected_radius, measured_response
from rodlib.ilc.laboratory.notes import (
    law_of,
    load_law,
    loop_of,
    rest_of,
    save_law,
    step_of,
    with_law,
)
from rodlib.ilc.laboratory.replay import Replay, replay_of
from rodlib.ilc.laboratory.temperature_control_lab import TemperatureControlLab

__all__ = [
    "Controller",
    "Excitation",
    "LogError",
    "MeasuredResponse",
    "Replay",
    "Rig",
    "RigError",
    "TemperatureControlLab",
    "expected_radius",
    "law_of",
    "load_law",
    "load_log",
    "loop_of",
    "measured_response",
    "multisine",
    "record",
    "replay_of",
    "rest_of",
    "save_law",
    "save_log",
    "shake",
    "step_of",
    "with_law",
]
