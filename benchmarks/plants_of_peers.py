"""Twenty plants for peers.py: each is a loop under its own controller, by its physics.

`off` is the share by which parameters are off, 0.1 and 0.2, to both sides; what they are is said of
each. The controller stays as it was designed for the nominal plant. With P come the cut-off of Q,
rad/s, and the samples of a trial.
"""

import control
import numpy as np
from kinds import EXCHANGE, S, delay, resonance, sampled


def closed(plant, controller, Ts, late=0):
    """A loop with unit feedback, a controller by Tustin's rule and a delay of some samples."""
    G = sampled(plant, Ts) * delay(late, Ts) * sampled(controller, Ts, "tustin")
    return control.feedback(G, np.eye(G.noutputs))


def lead(crossover):
    """What a mass of 1 kg needs for such a crossover."""
    ahead = (3 * S / crossover + 1) / (S / (3 * crossover) + 1)
    return crossover**2 / 3 * ahead * resonance(8 * crossover, 0.7)


# Resonant ones.


def stage(off):
    """A controller that leaves a resonance within the cut-off; its stiffness is off."""
    return sampled(resonance(62.8 * np.sqrt(1 - off), 0.05), 1e-3), 100.0, 1000


def arm(off):
    """A well damped loop with a sharp resonance beyond the cut-off; both stiffnesses are off."""
    w = np.sqrt(1 - off)
    return sampled(0.95 * resonance(50 * w, 0.7) + 0.05 * resonance(151 * w, 0.01), 1e-3), 60.0, 800


def belt(off):
    """A load behind a belt, with an antiresonance below its resonance; its stiffness is off."""
    w = np.sqrt(1 - off)
    P = resonance(40 * w, 0.05) / resonance(30 * w, 0.05) * 60 / (S + 60)
    return sampled(P, 5e-3), 60.0, 600


def converter(off):
    """The filter of a power converter, by its circuit; off in both of its parts."""
    L, C = 1e-3 * (1 + off), 1e-3 * (1 - off)
    P = 1 / (L * C * S**2 + (0.2 * C + L / 5) * S + 1.04)
    return sampled(P, 2e-4), 1500.0, 400


# Written after an earlier default had been frozen, and before any was run.


def wafer(off):
    """A wafer stage at 10 kHz, with modes at 160, 330 and 560 Hz; its force constant is off.

    12 kg on a magnetic bearing, a loop of 45 Hz; the first two modes are within 400 Hz, up to which
    it learns.
    """
    mass, crossover = 12.0, 2 * np.pi * 45
    G = 1 / S**2
    for hertz, damping, share in ((160, 0.01, 0.05), (330, 0.008, -0.08), (560, 0.01, 0.06)):
        w = 2 * np.pi * hertz
        G = G + share / w**2 * resonance(w, damping)
    C = mass * lead(crossover) * (1 + crossover / 6 / S)
    return closed((1 + off) / mass * G, C, 1e-4, late=1), 2 * np.pi * 400, 1000


def bearing(off):
    """A magnetic bearing, whose pull grows with the way: both of its constants are off."""
    mass, ki, ks = 2.5, 120.0 * (1 + off), 3e5 * (1 + off)  # kg, N/A, N/m
    amplifier = 1 / (S / 6000 + 1)
    C = 7000 * (1 + 40 / S) * (1 + S / 250) / (S / 5000 + 1)  # A/m
    return closed(ki / (mass * S**2 - ks) * amplifier, C, 1e-4, late=1), 1000.0, 800


def plate(off):
    """Two heaters on one plate, which conducts so well that their difference hardly shows.

    All of it is off: capacities and losses are larger, the conductance and the heaters' powers
    smaller.
    """
    C, h, k = np.array([40.0, 55.0]) * (1 + off), 1.0 + off, 30.0 * (1 - off)  # J/K, W/K
    A = np.array([[-h - k, k], [k, -h - k]]) / C[:, None]
    B = np.diag([1 - off, 1 - 0.5 * off] / C)
    return sampled(control.ss(A, B, np.eye(2), 0), 1.0), 0.15, 400


def quadruple(off):
    """Johansson's quadruple tank, non-minimum phase, with his PIs; pumps and outlets are off.

    K. H. Johansson, The quadruple-tank process, IEEE Transactions on Control Systems Technology 8
    (2000) 456-465: his P_+, K = 1.5 and -0.12, T_i = 110 and 220 s.
    """
    area, level = np.array([28, 32, 28, 32.0]), np.array([12.6, 13.0, 4.8, 4.9])
    outlet = np.array([0.071, 0.057, 0.071, 0.057]) * (1 - off)
    flow = outlet * np.sqrt(981 / 2 / level)  # cm3/s per cm
    A = (np.diag(flow[2:], 2) - np.diag(flow)) / area[:, None]
    B = np.array([[0.43, 0], [0, 0.34], [0, 0.66], [0.57, 0]]) * [3.14, 3.29] * (1 + off)
    plant = control.ss(A, B / area[:, None], 0.5 * np.eye(2, 4), 0)
    PIs = [control.ss(K * (1 + 1 / (T * S))) for K, T in ((1.5, 110), (-0.12, 220))]
    return closed(plant, control.append(*PIs), 5.0), 0.03, 800


def joint(off):
    """A load behind an elastic joint, its resonance at 80 of 100 rad/s; its inertia is off."""
    w = 80 / np.sqrt(1 + off)
    return sampled(resonance(70.0, 0.8) * resonance(w, 0.04), 2e-3), 100.0, 900


def spindle(off):
    """A motor that drives a load through a shaft, seen at the motor; the load's inertia is off.

    Its antiresonance, at 30 rad/s, is below the cut-off.
    """
    motor, load, k, d = 0.02, 0.03 * (1 + off), 27.0, 0.02  # kg m2, Nm/rad, Nms/rad
    shaft = k + d * S
    G = (load * S**2 + shaft) / (S * (motor * load * S**2 + (motor + load) * shaft))
    return closed(G, 1.5 * (1 + 5 / S) / (S / 300 + 1), 2e-3), 70.0, 800


def web(off):
    """A web of paper: 25 samples to the gauge and a dancer roll; its speed and spring are off."""
    Ts, dancer = 0.02, resonance(9.0 * np.sqrt(1 + off), 0.15) / (S / 15 + 1)
    return delay(round(25 / (1 + off)), Ts) * sampled(dancer, Ts), 12.0, 500


def double_mass(off):
    """Of the tests of IterativeLearningControl2.jl; the load's inertia is off."""
    shaft = S + 100.0
    motor, load = S**2 + S + shaft, (1.0 + off) * S**2 + S + shaft
    G = load / (motor * load - shaft**2)
    C = 10 * (1 + 1 / S) * (1 + S) / (0.02 * S + 1)
    return sampled(control.feedback(G * C, 1), 0.02), 140.0, 472


def their_reference():
    """Of the double mass, one channel."""
    s = np.sin(0.02 * np.arange(472))
    return (np.sign(s) * ((np.abs(s) + 0.01) ** 0.2 - 0.01**0.2))[:, None]


# Written before L = B with b = 1 / (2 L_max) was run on any.


def crane(off):
    """A trolley under a servo, seen at the load that swings below it; the rope is longer.

    The load's damping is 0.08, its frequency 1.6 rad/s, the cut-off twice that.
    """
    w = 1.6 / np.sqrt(1 + off)
    return sampled(resonance(5.0, 0.8) * resonance(w, 0.08), 0.02), 3.2, 1000


def cylinder(off):
    """A hydraulic cylinder, an integrator with an oil column at 60 rad/s; the oil is softer."""
    w = 60 * np.sqrt(1 - off)
    return closed(resonance(w, 0.2) / S, 12 * (1 + 0.5 / S), 1e-3, late=2), 50.0, 1200


def galvo(off):
    """A mirror at 50 kHz with a torsional mode at 3 kHz and four samples of delay; its inertia."""
    w = 2 * np.pi * 3000 / np.sqrt(1 + off)
    G = (1 / (1 + off)) * (1 / S**2 + 0.3 / w**2 * resonance(w, 0.01))
    return closed(G, lead(2 * np.pi * 400), 2e-5, late=4), 2 * np.pi * 1200, 800


def climb(off):
    """An aircraft's climb angle, which answers to the elevator the wrong way first.

    The zero, at 8 rad/s outside, and the pitch mode are off: it is heavier.
    """
    w, zero = 3.0 / np.sqrt(1 + off), 8.0 * (1 - off)
    return sampled((1 - S / zero) * resonance(w, 0.5) / (S / 15 + 1), 0.02), 6.0, 600


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
    ways = 0.7 / (5 * S + 1) + 0.3 * (1 + off) / (120 * (1 + off) * S + 1)
    return delay(round(8 * (1 + off)), 1.0) * sampled(ways, 1.0), 0.25, 500


def extruder(off):
    """Three zones of a barrel under PIs, each of which heats its neighbours; the barrel is heavier.

    The PIs are tuned for the zones by themselves.
    """
    C = np.array([180.0, 220.0, 160.0]) * (1 + off)  # J/K
    A = (2.5 * EXCHANGE - 1.2 * np.eye(3)) / C[:, None]  # W/K
    heaters = control.append(*[control.ss(1 / (6 * S + 1))] * 3)
    PIs = control.append(*[control.ss(8 * (1 + 1 / (60 * S)))] * 3)
    plant = control.ss(A, np.diag(1 / C), np.eye(3), 0)
    return closed(plant * heaters, PIs, 2.0), 0.15, 400


def tower(off):
    """Two floors of a shaken building with modes a sixth apart; the upper one is heavier.

    The two actuators push both of them, with gains that a controller's designer would call coupled.
    """
    k, gains = 900 * np.array([[2.0, -0.3], [-0.3, 2]]), 1700 * np.array([[1.0, 0.4], [-0.2, 1]])
    mass, none = np.array([[1.0], [1.2 * (1 + off)]]), np.zeros((2, 2))
    A = np.block([[none, np.eye(2)], [-k / mass, -4.0 * np.eye(2) / mass]])
    B = np.vstack([none, gains / mass])
    return sampled(control.ss(A, B, np.eye(2, 4), 0), 2e-3), 60.0, 900


PLANTS = {
    plant.__name__: plant
    for plant in (
        stage, arm, belt, converter,
        wafer, bearing, plate, quadruple, joint, spindle, web, double_mass,
        crane, cylinder, galvo, climb, suspension, exchanger, extruder, tower,
    )
}  # fmt: skip
