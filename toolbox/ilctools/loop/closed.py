"""Loops as objects: the current-trial loop with its P, and loops whose controller is not ours.

Section III, (16)-(19), (30)-(32): the plant, an observer that also estimates the equivalent input
disturbance, and a state feedback. What a model gets wrong is seen with the same controller around
another plant. How the gains are designed is in :mod:`ilctools.loop.design`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property

import control
import numpy as np

from ilctools import arguments, units
from ilctools.models import Model, frequency_response, sampled_plant
from ilctools.signals import Signals, check_match


@dataclass(frozen=True)
class CurrentTrialLoop:
    """The feedback loop (19) and what it is made of. Arrays are in the order of `plant`.

    That its gains are those of a stable loop and observer, and D of the controls is zero,
    :func:`current_trial_loop` checks; here only shapes are.

    Attributes
    ----------
    plant : control.StateSpace
        The plant (12): inputs u (m of them), then d; outputs y (m).
    Ks, KL, N : ndarray, shapes (m, n), (n + m, m), (m, m)
        State feedback (26), observer gain (29), static feedforward.
    units : dict
        Unit of each input and output of the plant, by name; "" if it is not known.
    """

    plant: Model
    Ks: np.ndarray
    KL: np.ndarray
    N: np.ndarray
    units: dict[str, str]

    def __post_init__(self):
        plant = sampled_plant(self.plant)
        n, m = plant.nstates, plant.noutputs
        for name, shape in {"Ks": (m, n), "KL": (n + m, m), "N": (m, m)}.items():
            vars(self)[name] = arguments.array(name, getattr(self, name), shape)
        signals = [*plant.output_labels, *plant.input_labels]
        vars(self).update(units=units.labels(self.units, signals), plant=plant)

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.plant.dt

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs y."""
        return self.plant.output_labels

    @property
    def controls(self) -> list[str]:
        """Names of the controls u."""
        return self.plant.input_labels[: self.plant.noutputs]

    @property
    def disturbances(self) -> list[str]:
        """Names of the disturbances d, which the controller does not know."""
        return self.plant.input_labels[self.plant.noutputs :]

    @property
    def references(self) -> list[str]:
        """Names of the inputs w = r + v."""
        return _learned(self)

    @property
    def commands(self) -> list[str]:
        """Names of what is sent to the actuators: the controls."""
        return self.controls

    def asked(self, signals) -> np.ndarray | None:
        """The commands of a trial, by name those of `commands`: its controls u, if it has them."""
        return signals.get("u")

    def realised(self, v, u, applied) -> np.ndarray:
        """The v with which the loop would have asked for what was applied, instead of u.

        Where the observer (16) is informed of what was applied, a trial cut off by actuators is
        exactly a trial with this v without limits, whatever the plant: u = N w - K_s x-hat - delta,
        (18).
        """
        try:
            return v + (applied - u) @ np.linalg.inv(self.N).T
        except np.linalg.LinAlgError:
            raise ValueError("loop.N is singular: w does not follow from its commands") from None

    @property
    def P(self) -> control.StateSpace:
        """The transfer function from w to y, P of (31), as C (zI - A + B K_s)^-1 B N.

        The signal w does not excite the estimation error, so the observer's states are left out.
        """
        B = self.plant.B[:, : self.plant.noutputs]
        return control.ss(
            self.plant.A - B @ self.Ks, B @ self.N, self.plant.C, 0, self.Ts,
            inputs=self.references, outputs=self.outputs,
        )  # fmt: skip

    @cached_property
    def closed(self) -> control.StateSpace:
        """The loop (19): inputs w1, w2, ..., then d; outputs y; states x, x-hat, epsilon-hat.

        Its frequency response from w is P of (31), and from d it is P-tilde of (32).
        """
        return _from_w_and_d(self)

    def around(self, plant: Model) -> control.StateSpace:
        """The loop (19) of the same controller around another plant, if it is stable.

        As `closed`, but the first states are those of `plant`, a model of any order. Its signals
        are matched by name: it must have the loop's controls and outputs, and a disturbance that it
        lacks has no effect. Others than the loop's are left out. Feedthrough is allowed.
        """
        return _from_w_and_d(self, plant)

    def frequency_response(self, omega, plant=None) -> np.ndarray:
        """P of (31), of the loop as designed or of the same controller around another plant.

        Around another plant the observer does not drop out: w excites the estimation error.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Angular frequencies, rad/s.
        plant : control.StateSpace, control.TransferFunction or array_like, optional
            A model as in :meth:`around`, or samples of shape (n, m, m) of a sampled plant's
            response on `omega`, from the controls to y in the loop's order: those of
            theory, or measured; (..., n, m, m) for several plants. Samples do not say whether the
            loop is stable; that is then for the caller to know. Default: the plant of the design.

        Returns
        -------
        ndarray, shape (n, m, m), complex
        """
        if plant is None:
            return frequency_response(self.P, omega)  # (31)
        m = self.plant.noutputs
        if isinstance(plant, control.StateSpace | control.TransferFunction):
            return frequency_response(self.around(plant)[:, :m], omega)
        omega = arguments.row("omega", omega)
        G = arguments.array("plant", plant, (..., len(omega), m, m), complex)
        # In the loop as designed, which is stable, u = U w + R noise. With G for G_0, the plant of
        # the design, the observer sees (G - G_0) u more than it expects: u = U w + R (G - G_0) u.
        # It is computed from that loop, and not from the controller alone, which integrates.
        replies = frequency_response(whole_loop(self)[m:, :], omega)
        U, R = replies[..., :m], replies[..., -m:]
        G_0 = frequency_response(self.plant[:, :m], omega)
        return G @ np.linalg.solve(np.eye(m) - R @ (G - G_0), U)


def _learned(loop):
    return [f"w{i + 1}" for i in range(len(loop.outputs))]


@dataclass(frozen=True)
class ClosedLoop:
    """A loop whose controller is not ours, such as a PID in a PLC: it takes w = r + v, y follows.

    Nothing else is assumed of it, not even that P(0) = I. Without P it can be run and shaken, by
    which P can be measured; with P it can be simulated, and filters can be designed for it.

    Attributes
    ----------
    P : control.StateSpace or control.TransferFunction, optional
        From w to y, in discrete time and stable.
    Ts : float, optional
        Sampling period, s. Default: that of P.
    outputs : sequence of str, optional
        Names of y. Default: those of P.
    controls : sequence of str
        Names of the commands u, one for each output, if the rig tells them.
    disturbances : sequence of str
        Names of what else the rig measures, or can be commanded.
    units : dict
        Unit of each of these, by name; "" if it is not said.

    See Also
    --------
    current_trial_loop : a loop of ours around a plant
    shake : how P can be measured

    Examples
    --------
    >>> import control
    >>> from ilctools import ClosedLoop
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)
    >>> loop = ClosedLoop(P, outputs=["x"], units={"x": "mm"})
    >>> loop.references, loop.frequency_response([1.0, 10.0]).shape
    (['u[0]'], (2, 1, 1))
    """

    P: Model = None
    Ts: float = None  # of P; once the loop is made, a number, and the next are names
    outputs: Sequence[str] = None
    controls: Sequence[str] = ()
    disturbances: Sequence[str] = ()
    units: dict[str, str] = field(default_factory=dict)

    def __post_init__(self):
        P, Ts, outputs = self.P, self.Ts, self.outputs
        if P is not None:
            P = _stable_model("P", P)
            outputs = P.output_labels if outputs is None else outputs
            Ts = P.dt if Ts is None else Ts
        if Ts is None or outputs is None:
            raise ValueError("P = None: then Ts and outputs must be given")
        Ts = arguments.sampling_period("Ts", Ts)
        outputs = arguments.different("outputs", outputs)
        controls = arguments.different("controls", self.controls)
        disturbances = arguments.different("disturbances", self.disturbances)
        if not outputs or (P is not None and P.noutputs != len(outputs)):
            raise ValueError(f"outputs = {outputs!r} must name the outputs of P")
        if controls and len(controls) != len(outputs):
            raise ValueError(f"controls = {controls!r} must be one for each output, or none")
        if P is not None:
            check_match(P=P, loop=Signals(Ts, labels=outputs))
        signals = [*outputs, *controls, *disturbances]
        vars(self).update(
            P=P,
            Ts=Ts,
            outputs=outputs,
            controls=controls,
            disturbances=disturbances,
            units=units.labels(self.units, signals),
        )

    @property
    def references(self) -> list[str]:
        """Names of the inputs w = r + v."""
        return _learned(self) if self.P is None else self.P.input_labels

    @property
    def commands(self) -> list[str]:
        """Names of what is sent to the rig: w."""
        return self.references

    def asked(self, signals) -> np.ndarray:
        """The commands of a trial, by name those of `commands`: its w = r + v."""
        return signals["reference"] + signals["v"]

    def realised(self, v, u, applied) -> np.ndarray:
        """The v with which the loop would have asked for what was applied, instead of u."""
        return v + (applied - u)  # v itself where nothing was cut off

    def model(self, plant=None) -> control.StateSpace:
        """P, or `plant` in its place, which is another model from w to y."""
        if plant is None and self.P is None:
            raise ValueError("loop has no P: it can be run and shaken, but not simulated")
        P = self.P if plant is None else _stable_model("plant", plant)
        check_match(loop=self, plant=P)
        if P.noutputs != len(self.outputs):
            raise ValueError(f"plant has {P.noutputs} outputs, but the loop {len(self.outputs)}")
        return P

    def frequency_response(self, omega, plant=None) -> np.ndarray:
        """P, or another model from w to y, at `omega` (rad/s), shape (n, m, m)."""
        return frequency_response(self.model(plant), omega)


Loop = CurrentTrialLoop | ClosedLoop


def same_loop(loop: Loop, other: Loop) -> bool:
    """Whether two loops are alike to the last digit, names and units included."""
    return all(map(np.array_equal, _values(loop), _values(other)))


def _values(loop):
    """All that a loop is, to be compared."""
    for part in fields(loop):
        value = getattr(loop, part.name)
        if not isinstance(value, control.StateSpace):
            yield value
            continue
        yield from (value.A, value.B, value.C, value.D, value.dt)
        yield from (value.input_labels, value.output_labels)


def _stable_model(name, P):
    """A stable model from w to y."""
    P = sampled_plant(P, name)
    arguments.stable(name, P.poles())
    arguments.square(name, P.ninputs, P.noutputs)
    return P


def controller(loop: CurrentTrialLoop) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, K of observer (16) and feedback (18): c(p+1) = A c + B u + K_L y, u = N w - K c.

    The states c are x-hat and delta.
    """
    m = loop.plant.noutputs
    B = loop.plant.B[:, :m]
    Aa, Ca = with_disturbance(loop.plant.A, B, loop.plant.C)
    return Aa - loop.KL @ Ca, np.pad(B, [(0, m), (0, 0)]), np.hstack([loop.Ks, np.eye(m)])


def with_disturbance(A, B, C) -> tuple[np.ndarray, np.ndarray]:
    """A_a and C_a of (15), with A_d = C_d = I: the states of the plant, then the disturbance."""
    n, m = B.shape
    return np.block([[A, B], [np.zeros((m, n)), np.eye(m)]]), np.pad(C, [(0, 0), (0, m)])


def whole_loop(loop: CurrentTrialLoop, plant=None) -> control.StateSpace:
    """The loop (19), (18) around its plant or another, whose signals are matched by name.

    Inputs are w, d and what is added to y before the observer (16) sees it; outputs y and u; the
    states are those of the plant, x-hat and delta.
    """
    if plant is None:
        return close(loop, loop.plant)
    plant = sampled_plant(plant)
    check_match(loop=loop, plant=Signals(plant.dt))
    signals = [*plant.input_labels, *plant.output_labels]
    missing = [n for n in [*loop.controls, *loop.outputs] if n not in signals]
    if missing:
        raise ValueError(f"plant has the signals {signals}, but lacks {missing} of the loop")
    ours, plant = loop.plant.input_labels, plant[loop.outputs, :]
    picked = np.array([[a == b for b in ours] for a in plant.input_labels])
    B, D = plant.B @ picked, plant.D @ picked
    closed = close(loop, control.ss(plant.A, B, plant.C, D, plant.dt))
    poles = closed.poles()
    worst = poles[np.abs(poles).argmax()]
    if abs(worst) > arguments.CIRCLE:
        raise ValueError(
            f"plant makes the loop unstable: a pole at z = {worst:.6g}, of modulus "
            f"{abs(worst):.6g}. If the plant is right, make the controller weaker, by a larger "
            "Rs or Ro"
        )
    return closed


def close(loop: CurrentTrialLoop, plant: control.StateSpace) -> control.StateSpace:
    """The whole of a loop, stable or not, around a plant with the same inputs and outputs."""
    m = loop.plant.noutputs
    A, B, K = controller(loop)
    Bu, E, Du, F = plant.B[:, :m], plant.B[:, m:], plant.D[:, :m], plant.D[:, m:]
    B = B + loop.KL @ Du  # u comes in by y, too
    return control.ss(  # (19), of which (31) and (32) are the responses, and (18)
        np.block([[plant.A, -Bu @ K], [loop.KL @ plant.C, A - B @ K]]),
        np.block([[Bu @ loop.N, E, 0 * Bu], [B @ loop.N, loop.KL @ F, loop.KL]]),
        np.block([[plant.C, -Du @ K], [0 * plant.C, -K]]),
        np.block([[Du @ loop.N, F, 0 * Du], [loop.N, 0 * F, 0 * Du]]),
        loop.Ts,
    )


def _from_w_and_d(loop, plant=None):
    """The loop (19) without noise, its signals by name."""
    m = len(loop.outputs)
    closed = whole_loop(loop, plant)[:m, :-m]
    closed.update_names(
        inputs=loop.references + loop.disturbances, outputs=loop.outputs, name="current-trial loop"
    )
    return closed
