"""Ten kinds of plants: what the toolbox is given of each, and what stands on the bench.

A rig is another plant than the model: parameters are off, by `off` times some ten percent; sensors
have noise, actuators have limits, and what is not linear is simulated so. whole_way.py uses them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import accumulate

import control
import numpy as np
import plants

from ilctools import ClosedLoop, current_trial_loop, measured_response, multisine, shake
from ilctools.models import frequency_response

S = control.tf("s")
EXCHANGE = np.array([[-1.0, 1, 0], [1, -2, 1], [0, 1, -1]])  # of three in a row


def resonance(w, damping):
    """A system of second order with a gain of one."""
    return w**2 / (S**2 + 2 * damping * w * S + w**2)


def sampled(system, Ts, method="zoh"):
    """A plant behind a hold; of a controller, by Tustin's rule."""
    return control.sample_system(control.ss(system), Ts, method)


def delay(samples, Ts):
    """A pipe of some samples."""
    return control.ss(control.tf([1.0], [1.0, *np.zeros(samples)], Ts))


@dataclass(frozen=True)
class Plant:
    """What stands on the bench: x(p + 1) = step(x, u), y = C x; zero is where it rests."""

    step: Callable
    C: np.ndarray
    noise: float | np.ndarray  # standard deviation of the sensors
    limits: dict = field(default_factory=dict)  # of the inputs, by name

    def linear(self, Ts, inputs, outputs):
        """The plant at rest, by differences; names are those of the loop."""
        names, states = {"inputs": inputs, "outputs": outputs}, self.C.shape[1]
        system = control.nlsys(
            lambda t, x, u, parameters: self.step(x, u),
            lambda t, x, u, parameters: self.C @ x,
            states=states, dt=Ts, **names,
        )  # fmt: skip
        return control.ss(control.linearize(system, np.zeros(states), 0), **names)


@dataclass(frozen=True)
class Kind:
    """One kind: what the toolbox is given, what stands on the bench, and what the user asks for."""

    loop: object
    bench: Plant
    reference: np.ndarray
    cutoff: float  # of Q, rad/s
    known: object = None  # what is known of P, if it is not the loop
    sliding: Plant | None = None  # for the check, if the bench has no slope at rest
    homes: bool = True  # whether every trial begins by a homing run

    @property
    def given(self):
        """What the design is given."""
        return self.loop if self.known is None else self.known

    @property
    def P(self):
        """P of the loop around the linear plant on the bench."""
        loop, plant = self.loop, self.sliding or self.bench
        plant = plant.linear(loop.Ts, loop.commands, loop.outputs)
        if isinstance(loop, ClosedLoop):
            return plant
        return loop.around(plant)[:, : len(loop.outputs)]


class Driver:
    """The bench, sample by sample."""

    def __init__(self, kind):
        self.bench, self.limits = kind.bench, kind.bench.limits
        self.low, self.high = np.array([*self.limits.values()] or [(-np.inf, np.inf)]).T
        self.start(0)
        if kind.homes:
            self.begin = self.start

    def start(self, trial):
        """At rest; the noise of a trial depends on its number alone."""
        self.x = np.zeros(self.bench.C.shape[1])
        self.random = np.random.default_rng([7, trial])

    def read(self):
        y = self.bench.C @ self.x
        return y + self.bench.noise * self.random.standard_normal(len(y))

    def apply(self, u):
        self.x = self.bench.step(self.x, np.clip(u, self.low, self.high))


def bump(samples, heights):
    """Rest, up, and back to rest: as smooth as a cosine, one for each channel."""
    t = np.clip((np.arange(samples) / samples - 0.1) / 0.7, 0, 1)
    return np.outer(np.sin(np.pi * t) ** 2, heights)


def flow(f, Ts, steps=1):
    """One sampling period of dx/dt = f(x, u) with u held, by Runge and Kutta."""
    h = Ts / steps

    def step(x, u):
        for _ in range(steps):
            a = f(x, u)
            b = f(x + h / 2 * a, u)
            c = f(x + h / 2 * b, u)
            x = x + h / 6 * (a + 2 * b + 2 * c + f(x + h * c, u))
        return x

    return step


def of_model(model, Ts, noise, **limits):
    """A bench whose dynamics are those of a linear model."""
    model = control.ss(model) if model.dt else sampled(model, Ts)
    return Plant(lambda x, u: model.A @ x + model.B @ u, model.C, noise, limits)


def our_loop(plant, Ts, commands, outputs, **weights):
    """The loop that a user closes around the linear model of a plant, from sizes of its signals."""
    model = plant.linear(Ts, [*commands], [*outputs])
    return current_trial_loop(model, sizes=commands | outputs, **weights)


def tanks(off):
    """Three tanks in a row, a pump each that gives 52 ml/s at most; outlets as Torricelli says."""
    Ts, pumps = 2.0, ["pump A", "pump B", "pump C"]

    def plant(area=150.0, pipe=12.0, outlet=1.0):
        def flows(x, u):  # about a level of 20 cm
            out = outlet * (np.sqrt(20 * np.maximum(20 + x, 0)) - 20)
            return (pipe * EXCHANGE @ x - 2 * out + u) / area

        limits = dict.fromkeys(pumps, (-15.0, 12.0))
        return Plant(flow(flows, Ts), np.eye(3), 0.02, limits)

    levels = dict.fromkeys(["left", "middle", "right"], 5.0)
    loop = our_loop(plant(), Ts, dict.fromkeys(pumps, 20.0), levels)
    bench = plant(150 * (1 + 0.1 * off), 12 * (1 - 0.15 * off), 1 + 0.15 * off)
    return Kind(loop, bench, bump(300, [5.0, 4.5, 4.8]), 0.1, homes=False)


def column(off):
    """Skogestad's distillation column: it answers to one direction a hundred times as much."""
    Ts, gains = 60.0, np.array([[0.878, -0.864], [1.082, -1.096]])

    def plant(error):
        T = 75 * 60 * (1 + 0.1 * error)
        B = gains @ np.diag([1 + 0.1 * error, 1 - 0.1 * error]) / T
        return of_model(control.ss(-np.eye(2) / T, B, np.eye(2), 0), Ts, 0.005)

    actuators = {"reflux": 20.0, "boilup": 20.0}
    loop = our_loop(plant(0), Ts, actuators, {"top": 1.0, "bottom": 1.0})
    return Kind(loop, plant(off), bump(400, [1.0, -0.5]), 0.1 / Ts)


def piezo(off):
    """A piezo at 10 kHz, a resonance at 800 Hz, damping 0.02."""
    Ts = 1e-4

    def plant(hertz):
        return of_model(resonance(2 * np.pi * hertz, 0.02), Ts, 1e-3, V=(-10.0, 10.0))

    loop = our_loop(plant(800), Ts, {"V": 1.0}, {"um": 1.0})
    return Kind(loop, plant(800 - 40 * off), bump(600, [2.0]), 2 * np.pi * 300)


def furnace(off):
    """A valve, a lag, and a pipe of 30 samples to the thermometer."""

    def plant(gain=1.0, delay=30):
        return of_model(plants.furnace(delay, gain=gain), 1.0, 0.01)

    # By the default weights the loop bears one sample of delay more: the error says "a larger Ro".
    loop = our_loop(plant(), 1.0, {"valve": 1.0}, {"outlet": 4.0}, Ro=[[1600.0]])
    bench = plant(1 + 0.1 * off, 30 + round(2 * off))
    return Kind(loop, bench, bump(500, [5.0]), 0.05, homes=False)


def motor(off):
    """A motor with inertia, known from an ARX fit to a noisy step test."""
    Ts, random = 0.01, np.random.default_rng(3)

    def plant(inertia=2e-4, friction=1e-4):
        def flows(x, u):  # speed, current; R = 1 ohm, L = 5 mH, k = 0.05
            torque, voltage = 0.05 * x[1] - friction * x[0], u[0] - x[1] - 0.05 * x[0]
            return np.array([torque / inertia, voltage / 0.005])

        return Plant(flow(flows, Ts, 4), np.eye(1, 2), 0.05, {"V": (-24.0, 24.0)})

    u = np.repeat(random.choice([-6.0, 6.0], 100), 10)
    states = [*accumulate(u[:-1, None], plant().step, initial=np.zeros(2))]
    y = np.array(states)[:, 0] + 0.05 * random.standard_normal(len(u))
    past = np.column_stack([y[1:-1], y[:-2], u[1:-1], u[:-2]])
    a1, a2, b1, b2 = np.linalg.lstsq(past, y[2:], rcond=None)[0]
    model = control.tf([b1, b2], [1, -a1, -a2], Ts, inputs=["V"], outputs=["speed"])
    loop = current_trial_loop(model, sizes={"speed": 100.0, "V": 12.0})
    bench = plant(2e-4 * (1 + 0.2 * off), 1e-4 * (1 + 0.5 * off))
    return Kind(loop, bench, bump(200, [150.0]), 40.0)


def levitation(off):
    """A ball under a magnet, held by a PD of its own, so that P(0) is not one."""
    Ts, g, gap = 1e-3, 9810.0, 10.0  # s, mm/s2, mm

    def plant(force):  # of the magnet; at its trim the current holds the ball
        def flows(x, u):  # mm, downwards, and mm/s; w moves the set point
            current = 1 / np.sqrt(force) + 0.25 * (x[0] - u[0]) + 0.004 * x[1]
            pull = force * (current * gap / max(gap + x[0], 1.0)) ** 2
            return np.array([x[1], g * (1 - pull)])

        return Plant(flow(flows, Ts, 2), np.eye(1, 2), 2e-3, {"w1": (-5.0, 5.0)})

    loop = ClosedLoop(plant(1.0).linear(Ts, ["w1"], ["gap"]))
    return Kind(loop, plant(1 + 0.15 * off), bump(400, [2.0]), 60.0)


def plc(off):
    """Two coupled ovens under PIDs in a PLC, known only by shaking: all goes through w."""
    Ts, ovens = 0.5, ["oven A", "oven B"]

    def plant(gain, lag):
        def step(x, w):  # two lags, an integrator for each, which does not wind up
            T, before, integral = x[:2], x[2:4], x[4:]
            wanted = 3.0 * (w - T) + integral
            u = np.clip(wanted, -30.0, 70.0)
            integral = integral + (u == wanted) * 3.0 * Ts / 15.0 * (w - T)
            heat = gain * (u + 0.2 * u[::-1])
            T = T + Ts / lag * (before - T)
            return np.concatenate([T, before + Ts / 3.0 * (heat - before), integral])

        return Plant(step, np.eye(2, 6), 0.02)

    loop = ClosedLoop(Ts=Ts, outputs=ovens, units=dict.fromkeys(ovens, "K"))
    shaken = Kind(loop, plant(1.0, 20.0), np.zeros((1, 2)), 0.2)
    excitation = multisine(loop, 0.02, 1.5, 2.0, 2.0)
    P = measured_response(shake(Driver(shaken), loop, excitation))
    bench = plant(1.0 - 0.1 * off, 20.0 * (1 + 0.1 * off))
    return Kind(loop, bench, bump(300, [10.0, 6.0]), 0.2, known=P)


def table(off):
    """A stage under its own controller, measured up to 100 of 500 Hz; above is a resonance."""
    Ts, w, upper = 1e-3, 2 * np.pi * 30, 2 * np.pi * 160

    def plant(w, upper):
        return sampled(resonance(w, 0.6) * (0.97 + 0.03 * resonance(upper, 0.01)), Ts)

    random = np.random.default_rng(5)
    omega = 2 * np.pi * np.geomspace(0.5, 100, 150)
    P = frequency_response(plant(w, upper), omega)[:, 0, 0]
    P = P + 0.003 * (random.standard_normal((2, 150)).T @ [1, 1j])
    bench = of_model(plant(w * (1 - 0.1 * off), upper * (1 - 0.05 * off)), Ts, 2e-3)
    loop = ClosedLoop(Ts=Ts, outputs=["x"])
    return Kind(loop, bench, bump(400, [5.0]), w, known=control.frd(P, omega))


def gantry(off):
    """Two axes with dry friction, which their models do not have."""
    Ts, forces, mass = 1e-3, ["F x", "F y"], np.array([8.0, 3.0])

    def plant(error, dry):
        def flows(x, u):  # mm, mm/s, N
            friction = dry * np.tanh(x[2:]) + np.array([20.0, 10.0]) * x[2:] / 1e3
            force = (u - friction) / (mass * (1 + 0.1 * error))
            return np.concatenate([x[2:], 1e3 * force])

        limits = dict.fromkeys(forces, (-80.0, 80.0))
        return Plant(flow(flows, Ts, 2), np.eye(2, 4), 1e-3, limits)

    loop = our_loop(plant(0, 0.0), Ts, dict.fromkeys(forces, 40.0), {"x": 1.0, "y": 1.0})
    bench = plant(off, np.array([4.0, 2.0]) * abs(off))
    return Kind(loop, bench, bump(500, [20.0, 10.0]), 60.0, sliding=plant(off, 0.0))


def pendulum(off):
    """An inverted pendulum that has to lean by 0.8 rad and come back."""
    Ts = 0.01

    def plant(mass=1.0, length=0.5):
        def flows(x, u):
            torque = mass * 9.81 * length * np.sin(x[0]) + u[0] - 0.05 * x[1]
            return np.array([x[1], torque / (mass * length**2)])

        return Plant(flow(flows, Ts), np.eye(1, 2), 1e-3, {"torque": (-10.0, 10.0)})

    loop = our_loop(plant(), Ts, {"torque": 5.0}, {"angle": 0.5})
    return Kind(loop, plant(1 + 0.1 * off, 0.5 + 0.025 * off), bump(300, [0.8]), 6.0)


KINDS = {
    kind.__name__: kind
    for kind in (
        tanks, column, piezo, furnace, motor, levitation, plc, table, gantry, pendulum,
    )
}  # fmt: skip
