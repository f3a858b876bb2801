"""Eight more plants for peers.py, written before L = B with b = 1 / (2 L_max) was run on any.

As in unseen.py each is a loop under its own controller, and `off` is the share by which parameters
are off; what they are is said of each.
"""

import control
import numpy as np
from unseen import S, closed, resonance, sampled


def crane(off):
    """A trolley under a servo, seen at the load that swings below it; the rope is longer.

    The load's damping is 0.08, its frequency 1.6 rad/s, the cut-off twice that.
    """
    w = 1.6 / np.sqrt(1 + off)
    return sampled(resonance(5.0, 0.8) * resonance(w, 0.08), 0.02), 3.2, 1000


def cylinder(off):
    """A hydraulic cylinder, an integrator with an oil column at 60 rad/s; the oil is softer."""
    w = 60 * np.sqrt(1 - off)
    C = 12 * (1 + 0.5 / S)
    return closed(resonance(w, 0.2) / S, C, 1e-3, delay=2), 50.0, 1200


def galvo(off):
    """A mirror at 50 kHz with a torsional mode at 3 kHz and four samples of delay; its inertia."""
    w = 2 * np.pi * 3000 / np.sqrt(1 + off)
    G = (1 / (1 + off)) * (1 / S**2 + 0.3 / (S**2 + 0.02 * w * S + w**2))
    crossover = 2 * np.pi * 400
    lead = (3 * S / crossover + 1) / (S / (3 * crossover) + 1)
    C = crossover**2 / 3 * lead * resonance(8 * crossover, 0.7)
    return closed(G, C, 2e-5, delay=4), 2 * np.pi * 1200, 800


def climb(off):
    """An aircraft's climb angle, which answers to the elevator the wrong way first.

    The zero, at 8 rad/s outside, and the pitch mode are off: it is heavier.
    """
    w, zero = 3.0 / np.sqrt(1 + off), 8.0 * (1 - off)
    G = (1 - S / zero) * resonance(w, 0.5) / (S / 15 + 1)
    return sampled(G, 0.02), 6.0, 600


def suspension(off):
    """A quarter of a car on a test rig, from the commanded to the measured height of its body.

    A stiff actuator below the wheel, 300 kg on 40 kg: the body is heavier.
    """
    M, m, ks, kt, d = 300 * (1 + off), 40.0, 16e3, 160e3, 1500.0
    suspended = d * S + ks
    G = kt * suspended / ((M * S**2 + suspended) * (m * S**2 + suspended + kt) - suspended**2)
    return sampled(G * 1 / (S / 120 + 1), 2e-3), 40.0, 1000


def exchanger(off):
    """A heat exchanger with a fast and a slow way to the outlet, and a pipe of eight samples."""
    Ts, delay = 1.0, round(8 * (1 + off))
    late = control.ss(control.tf([1.0], [1.0, *np.zeros(delay)], Ts))
    ways = 0.7 / (5 * S + 1) + 0.3 * (1 + off) / (120 * (1 + off) * S + 1)
    return late * sampled(ways, Ts), 0.25, 500


def extruder(off):
    """Three zones of a barrel under PIs, each of which heats its neighbours; the barrel is heavier.

    The PIs are tuned for the zones by themselves.
    """
    Ts, loss, across = 2.0, 1.2, 2.5  # s, W/K, W/K
    exchange = across * np.array([[-1.0, 1, 0], [1, -2, 1], [0, 1, -1]])
    C = np.array([180.0, 220.0, 160.0]) * (1 + off)
    plant = control.ss((exchange - loss * np.eye(3)) / C[:, None], np.diag(1 / C), np.eye(3), 0)
    heaters = control.append(*[control.ss(1 / (6 * S + 1))] * 3)
    PIs = control.append(*[control.ss(8 * (1 + 1 / (60 * S)))] * 3)
    return closed(plant * heaters, PIs, Ts), 0.15, 400


def tower(off):
    """Two floors of a shaken building with modes a sixth apart; the upper one is heavier.

    The two actuators push both of them, with gains that a controller's designer would call coupled.
    """
    k, d = np.array([[2.0, -0.3], [-0.3, 2.0]]) * 900, 4.0
    mass = np.array([1.0, 1.2 * (1 + off)])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-k / mass[:, None], -d * np.diag(1 / mass)]])
    B = np.vstack([np.zeros((2, 2)), np.array([[1.0, 0.4], [-0.2, 1.0]]) * 1700 / mass[:, None]])
    return sampled(control.ss(A, B, np.eye(2, 4), 0), 2e-3), 60.0, 900


EIGHT = {
    plant.__name__: plant
    for plant in (crane, cylinder, galvo, climb, suspension, exchanger, extruder, tower)
}
