"""The Temperature Control Lab: a board with two heaters and two thermometers, as a rig.

It is a kit to learn control with. Its own package, tclab, talks to it and brings an emulator; the
two differ in what time is, which is hidden here. The extra ``rodlib[tclab]`` installs it.
"""

import random
import time

import control
import numpy as np
from scipy.signal import cont2discrete

from ilctools import arguments

HEATERS, THERMOMETERS = ["Q1", "Q2"], ["T1", "T2"]
LAST = 60.0  # s of the wait before the first trial, over which the readings at rest are averaged


class TemperatureControlLab:
    """The kit or its emulator, around a state of rest in which both heaters are on.

    A heater that is off cannot cool; one that is on can be turned down. So :meth:`apply` takes
    percents above those at rest, :meth:`read` gives kelvins above the temperatures at rest, and
    every trial begins there. These are the mean of the last minute before the first trial: the
    emulator is 0.15 K below its rest then, after 300 s 3.5 K. Heaters are cut off at 0 and 100 %.

    Parameters
    ----------
    kit : bool
        Whether to connect to the kit. Default: the emulator, whose time is computed and not waited
        for.
    rest : (float, float)
        The heaters at rest, %.
    Ts : float
        Sampling period, s.
    wait : float
        How long both heaters are held at rest before a trial, s; at least a minute.
    seed : int
        Of the emulator's noise, which comes from Python's own generator of random numbers.

    See Also
    --------
    heat_balance : a model of it
    record : trials on it

    Examples
    --------
    >>> from rodlib import TemperatureControlLab
    >>> board = TemperatureControlLab(rest=(30.0, 40.0))  # doctest: +ELLIPSIS
    TCLab version ...
    Simulated TCLab
    >>> board.begin(1)
    >>> board.limits["Q1"], board.read().shape
    ((-30.0, 70.0), (2,))
    """

    inputs = HEATERS

    def __init__(
        self,
        kit: bool = False,
        rest: tuple[float, float] = (30.0, 40.0),
        Ts: float = 2.0,
        wait: float = 900.0,
        seed: int = 1,
    ):
        self.kit = arguments.flag("kit", kit)
        self.rest = arguments.array("rest", rest, (2,))
        if self.rest.min() < 0 or self.rest.max() > 100:
            raise ValueError(f"rest = {rest!r} must be two numbers from 0 to 100 %")
        self.Ts = arguments.number("Ts", Ts, "a sampling period up to a minute, in s", 0, most=LAST)
        self.wait = arguments.number("wait", wait, "a minute or more, in s", least=LAST)
        seed = arguments.whole("seed", seed, 0)
        import tclab  # here, because only this driver needs it

        self.lab = tclab.TCLab() if self.kit else tclab.TCLabModel(synced=False)
        if not self.kit:
            random.seed(seed)
            # its time begins when it is made, which is never the same
            self.lab.update(0.0)
        self.zero = None  # the temperatures at rest, degC
        self._due = self.clock()

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest heaters, %, above those at rest."""
        rest = zip(HEATERS, self.rest.tolist(), strict=True)
        return {name: (-percent, 100 - percent) for name, percent in rest}

    def clock(self) -> float:
        """Time, s; the emulator's stands still between two samples."""
        return time.monotonic() if self.kit else self.lab.tlast

    def begin(self, trial: int) -> None:
        """Wait for the state of rest; the first time, find the temperatures there."""
        self._due = self.clock()
        readings = []
        for _ in range(round(self.wait / self.Ts)):
            readings.append(self._temperatures())
            self.apply([0, 0])
        if self.zero is None:
            self.zero = np.mean(readings[-round(LAST / self.Ts) :], axis=0)

    def read(self) -> np.ndarray:
        """Temperatures above those at rest, K, shape (2,)."""
        if self.zero is None:
            raise RuntimeError("the temperatures at rest are unknown: call begin first")
        return self._temperatures() - self.zero

    def apply(self, heaters) -> None:
        """Set the heaters (%, above those at rest) and let one sampling period pass."""
        first, second = (self.rest + arguments.array("heaters", heaters, (2,))).tolist()
        self.lab.Q1(first)  # cut off at 0 and 100 by tclab
        self.lab.Q2(second)
        self._due += self.Ts
        if self.kit:
            time.sleep(max(0.0, self._due - time.monotonic()))
        else:
            self.lab.update(self._due)

    def safe(self) -> None:
        """Switch the heaters off."""
        self.lab.Q1(0)
        self.lab.Q2(0)

    def _temperatures(self):
        return np.array([self.lab.T1, self.lab.T2])


def heat_balance(gain_1, gain_2, loss, exchange, lag, Ts) -> control.StateSpace:
    """Two heaters that warm each other and lose heat to the air, each with a slow thermometer.

    dH_i/dt = gain_i Q_i - loss H_i - exchange (H_i - H_j),    lag dT_i/dt = H_i - T_i

    From Q1, Q2 (%, held for Ts) to T1, T2 (K), all counted from a state of rest. The gains
    are in K/s per %, loss and exchange in 1/s, the lag and Ts in s: positive, which is not checked.

    See Also
    --------
    TemperatureControlLab : the board, or its emulator

    Examples
    --------
    >>> from ilctools import current_trial_loop
    >>> from rodlib import heat_balance
    >>> board = heat_balance(0.006, 0.004, 0.006, 0.003, 16.0, Ts=2.0)
    >>> current_trial_loop(board).outputs
    ['T1', 'T2']
    """
    I = np.eye(2)  # noqa: E741
    lost = (loss + exchange) * I - exchange * I[::-1]
    A = np.block([[-lost, 0 * I], [I / lag, -I / lag]])  # of H1, H2, T1, T2
    B = np.vstack([np.diag([gain_1, gain_2]), 0 * I])
    held = cont2discrete((A, B, np.eye(2, 4, 2), 0 * I), Ts)
    return control.ss(*held, inputs=HEATERS, outputs=THERMOMETERS, name="heat balance")
