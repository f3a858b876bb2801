# From the registry in __init__.py, by `make stubs`.

from ilctools import errors as errors
from ilctools.alternatives import NormOptimal as NormOptimal
from ilctools.errors import InfeasibleError as InfeasibleError
from ilctools.evidence.convergence import convergence as convergence
from ilctools.evidence.finite import trial_map as trial_map
from ilctools.evidence.finite import trial_norm as trial_norm
from ilctools.evidence.finite import trial_operators as trial_operators
from ilctools.evidence.robustness import worst_case as worst_case
from ilctools.filters import LearningFilter as LearningFilter
from ilctools.filters import zero_phase_butterworth as zero_phase_butterworth
from ilctools.law.law import Law as Law
from ilctools.law.notes import law_of as law_of
from ilctools.law.notes import load_law as load_law
from ilctools.law.notes import save_law as save_law
from ilctools.logs.format import save_log as save_log
from ilctools.logs.reader import load_log as load_log
from ilctools.logs.replay import replay as replay
from ilctools.logs.table import read_table as read_table
from ilctools.loop.closed import ClosedLoop as ClosedLoop
from ilctools.loop.design import current_trial_loop as current_trial_loop
from ilctools.measurement.excitation import multisine as multisine
from ilctools.measurement.measurement import measured_response as measured_response
from ilctools.models import frequency_response as frequency_response
from ilctools.models import minimal_realisation as minimal_realisation
from ilctools.models import state_sequence as state_sequence
from ilctools.rigs.controller import Controller as Controller
from ilctools.rigs.experiments import record as record
from ilctools.rigs.experiments import shake as shake
from ilctools.rigs.protocol import Rig as Rig
from ilctools.synthesis.design import synthesise as synthesise
from ilctools.synthesis.search import least_gain as least_gain
from ilctools.trials.rms import rms as rms
from ilctools.trials.run import run_trials as run_trials
from ilctools.trials.transfer import transfer as transfer

__version__: str
