# From the registry in __init__.py, by `make stubs`.

from rodlib.boards import TemperatureControlLab as TemperatureControlLab
from rodlib.boards import heat_balance as heat_balance
from rodlib.case import assumed_disturbance as assumed_disturbance
from rodlib.case import assumed_reference as assumed_reference
from rodlib.case import paper_choices as paper_choices
from rodlib.case import paper_loop as paper_loop
from rodlib.held import sampled_response as sampled_response
from rodlib.peltier_rig import PeltierParameters as PeltierParameters
from rodlib.peltier_rig import PeltierRig as PeltierRig
from rodlib.peltier_rig import RestartingPeltierRig as RestartingPeltierRig
from rodlib.rigs import MISMATCHED as MISMATCHED
from rodlib.rigs import RestartingRig as RestartingRig
from rodlib.rigs import RigParameters as RigParameters
from rodlib.rigs import VirtualRig as VirtualRig
from rodlib.rod import Rod as Rod
from rodlib.rod import exact_response as exact_response
from rodlib.rod import finite_volumes as finite_volumes
from rodlib.rod import midr as midr
from rodlib.specimens import Specimen as Specimen
from rodlib.specimens import Spread as Spread
from rodlib.specimens import draw as draw
from rodlib.specimens import responses as responses
from rodlib.workbench import open_workbench as open_workbench
from rodlib.workbench import plot as plot
from rodlib.workbench import try_out as try_out

__version__: str
