"""The laboratory: experiments on a rig, trial by trial, and the logs that they leave.

What runs an experiment knows a rig by its Protocol only; the virtual rig is one that fits.
"""

from rodlib.laboratory.experiment import Controller, Rig, RigError, record
from rodlib.laboratory.loading import load_log
from rodlib.laboratory.notes import law_of, loop_of, rest_of, step_of, with_law
from rodlib.laboratory.replay import Replay, replay_of
from rodlib.laboratory.saving import save_log
from rodlib.laboratory.tables import LogError
from rodlib.laboratory.temperature_control_lab import TemperatureControlLab
from rodlib.laboratory.virtual_rig import RestartingRig, RigParameters, VirtualRig

__all__ = [
    "Controller",
    "LogError",
    "Replay",
    "RestartingRig",
    "Rig",
    "RigError",
    "RigParameters",
    "TemperatureControlLab",
    "VirtualRig",
    "law_of",
    "load_log",
    "loop_of",
    "record",
    "replay_of",
    "rest_of",
    "save_log",
    "step_of",
    "with_law",
]
