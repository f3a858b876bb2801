"""The study of 10,000 rods, with ARGUMENTS the address of a dask scheduler.

With one it runs on its workers, which need this very rodlib.
"""

import sys

import pandas as pd
from distributed import Client

from ilctools.filters import LearningFilter, zero_phase_butterworth
from rodlib.case import paper_loop
from rodlib.paper import published
from rodlib.paper.repository import results
from rodlib.specimens import Spread
from rodlib.study import Study

RODS = 10_000
SPREADS = {"material": Spread(0.2, 0.2, 0.2, 0.2), "everything": Spread.of_all(0.2)}


def study(spread: Spread) -> Study:
    """The paper's two printed filters around rods that are off."""
    filters = {
        kind: LearningFilter(published.matrix(f"L_{kind}"), 1.0) for kind in ("diagonal", "full")
    }
    return Study(paper_loop(), zero_phase_butterworth(2, 0.1, 1.0), filters, spread)


def workers(scheduler: str | None = None) -> Client:
    """Those of a dask scheduler; default: a process for each core."""
    if scheduler is not None:
        return Client(scheduler)
    return Client(threads_per_worker=1, dashboard_address="127.0.0.1:0")


def main(scheduler: str | None = None, rods: int = RODS):
    """Run the study, print how many rods converge, and save the results in build/study."""
    folder = results("make measure WHAT=study") / "study"
    folder.mkdir(exist_ok=True)
    with workers(scheduler) as client:
        for name, spread in SPREADS.items():
            data = study(spread).run(rods, client)
            data.to_netcdf(folder / f"{name}.nc", engine="scipy")
            print(f"{rods} rods, {name} off by up to 20 %: {folder / name}.nc")
            print(f"{summary(data).round(3).to_string()}\n")


def summary(data) -> pd.DataFrame:
    """How many rods converge, for each filter."""
    last = data.rms[..., -1]
    columns = {
        "converge, %": 100 * (data.spectral_radius < 1).mean("rod"),
        "monotonically, %": 100 * (data.gamma < 1).mean("rod"),
        "largest rate": data.gamma.max("rod"),
        f"median RMS of trial {last.trial.item()}, K": last.median("rod"),
    }
    table = pd.DataFrame({name: column.to_series() for name, column in columns.items()})
    table.insert(0, "stable, %", 100 * (data.unstable_poles == 0).mean().item())
    return table


if __name__ == "__main__":
    main(*sys.argv[1:2])
