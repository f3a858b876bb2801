"""The Temperature Control Lab: a board with two heaters and two thermometers, as a rig.

It is a kit to learn control with. Its own package, tclab, talks to it and brings an emulator; the
two differ in what time is, which is hidden here. The extra ``rodlib[tclab]`` installs it.
"""

import random
import time
import warnings
from dataclasses import dataclass
from itertools import product

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
UNITS = {"gain_1": "K/s per %", "gain_2": "K/s per %", "loss": "1/s", "exchange": "1/s", "lag": "s"}
PARTS = 6  # of a record, each left out once; with more, noise of a minute makes intervals short
# relative standard error, from which on a parameter counts as not determined
VAGUE = 0.5


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

    # in the order of heat_balance; NaN for what moves nothing in the record
    values: np.ndarray
    covariance: np.ndarray  # of their logarithms
    zero: np.ndarray  # readings at rest, as fitted, shape (2,)
    left: np.ndarray  # readings minus model, K, shape (samples, 2)

    @property
    def unknown(self) -> list[str]:
        """Parameters that the record does not determine."""
        return [n for n, e in zip(UNITS, self.standard_errors, strict=True) if not e < VAGUE]

    @property
    def standard_errors(self) -> np.ndarray:
        """Relative standard errors of the parameters."""
        return np.sqrt(np.diag(self.covariance))

    def table(self) -> pd.DataFrame:
        """Each parameter with its interval of 95 % and its unit."""
        quantile = t.ppf(0.975, PARTS - 1)
        width = np.exp(np.minimum(quantile * self.standard_errors, 500))
        columns = {"value": self.values, "from": self.values / width}
        columns |= {"to": self.values * width, "unit": UNITS.values()}
        return pd.DataFrame(columns, list(UNITS))


def fit_heat_balance(heaters, readings, Ts: float) -> HeatBalanceFit:
    """The heat balance nearest to a record in least squares, from several starts.

    With the temperatures T(p) that :func:`heat_balance` gives for the parameters p, from rest,

        minimise over log p and zero   sum_k |readings_k - zero - T_k(p)|^2 .

    There is a second minimum where heater and thermometer exchange their times. Parameters are
    positive, and times between Ts/10 and ten records. The intervals are of the jackknife: how much
    changes if a sixth of the record is left out. They count noise of any colour and what the model
    leaves, as far as it differs from one sixth to another.

    Parameters
    ----------
    heaters, readings : array, shape (samples, 2)
        In %, above those at rest, held for Ts; in K or degC, from any zero. Begins at rest. Some
        thirty samples at least, or the intervals are of rounding.
    Ts : float
        Sampling period, s.

    Warns
    -----
    UserWarning
        If the record does not determine a parameter: a heater that never moves, one step alone.

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

    def residual(unknowns):
        log_p, zero = np.split(unknowns, [5])
        board = heat_balance(*np.exp(log_p), Ts)
        T = state_sequence(board.A, heaters @ board.B.T, np.zeros(4)) @ board.C.T  # from rest
        return (readings - readings[0] - zero - T).ravel()

    best = _least_squares(residual, heaters, readings, Ts)
    idle = np.append(~heaters.any(axis=0), np.zeros(5, bool))  # of the gains: their slope is zero
    covariance = _jackknife(np.where(idle, 0.0, best.jac), best.fun)
    values, zero = np.exp(best.x), readings[0] + best.x[5:]
    values[idle] = covariance[idle, idle] = np.nan
    fit = HeatBalanceFit(values[:5], covariance[:5, :5], zero, best.fun.reshape(-1, 2))
    if fit.unknown:
        warnings.warn(
            f"the record does not tell {', '.join(fit.unknown)}: without a sixth of it, they "
            f"would change by more than half. Move each heater, independently, up and down",
            stacklevel=2,
        )
    return fit


def _least_squares(residual, heaters, readings, Ts):
    """The best fit of four starts, which say how quickly heater and thermometer follow."""
    heights, record = np.ptp(readings, axis=0), Ts * len(heaters)
    swing = max(heights.max() / max(np.ptp(heaters), 1e-9), 1e-9)  # K per %
    shortest, longest = Ts / 10, 10 * record

    def point(gain, loss, exchange, lag, zero):
        return np.append(np.log([gain, gain, loss, exchange, lag]), zero * (heights + 1))

    low = point(swing / longest, 1 / longest, 0.01 / longest, shortest, -1)
    high = point(swing / Ts, 1 / shortest, 1 / shortest, longest, 1)
    # Tolerances so small that the start does not show.
    options = {"bounds": (low, high), "x_scale": "jac", "ftol": 1e-12, "xtol": 1e-10}
    fits = []
    for cooling, lag in product((record / 3, record / 30), repeat=2):
        start = point(2 * swing / cooling, 1 / cooling, 0.3 / cooling, lag, 0)
        fits.append(least_squares(residual, np.clip(start, low, high), **options))
    return min(fits, key=lambda fit: fit.cost)


def _jackknife(slopes, residuals):
    """Covariance of what a linear fit changes by when each part of the residuals is left out."""
    left_out = np.array_split(np.arange(residuals.size), PARTS)
    remains = [(np.delete(slopes, part, 0), np.delete(residuals, part)) for part in left_out]
    changes = np.array([np.linalg.lstsq(A, b, rcond=1e-9)[0] for A, b in remains])
    return (PARTS - 1) / PARTS * changes.T @ changes
