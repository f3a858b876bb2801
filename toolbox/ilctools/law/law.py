"""The ILC law (23): from a trial's signal and error to the next trial's signal."""

import reprlib
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ilctools import arguments
from ilctools.filters import LearningOperator, ZeroPhaseButterworth, check_learning
from ilctools.law.limits import Actuators, LimitsOf, check_solver, projected, stated_limits
from ilctools.loop.closed import Loop, same_loop
from ilctools.signals import Signals, check_match


@dataclass(frozen=True, eq=False)
class Law:
    """The law of iterative learning, v_{k+1} = Q (v_k + L e_k); what it is made of is checked.

    From trial k with the error e_k to the signal v of the next, (23) of the paper; D. A. Bristow,
    M. Tharayil and A. G. Alleyne, A survey of iterative learning control, IEEE Control Systems
    Magazine 26 (2006) 96-114.

    With a learning gain a below one, v goes only that share of the way there,
    v_{k+1} = (1 - a) v_k + a Q (v_k + L e_k): slower, but noise in e is averaged.

    Attributes
    ----------
    Q : ZeroPhaseButterworth
    L : LearningOperator or None
        None switches learning off: v stays what it is.
    rest : int
        Number of samples at the end of every trial in which v is held at zero. The filters look
        beyond the end, so what they make of the last samples may grow from trial to trial.
    gain : float
        Learning gain a, in (0, 1].
    limits : dict, optional
        Lowest and highest command, by the names of the loop's commands, in their units. The law
        then projects v onto what can be applied. {} stands for no limits at all, also on a rig that
        has some. Default: :func:`ilctools.record` takes the limits of the rig, and elsewhere there
        are none; the attribute is then :attr:`.LimitsOf.RIG`. Where an actuator is limited in its
        rate, let the reference rise as slowly.
    loop : CurrentTrialLoop or ClosedLoop, optional
        The loop that the law is for. :func:`ilctools.run_trials` and :func:`ilctools.record` bind a
        law without one to theirs, and refuse a law for another.
    region : Response, optional
        The plants of a design and their radius: trials are judged by them. If it is one model
        alone, they are judged by the loop's P, if the loop has one. :meth:`.Synthesis.law` gives
        it; neither a file of the law nor a log stores it.
    labels : Signals, optional
        Names and units of the plant of a design: a loop with the same in another order is refused.
        No file stores them, either.

    See Also
    --------
    synthesise : its L
    run_trials : simulated trials
    record : trials on a rig
    save_law : to a file

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

    def __post_init__(self):
        if not isinstance(self.Q, ZeroPhaseButterworth):
            raise ValueError(
                f"Q = {reprlib.repr(self.Q)} must be a ZeroPhaseButterworth, which runs in both "
                "directions: zero_phase_butterworth(order, cutoff, Ts), with the cut-off in rad/s"
            )
        if self.L is not None:
            check_learning(self.L)
        if self.loop is not None:
            arguments.instance("loop", self.loop, Loop)
        check_match(Q=self.Q, L=self.L, law=self.labels, loop=self.loop)
        vars(self).update(
            rest=arguments.whole("rest", self.rest, 0),
            gain=arguments.number("gain", self.gain, "in (0, 1]", 0, most=1),
        )
        commands = getattr(self.loop, "commands", None)
        vars(self)["limits"] = stated_limits(self.limits, commands)

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.Q.Ts

    @property
    def outputs(self) -> list[str] | None:
        """Names of the outputs whose errors it takes, of a law that is bound to a loop."""
        return getattr(self.loop, "outputs", None)

    @property
    def inputs(self) -> list[str] | None:
        """Names of the channels of v, of a law that is bound to a loop.

        Where v is added to references, one for each output, they are those of the outputs.
        """
        if self.loop is None:
            return None
        return self.loop.outputs if self.loop.one_for_one else self.loop.learned

    @property
    def rows(self) -> int | None:
        """Number m of channels of v; None if neither L nor a loop says it."""
        return self.L.rows if self.L is not None else self.inputs and len(self.inputs)

    @property
    def columns(self) -> int | None:
        """Number p of channels of the error; None if neither L nor a loop says it."""
        return self.L.columns if self.L is not None else self.outputs and len(self.outputs)

    @property
    def known_limits(self) -> dict[str, tuple[float, float]]:
        """The limits that hold before a rig states its own: {} for none."""
        return {} if self.limits is LimitsOf.RIG else self.limits

    def on_rig(self, limits: dict[str, tuple[float, float]]) -> "Law":
        """This law on a rig with these limits: they hold where the law does not state its own.

        A law whose limits are {} has none at all, whatever the rig follows.
        """
        if self.limits == {}:
            return self
        return replace(self, limits=limits | self.known_limits)

    @cached_property
    def actuators(self) -> Actuators | None:
        """What the limits make of commands; None without limits."""
        if not self.known_limits:
            return None
        if self.loop is None:
            raise ValueError("limits need the law's loop: law.bound_to(loop)")
        if self.L is not None:
            check_solver(self.loop)
        return Actuators.of(self.known_limits, self.loop)

    def bound_to(self, loop: Loop) -> "Law":
        """This law for a loop; a ValueError if it is for another."""
        arguments.instance("loop", loop, Loop)
        if self.loop is None:
            return replace(self, loop=loop)
        if not same_loop(self.loop, loop):
            raise ValueError(
                "law is bound to another loop: pass law.loop, or "
                "dataclasses.replace(law, loop=None)"
            )
        return self

    def first(self, samples: int, v=None) -> np.ndarray:
        """The signal of the first trial, shape (samples, m): `v`, or zero; zero in the rest."""
        rest = arguments.whole("rest", self.rest, 0, samples - 1)
        shape = samples, self.rows
        v = np.zeros(shape) if v is None else v
        v = arguments.in_columns("v", v, shape, self._names(v, self.inputs, self.rows))
        v[samples - rest :] = 0
        if self.L is not None:
            # which one for other trials refuses, before any is run
            self.L.apply(np.zeros((samples, self.columns)))
        return v

    def next(self, v, e, u=None, applied=None) -> np.ndarray:
        """The signal of the next trial, v_{k+1} of (23).

        With limits, of all v whose commands stay within them, the nearest to the v* of the law
        without: it minimises ||P (v - v*)||^2 + weight ||v - v*||^2, by the model of the loop, from
        the commands that were applied. The weight is that of L, 0.01 of a filter: with that
        of :class:`ilctools.NormOptimal` and a Q near one this is constrained norm-optimal learning,
        whose predicted error cannot rise. What the loop asks for in the rest, where v is zero, is
        left out of account. Of a ClosedLoop without P the commands are cut off instead.

        Parameters
        ----------
        v : array_like, shape (time, m), or (time,) of one channel
            ILC signal of the trial just done; the time first, which a square array cannot show.
            Labelled signals (columns, or coordinates) are matched by name, for which a law of
            several channels must be bound to a loop.
        e : array_like, shape (time, p), or (time,) of one channel
            Its tracking error, reference - y.
        u : array_like, shape (time, commands), optional
            Needed with limits: commands that the controller asked for in it; of a CurrentTrialLoop
            its controls, of a ClosedLoop its inputs w. Also of a first trial, where v is zero
            and they are not.
        applied : array_like, shape (time, commands), optional
            What the actuators made of u, and the observer was informed of. Default: u, cut off at
            the limits.

        Returns
        -------
        ndarray, DataFrame or DataArray, with the shape, labels and order of v

        Raises
        ------
        ValueError
            If signals do not fit the law, or are so large that the next v is not finite, or if
            limits lack a loop or u.
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
        rest = arguments.whole("rest", self.rest, 0, v.shape[-2] - 1)
        v, applied = self.applied(v, u, applied)
        following = self._learned(v, e)
        following[..., v.shape[-2] - rest :, :] = 0
        if self.actuators is not None:
            weight = self.L.weight_of_change
            following = projected(self.loop, self.actuators, v, applied, following, weight, rest)
        return arguments.labelled_as(labelled, following, names)

    def _learned(self, v, e):
        """v of (23) without rest and limits."""
        a = self.gain
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused
            learned = _finite(v + self.L.apply(e))
            return _finite((1 - a) * v + a * self.Q.apply(learned))  # (23)

    def _names(self, signal, known, count):
        """Names of v's or e's channels; of a law without a loop, they cannot be matched with L."""
        if known or count is None:
            return known
        labels = arguments.names_of(signal) or [""] * count
        if any(labels) and count > 1:
            raise ValueError(
                f"v or e holds the signals {reprlib.repr(labels)}, of which a law without a loop "
                "does not know the order: bind it, law.bound_to(loop), or pass an array"
            )
        return labels

    def applied(self, v, u, applied=None) -> tuple[np.ndarray, np.ndarray | None]:
        """v as far as it was applied, and the commands that were, from u, those asked for."""
        if self.actuators is None:
            return v, applied
        if u is None:
            raise ValueError("u = None: with limits, the trial's commands are needed")
        commands, shape = self.loop.commands, (*v.shape[:-1], len(self.loop.commands))
        u = arguments.in_columns("u", u, shape, commands)
        if applied is None:
            applied = self.actuators.follow(u)
        else:
            applied = arguments.in_columns("applied", applied, shape, commands)
        return self.loop.realised(v, u, applied), applied


def _finite(signal):
    """The signal; a ValueError if it overflowed, for it would go to actuators."""
    if not np.isfinite(signal).all():
        raise ValueError(
            f"v or e is too large: the next v would exceed {np.finfo(float).max:.2g}. Check the "
            "units, and whether the trials have diverged"
        )
    return signal
