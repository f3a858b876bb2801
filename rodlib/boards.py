"""The Temperature Control Lab: a board with two heaters and two thermometers, as a rig.

The board is a kit to learn control with. The package tclab connects to the kit and also contains an
emulator. Time runs differently for kit and emulator; this module hides the difference. The extra
``rodlib[tclab]`` installs tclab.
"""

import random
import time

import control
import numpy as np
from scipy.signal import cont2discrete

from ilctools import arguments

HEATERS, THERMOMETERS = ["Q1", "Q2"], ["T1", "T2"]
LAST = 60.0  # s: the readings at rest are averaged over this last part of the first wait


class TemperatureControlLab:
    """The kit or its emulator, around a state of rest in which both heaters are on.

    A heater that is switched off cannot cool, but a heater that is on can be turned down. Therefore
    :meth:`apply` takes heaters relative to the state of rest, in percent, and :meth:`read` returns
    temperatures relative to the state of rest, in kelvin. Every trial begins at rest. The
    temperatures at rest are the mean over the last minute before the first trial. After the default
    wait of 900 s, the emulator is still 0.15 K below its final state. After 300 s, it would be
    3.5 K below. Heaters saturate at 0 and 100 %.

    Parameters
    ----------
    kit : bool
        Whether to connect to the kit. By default, this object connects to the emulator. The time of
        the emulator is simulated, so that no call has to wait.
    rest : (float, float)
        The heaters at rest, %.
    Ts : float
        Sampling period, s.
    wait : float
        Time for which both heaters are held at rest before a trial, s; at least a minute.
    seed : int
        Seed of the emulator's noise, which comes from Python's own generator of random numbers.

    See Also
    --------
    heat_balance : a model of the board
    record : runs trials on the board

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
            # the emulator's time begins when it is made, which differs from run to run
            self.lab.update(0.0)
        self.zero = None  # the temperatures at rest, degC
        self._due = self.clock()

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each heater, %, relative to rest."""
        rest = zip(HEATERS, self.rest.tolist(), strict=True)
        return {name: (-percent, 100 - percent) for name, percent in rest}

    def clock(self) -> float:
        """Return the time, s; the emulator's time stands still between two samples."""
        return time.monotonic() if self.kit else self.lab.tlast

    def begin(self, trial: int) -> None:
        """Wait for the state of rest.

        In the first trial, the temperatures at rest are also measured.
        """
        self._due = self.clock()
        readings = []
        for _ in range(round(self.wait / self.Ts)):
            readings.append(self._temperatures())
            self.apply([0, 0])
        if self.zero is None:
            self.zero = np.mean(readings[-round(LAST / self.Ts) :], axis=0)

    def read(self) -> np.ndarray:
        """Return the temperatures above the temperatures at rest, K, shape (2,)."""
        if self.zero is None:
            raise RuntimeError("the temperatures at rest are unknown: call begin first")
        return self._temperatures() - self.zero

    def apply(self, heaters) -> None:
        """Set the heaters (%, relative to rest) and let one sampling period pass."""
        first, second = (self.rest + arguments.array("heaters", heaters, (2,))).tolist()
        self.lab.Q1(first)  # tclab saturates the heaters at 0 and 100
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
    """Model two heaters that warm each other and lose heat to the air, with slow thermometers.

    dH_i/dt = gain_i Q_i - loss H_i - exchange (H_i - H_j),    lag dT_i/dt = H_i - T_i

    H_i is the temperature of heater i, and T_i is the reading of its thermometer. The inputs are
    Q1, Q2 (%, held for Ts), and the outputs are T1, T2 (K). All are relative to a state of rest.
    The gains are in K/s per %, loss and exchange in 1/s, the lag and Ts in s. All must be positive,
    which is not checked.

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
    A = np.block([[-lost, 0 * I], [I / lag, -I / lag]])  # states H1, H2, T1, T2
    B = np.vstack([np.diag([gain_1, gain_2]), 0 * I])
    held = cont2discrete((A, B, np.eye(2, 4, 2), 0 * I), Ts)
    return control.ss(*held, inputs=HEATERS, outputs=THERMOMETERS, name="heat balance")
