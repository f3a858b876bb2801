"""The laboratory: experiments on a rig, trial by trial, and the logs that they leave.

What runs an experiment knows a rig by its Protocol only; the virtual rig is one that fits.
"""

from rodlib.laboratory.experiment import Controller, Rig, RigError, record
from rodlib.laboratory.logs import load_log, save_log
from rodlib.laboratory.notes import law_of, loop_of, rest_of, with_law
from rodlib.laboratory.tables import LogError
from rodlib.laboratory.temperature_control_lab import TemperatureControlLab
from rodlib.laboratory.virtual_rig import RestartingRig, RigParameters, VirtualRig

__all__ = [
    "Controller",
    "LogError",
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
    "rest_of",
    "save_log",
    "with_law",
]
