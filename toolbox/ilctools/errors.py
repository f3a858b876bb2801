"""The toolbox's own exceptions, to be caught by name; a wrong argument is a plain ValueError.

InfeasibleError and LogError are ValueErrors, SolverError and RigError RuntimeErrors, and
StoppedError is a RigError.
"""

from contextlib import contextmanager

# what a note may lead to
MISUNDERSTOOD = (KeyError, TypeError, ValueError, ArithmeticError, RecursionError)
LONGEST_MESSAGE = 1000  # letters of a message


class InfeasibleError(ValueError):
    """No learning filter of the given order and structure meets the bounds.

    Attributes
    ----------
    smallest_M_max : float
        What is feasible with the other arguments; from one on, nothing that converges.
    plant, omega : int, float
        Where the bound on M that stands most in the way is; plant number 0 is the nominal one.

    See Also
    --------
    synthesise : what raises it

    Examples
    --------
    >>> import control
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)
    >>> from ilctools import InfeasibleError, synthesise, zero_phase_butterworth
    >>> try:
    ...     synthesise(P, zero_phase_butterworth(2, 40.0, 0.01), order=2, M_max=0.1)
    ... except InfeasibleError as error:
    ...     print(error.smallest_M_max > 0.1)
    ...
    True
    """

    def __init__(self, message: str, smallest_M_max: float, plant: int, omega: float):
        super().__init__(message)
        self.smallest_M_max, self.plant, self.omega = smallest_M_max, plant, omega


class SolverError(RuntimeError):
    """The solver returned no filter, or one whose certificate fails."""


class RigError(RuntimeError):
    """A rig that gave what is no reading; nothing that follows from it was applied.

    What was learned before it is in `trials`.
    """

    trials = None  # as from record; None if no trial has ended


class StoppedError(RigError):
    """A trial that went beyond a stop limit."""


class LogError(ValueError):
    """A log or a table that cannot be used; the message says where, and what to do."""


def shortened(message: str) -> str:
    """A message without its middle, if that is long: what it quotes may be a whole file."""
    return message if len(message) <= LONGEST_MESSAGE else f"{message[:600]} ... {message[-300:]}"


@contextmanager
def reading(key: str):
    """Make a LogError of whatever a note leads to that is not of its kind."""
    try:
        yield
    except MISUNDERSTOOD as error:
        text = f"metadata: {key} cannot be understood: {error!r}"
        raise LogError(shortened(text)) from None
