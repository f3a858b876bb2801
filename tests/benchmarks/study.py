"""The study of 10,000 rods: ``make study``, or ``python tests/benchmarks/study.py [scheduler]``.

With the address of a dask scheduler it runs on its workers. It goes on where it was interrupted.
"""

import sys

import pandas as pd

from rodlib.case import paper_loop
from rodlib.ilc.files import replacing
from rodlib.ilc.filters import LearningFilter, zero_phase_butterworth
from rodlib.paper import published
from rodlib.paper.repository import results
from rodlib.specimens import Spread
from rodlib.study import Study, run

RODS = 10_000
SPREADS = {"material": Spread(0.2, 0.2, 0.2, 0.2), "everything": Spread.of_all(0.2)}


def study(spread: Spread) -> Study:
    """The paper's two printed filters around rods that are off."""
    filters = {
        kind: LearningFilter(published.matrix(f"L_{kind}"), 1.0)
        for kind in ("diagonal", "full")
    }
    return Study(paper_loop(), zero_phase_butterworth(), filters, spread)


def main(scheduler: str | None = None, rods: int = RODS):
    """Run the study, print how many rods converge, and save what was found in build/study."""
    folder = results("make study") / "study"
    for name, spread in SPREADS.items():
        found = run(study(spread), rods, folder=folder, scheduler=scheduler)
        with replacing(folder / f"{name}.nc") as temporary:
            found.to_netcdf(temporary, engine="scipy")
        last = found.rms[..., -1]
        columns = {
            "converge, %": 100 * (found.spectral_rate < 1).mean("rod"),
            "monotonically, %": 100 * (found.rate < 1).mean("rod"),
            "largest rate": found.rate.max("rod"),
            f"median RMS of trial {last.trial.item()}, K": last.median("rod"),
        }
        table = pd.DataFrame(
            {name: column.to_series() for name, column in columns.items()}
        )
        table.insert(0, "stable, %", 100 * (found.unstable_poles == 0).mean().item())
        print(
            f"{rods} rods, {name} off by up to 20 %: {folder / name}.nc\n{table.round(3)}\n"
        )


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2])
    except RuntimeError as error:
        sys.exit(str(error))
