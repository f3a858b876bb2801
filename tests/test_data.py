"""Data that are not a log: that they are what data/README.md says."""

import numpy as np
import plants

from rodlib import current_trial_loop
from rodlib.ilc.models import frequency_response
from rodlib.paper.repository import ROOT

TABLE = ROOT / "data" / "stage" / "closed-loop.csv"


def closed_loop(frequency, Ts=1e-3):
    """Around the stage with a sample more of delay than its model, with a scatter of 0.5 %."""
    omega = 2 * np.pi * frequency
    stage = plants.stage()
    loop = current_trial_loop(stage, ["F"], sizes={"x": 1.0, "F": 3.0})
    delay = np.exp(-1j * omega * Ts)[:, None, None]
    P = loop.frequency_response(
        omega, frequency_response(stage[:, ["F"]], omega) * delay
    )
    scatter = np.random.default_rng(1).standard_normal((2, len(omega)))
    return P[:, 0, 0] * (1 + 0.005 / np.sqrt(2) * (scatter[0] + 1j * scatter[1]))


def table():
    """The text of the file."""
    frequency = np.unique(np.geomspace(1, 499, 80).round(1))
    P = closed_loop(frequency)
    lines = [
        "# synthetic: the closed position loop of a motion stage, see data/README.md"
    ]
    lines.append("# frequency (Hz), magnitude (mm/mm), phase (deg)")
    rows = zip(frequency, np.abs(P), np.degrees(np.unwrap(np.angle(P))), strict=True)
    return "\n".join(
        [*lines, *(f"{f:.1f},{gain:.4g},{phase:.2f}" for f, gain, phase in rows), ""]
    )


def test_the_stages_response_is_that_of_the_loop_in_the_readme():
    assert TABLE.read_text(encoding="utf-8") == table()
