"""Iterative learning control of a heated rod: the module behind the notebooks."""

from rodlib.feedback import CurrentTrialLoop, current_trial_loop, minimal_realisation, paper_loop
from rodlib.filters import LearningFilter, ZeroPhaseButterworth, update, zero_phase_butterworth
from rodlib.logs import LogError, load_log, save_log
from rodlib.rod import Rod, exact_response, midr
from rodlib.synthesis import InfeasibleError, SolverError, Synthesis, synthesise
from rodlib.trials import run_trials

__all__ = [
    "CurrentTrialLoop",
    "InfeasibleError",
    "LearningFilter",
    "LogError",
    "Rod",
    "SolverError",
    "Synthesis",
    "ZeroPhaseButterworth",
    "current_trial_loop",
    "exact_response",
    "load_log",
    "midr",
    "minimal_realisation",
    "paper_loop",
    "run_trials",
    "save_log",
    "synthesise",
    "update",
    "zero_phase_butterworth",
]
