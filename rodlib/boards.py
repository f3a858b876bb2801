"""The Temperature Control Lab: a board with two heaters and two thermometers, as a rig.

It is a kit to learn control with. Its own package, tclab, talks to it and brings an emulator; the
two differ in what time is, which is hidden here. The extra ``rodlib[tclab]`` installs it.
"""

import random
import time
from dataclasses import dataclass

import control
import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.signal import cont2discrete
from scipy.stats import t

from ilctools import arguments
from ilctools.models import state_sequence

HEATERS, THERMOMETERS = ["Q1", "Q2"], ["T1", "T2"]
LAST = 60.0  # s of the wait before the first trial, over which the readings at rest are averaged
PARTS = 6  # of a record, each left out once; with more, noise of a minute makes intervals short
UNITS = {"gain_1": "K/s per %", "gain_2": "K/s per %", "loss": "1/s", "exchange": "1/s", "lag": "s"}


class TemperatureControlLab:
    """The kit or its emulator, around a state of rest in which both heaters are on.

    A heater that is off cannot cool; one that is on can be turned down. So :meth:`apply` takes
    percents above those at rest, :meth:`read` gives kelvins above the temperatures at rest, and
    every trial begins there. Heaters are cut off at 0 and 100 %.

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
    fit_heat_balance : a model of it, from a record
    record : trials on it

    Examples
    --------
    >>> from rodlib import TemperatureControlLab
    >>> board = TemperatureControlLab(rest=(30.0, 40.0), wait=60.0)  # doctest: +ELLIPSIS
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

    From Q1, Q2 (%, held for Ts) to T1, T2 (K), all counted from a state of rest. The units of the
    parameters are in `UNITS`.

    See Also
    --------
    fit_heat_balance : its parameters, from a record

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


@dataclass(frozen=True, eq=False)
class HeatBalanceFit:
    """The parameters of :func:`heat_balance` from a record, and how well it determines them."""

    values: np.ndarray  # in the order of heat_balance
    covariance: np.ndarray  # of their logarithms
    zero: np.ndarray  # readings at rest, as fitted, shape (2,)
    left: np.ndarray  # readings minus model, K, shape (samples, 2)

    def table(self) -> pd.DataFrame:
        """Each parameter with its interval of 95 % and its unit."""
        errors = t.ppf(0.975, PARTS - 1) * np.sqrt(np.diag(self.covariance))
        width = np.exp(np.minimum(errors, 500))
        ends = {"value": self.values, "from": self.values / width, "to": self.values * width}
        return pd.DataFrame(ends | {"unit": UNITS.values()}, list(UNITS))


def fit_heat_balance(heaters, readings, Ts: float) -> HeatBalanceFit:
    """Fit :func:`heat_balance` to a record that begins at rest, by least squares.

    There is a second minimum where heater and thermometer exchange their times: the search starts
    on both sides, and the better end counts. The covariance is the jackknife's: how much changes,
    by the slopes, if a sixth of the record is left out. That counts noise of any colour and what
    the model leaves, as far as it differs from one sixth to another; of white noise alone, s^2
    (J' J)^-1 would do. What the record does not determine, such as the gain of a heater that never
    moves, has an interval of many decades.

    Parameters
    ----------
    heaters, readings : array, shape (samples, 2)
        In %, above those at rest, held for Ts; in K or degC, from any zero. Begins at rest.
    Ts : float
        Sampling period, s.

    See Also
    --------
    heat_balance : the model
    measured_response : a region for P, without a model

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from rodlib import fit_heat_balance, heat_balance
    >>> board = heat_balance(0.006, 0.004, 0.006, 0.003, 16.0, Ts=2.0)
    >>> heaters = 10 * np.sign(np.sin(np.outer(np.arange(300), [0.02, 0.05])))
    >>> response = control.forced_response(board, np.arange(300) * 2.0, heaters.T)
    >>> fit = fit_heat_balance(heaters, response.outputs.T, Ts=2.0)
    >>> round(float(fit.table()["value"]["lag"]), 2)
    16.0
    """
    heaters = arguments.array("heaters", heaters, ("samples", 2))
    readings = arguments.array("readings", readings, (len(heaters), 2))
    Ts = arguments.sampling_period("Ts", Ts)
    above = readings - readings[0]

    def residual(unknowns):  # logarithms of the parameters, and what the first readings are off by
        board = heat_balance(*np.exp(unknowns[:5]), Ts)
        T = state_sequence(board.A, heaters @ board.B.T, np.zeros(4)) @ board.C.T  # from rest
        return (above - unknowns[5:] - T).ravel()

    # tolerances so small that the start does not show
    options = {"x_scale": "jac", "ftol": 1e-12, "xtol": 1e-10}
    fits = [
        least_squares(residual, start, bounds=(start - 7, start + 7), **options)
        for start in _starts(np.ptp(above) / np.ptp(heaters), Ts * len(heaters))
    ]
    best = min(fits, key=lambda fit: fit.cost)
    zero, left = readings[0] + best.x[5:], best.fun.reshape(-1, 2)
    return HeatBalanceFit(np.exp(best.x[:5]), _covariance(best)[:5, :5], zero, left)


def _starts(swing, record):
    """Slow heaters with quick thermometers, and the reverse; K per % and s of the record.

    What is searched, logarithms and K, is within three decades and 7 K of them.
    """
    for cooling, lag in ((record / 3, record / 30), (record / 30, record / 3)):
        gain = 2 * swing / cooling
        yield np.log([gain, gain, 1 / cooling, 0.3 / cooling, lag, 1, 1])


def _covariance(fit):
    """The jackknife's; what moves nothing has no slope, and a variance without end."""
    left_out = np.array_split(np.arange(fit.fun.size), PARTS)
    remains = [(np.delete(fit.jac, part, 0), np.delete(fit.fun, part)) for part in left_out]
    changes = np.array([np.linalg.lstsq(J, e, rcond=1e-9)[0] for J, e in remains])
    covariance = (PARTS - 1) / PARTS * changes.T @ changes
    slopes = np.abs(fit.jac).max(axis=0)
    still = slopes < 1e-6 * slopes.max()  # but for rounding
    covariance[still, still] = np.inf
    return covariance
