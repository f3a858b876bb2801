"""The study of 10,000 rods: around how many of them do the paper's printed filters converge?

The rods are drawn by number and judged in batches, on all cores; five trials of each are simulated.
"""

from functools import partial

import numpy as np
import pandas as pd
from runner import run

from ilctools import convergence
from ilctools.filters import LearningFilter, zero_phase_butterworth
from rodlib import Spread, assumed_reference, draw, paper_loop, responses
from rodlib.paper import published
from rodlib.paper.repository import results
from rodlib.specimens import unstable_poles

RODS, BATCH, TRIALS = 10_000, 100, 5  # a batch takes some seconds
SPREADS = {"material": Spread(0.2, 0.2, 0.2, 0.2), "everything": Spread.of_all(0.2)}
LOOP, Q, R = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0), assumed_reference()
OMEGA, COUNT = np.geomspace(1e-4, np.pi, 1000), 4 * len(R)  # until P has decayed
FILTERS = ("diagonal", "full")


def last_rms(P, L):
    """RMS of the last trial (23) around each rod, from P at the lines of COUNT samples."""
    v = np.zeros((len(P), *R.shape))
    for _ in range(TRIALS):
        spectrum = np.fft.rfft(R + v, COUNT, axis=1)
        y = np.fft.irfft(np.einsum("rnij,rnj->rni", P, spectrum), COUNT, axis=1)
        e = R - y[:, : len(R)]
        v = Q.apply(v + L.apply(e))  # (23)
    return np.sqrt((e**2).sum(axis=2).mean(axis=1))


def judged(spread: Spread, numbers) -> pd.DataFrame:
    """A row for each rod and filter; NaN where the loop is not stable."""
    specimens = [draw(spread, number) for number in numbers]
    stable = unstable_poles(LOOP, specimens) == 0
    P = responses(LOOP, specimens, OMEGA)
    P_lines = responses(LOOP, specimens, np.fft.rfftfreq(COUNT, LOOP.Ts / (2 * np.pi)))
    tables = []
    for name in FILTERS:
        L = LearningFilter(published.matrix(f"L_{name}"), LOOP.Ts)
        result = convergence(P, Q, L, OMEGA)
        table = pd.DataFrame({"rod": numbers, "stable": stable, "gamma": result.gamma})
        table["spectral_radius"], table["rms"] = result.spectral_radius, last_rms(P_lines, L)
        table.loc[~stable, ["gamma", "spectral_radius", "rms"]] = np.nan
        tables.append(table.assign(filter=name))
    return pd.concat(tables)


def summary(data: pd.DataFrame) -> pd.DataFrame:
    """How many rods converge, for each filter."""
    groups = data.assign(converges=data.spectral_radius < 1, monotonically=data.gamma < 1).groupby(
        "filter"
    )
    table = 100 * groups[["stable", "converges", "monotonically"]].mean()
    table.columns = ["stable, %", "converge, %", "monotonically, %"]
    table["largest rate"] = groups.gamma.max()
    table[f"median RMS of trial {TRIALS}, K"] = groups.rms.median()
    return table


def main(rods: int = RODS):
    """Run the study, print how many rods converge, and save the results in build/study."""
    folder = results("make measure WHAT=study") / "study"
    folder.mkdir(parents=True, exist_ok=True)
    batches = [range(rods)[k : k + BATCH] for k in range(0, rods, BATCH)]
    for name, spread in SPREADS.items():
        data = pd.concat(run(partial(judged, spread), batches))
        data.to_csv(folder / f"{name}.csv", index=False)
        print(f"{rods} rods, {name} off by up to 20 %: {folder / name}.csv")
        print(f"{summary(data).round(3).to_string()}\n")


if __name__ == "__main__":
    main()
