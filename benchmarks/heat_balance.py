"""How often the intervals of a fitted heat balance hold the truth, as notebook 13 says.

Logs are simulated with the heaters of the two real ones, and noise that is white or lasts a minute.
Some two minutes.
"""

import warnings

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from ilctools import read_table
from ilctools.models import state_sequence
from rodlib.boards import UNITS, fit_heat_balance, heat_balance
from rodlib.paper.repository import ROOT

SEEDS = 100  # of the noise
TRUE = np.array([0.0033, 0.0018, 0.0051, 0.0018, 18.0])  # about what the logs give
NAMED = {"time": 0, "inputs": {"Q1": 1, "Q2": 2}, "outputs": {"T1": 3, "T2": 4}}


def held(log, lasts: float, size: float = 0.5) -> np.ndarray:
    """Share of the logs in whose 95 % intervals the truth is, by parameter."""
    u, model = log.u.values[0], heat_balance(*TRUE, log.Ts)
    answer = state_sequence(model.A, u @ model.B.T, np.zeros(4)) @ model.C.T
    pole, within = np.exp(-log.Ts / lasts) if lasts else 0.0, []
    for seed in range(SEEDS):
        white = np.random.default_rng(seed).standard_normal((len(u) + 500, 2))
        noise = lfilter([size * np.sqrt(1 - pole**2)], [1, -pole], white, axis=0)
        fit = fit_heat_balance(u, 20 + answer + noise[500:], log.Ts).table()
        within.append((fit["from"].values < TRUE) & (fit.to.values > TRUE))
    return np.mean(within, axis=0)


def main() -> pd.DataFrame:
    """Count, for both logs and both kinds of noise."""
    warnings.simplefilter("ignore")
    rows = {}
    for name in ("board-1s.csv", "board-3s.csv"):
        log = read_table(ROOT / "data" / "tclab" / name, **NAMED)
        for lasts in (0.0, 60.0):
            rows[name, f"{lasts:g} s"] = held(log, lasts)
    return pd.DataFrame(rows, UNITS).T.rename_axis(["heaters of", "noise lasts"])


if __name__ == "__main__":
    print(main().to_string())
