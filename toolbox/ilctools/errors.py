"""The toolbox's own exceptions; a wrong argument raises a plain ValueError instead.

InfeasibleError and LogError are ValueErrors. SolverError and RigError are RuntimeErrors.
StoppedError is a RigError.
"""

from contextlib import contextmanager

# errors that may occur while an entry of the metadata is read
MISUNDERSTOOD = (KeyError, TypeError, ValueError, ArithmeticError, RecursionError)
LONGEST_MESSAGE = 1000  # letters of a message


class InfeasibleError(ValueError):
    """No learning filter of the given order and structure meets the bounds.

    Attributes
    ----------
    smallest_M_max : float
        The smallest feasible M_max if the other arguments stay the same. If this number is one or
        more, no filter that meets the other bounds is proved to converge.
    plant, omega : int, float
        The number of the plant, and the frequency (rad/s), at which the bound on M is the main
        obstacle. Plant number 0 is the nominal plant.

    See Also
    --------
    synthesise : raises this error

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
    """The solver returned no filter, or a filter whose certificate fails."""


class RigError(RuntimeError):
    """A rig gave an invalid reading; no command computed from this reading was applied.

    The trials before the error are in `trials`.
    """

    trials = None  # as `record` returns them; None if no trial has ended


class StoppedError(RigError):
    """A signal of a trial exceeded a stop limit, and the experiment was stopped."""


class LogError(ValueError):
    """A log or a table cannot be used; the message says where the mistake is, and what to do."""


def shortened(message: str) -> str:
    """Leave out the middle of a long message, which may quote a whole file."""
    return message if len(message) <= LONGEST_MESSAGE else f"{message[:600]} ... {message[-300:]}"


@contextmanager
def reading(key: str):
    """Turn an error in this block, which reads the metadata entry `key`, into a LogError."""
    try:
        yield
    except MISUNDERSTOOD as error:
        text = f"metadata: {key} cannot be understood: {error!r}"
        raise LogError(shortened(text)) from None
