"""The loop of iterative learning, Section IV, whatever runs the trials: a model or a rig."""

from collections.abc import Callable, Sequence

import numpy as np

from ilctools import arguments
from ilctools.law.law import Law
from ilctools.law.repetitive import check_period, memory, next_samples
from ilctools.loop.closed import Loop

Part = dict[str, np.ndarray]  # signals of a trial, or of a part of one, shape (time, channel)


def asked_of(loop: Loop, law: Law, reference, trials: int, v, reset: bool):
    """The references of all trials (trial, time, m) and v of the first (time, m), checked."""
    trials = arguments.whole("trials", trials, 1)
    reference = arguments.each_trial("reference", reference, trials, "time", loop.outputs, loop.Ts)
    first = law.first(reference.shape[1], v)
    if not arguments.flag("reset", reset):
        check_period(law, reference.shape[1])
    return reference, first


def disturbances_of(loop: Loop, disturbance, trials: int, samples: int) -> np.ndarray:
    """The disturbances of all trials (trial, time, d); None stands for zero."""
    names = loop.disturbances
    d = np.zeros((samples, len(names))) if disturbance is None else disturbance
    return arguments.each_trial("disturbance", d, trials, samples, names, loop.Ts)


def learn(
    loop: Loop,
    respond: Callable,
    following: Callable,
    reference: np.ndarray,
    past: Sequence[Part] = (),
) -> list[Part]:
    """Learn what a reference (time, p) asks for, in parts; with a reset each is a trial.

        w_k = r + v_k, or F r + G v_k                                                        (22)
        v_{k+1} = Q (v_k + L e_k),    e_k = r - y_k                                          (23)

    `following(parts)` is (23) after these parts, see :func:`next_v`; `respond(w, now)` applies w
    in the samples `now` of the reference and returns the other signals.
    """
    parts, done = [], 0
    while done < len(reference):
        v = following([*past, *parts])[: len(reference) - done]  # (23)
        now = slice(done, done + len(v))
        r = reference[now]
        parts.append({"v": v, "reference": r} | respond(loop.w(r, v), now))  # (22)
        done = now.stop
    return parts


def next_v(law: Law, first: np.ndarray, reset: bool, parts: Sequence[Part]) -> np.ndarray:
    """v by (23) after these parts; without reset, of the samples that follow from them."""
    if not parts:
        return first
    if reset:
        parts = parts[-1:]
    elif not law.known_limits:  # with them what was applied follows from the start on
        parts = _last(parts, memory(law, len(first)))
    signals = joined(parts)
    e = signals["reference"] - signals["y"]
    if reset:
        u = law.loop and law.loop.asked(signals)
        return law.next(signals["v"], e, u, signals.get("applied"))
    return next_samples(law, applied_v(law, signals), e, first)


def applied_v(law: Law, signals: Part) -> np.ndarray:
    """v (time, m) as far as it was applied."""
    u = law.loop and law.loop.asked(signals)
    v, _ = law.applied(signals["v"], u, signals.get("applied"))
    return v


def _last(parts, samples):
    """The last parts, as many as have so many samples."""
    done = np.cumsum([len(part["v"]) for part in reversed(parts)])
    return parts[-1 - np.searchsorted(done, samples) :]


def joined(parts: Sequence[Part], join: Callable = np.concatenate) -> Part:
    """The signals of samples, of parts of a trial or of trials, joined."""
    return {name: join([part[name] for part in parts]) for name in parts[-1]}
