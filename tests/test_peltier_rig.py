from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from rodlib import Rod
from rodlib.peltier_rig import PeltierElement, PeltierParameters, PeltierRig

SILENT = PeltierParameters(noise=0, quantum=0, ambient_rate=0)
ROOM = SILENT.temperature


def test_the_element_has_the_data_sheet_of_a_common_one():
    """TEC1-12706, hot side at 25 degrees: 6.4 A and 66 K without heat, 50 W without difference."""
    element, hot = PeltierElement(), 298.15

    def pumped(current, cold):  # from the cold side, which is that of the rod
        return -element.heat(-current, cold, hot)

    most = minimize_scalar(lambda i: -pumped(i, hot), bounds=(0, 20), method="bounded")
    assert -most.fun == pytest.approx(50, rel=0.15)
    cold = np.linspace(200, hot, 20001)
    currents = element.seebeck * cold / element.resistance
    coldest = np.flatnonzero(pumped(currents, cold) > 0)[0]
    assert hot - cold[coldest] == pytest.approx(66, rel=0.05)
    assert currents[coldest] == pytest.approx(6.4, rel=0.15)


@given(
    heat=st.floats(-500, 500),
    resistance=st.sampled_from([0.0, 1e-9, 0.5, 2.0, 8.0]),
    sink=st.floats(250, 330),
)
def test_the_current_is_the_least_that_gives_the_heat_or_the_best(heat, resistance, sink):
    element = PeltierElement(resistance=resistance)
    current = element.current(heat, ROOM, sink)
    peltier = element.seebeck * ROOM
    assert resistance * current >= -peltier * (1 + 1e-12)  # beyond, more current cools less
    given_heat = element.heat(current, ROOM, sink)
    if resistance * current > -peltier * (1 - 1e-6):
        assert given_heat == pytest.approx(heat, abs=1e-9 * (500 + abs(peltier * current)))
    else:
        tried = element.heat(current * np.linspace(0.5, 1.5, 101), ROOM, sink)
        assert given_heat == pytest.approx(tried.min()) and given_heat >= heat - 1e-9


def reference_solution(rod, p, currents, ambient_rate, Ts):
    """Readings by scipy, from heat flows in watts and absolute temperatures."""
    cells, e = rod.sections * p.cells, p.element
    dz = rod.length / cells
    surface, section = rod.width * dz, rod.width * rod.height  # m2, of a cell
    middles = (np.arange(cells) + 0.5) * dz

    def slopes(t, x, current):
        theta, sinks, shown = np.split(x, [cells, cells + rod.sections])
        room = p.temperature + ambient_rate * t
        lost = p.convection * abs(theta - room) ** 0.25 * (theta - room)
        lost += p.emissivity * 5.670374419e-8 * (theta**4 - room**4)
        pumped = e.heat(current.repeat(p.cells), theta, sinks.repeat(p.cells)) / p.cells
        into = pumped - lost * surface
        conducted = rod.conductivity * section * np.diff(theta) / dz  # to the cell before
        into[:-1] += conducted
        into[1:] -= conducted
        mean = theta.reshape(-1, p.cells).mean(axis=1)
        power = e.seebeck * (mean - sinks) * current + e.resistance * current**2
        taken = e.heat(current, mean, sinks) - power
        warmed = (-taken - p.fan * (sinks - room)) / p.sink_capacity
        followed = (np.interp(rod.sensors, middles, theta) - shown) / p.lag
        mass = rod.density * rod.heat_capacity * section * dz  # J/K
        return np.concatenate([into / mass, warmed, followed])

    x, readings = np.full(cells + rod.sections + len(rod.sensors), p.temperature), []
    for k, current in enumerate(currents):
        readings.append(x[cells + rod.sections :] - p.temperature)
        span, tolerances = (k * Ts, (k + 1) * Ts), {"rtol": 1e-10, "atol": 1e-9}
        x = solve_ivp(slopes, span, x, "LSODA", args=(current,), **tolerances).y[:, -1]
    return np.array(readings)


def test_the_integration_is_that_of_scipy():
    """Large steps of the current, which heat the sinks; a step is off by its third order."""
    Ts, rod = 2.0, Rod(sections=3, sensors=(0.0, 0.15, 0.32), conductivity=200.0)
    parameters = replace(SILENT, cells=4, fan=1.0, sink_capacity=60.0, ambient_rate=0.01)
    rig = PeltierRig(rod, parameters, Ts)
    commands = np.random.default_rng(1).uniform(-50, 90, (6, rod.sections)).repeat(10, axis=0)
    currents, readings = [], []
    for command in commands:
        readings.append(rig.read())
        rig.apply(command)
        currents.append(rig.currents)
    expected = reference_solution(rod, parameters, currents, 0.01, Ts)
    assert np.abs(expected).max() > 5
    tolerance = 2e-4 * Ts**2 * np.abs(expected).max()
    np.testing.assert_allclose(readings, expected, atol=tolerance)


def test_a_current_stays_within_its_limit_and_within_what_cools():
    weak = replace(SILENT, element=PeltierElement(limit=2.0))
    strong = replace(SILENT, known=PeltierElement(resistance=6.0))
    for parameters, ends in ((weak, (-2.0, 2.0)), (strong, (-0.05 * ROOM / 6.0, 6.0))):
        rig = PeltierRig(parameters=parameters)
        low, high = rig.limits["Q1"]
        for asked in ([low, high, 0.0, 0.0], [low - 100, high + 100, 0.0, 0.0]):
            rig.apply(asked)
            np.testing.assert_allclose(rig.currents, [*ends, 0.0, 0.0], rtol=1e-7, atol=1e-12)
