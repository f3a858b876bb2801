"""Iterative learning control of a heated rod: the module behind the notebooks."""

from rodlib.feedback import CurrentTrialLoop, current_trial_loop, minimal_realisation, paper_loop
from rodlib.filters import LearningFilter, ZeroPhaseButterworth, update, zero_phase_butterworth
from rodlib.rod import Rod, exact_response, midr
from rodlib.synthesis import InfeasibleError, SolverError, Synthesis, synthesise

__all__ = [
    "CurrentTrialLoop",
    "InfeasibleError",
    "LearningFilter",
    "Rod",
    "SolverError",
    "Synthesis",
    "ZeroPhaseButterworth",
    "current_trial_loop",
    "exact_response",
    "midr",
    "minimal_realisation",
    "paper_loop",
    "synthesise",
    "update",
    "zero_phase_butterworth",
]
