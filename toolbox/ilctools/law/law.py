"""The ILC law, equation (23) of the paper: it computes the next v from the v and e of a trial."""

import reprlib
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ilctools import arguments
from ilctools.filters import LearningOperator, ZeroPhaseButterworth, check_learning
from ilctools.law.limits import (
    UNLIMITED,
    Actuators,
    LimitsOf,
    check_solver,
    command_model,
    commands_after,
    named_limits,
    projected,
)
from ilctools.law.nearest import Norm
from ilctools.law.output_limits import OutputLimits
from ilctools.law.output_program import Commands
from ilctools.law.output_spread import PAST, Done
from ilctools.law.output_step import Step
from ilctools.loop.closed import Loop, check_loop, same_loop
from ilctools.signals import Signals, check_match


@dataclass(frozen=True, eq=False)
class Law:
    """The law of iterative learning, v_{k+1} = Q (v_k + L e_k), made of checked parts.

    The law computes the signal v of the next trial from the signal and the error e_k of trial k,
    equation (23) of the paper. See D. A. Bristow, M. Tharayil and A. G. Alleyne, A survey of
    iterative learning control, IEEE Control Systems Magazine 26 (2006) 96-114.

    A learning gain a below one makes v change by a times as much,
    v_{k+1} = (1 - a) v_k + a Q (v_k + L e_k). Learning is then slower, but noise in e is averaged.

    Attributes
    ----------
    Q : ZeroPhaseButterworth
    L : LearningOperator or None
        With None there is no learning, and v does not change.
    rest : int
        At the end of every trial, v is held at zero for this number of samples. The filters look
        beyond the end. The values that they compute for the last samples may therefore grow from
        trial to trial.
    gain : float
        Learning gain a, in (0, 1].
    limits : dict, optional
        Lowest and highest command, by the names of the loop's commands, in their units. The law
        then takes the nearest v whose commands are within the limits. {} stands for no limits at
        all, also on a rig that has limits. Default: :func:`ilctools.record` takes the limits of the
        rig, and elsewhere there are none. The attribute is then :attr:`.LimitsOf.RIG`. If an
        actuator has a rate limit, choose a reference that needs no faster change of the command.
    loop : CurrentTrialLoop or ClosedLoop, optional
        The loop that the law is for. :func:`ilctools.run_trials` and :func:`ilctools.record` bind a
        law without a loop to their loop. They refuse a law for another loop.
    region : Response, optional
        The plants of a design, with a radius: the largest error of each plant, by frequency. Trials
        are compared with this region. If the region is a single exact model and the loop has a P,
        trials are compared with the loop's P. :meth:`.Synthesis.law` sets this attribute. Neither a
        file of the law nor a log stores it.
    labels : Signals, optional
        Names and units of the signals of a design's plant. A loop with the same signals in another
        order is refused. Neither a file of the law nor a log stores them.
    output_limits : OutputLimits, optional
        Limits of outputs, with what is known of the plant. :meth:`.Synthesis.law` makes them. Print
        this object to see what it guarantees.

    See Also
    --------
    synthesise : designs L
    run_trials : simulates trials
    record : runs trials on a rig
    save_law : writes the law to a file

    Examples
    --------
    >>> import numpy as np
    >>> from ilctools import Law, LearningFilter, zero_phase_butterworth
    >>> Q, L = zero_phase_butterworth(2, 0.1, 1.0), LearningFilter([[[0.5]]], Ts=1.0)
    >>> law = Law(Q, L, rest=5)
    >>> v, e = np.zeros((100, 1)), np.ones((100, 1))
    >>> law.next(v, e)[[50, -1]].round(3).ravel().tolist()
    [0.514, 0.0]
    """

    Q: ZeroPhaseButterworth
    L: LearningOperator | Any
    rest: int = 0
    gain: float = 1.0
    limits: dict[str, tuple[float, float]] | LimitsOf | None = None
    loop: Loop | None = None
    region: Any = field(default=None, repr=False)
    labels: Signals | None = field(default=None, repr=False)
    output_limits: OutputLimits | None = None

    def __post_init__(self):
        if not isinstance(self.Q, ZeroPhaseButterworth):
            raise ValueError(
                f"Q = {reprlib.repr(self.Q)} must be a ZeroPhaseButterworth, which filters in "
                "both directions: pass zero_phase_butterworth(order, cutoff, Ts), with the "
                "cut-off in rad/s"
            )
        if self.L is not None:
            check_learning(self.L)
        if self.loop is not None:
            check_loop(self.loop)
            self._refuse_outputs()
        check_match(Q=self.Q, L=self.L, law=self.labels, loop=self.loop)
        vars(self).update(
            rest=arguments.whole("rest", self.rest, 0),
            gain=arguments.number("gain", self.gain, "in (0, 1]", 0, most=1),
        )
        limits = LimitsOf.RIG
        if not isinstance(self.limits, LimitsOf | None):
            limits = named_limits("limits", self.limits, getattr(self.loop, "commands", None))
        vars(self)["limits"] = limits

    def _refuse_outputs(self):
        """Refuse limits of outputs that are not from a design, or that are for another loop."""
        kept, outputs = self.output_limits, [*self.loop.outputs]
        names = self.limits if isinstance(self.limits, dict) else ()
        for name in names:
            if name in outputs and name not in self.loop.commands:
                raise ValueError(
                    f"limits[{name!r}] is a limit of an output, which only the law of a "
                    "design can keep, because it takes a plant and its radius: make the law by "
                    "synthesise(...).law(limits=...)"
                )
        if kept is None:
            return
        arguments.instance("output_limits", kept, OutputLimits)
        if kept.region.outputs != outputs:
            raise ValueError(
                f"limits of outputs are for a plant with the outputs {kept.region.outputs}, "
                f"but the loop has {outputs}"
            )

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.Q.Ts

    @property
    def outputs(self) -> list[str] | None:
        """Names of the outputs whose errors the law uses; None for a law without a loop."""
        return getattr(self.loop, "outputs", None)

    @property
    def inputs(self) -> list[str] | None:
        """Names of the channels of v, or None if the law is not bound to a loop.

        If v is added to references, one for each output, the channels have the outputs' names.
        """
        if self.loop is None:
            return None
        return self.loop.outputs if self.loop.one_for_one else self.loop.learned

    @property
    def rows(self) -> int | None:
        """Number m of channels of v; None if the law has neither an L nor a loop."""
        return self.L.rows if self.L is not None else self.inputs and len(self.inputs)

    @property
    def columns(self) -> int | None:
        """Number p of channels of the error; None if the law has neither an L nor a loop."""
        return self.L.columns if self.L is not None else self.outputs and len(self.outputs)

    @property
    def known_limits(self) -> dict[str, tuple[float, float]]:
        """The limits of the law itself, without the limits of a rig.

        If the law has no limits, the dict is empty.
        """
        return {} if self.limits is LimitsOf.RIG else self.limits

    def on_rig(self, limits: dict[str, tuple[float, float]]) -> "Law":
        """Return this law with a rig's limits for all commands that the law does not limit itself.

        A law whose limits are {} has no limits at all, whatever the limits of the rig are.
        """
        if self.limits == {}:
            return self
        return replace(self, limits=limits | self.known_limits)

    @cached_property
    def actuators(self) -> Actuators | None:
        """The actuators with the limits of this law.

        If the law has no limits, the value is None.
        """
        if not self.known_limits:
            return None
        if self.loop is None:
            raise ValueError(
                "limits need the loop of the law: bind the law first, by law.bound_to(loop)"
            )
        if self.L is not None:
            check_solver(self.loop)
        return Actuators.of(self.known_limits, self.loop)

    def bound_to(self, loop: Loop) -> "Law":
        """Return this law, bound to a loop.

        If the law is for another loop, a ValueError is raised.
        """
        check_loop(loop)
        if self.loop is None:
            return replace(self, loop=loop)
        if not same_loop(self.loop, loop):
            raise ValueError(
                "law is bound to another loop: pass the loop law.loop, or unbind the law by "
                "dataclasses.replace(law, loop=None)"
            )
        return self

    def first(self, samples: int, v=None) -> np.ndarray:
        """Return the signal of the first trial, (samples, m): the argument `v`, or zero.

        The signal is zero in the last `rest` samples.
        """
        rest = arguments.whole("rest", self.rest, 0, samples - 1)
        shape = samples, self.rows
        v = np.zeros(shape) if v is None else v
        v = arguments.in_columns("v", v, shape, self._names(v, self.inputs, self.rows))
        v[samples - rest :] = 0
        if self.L is not None:
            # an L for trials of another length refuses this, before any trial is run
            self.L.apply(np.zeros((samples, self.columns)))
        return v

    def next(self, v, e, u=None, applied=None, y=None, *, references=None, past=()) -> np.ndarray:
        """Compute the signal of the next trial, v_{k+1} of equation (23) of the paper.

        With limits of commands, let v* be the next v without limits. The law takes the v that
        minimises ||P (v - v*)||^2 + weight ||v - v*||^2 among all v whose commands are within the
        limits. P is the model of the loop, and the applied commands are the starting point. The
        weight is taken from L, and is 0.01 for a filter. With a :class:`ilctools.NormOptimal` and a
        Q near one, this is constrained norm-optimal learning, whose predicted error cannot rise.
        Limits do not count in the last `rest` samples, where v is zero. If a ClosedLoop has no P,
        the commands are clipped to the limits instead.

        With limits of outputs, the change of v is shortened, or replaced by another change that
        brings the outputs less close to their limits, see :mod:`.output_step`. If an output
        exceeded its limit, the law takes a change after which all limits hold for sure. If there is
        no such change, the law goes back to a share of the last w, the signal that drove P: v, or v
        plus the reference. With this share of w, the last trial would have kept the limits.

        Parameters
        ----------
        v : array_like, shape (time, m), or (time,) of one channel
            ILC signal of the last trial. The time must be the first axis; in a square array,
            exchanged axes cannot be detected. Labelled signals (columns, or coordinates) are
            matched by name. For this, a law of several channels must be bound to a loop.
        e : array_like, shape (time, p), or (time,) of one channel
            Tracking error of the last trial, reference - y.
        u : array_like, shape (time, commands), optional
            Commands that the controller asked for: the controls of a CurrentTrialLoop, or the
            inputs w of a ClosedLoop. If commands have limits, `u` is needed, also after the first
            trial.
        applied : array_like, shape (time, commands), optional
            Commands that the actuators applied, as passed to the observer. Default: the saturated
            u.
        y : array_like, shape (time, p), optional
            Outputs of the last trial. If outputs have limits, `y` is needed.
        references : tuple of array_like, shapes (time, p), optional
            References of the last trial and of the next one. Default: e + y for both references.
        past : sequence of dict, optional
            Signals v, reference and y of the trials before the last one, in their order. With these
            signals, larger changes are possible within limits of outputs.

        Returns
        -------
        ndarray, DataFrame or DataArray, with the shape, labels and order of v

        Raises
        ------
        ValueError
            If signals do not fit the law, or are so large that the next v is not finite. If there
            are limits, but no loop, u or y. If an output exceeds its limit because of a reference
            alone.
        RuntimeError
            If the solver fails.
        """
        if self.L is None:
            arguments.array("v", v, (...,))
            return copy(v)
        labelled, names = v, self._names(v, self.inputs, self.rows)
        v = arguments.in_columns("v", v, (..., "time", self.rows), names)
        of_e = self._names(e, self.outputs, self.columns)
        e = arguments.in_columns("e", e, (*v.shape[:-1], self.columns), of_e)
        arguments.whole("rest", self.rest, 0, v.shape[-2] - 1)
        v, applied = self.applied(v, u, applied)
        y = y if y is None else arguments.in_columns("y", y, e.shape, of_e)
        references = _two_references(references, e if y is None else e + y, of_e)
        target = self.unlimited(v, e)
        following, _ = self.within_limits(target, v, applied, y, references, past)
        return arguments.labelled_as(labelled, following, names)

    def unlimited(self, v, e) -> np.ndarray:
        """Compute the next v by the law without limits, zero in the last `rest` samples.

        All arrays have the shape (..., time, channel).
        """
        a = self.gain
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused
            learned = _finite(v + self.L.apply(e))
            following = _finite((1 - a) * v + a * self.Q.apply(learned))  # (23)
        following[..., v.shape[-2] - self.rest :, :] = 0
        return following

    def within_limits(
        self, target, v, applied, y, references, past=()
    ) -> tuple[np.ndarray, Step | None]:
        """Bring a target for the next v within the limits.

        Returns the next v, and the step that keeps limits of outputs. The step is None if outputs
        have no limits, or if the law goes back to a share of the last w. The arguments `v` and
        `applied` are the results of :meth:`applied`. The other arguments are as for :meth:`next`.
        """
        if self.actuators is not None:
            commands = self._commands_after(target - v, applied, references)
            target = projected(
                self.loop, self.actuators, target, commands, Norm.of(self.L), self.rest
            )
        if self.output_limits is None:
            return target, None
        return self._keeping_outputs(target, v, applied, y, references, past)

    def _commands_after(self, change, applied, references):
        """Predict the commands of the next trial, in which v differs by `change`."""
        now, after = references
        return commands_after(self.loop, applied, change, after - now)

    def _keeping_outputs(self, target, v, applied, y, references, past):
        """Change v such that the outputs keep their limits, as a part of :meth:`within_limits`."""
        if self.loop is None:
            raise ValueError(
                "limits of outputs need the loop of the law: bind the law first, "
                "by law.bound_to(loop)"
            )
        if y is None:
            raise ValueError(
                "y = None, but with limits of outputs the outputs of the trial are needed: pass y"
            )
        commands, active = None, len(v) - self.rest
        if self.actuators is not None:
            u = self._commands_after(target - v, applied, references)
            low, high = self.actuators.room(u)
            low[active:], high[active:] = UNLIMITED  # in the rest, limits do not count
            commands = Commands(command_model(self.loop), (low, high))
        # the part of w that drives P is v plus the reference, or v alone
        now, after = references if self.loop.one_for_one else np.zeros((2, *v.shape))
        w, moved = v + now, after - now
        step = self.output_limits.step(
            target - v + moved, Done(w, y), [*map(self._done, past[-PAST:])],
            Norm.of(self.L), active, commands,
        )  # fmt: skip
        if step is None:
            return now[0] + self._share_back(y) * (w - now[0]) - after, None
        return v + step.change - moved, step

    def _done(self, part):
        """Return the outputs of a trial, and the part of the signal that really drove P."""
        part = part | {name: np.asarray(part[name], float) for name in ("v", "reference", "y")}
        v = self.applied_v(part)
        return Done(v + part["reference"] if self.loop.one_for_one else v, part["y"])

    def _share_back(self, y):
        """Compute the share of the last w to take after a trial that exceeded a limit.

        With this share, the limits would have held.
        """
        kept = self.output_limits
        if not self.loop.one_for_one and self.loop.references:
            name = kept.region.outputs[int(kept.beyond(y).argmax())]
            raise ValueError(
                f"{name} was beyond its limit by {kept.beyond(y).max():.3g}, and v alone "
                f"cannot bring it back, because {name} also follows a reference: take a "
                "smaller reference"
            )
        return kept.safe_share(y)

    def _names(self, signal, known, count):
        """Return the names of the channels of v or e.

        Names are refused if no loop states their order.
        """
        if known or count is None:
            return known
        labels = arguments.names_of(signal) or [""] * count
        if any(labels) and count > 1:
            raise ValueError(
                f"v or e holds the signals {reprlib.repr(labels)}, but a law without a loop "
                "does not know their order: bind the law, by law.bound_to(loop), or pass an "
                "array"
            )
        return labels

    def applied(self, v, u, applied=None) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the part of v that was applied, and the applied commands.

        `u` contains the commands that the controller asked for.
        """
        if self.actuators is None:
            return v, applied
        if u is None:
            raise ValueError(
                "u = None, but with limits the commands of the trial are needed: pass u"
            )
        commands, shape = self.loop.commands, (*v.shape[:-1], len(self.loop.commands))
        u = arguments.in_columns("u", u, shape, commands)
        if applied is None:
            applied = self.actuators.follow(u)
        else:
            applied = arguments.in_columns("applied", applied, shape, commands)
        return self.loop.realised(v, u, applied), applied

    def applied_v(self, signals) -> np.ndarray:
        """Return the part of v that was applied in a trial, (time, m), from its signals by name."""
        u = None if self.loop is None else self.loop.asked(signals)
        v, _ = self.applied(signals["v"], u, signals.get("applied"))
        return v


def _two_references(references, reference, names):
    """Return the references of the last trial and of the next trial.

    If the references are not known, `reference` is the reference of both trials.
    """
    if references is None:
        return reference, reference
    if not isinstance(references, list | tuple) or len(references) != 2:
        raise ValueError(
            f"references = {reprlib.repr(references)} must be two references: one of the "
            "trial, and one of the next trial"
        )
    return [arguments.in_columns("references", r, reference.shape, names) for r in references]


def _finite(signal):
    """Return the signal; if a value is not finite, raise a ValueError."""
    if not np.isfinite(signal).all():
        raise ValueError(
            f"v or e is too large, because the next v would exceed {np.finfo(float).max:.2g}: "
            "check the units, and whether the trials have diverged"
        )
    return signal
