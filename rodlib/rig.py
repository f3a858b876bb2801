"""The virtual rig that stands in for the laboratory, and the controller that runs on it.

Nothing here knows the design model: the rig is a modal series of the rod's equation with material
parameters of its own. Its interface is what a hardware driver would offer, one call each per
sample: :meth:`VirtualRig.read` and :meth:`VirtualRig.apply`. Whoever has a real rod replaces that
one object. ``python -m rodlib.rig`` records the logs in data/rig.
"""

import json
import re
import sys
from dataclasses import asdict, dataclass

import numpy as np
import xarray as xr

from rodlib import arguments, published
from rodlib.feedback import CurrentTrialLoop, paper_loop
from rodlib.files import checkout
from rodlib.filters import LearningFilter, ZeroPhaseButterworth, update, zero_phase_butterworth
from rodlib.logs import save_log, with_law
from rodlib.rod import Rod
from rodlib.trials import assumed_disturbance, assumed_reference, check_law, dataset

# Material parameters off by several percent from those of the design model.
MISMATCHED = Rod(density=8100.0, heat_capacity=440.0, heat_transfer=160.0, conductivity=51.0)


@dataclass(frozen=True)
class RigParameters:
    """What makes the rig unlike the design model.

    All of it is assumed: the paper says neither how its sensors err, nor what its Peltier elements
    can pump, nor how fast its laboratory warmed up.
    """

    modes: int = 300
    noise: float = 0.02  # standard deviation of the sensor noise, K
    quantum: float = 0.01  # resolution of the sensors, K
    lag: float = 4.0  # time constant of the Peltier elements, s
    limit: float = 60.0  # largest heat flow of an element, W
    ambient_rate: float = 5e-5  # rise of the ambient temperature, K/s


class VirtualRig:
    """A rod in the laboratory, sample by sample.

    Parameters
    ----------
    rod : Rod
    parameters : RigParameters
    Ts : float
        Sampling period, s.
    seed : int
        Of the sensor noise.

    Notes
    -----
    With theta = sum_n T_n(t) cos(n pi z / l), (1)-(4) fall apart into one first-order equation per
    mode. Commands are held for a period and pass the lag of the elements; both are integrated
    exactly.
    """

    def __init__(
        self,
        rod: Rod = MISMATCHED,
        parameters: RigParameters = RigParameters(),
        Ts: float = 1.0,
        seed: int = 1,
    ):
        self.rod, self.parameters, self.Ts = rod, parameters, Ts
        self.time = 0.0
        self._random = np.random.default_rng(seed)
        n = np.arange(parameters.modes)
        wave = n * np.pi / rod.length
        s = -(rod.kappa_2 + rod.conductivity * wave**2) / rod.kappa_1
        # Mean of cos(wave z) over each section; mode n > 0 has half the norm of mode 0.
        edges = np.sin(np.outer(wave[1:], rod.edges)) / wave[1:, None]
        shares = np.diff(edges, axis=1) / (rod.length / rod.sections)
        shares = np.vstack([np.ones(rod.sections), 2 * shares])
        input_gain = shares / (rod.kappa_1 * rod.width * rod.height * rod.length)

        self._decay = np.exp(s * Ts)
        self._held = (np.expm1(s * Ts) / s)[:, None] * input_gain
        self._lag = np.exp(-Ts / parameters.lag) if parameters.lag else 0.0
        difference = -1 / parameters.lag - s if parameters.lag else np.inf
        near = np.abs(difference * Ts) < 1e-6
        lagging = (self._lag - self._decay) / np.where(near, 1, difference)
        self._lagging = np.where(near, Ts * self._decay, lagging)[:, None] * input_gain
        self._air = -np.expm1(s[0] * Ts)
        self._sensors = np.cos(np.outer(rod.sensors, wave))
        self._modes = np.zeros(parameters.modes)
        self._flows = np.zeros(rod.sections)

    @property
    def ambient(self) -> float:
        """Ambient temperature above its initial value, K, as a thermometer in the room shows it."""
        return self.parameters.ambient_rate * self.time

    def read(self) -> np.ndarray:
        """Read the sensors: K above the initial ambient temperature, shape (m,)."""
        noisy = self._sensors @ self._modes
        if self.parameters.noise:
            noisy = noisy + self.parameters.noise * self._random.standard_normal(len(noisy))
        quantum = self.parameters.quantum
        return np.round(np.round(noisy / quantum) * quantum, 9) if quantum else noisy

    def apply(self, heat_flows) -> None:
        """Command heat flows (W), shape (sections,), and let one sampling period pass.

        Raises
        ------
        ValueError
            If the shape is wrong or a value is not finite.
        """
        command = np.asarray(heat_flows, dtype=float)
        if command.shape != self._flows.shape or not np.isfinite(command).all():
            raise ValueError(
                f"heat_flows = {heat_flows!r} must be {len(self._flows)} finite numbers"
            )
        command = np.clip(command, -self.parameters.limit, self.parameters.limit)
        self._modes *= self._decay
        self._modes += self._held @ command + self._lagging @ (self._flows - command)
        self._modes[0] += self._air * self.ambient
        self._flows = command + self._lag * (self._flows - command)
        self.time += self.Ts

    def profile(self, z) -> np.ndarray:
        """True temperature at positions `z` (m), K; what no sensor shows."""
        return (
            np.cos(np.outer(z, np.arange(len(self._modes)) * np.pi / self.rod.length)) @ self._modes
        )


class Controller:
    """Observer (16) and state feedback (18), sample by sample as on hardware."""

    def __init__(self, loop: CurrentTrialLoop):
        n, m = loop.plant.nstates, loop.plant.noutputs
        self.loop = loop
        self._B = loop.plant.B[:, :m]
        self._x_hat, self.delta = np.zeros(n), np.zeros(m)

    def step(self, y, w) -> np.ndarray:
        """Heat flows u(p) (W) from the measured y(p) and w(p) (K); advances the observer."""
        loop = self.loop
        u = np.round(loop.N @ w - loop.Ks @ self._x_hat - self.delta, 4)  # (18), in 0.1 mW
        surprise = loop.KL @ (y - loop.plant.C @ self._x_hat)
        n = len(self._x_hat)
        self._x_hat = loop.plant.A @ self._x_hat + self._B @ (u + self.delta) + surprise[:n]  # (16)
        self.delta = self.delta + surprise[n:]
        return u


def record(
    rig: VirtualRig,
    loop: CurrentTrialLoop,
    Q: ZeroPhaseButterworth,
    L: LearningFilter | None,
    reference,
    disturbance,
    trials: int = 10,
    pause: int = 600,
    rest: int = 0,
) -> xr.Dataset:
    """Run an experiment of several trials on a rig and record it.

    Between two trials the controller keeps running for `pause` samples, as in the paper, so that
    the rod is back at the start of the reference when the next trial begins.

    Parameters
    ----------
    rig : VirtualRig
        Or any object with its ``read``, ``apply`` and ``ambient``; ``Ts`` is compared with the
        loop's if there is one.
    loop : CurrentTrialLoop
        Controls and disturbances named as the paper's: Q1, Q3 and theta_a, Q2, Q4.
    Q, L : ZeroPhaseButterworth, LearningFilter
        L None switches learning off.
    reference : ndarray, shape (time, m)
    disturbance : ndarray, shape (trial, time, 3)
        Heat flows of the disturbing elements in the last two columns, W; the first is ignored,
        the room does what it does. Further trials than those recorded are ignored, too.
    trials, pause : int
    rest : int
        Number of samples at the end of every trial in which v is held at zero.

    Returns
    -------
    xarray.Dataset
        As from :func:`rodlib.run_trials`, with the measured ambient temperature.

    Raises
    ------
    ValueError
        If something is missing from the rig, the filters, the loop and the rig do not belong
        together, or a signal has the wrong shape or a gap.
    """
    missing = [name for name in ("read", "apply", "ambient") if not hasattr(rig, name)]
    if missing:
        raise ValueError(f"rig = {rig!r} has no {', '.join(missing)}: see VirtualRig")
    arguments.instance("loop", loop, CurrentTrialLoop)
    check_law(loop, Q, L, rig=arguments.sampling_period("rig.Ts", getattr(rig, "Ts", loop.Ts)))
    names, m = loop.plant.input_labels, loop.plant.noutputs
    heated = [name for name in names if name != "theta_a"]
    if names[m : m + 1] != ["theta_a"] or not all(re.fullmatch(r"Q[1-9]\d*", q) for q in heated):
        raise ValueError(f"loop has the inputs {names}, but must have Q1, ..., theta_a, Q2, ...")
    sections = [int(name[1:]) - 1 for name in heated]
    trials = arguments.whole("trials", trials, 1)
    pause = arguments.whole("pause", pause, 0)
    reference = np.round(arguments.array("reference", reference, ("time", m)), 6)
    rest = arguments.whole("rest", rest, 0, len(reference) - 1)
    d = arguments.array("disturbance", disturbance, ("trial", len(reference), len(names) - m))
    if len(d) < trials:
        raise ValueError(f"disturbance has {len(d)} trials, but trials = {trials} are asked for")
    d = np.round(d[:trials], 6)
    controller = Controller(loop)
    shape = (trials, *reference.shape)
    v, u, y, delta = (np.zeros(shape) for _ in range(4))

    def sample(w, flows):
        measured, estimate = rig.read(), controller.delta
        command = np.zeros(max(sections) + 1)
        command[sections] = np.concatenate([controller.step(measured, w), flows])
        rig.apply(command)
        return command[sections[: len(w)]], measured, np.round(estimate, 4)

    for k in range(trials):
        if k and L is not None:
            v[k] = np.round(update(v[k - 1], reference - y[k - 1], Q, L, rest), 6)  # as stored
        for _ in range(pause if k else 0):
            sample(reference[0], np.zeros(d.shape[2] - 1))
        for p, w in enumerate(reference + v[k]):
            d[k, p, 0] = round(rig.ambient, 4)
            u[k, p], y[k, p], delta[k, p] = sample(w, d[k, p, 1:])
    signals = {"reference": np.broadcast_to(reference, shape), "v": v, "u": u, "y": y}
    signals |= {"delta": delta, "disturbance": d}
    names = (loop.outputs, loop.controls, loop.disturbances)
    return with_law(dataset(loop.Ts, *names, loop.units, **signals), Q, L, rest)


def main():
    """Record the two experiments of data/rig; the same bytes in every run."""
    try:
        folder = checkout("python -m rodlib.rig") / "data" / "rig"
    except RuntimeError as error:
        sys.exit(str(error))
    loop, Q = paper_loop(), zero_phase_butterworth()
    printed = LearningFilter(published.matrix("L_diagonal"), loop.Ts)
    folder.mkdir(parents=True, exist_ok=True)
    for name, L, seed in (("learning", printed, 1), ("no-learning", None, 2)):
        print(f"recording {name} ...", flush=True)
        rig = VirtualRig(seed=seed)
        log = record(rig, loop, Q, L, assumed_reference(), assumed_disturbance())
        log.attrs["origin"] = "synthetic: virtual rig of rodlib, no laboratory data"
        log.attrs["rig"] = json.dumps(
            asdict(rig.parameters) | {"seed": seed, "rod": asdict(rig.rod)}
        )
        save_log(log, folder / f"{name}.csv")


if __name__ == "__main__":
    main()
