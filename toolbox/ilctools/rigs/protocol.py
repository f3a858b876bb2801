"""What an experiment asks of a rig, and what it says when a rig fails."""

from collections.abc import Iterable
from typing import Protocol, runtime_checkable


@runtime_checkable
class Rig(Protocol):
    """What :func:`record` asks of a rig: a driver of two methods, one call each per sample.

    With a :class:`ClosedLoop`, whose controller is on the rig, the inputs are w = r + v, and
    ``measured`` has the commands u, if the loop names any.

    A rig may have more. ``inputs``: names of the numbers that ``apply`` takes; without it they are
    the loop's controls, or references. ``limits``: a dict of the lowest and the highest number that
    it follows, by the name of the input;
    commands are cut off there, and the observer (16) is informed. ``Ts``: its sampling
    period, s. ``measured``: a dict of what else it measures, by name, such as the temperature of
    the room. ``safe()``: what leaves it in a safe state; without it, zeros are applied.
    ``safe_time``: how long this may take, s, before a signal ends it; 10 s without it.
    ``begin(trial)``: what brings it into the state in which every trial begins, such as a homing
    run; the controller then starts afresh, too. ``clock()``: the time, s, by which samples are late
    or not, such as ``time.monotonic``.

    See Also
    --------
    record : trials on a rig
    shake : its response

    Examples
    --------
    >>> from ilctools import Rig
    >>> class Heater(Rig):
    ...     y = 20.0
    ...     def read(self):
    ...         return [self.y]
    ...     def apply(self, commands):
    ...         self.y += 0.1 * (commands[0] - self.y)
    ...
    >>> heater = Heater()
    >>> heater.apply([30.0])
    >>> heater.read()
    [21.0]
    """

    def read(self) -> Iterable[float] | float:
        """The outputs now, in the order and the units of the loop; a number, if there is one."""

    def apply(self, commands, /) -> None:
        """Set the inputs, and return when the next sample is due."""
