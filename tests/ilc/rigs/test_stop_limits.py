"""What a rig says about its actuators: on plants of one, two and three channels."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import furnace, stage, tanks

from rodlib import current_trial_loop, measured_response, multisine, shake
from rodlib.ilc.law.limits import commands_beyond
from rodlib.ilc.models import sampled_plant

CASES = {  # loop, lowest and highest frequency (rad/s), amplitude, hours
    "stage": (lambda: current_trial_loop(stage(), ["F"], sizes={"x": 1.0, "F": 3.0}),
              100.0, 1500.0, 1.0, 0.0005),
    "tanks": (lambda: current_trial_loop(tanks(), ["pump A", "pump B", "pump C"]),
              0.1, 1.0, [1.0, 2.0, 1.0], 0.5),
    "furnace": (lambda: current_trial_loop(furnace(10)), 0.08, 1.5, 1.0, 0.4),
}  # fmt: skip


class Clipped:
    """The plant of a loop whose first control is cut off at a limit."""

    def __init__(self, loop, limit=np.inf):
        self.plant, self.inputs = sampled_plant(loop.plant), loop.controls
        self.limits = {loop.controls[0]: (-limit, limit)} if np.isfinite(limit) else {}
        self.x = np.zeros(self.plant.nstates)

    def read(self):
        return self.plant.C @ self.x

    def apply(self, u):
        u = np.array(u)
        if self.limits:
            u[0] = np.clip(u[0], *self.limits[self.inputs[0]])
        self.x = self.plant.A @ self.x + self.plant.B[:, : len(u)] @ u


@pytest.mark.parametrize("case", CASES)
def test_what_is_cut_off_is_told_and_what_is_not_is_not(case):
    make, lowest, highest, amplitude, hours = CASES[case]
    loop = make()
    excitation = multisine(loop, lowest, highest, amplitude, hours, lines=8)
    free = shake(Clipped(loop), loop, excitation)
    largest = np.abs(free.u.values[..., 0]).max()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wide = shake(Clipped(loop, 1.01 * largest), loop, excitation)
    np.testing.assert_array_equal(wide.u, free.u)
    with pytest.warns(UserWarning, match="commands were beyond") as told:
        tight = shake(Clipped(loop, 0.7 * largest), loop, excitation)
    over = np.abs(tight.u.values[..., 0]) > 0.7 * largest
    name = loop.controls[0]
    assert [str(one.message).split(" of all")[0] for one in told] == [
        f"trial {k + 1}: commands were beyond the limits of {name} in {part.mean():.1%}"
        for k, part in enumerate(over)
        if part.any()
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        measured, doubted = measured_response(wide), measured_response(tight)
    assert not any("beyond the limits" in finding for finding in measured.findings)
    assert f"limits of {name} in {over.mean():.1%} of all" in doubted.findings[0]
    truth = loop.frequency_response(excitation.omega)
    off = [
        np.linalg.norm(one.response - truth, 2, axis=(1, 2)).max()
        for one in (measured, doubted)
    ]
    assert off[1] > 10 * off[0]


@given(
    st.lists(st.integers(-5, 5), min_size=1, max_size=30),
    st.integers(-5, 4),
    st.integers(1, 5),
)
def test_the_share_is_that_of_the_samples_beyond_either_end(commands, low, width):
    u = np.array(commands, dtype=float)[:, None] * [1, 0]
    expected = sum(not low <= value <= low + width for value in commands) / len(
        commands
    )
    said = commands_beyond(u, ["fan", "belt"], {"fan": (low, low + width)})
    assert (
        (f" of fan in {expected:.1%} of all samples" in said)
        == bool(said)
        == bool(expected)
    )
    assert commands_beyond(u, ["fan", "belt"], {}) == ""
