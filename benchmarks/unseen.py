"""Eight plants for peers.py, written after the default had been frozen, and before any was run.

Each is a loop under its own controller, from the reference to what is measured, by its physics.
`off` is the share by which parameters are off: 0.1 and 0.2, to both sides; what they are is said
of each. The controller stays as it was designed for the nominal plant.
"""

import control
import numpy as np

S = control.tf("s")


def resonance(w, damping):
    """A system of second order with a gain of one."""
    return w**2 / (S**2 + 2 * damping * w * S + w**2)


def sampled(system, Ts, method="zoh"):
    """A plant behind a hold; of a controller, by Tustin's rule."""
    return control.sample_system(control.ss(system), Ts, method)


def closed(plant, controller, Ts, delay=0):
    """A loop with unit feedback, from its reference to its output; a delay of some samples."""
    late = control.ss(control.tf([1.0], [1.0, *np.zeros(delay)], Ts))
    G = sampled(plant, Ts) * late * sampled(controller, Ts, "tustin")
    return control.feedback(G, control.ss([], [], [], np.eye(G.noutputs), Ts))


def wafer(off):
    """A wafer stage at 10 kHz, with modes at 160, 330 and 560 Hz; its force constant is off.

    12 kg on a magnetic bearing, a loop of 45 Hz; the first two modes are within 400 Hz, up to which
    it learns.
    """
    Ts, mass, crossover = 1e-4, 12.0, 2 * np.pi * 45
    G = 1 / S**2
    for hertz, damping, share in ((160, 0.01, 0.05), (330, 0.008, -0.08), (560, 0.01, 0.06)):
        w = 2 * np.pi * hertz
        G = G + share / (S**2 + 2 * damping * w * S + w**2)
    lead = (3 * S / crossover + 1) / (S / (3 * crossover) + 1)
    C = mass * crossover**2 / 3 * lead * (1 + crossover / 6 / S) * resonance(8 * crossover, 0.7)
    return closed((1 + off) / mass * G, C, Ts, delay=1), 2 * np.pi * 400, 1000


def bearing(off):
    """A magnetic bearing, whose pull grows with the way: both of its constants are off."""
    Ts, mass, ki, ks = 1e-4, 2.5, 120.0 * (1 + off), 3e5 * (1 + off)  # kg, N/A, N/m
    amplifier = 1 / (S / 6000 + 1)
    C = 7000 * (1 + 40 / S) * (1 + S / 250) / (S / 5000 + 1)  # A/m
    return closed(ki / (mass * S**2 - ks) * amplifier, C, Ts, delay=1), 1000.0, 800


def plate(off):
    """Two heaters on one plate, which conducts so well that their difference hardly shows.

    All of it is off: capacities and losses are larger, the conductance and the heaters' powers
    smaller.
    """
    Ts, C, h, k = 1.0, np.array([40.0, 55.0]), 1.0, 30.0  # s, J/K, W/K
    C, h, k = C * (1 + off), h * (1 + off), k * (1 - off)
    A = np.array([[-h - k, k], [k, -h - k]]) / C[:, None]
    B = np.diag(1 - np.array([1.0, 0.5]) * off) / C[:, None]
    return sampled(control.ss(A, B, np.eye(2), 0), Ts), 0.15, 400


def quadruple(off):
    """Johansson's quadruple tank, non-minimum phase, with his PIs; pumps and outlets are off.

    K. H. Johansson, The quadruple-tank process, IEEE Transactions on Control Systems Technology 8
    (2000) 456-465: his P_+, K = 1.5 and -0.12, T_i = 110 and 220 s.
    """
    Ts, area, level = 5.0, np.array([28, 32, 28, 32.0]), np.array([12.6, 13.0, 4.8, 4.9])
    outlet = np.array([0.071, 0.057, 0.071, 0.057]) * (1 - off)
    (k1, k2), (g1, g2) = np.array([3.14, 3.29]) * (1 + off), (0.43, 0.34)
    rate = outlet / area * np.sqrt(981 / 2 / level)  # 1 / T
    A = np.diag(-rate)
    A[0, 2], A[1, 3] = rate[2] * area[2] / area[0], rate[3] * area[3] / area[1]
    B = np.array([[g1 * k1, 0], [0, g2 * k2], [0, (1 - g2) * k2], [(1 - g1) * k1, 0]])
    plant = control.ss(A, B / area[:, None], 0.5 * np.eye(2, 4), 0)
    PIs = [control.ss(K * (1 + 1 / (T * S))) for K, T in ((1.5, 110), (-0.12, 220))]
    return closed(plant, control.append(*PIs), Ts), 0.03, 800


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
    Ts, delay = 0.02, round(25 / (1 + off))
    late = control.ss(control.tf([1.0], [1.0, *np.zeros(delay)], Ts))
    dancer = resonance(9.0 * np.sqrt(1 + off), 0.15) / (S / 15 + 1)
    return late * sampled(dancer, Ts), 12.0, 500


def double_mass(off):
    """Of the tests of IterativeLearningControl2.jl; the load's inertia is off."""
    motor, load, k = 1.0, 1.0 + off, 100.0
    A = [[0, 1, 0, 0], [-k / motor, -2 / motor, k / motor, 1 / motor],
         [0, 0, 0, 1], [k / load, 1 / load, -k / load, -2 / load]]  # fmt: skip
    plant = control.ss(A, [[0], [1 / motor], [0], [0]], [[1, 0, 0, 0]], 0)
    C = control.ss(10 * (1 + 1 / S) * (1 + S) / (0.02 * S + 1))
    return sampled(control.feedback(plant * C, 1), 0.02), 140.0, 472


def their_reference():
    """Of the double mass, one channel."""
    s = np.sin(0.02 * np.arange(472))
    return (np.sign(s) * ((np.abs(s) + 0.01) ** 0.2 - 0.01**0.2))[:, None]


UNSEEN = {
    plant.__name__: plant
    for plant in (wafer, bearing, plate, quadruple, joint, spindle, web, double_mass)
}
