"""The toolbox's own exceptions, to be caught by name; a wrong argument is a plain ValueError.

InfeasibleError and LogError are ValueErrors, SolverError and RigError RuntimeErrors, and
StoppedError is a RigError.
"""

from ilctools.loop.notes import LogError
from ilctools.rigs.protocol import RigError, StoppedError
from ilctools.synthesis.result import InfeasibleError, SolverError

__all__ = ["InfeasibleError", "LogError", "RigError", "SolverError", "StoppedError"]
