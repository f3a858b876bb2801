"""Loops as objects: the current-trial loop of the paper, and loops that another controller closes.

Equation numbers in this module are those of the paper. The current-trial loop is from Section III,
(16)-(19) and (30)-(32). It consists of the plant, a state feedback, and an observer that also
estimates the equivalent input disturbance. To see the effect of model errors, put the same
controller around another plant. The gains are designed in :mod:`ilctools.loop.design`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property
from typing import NamedTuple, Protocol, runtime_checkable

import control
import numpy as np

from ilctools import arguments, units
from ilctools.models import Model, frequency_response, sampled_plant, stable_plant
from ilctools.signals import Signals, check_match


class Feedback(NamedTuple):
    """The matrices K and N of the commands u = K x + N v.

    x are the states of P_v, the model from v to y.
    """

    K: np.ndarray  # (commands, states)
    N: np.ndarray  # (commands, m)


@runtime_checkable
class Loop(Protocol):
    """The interface of a loop to which learning is applied.

    The inputs of a loop are w = F r + G v, with references r, learned signals v, and matrices F and
    G. Its outputs are y. :class:`CurrentTrialLoop` and :class:`ClosedLoop` have this interface. A
    class of your own may have this interface as well, because laws, simulated trials, rigs and
    measurements use nothing else of a loop. A log does not store a loop of your class. Two loops of
    one dataclass are the same if all their fields are equal. Other loops are compared by ``==``.
    Signals have the shape (..., time, channel), in the order of the names and in their units.
    """

    @property
    def Ts(self) -> float:
        """Sampling period, s."""

    @property
    def outputs(self) -> Sequence[str]:
        """Names of the p outputs y, and of the references r."""

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs w."""

    @property
    def learned(self) -> Sequence[str]:
        """Names of the m inputs that v is added to."""

    @property
    def one_for_one(self) -> bool:
        """Whether v is added to the references.

        If so, v has one channel for each output, in the order of the outputs.
        """

    @property
    def commands(self) -> list[str]:
        """Names of the signals that are sent to the rig, or of the inputs w of its controller."""

    @property
    def controls(self) -> Sequence[str]:
        """Names of further commands that the rig reports; [] for none."""

    @property
    def disturbances(self) -> Sequence[str]:
        """Names of the inputs d of the plant, which the controller does not know."""

    @property
    def units(self) -> dict[str, str]:
        """Units of all signals of the loop, by name.

        If a unit is not known, the entry is "".
        """

    @property
    def P_v(self) -> control.StateSpace | None:
        """The stable model from v to y; None if it is not known."""

    @property
    def P_r(self) -> control.StateSpace | None:
        """The model from r to y; None if it is not known."""

    def feedback(self) -> Feedback:
        """Return how the commands depend on v and on the states of P_v.

        The loop must have a P_v.
        """

    def w(self, reference, v) -> np.ndarray:
        """Compute the inputs w from a reference and a signal v.

        The shapes are (..., inputs) for w, (..., p) for the reference, and (..., m) for v.
        """

    def asked(self, signals) -> np.ndarray | None:
        """Return the commands of a trial, or None if they are not known.

        `signals` holds the signals of the trial by name. The commands have the shape
        (..., commands).
        """

    def realised(self, v, u, applied) -> np.ndarray:
        """Compute the v with which the loop would have asked for `applied` instead of `u`.

        The result has the shape (..., m). Both `u` and `applied` are commands of shape
        (..., commands). Where `u` and `applied` are equal, the result is v.
        """

    def model(self, plant=None) -> control.StateSpace:
        """Return the model from w to y, with the plant of the loop or with another plant.

        Raises a ValueError if there is no model.
        """

    def frequency_response(self, omega, plant=None) -> np.ndarray:
        """Compute the frequency response from v to y at `omega` (rad/s).

        `omega` has the shape (n,). The result is complex and has the shape (n, p, m). The argument
        `plant` is as in :meth:`model`.
        """


@dataclass(frozen=True)
class CurrentTrialLoop:
    """The feedback loop (19) of the paper: plant, state feedback, observer and feedforward.

    Arrays are in the order of the signals of `plant`. Only shapes are checked here.
    :func:`current_trial_loop` also checks that loop and observer are stable, and that the controls
    do not act on y within the same sample.

    Attributes
    ----------
    plant : control.StateSpace
        The plant (12). Its first m inputs are the controls u. The others are the disturbances d.
        Its m outputs are y.
    Ks, KL, N : ndarray, shapes (m, n), (n + m, m), (m, m)
        State feedback gain (26), observer gain (29), and gain of the static feedforward.
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
    def inputs(self) -> list[str]:
        """Names of the inputs w = r + v."""
        return _inputs_of(self.outputs)

    learned = inputs  # v is added to all inputs
    one_for_one = True  # v is added to the references, one channel for each output
    commands = controls  # the signals that are sent to the actuators

    def w(self, reference, v) -> np.ndarray:
        """Compute the inputs w = r + v, equation (22)."""
        return reference + v

    def asked(self, signals) -> np.ndarray | None:
        """Return the commands of a trial, which are the controls u.

        If u was not recorded, None is returned.
        """
        return signals.get("u")

    def realised(self, v, u, applied) -> np.ndarray:
        """Compute the v with which the loop would have asked for `applied` instead of `u`.

        If the observer (16) gets the applied commands, a trial with saturated actuators is exactly
        a trial without limits and with this v. This holds for any plant and follows from
        u = N w - K_s x-hat - delta, (18).
        """
        try:
            return v + (applied - u) @ np.linalg.inv(self.N).T
        except np.linalg.LinAlgError:
            raise ValueError(
                "loop.N is singular, so that w cannot be computed from the commands of the loop"
            ) from None

    @property
    def P(self) -> control.StateSpace:
        """The transfer function P = C (zI - A + B K_s)^-1 B N from w to y, see (31).

        The signal w does not excite the estimation error, so the observer's states are left out.
        """
        B = self.plant.B[:, : self.plant.noutputs]
        return control.ss(
            self.plant.A - B @ self.Ks, B @ self.N, self.plant.C, 0, self.Ts,
            inputs=self.inputs, outputs=self.outputs,
        )  # fmt: skip

    P_v = P_r = P  # w = r + v, so that P is also the transfer function from v to y, and from r to y

    def feedback(self) -> Feedback:
        """Return K = -K_s and N of the commands u = N w - K_s x.

        These commands follow from (18) without a disturbance.
        """
        return Feedback(-self.Ks, self.N)

    @cached_property
    def closed(self) -> control.StateSpace:
        """The loop (19) as one model, with the states x, x-hat and epsilon-hat.

        The inputs are w1, w2, ..., and then the disturbances d. The outputs are y. The frequency
        response from w is P of (31), and the response from d is P-tilde of (32).
        """
        return self.around(None)

    def around(self, plant: Model) -> control.StateSpace:
        """Return the loop (19) with the same controller around another plant.

        If this loop is unstable, a ValueError is raised. The result is like :attr:`closed`, but the
        first states belong to `plant`, a model of any order. The signals of `plant` are matched by
        name. The plant must have the loop's controls and outputs. A disturbance that the plant
        lacks has no effect. Signals of the plant that the loop does not have are left out. The
        plant may have direct feedthrough.
        """
        closed = whole_loop(self, plant)[: len(self.outputs), : -len(self.outputs)]
        inputs = self.inputs + self.disturbances
        closed.update_names(inputs=inputs, outputs=self.outputs, name="current-trial loop")
        return closed

    def model(self, plant: Model | None = None) -> control.StateSpace:
        """Return P, or the transfer function from w to y around another plant."""
        return self.P if plant is None else self.around(plant)[:, self.inputs]

    def frequency_response(self, omega, plant=None) -> np.ndarray:
        """Compute P of (31) for the loop as designed, or for its controller around another plant.

        Around another plant, w excites the estimation error. The observer then affects P.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Angular frequencies, rad/s.
        plant : control.StateSpace, control.TransferFunction or array_like, optional
            A model as in :meth:`around`, or the frequency response of a sampled plant at `omega`.
            The response is from the controls to y in the loop's order, shape (n, m, m), and may be
            computed or measured. For several plants, the shape is (..., n, m, m). A response does
            not show whether the loop is stable; the caller must know that the loop is stable.
            Default: the plant of the design.

        Returns
        -------
        ndarray, shape (n, m, m), complex
        """
        if isinstance(plant, control.StateSpace | control.TransferFunction | None):
            return frequency_response(self.model(plant), omega)  # (31)
        m = self.plant.noutputs
        omega = arguments.row("omega", omega)
        G = arguments.array("plant", plant, (..., len(omega), m, m), complex)
        # In the loop as designed, which is stable, u = U w + R noise. With G for G_0, the plant of
        # the design, the observer sees (G - G_0) u more than it expects: u = U w + R (G - G_0) u.
        # U and R are computed from that loop, and not from the controller alone, which integrates.
        replies = frequency_response(whole_loop(self)[m:, :], omega)
        U, R = replies[..., :m], replies[..., -m:]
        G_0 = frequency_response(self.plant[:, :m], omega)
        return G @ np.linalg.solve(np.eye(m) - R @ (G - G_0), U)


def _inputs_of(outputs):
    """Return the names w1, w2, ... of inputs, one for each output."""
    return [f"w{i + 1}" for i in range(len(outputs))]


@dataclass(frozen=True)
class ClosedLoop:
    """A loop that another controller closes, such as a PID in a PLC; its outputs y follow w.

    Each input w takes the reference r of an output, a learned signal v, or both,

        w = F r + G v,

    where F and G consist of zeros and ones. Usually there is one input for each output, and
    w = r + v. A torque that is added to the command of a controller is an input that takes v alone.
    There may be more outputs than learned inputs, or fewer.

    Nothing else is assumed of the loop, not even that P(0) = I. Without P, the loop can be run, and
    P can be measured by :func:`shake`. With P, the loop can be simulated, and learning filters can
    be designed.

    Attributes
    ----------
    P : control.StateSpace or control.TransferFunction, optional
        The stable response from w to y, in discrete time.
    Ts : float, optional
        Sampling period, s. Default: the period of P.
    outputs : sequence of str, optional
        Names of y. Default: the names in P.
    references : dict, optional
        Which input takes the reference of which output, ``{input: output}``. With {}, no input
        takes a reference. Default, if there are as many inputs as outputs: each input takes the
        reference of the output at the same place.
    learned : sequence of str, optional
        Names of the inputs that take a learned signal. Default, if there are as many inputs as
        outputs: all inputs.
    controls : sequence of str
        Names of the commands u, one for each output, if the rig reports them.
    disturbances : sequence of str
        Names of further signals that the rig measures, or that can be commanded.
    units : dict
        Unit of each of these signals, by name; "" if it is not known.

    See Also
    --------
    current_trial_loop : designs a loop around a plant
    shake : how P can be measured

    Examples
    --------
    >>> import control
    >>> from ilctools import ClosedLoop
    >>> P = control.sample_system(control.tf([400], [1, 20, 400]), 0.01)
    >>> loop = ClosedLoop(P, outputs=["x"], units={"x": "mm"})
    >>> loop.inputs, loop.frequency_response([1.0, 10.0]).shape
    (['u[0]'], (2, 1, 1))
    >>> # a drive with a closed position loop and a second input, a torque, which v drives
    >>> names = {"inputs": ["position", "torque"], "outputs": ["x"]}
    >>> both = control.ss(0.8, [[0.2, 0.1]], 1, 0, 0.01, **names)
    >>> loop = ClosedLoop(both, references={"position": "x"}, learned=["torque"])
    >>> loop.w([[1.0]], [[0.5]]).tolist()
    [[1.0, 0.5]]
    """

    P: Model = None
    Ts: float = None  # after __post_init__ a number; the next fields then hold names
    outputs: Sequence[str] = None
    references: dict[str, str] = None
    learned: Sequence[str] = None
    controls: Sequence[str] = ()
    disturbances: Sequence[str] = ()
    units: dict[str, str] = field(default_factory=dict)

    def __post_init__(self):
        P, Ts, outputs = self.P, self.Ts, self.outputs
        if P is not None:
            P = stable_plant(P, "P")
            outputs = P.output_labels if outputs is None else outputs
            Ts = P.dt if Ts is None else Ts
        if Ts is None or outputs is None:
            raise ValueError("P = None: then Ts and outputs must be given")
        Ts = arguments.sampling_period("Ts", Ts)
        outputs = arguments.different("outputs", outputs)
        controls = arguments.different("controls", self.controls)
        disturbances = arguments.different("disturbances", self.disturbances)
        if not outputs or (P is not None and P.noutputs != len(outputs)):
            raise ValueError(
                f"outputs = {outputs!r} must be the names of the outputs of P, one for each"
            )
        references, learned = self._channels(P, outputs)
        if controls and len(controls) != len(outputs):
            raise ValueError(f"controls = {controls!r} must be one name for each output, or none")
        if P is not None:
            check_match(P=P, loop=Signals(Ts, labels=outputs))
        vars(self).update(P=P, references=references, learned=learned, outputs=outputs)
        # a v that is added to references has the units of the outputs
        others = [] if self.one_for_one else [name for name in self.inputs if name not in outputs]
        signals = [*outputs, *others, *controls, *disturbances]
        vars(self).update(
            Ts=Ts,
            controls=controls,
            disturbances=disturbances,
            units=units.labels(self.units, signals),
        )

    def _channels(self, P, outputs):
        """Check and return the references that inputs take, and the names of learned inputs."""
        references, learned = self.references, self.learned
        if P is not None:
            inputs = arguments.different("inputs of P", P.input_labels)
        elif references is None or learned is None:
            inputs = _inputs_of(outputs)
        else:
            inputs = self.inputs
        if (references is None or learned is None) and len(inputs) != len(outputs):
            raise ValueError(
                f"P has the inputs {inputs} and the outputs {outputs}, which are not equally "
                "many: state which reference each input takes, by "
                f"references={{input: output}}, with {{}} for none, and which inputs are "
                "learned, by learned=[inputs]"
            )
        if references is None:
            references = dict(zip(inputs, outputs, strict=True))
        given = arguments.by_name("references", references, inputs)
        references = {name: given[name] for name in inputs if name in given}
        for name, output in references.items():
            if output not in outputs:
                raise ValueError(
                    f"references[{name!r}] = {output!r} must be one of the outputs, {outputs}"
                )
        learned = arguments.different("learned", inputs if learned is None else learned)
        unknown = [name for name in learned if name not in inputs]
        if unknown or not learned:
            raise ValueError(f"learned = {learned} must name some of the inputs, {inputs}")
        idle = [name for name in inputs if name not in learned and name not in references]
        if idle:
            raise ValueError(
                f"the inputs {idle} of P take neither a reference nor a learned signal: name "
                f"them in references or in learned, or leave them out, as P[:, {learned}]"
            )
        return references, learned

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs w."""
        if self.P is None:
            return [*dict.fromkeys([*self.references, *self.learned])]
        return self.P.input_labels

    @property
    def one_for_one(self) -> bool:
        """Whether v is added to the references.

        If so, v has one channel for each output, in the order of the outputs.
        """
        own = [self.references.get(name) for name in self.inputs]
        return self.learned == self.inputs and own == self.outputs

    @cached_property
    def F(self) -> np.ndarray:
        """The matrix F, shape (inputs, p).

        An entry is one if the input takes the reference of the output, and zero otherwise.
        """
        return np.array([[self.references.get(i) == o for o in self.outputs] for i in self.inputs])

    @cached_property
    def G(self) -> np.ndarray:
        """The matrix G, shape (inputs, m).

        An entry is one if the input takes the channel of v, and zero otherwise.
        """
        return np.array([[i == name for name in self.learned] for i in self.inputs])

    commands = inputs  # the signals that are sent to the rig

    def w(self, reference, v) -> np.ndarray:
        """Compute the inputs w = F r + G v.

        The shapes are (..., inputs) for w, (..., p) for r, and (..., m) for v.
        """
        return np.asarray(reference) @ self.F.T + np.asarray(v) @ self.G.T

    def asked(self, signals) -> np.ndarray:
        """Return the commands of a trial, which are its inputs w = F r + G v."""
        return self.w(signals["reference"], signals["v"])

    def realised(self, v, u, applied) -> np.ndarray:
        """Compute the v with which the loop would have asked for `applied` instead of `u`.

        If an input that takes only a reference saturates, no v can express this saturation.
        """
        return v + (applied - u) @ self.G  # v itself where nothing saturated

    @property
    def P_v(self) -> control.StateSpace | None:
        """The model from v to y; None if the loop has no P."""
        return None if self.P is None else self.P[:, self.learned]

    @property
    def P_r(self) -> control.StateSpace | None:
        """The model from r to y; None if the loop has no P."""
        return None if self.P is None else self.P * self.F

    def feedback(self) -> Feedback:
        """Return K and N of the commands w.

        K is zero, because w does not depend on the states.
        """
        return Feedback(np.zeros((len(self.inputs), self.P.nstates)), self.G)

    def model(self, plant=None) -> control.StateSpace:
        """Return the model from w to y, which is P, or `plant` if `plant` is passed."""
        if plant is None and self.P is None:
            raise ValueError(
                "loop has no P: it can be run and excited, but not simulated. "
                "Give ClosedLoop a model P"
            )
        P = self.P if plant is None else stable_plant(plant)
        labels = [*self.outputs, *self.inputs]
        check_match(loop=Signals(self.Ts, labels=labels), plant=P)
        sizes = len(self.outputs), len(self.inputs)
        if P.shape != sizes:
            raise ValueError(
                f"plant has {P.shape[0]} outputs and {P.shape[1]} inputs, but the loop has "
                f"{sizes[0]} and {sizes[1]}"
            )
        return P

    def frequency_response(self, omega, plant=None) -> np.ndarray:
        """Compute the frequency response from v to y at `omega` (rad/s), with P or `plant`.

        The result has the shape (n, p, m). The other model, `plant`, is from w to y.
        """
        return frequency_response(self.model(plant)[:, self.learned], omega)


def check_loop(value) -> Loop:
    """Check that a value is a loop."""
    if isinstance(value, control.LTI):
        raise ValueError(
            "loop is a model, but must be a Loop: if the model leads from references to the "
            "outputs of a closed loop, pass ClosedLoop(model). If the plant has no controller yet, "
            "pass current_trial_loop(plant, controls)"
        )
    return arguments.instance("loop", value, Loop)


def same_loop(loop: Loop, other: Loop) -> bool:
    """Whether two loops are equal to the last digit, including their names and units."""
    if not (is_dataclass(loop) and type(loop) is type(other)):
        return loop == other
    return all(map(np.array_equal, _values(loop), _values(other)))


def _values(loop):
    """Yield all values of a loop that are compared."""
    for part in fields(loop):
        value = getattr(loop, part.name)
        if not isinstance(value, control.StateSpace):
            yield value
            continue
        yield from (value.A, value.B, value.C, value.D, value.dt)
        yield from (value.input_labels, value.output_labels)


def controller(loop: CurrentTrialLoop) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, K of the observer (16) and the feedback (18).

    The equations are c(p+1) = A c + B u + K_L y and u = N w - K c.

    The states c are x-hat and delta.
    """
    m = loop.plant.noutputs
    B = loop.plant.B[:, :m]
    Aa, Ca = with_disturbance(loop.plant.A, B, loop.plant.C)
    return Aa - loop.KL @ Ca, np.pad(B, [(0, m), (0, 0)]), np.hstack([loop.Ks, np.eye(m)])


def with_disturbance(A, B, C) -> tuple[np.ndarray, np.ndarray]:
    """Return A_a and C_a of (15) for A_d = C_d = I.

    The states of the plant come first.
    """
    n, m = B.shape
    return np.block([[A, B], [np.zeros((m, n)), np.eye(m)]]), np.pad(C, [(0, 0), (0, m)])


def whole_loop(loop: CurrentTrialLoop, plant=None) -> control.StateSpace:
    """Return the loop (18), (19) around its own plant or another plant.

    The signals of another plant are matched by name. The inputs are w, d, and a signal that is
    added to y before the observer (16). The outputs are y and u. The states are the plant's states,
    x-hat and delta.
    """
    if plant is None:
        return close(loop, loop.plant)
    plant = sampled_plant(plant)
    check_match(loop=loop, plant=Signals(plant.dt))
    signals = [*plant.input_labels, *plant.output_labels]
    missing = [n for n in [*loop.controls, *loop.outputs] if n not in signals]
    if missing:
        raise ValueError(f"plant has the signals {signals}, but the loop also needs {missing}")
    ours = loop.plant.input_labels
    picked = np.array([[a == b for b in ours] for a in plant.input_labels])
    closed = close(loop, plant[loop.outputs, :] * picked)
    poles = closed.poles()
    worst = poles[np.abs(poles).argmax()]
    if abs(worst) > arguments.CIRCLE:
        raise ValueError(
            f"plant makes the loop unstable: a pole is at z = {worst:.6g}, of modulus "
            f"{abs(worst):.6g}. If the plant is right, make the controller weaker, by a larger "
            "Rs or Ro"
        )
    return closed


def close(loop: CurrentTrialLoop, plant: control.StateSpace) -> control.StateSpace:
    """Close a loop around a plant with the same inputs and outputs.

    The closed loop may be unstable.
    """
    m = loop.plant.noutputs
    A, B, K = controller(loop)
    Bu, E, Du, F = plant.B[:, :m], plant.B[:, m:], plant.D[:, :m], plant.D[:, m:]
    B = B + loop.KL @ Du  # u also enters the observer through y
    return control.ss(  # (19), whose responses are (31) and (32), together with (18)
        np.block([[plant.A, -Bu @ K], [loop.KL @ plant.C, A - B @ K]]),
        np.block([[Bu @ loop.N, E, 0 * Bu], [B @ loop.N, loop.KL @ F, loop.KL]]),
        np.block([[plant.C, -Du @ K], [0 * plant.C, -K]]),
        np.block([[Du @ loop.N, F, 0 * Du], [loop.N, 0 * F, 0 * Du]]),
        loop.Ts,
    )
