"""The laboratory: experiments on a rig, trial by trial, and the logs that they leave.

What runs an experiment knows a rig by its Protocol only; the virtual rig is one that fits.
"""

from rodlib.ilc import lazily

MODULES = {
    "controlled_rig": "Controller",
    "estimation": "EstimatedResponse",
    "excitation": "Excitation multisine",
    "experiment": "record shake",
    "foreign": "read_table",
    "log": "LogError load_log save_log",
    "measurement": "MeasuredResponse expected_radius measured_response",
    "notes": "law_of load_law loop_of rest_of save_law step_of with_law",
    "replay": "Replay replay_of",
    "rig": "Rig RigError StoppedError TrialRig",
    "tabulated": "TabulatedResponse",
    "temperature_control_lab": "TemperatureControlLab",
}
__getattr__, __dir__, __all__ = lazily(__name__, MODULES)
