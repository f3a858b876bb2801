"""Record the logs of a virtual rig in data/rig: ``python -m rodlib.paper.rig_logs``.

The rig has Peltier elements. Its map from heat flow to current is proportional, as if there were no
Joule heat. The inverse map would be an exact model between controller and rod.
"""

import json
from dataclasses import asdict

import numpy as np

from ilctools import Law, record, save_log
from ilctools.filters import LearningFilter, zero_phase_butterworth
from rodlib.case import assumed_disturbance, assumed_reference, paper_loop
from rodlib.paper import published
from rodlib.paper.repository import checkout
from rodlib.peltier_rig import PeltierElement, PeltierParameters, PeltierRig

PARAMETERS = PeltierParameters(known=PeltierElement(resistance=0.0))
# Recorded digits: heat flows in 0.1 mW, temperatures in 0.1 mK, v in 1 uK.
DECIMALS = {"v": 6, "u": 4, "delta": 4, "disturbance": 4}


def experiment() -> dict:
    """Return the arguments of `record` for both logs, without rig and law."""
    return {
        "loop": paper_loop(),
        "reference": np.round(assumed_reference(), 6),
        "disturbance": np.round(assumed_disturbance(), 6),
        "decimals": DECIMALS,
        "pause": 600,  # assumed, as are all these values
    }


def record_logs():
    """Record the two experiments of data/rig.

    Every run on one machine writes the same bytes. On another machine, the loop of the metadata may
    differ in its last digits. The signals are rounded.
    """
    folder = checkout("python -m rodlib.paper.rig_logs") / "data" / "rig"
    printed = LearningFilter(published.matrix("L_diagonal"), 1.0)
    for name, L, seed in (("learning", printed, 1), ("no-learning", None, 2)):
        print(f"recording {name} ...", flush=True)
        rig = PeltierRig(parameters=PARAMETERS, seed=seed)
        # The paper's law has no limits. The commands stay within the rig's limits.
        law = Law(zero_phase_butterworth(2, 0.1, 1.0), L, limits={})
        log = record(rig, law=law, **experiment())
        log.attrs["origin"] = "synthetic: virtual rig with Peltier elements, no laboratory data"
        log.attrs["rig"] = json.dumps(
            asdict(rig.parameters) | {"seed": seed, "rod": asdict(rig.linearised)}
        )
        save_log(log, folder / f"{name}.csv")


if __name__ == "__main__":
    record_logs()
