"""Tracked data: that they are what data/README.md says, and are read as ever."""

from hashlib import sha256

import numpy as np
import pandas as pd
import plants
import pytest

from ilctools import current_trial_loop, load_log, read_table
from ilctools.models import frequency_response
from rodlib.paper.repository import ROOT

TABLE = ROOT / "data" / "stage" / "closed-loop.csv"


def closed_loop(frequency, Ts=1e-3):
    """Around the stage with a sample more of delay than its model, with a scatter of 0.5 %."""
    omega = 2 * np.pi * frequency
    stage = plants.stage()
    loop = current_trial_loop(stage, ["F"], sizes={"x": 1.0, "F": 3.0})
    delay = np.exp(-1j * omega * Ts)[:, None, None]
    P = loop.frequency_response(omega, frequency_response(stage[:, ["F"]], omega) * delay)
    scatter = np.random.default_rng(1).standard_normal((2, len(omega)))
    return P[:, 0, 0] * (1 + 0.005 / np.sqrt(2) * (scatter[0] + 1j * scatter[1]))


def test_the_stages_response_is_that_of_the_loop_in_the_readme():
    frequency, gain, phase = np.loadtxt(TABLE, delimiter=",", unpack=True)
    np.testing.assert_array_equal(frequency, np.unique(np.geomspace(1, 499, 80).round(1)))
    P = closed_loop(frequency)
    np.testing.assert_allclose(gain, np.abs(P), rtol=5.1e-4)  # four digits
    angle = np.degrees(np.unwrap(np.angle(P)))
    np.testing.assert_allclose(phase, angle, atol=0.0051)


def digest(log):
    """Of the bits of y and u."""
    return sha256(log.y.values.tobytes() + log.u.values.tobytes()).hexdigest()[:16]


@pytest.mark.parametrize(
    ("name", "bits"), [("learning", "ee9c4aa582e466d9"), ("no-learning", "e3741c83237aab02")]
)
def test_the_logs_of_the_virtual_rig_are_read_bit_for_bit(name, bits):
    log = load_log(ROOT / "data" / "rig" / f"{name}.csv")
    assert digest(log) == bits
    assert log.attrs["origin"].startswith("synthetic")


@pytest.mark.skipif(pd.__version__ < "3.1", reason="it reads numbers to some units of a last digit")
@pytest.mark.parametrize(("Ts", "bits"), [(1, "18c6133dac4af475"), (3, "58f7c18481567ccd")])
def test_the_tables_of_the_boards_are_read_bit_for_bit(Ts, bits):
    inputs, outputs = (
        {f"{name}{k}": f"{word} {k}" for k in (1, 2)}
        for name, word in (("Q", "Heater"), ("T", "Temperature"))
    )
    path = ROOT / "data" / "tclab" / f"board-{Ts}s.csv"
    log = read_table(path, time="Time", inputs=inputs, outputs=outputs)
    assert log.attrs["Ts"] == Ts and digest(log) == bits
