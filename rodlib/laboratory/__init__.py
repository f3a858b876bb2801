"""The laboratory: experiments on a rig, trial by trial, and the logs that they leave.

What runs an experiment knows a rig by its Protocol only; the virtual rig is one that fits.
"""

from rodlib.laboratory.bench import Controller, Rig, RigError
from rodlib.laboratory.excitation import Excitation, multisine
from rodlib.laboratory.experiment import record, shake
from rodlib.laboratory.law import load_law, save_law
from rodlib.laboratory.loading import load_log
from rodlib.laboratory.measurement import MeasuredResponse, expected_radius, measured_response
from rodlib.laboratory.notes import law_of, loop_of, rest_of, step_of, with_law
from rodlib.laboratory.replay import Replay, replay_of
from rodlib.laboratory.saving import save_log
from rodlib.laboratory.tables import LogError
from rodlib.laboratory.temperature_control_lab import TemperatureControlLab
from rodlib.laboratory.virtual_rig import RestartingRig, RigParameters, VirtualRig

__all__ = [
    "Controller",
    "Excitation",
    "LogError",
    "MeasuredResponse",
    "Replay",
    "RestartingRig",
    "Rig",
    "RigError",
    "RigParameters",
    "TemperatureControlLab",
    "VirtualRig",
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
