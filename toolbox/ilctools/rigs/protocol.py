"""The interface between an experiment and a rig."""

from collections.abc import Iterable
from typing import Protocol, runtime_checkable


@runtime_checkable
class Rig(Protocol):
    """The driver of a rig for :func:`record`: two methods, each called once per sample.

    With a :class:`ClosedLoop`, the controller is on the rig. The inputs are then w = r + v, the
    reference plus the ILC signal, and ``measured`` has the commands u, if the loop names any.

    A rig may have further attributes and methods:

    - ``inputs``: names of the numbers that ``apply`` takes. Default: the loop's controls, or its
      references.
    - ``limits``: a dict of the lowest and the highest number that the rig can apply, by the name of
      the input. Commands saturate there, and the observer, (16) of the paper, gets the saturated
      commands.
    - ``Ts``: the sampling period of the rig, s.
    - ``measured``: a dict of other measured quantities by name, such as the temperature of the
      room.
    - ``safe()``: leaves the rig in a safe state. Without this method, zeros are applied.
    - ``safe_time``: the time in s that ``safe()`` may take before a signal ends it. Default: 10 s.
    - ``begin(trial)``: brings the rig into the state in which every trial begins, for example by a
      homing run. The controller is then reset, too.
    - ``clock()``: a clock in s, such as ``time.monotonic``, by which late samples are found.

    See Also
    --------
    record : runs trials on a rig
    shake : excites a rig, to measure its response

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
        """Read the outputs, in the order and the units of the loop; one output may be a number."""

    def apply(self, commands, /) -> None:
        """Set the inputs, and return at the time of the next sample."""
