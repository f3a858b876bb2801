import sys
from unittest.mock import Mock

import control
import numpy as np
import pytest
from rods import readings_of

from rodlib import boards
from rodlib.boards import TemperatureControlLab, heat_balance

tclab = pytest.importorskip("tclab")

# of the emulator: TCLabModel.update
TRUE = [200 / 5720, 100 / 5720, 1 / 20, 1 / 100, 140.0]


@pytest.fixture
def undisturbed(monkeypatch):
    """The emulator with thermometers that show what is there."""
    monkeypatch.setattr(tclab.TCLabModel, "measurement", lambda self, T: T)


def test_the_emulator_is_a_heat_balance(undisturbed):
    """Solved by Euler's method: half the step, half the difference."""
    u = np.repeat([[20.0, 0.0], [0.0, 0.0], [-10.0, 40.0]], 100, axis=0)
    model = control.forced_response(heat_balance(*TRUE, 2.0), inputs=u.T).outputs.T
    differences = []
    for step in (0.2, 0.1):
        rig = TemperatureControlLab(wait=3000.0)
        rig.lab.maxstep = step
        rig.begin(1)
        differences.append(np.abs(readings_of(rig, u) - model).max())
    assert differences[0] < 0.005 * np.ptp(model)
    assert differences[1] == pytest.approx(differences[0] / 2, rel=0.05)


def test_every_trial_begins_at_rest(undisturbed):
    rig = TemperatureControlLab(wait=3000.0)
    with pytest.raises(RuntimeError, match="call begin first"):
        rig.read()
    for trial in (1, 2):
        rig.begin(trial)
        zero = rig.zero
        assert np.abs(rig.read()).max() < 1e-6
        for _ in range(100):
            rig.apply([20, 20])
        assert rig.read().min() > 5
    assert rig.zero is zero and np.all(zero > [35, 30])


def test_heaters_are_cut_off_where_they_end():
    rig = TemperatureControlLab(rest=(30, 40))
    assert rig.limits == {"Q1": (-30, 70), "Q2": (-40, 60)}
    for asked, applied in [([10, -10], (40, 30)), ([-31, 61], (0, 100))]:
        rig.apply(asked)
        assert (rig.lab.Q1(), rig.lab.Q2()) == applied
    rig.safe()
    assert (rig.lab.Q1(), rig.lab.Q2()) == (0, 0)
    with pytest.raises(ValueError, match="heaters"):
        rig.apply([1, 2, 3])


class Clock:
    """Stands in for the module time: it stands still but for sleep."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


def heaters(kit):
    """What both were set to last."""
    return kit.Q1.call_args.args + kit.Q2.call_args.args


def test_the_kit_is_waited_for_and_a_delay_is_caught_up(monkeypatch):
    clock = Clock()
    kit = Mock(T1=21.0, T2=21.0)
    monkeypatch.setattr(tclab, "TCLab", lambda: kit)
    monkeypatch.setattr(boards, "time", clock)
    rig = TemperatureControlLab(kit=True)
    clock.now += 100  # of no concern before it begins
    rig.begin(1)
    assert rig.clock() == 2000 and heaters(kit) == (30, 40)
    assert rig.read().tolist() == [0, 0]
    clock.now += 0.5
    rig.apply([1.0, 2.0])
    assert clock.now == 2002 and heaters(kit) == (31, 42)
    clock.now += 2.5
    rig.apply([0, 0])
    assert clock.now == 2004.5
    rig.apply([0, 0])
    assert clock.now == 2006
    rig.safe()
    assert heaters(kit) == (0, 0)


@pytest.mark.parametrize(
    ("name", "value"),
    [("kit", "yes"), ("rest", (30, 101)), ("Ts", 61.0), ("wait", 59.0), ("seed", -1)],
)
def test_bad_arguments_are_refused_before_anything_is_connected(name, value, monkeypatch):
    monkeypatch.setitem(sys.modules, "tclab", None)
    with pytest.raises(ValueError, match=f"{name} = "):
        TemperatureControlLab(**{name: value})
