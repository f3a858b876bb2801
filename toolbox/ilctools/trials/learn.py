"""The loop of iterative learning, Section IV of the paper, for trials on a model or on a rig."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ilctools import arguments
from ilctools.law.law import Law
from ilctools.law.output_step import Step
from ilctools.law.repetitive import check_period, memory, next_samples
from ilctools.loop.closed import Loop
from ilctools.trials.points import asking, filled, one_mask
from ilctools.trials.transfer import fitted

BETWEEN_TRIALS = ("law", "transfer")  # what computes v if the reference changes
TRANSFER = BETWEEN_TRIALS[1]
ROUNDED_PILOT = 1e-3  # tolerance relative to the reference, because a rig may round v

Part = dict[str, np.ndarray]  # signals of a trial, or of a part of one, shape (time, channel)


class Asked(NamedTuple):
    """The checked task of an experiment: the law, the references and the first v."""

    law: Law
    reference: np.ndarray  # (trial, time, p), with numbers between points
    first: np.ndarray  # v of the first trial, (time, m)
    points: np.ndarray | None  # (time, p): where a reference is given; None: everywhere


def asked_of(
    law: Law, reference, trials: int, v, reset: bool, pilot: float | None, between: str
) -> Asked:
    """Check the arguments of an experiment, and return its task.

    The law must know its loop.
    """
    loop, trials = law.loop, arguments.whole("trials", trials, 1)
    reference, asked = filled(reference)
    like = "time", loop.outputs, loop.Ts
    reference = arguments.each_trial("reference", reference, trials, *like)
    if asked is not None:
        asked = one_mask(arguments.each_trial("reference", asked, trials, *like))
        law = asking(law, asked)
    first = law.first(reference.shape[1], v)
    if not arguments.flag("reset", reset):
        check_period(law, reference.shape[1])
    check_between(between, loop, reset)
    if law.output_limits is not None:
        _check_output_limits(law, reference, reset)
    share = _first_share(law, reference[0], v, pilot)
    if share is not None:
        first = (share - 1) * (reference[0] - reference[0, 0])
    return Asked(law, reference, first, asked)


def _first_share(law, reference, v, pilot):
    """Return the share of the reference that drives trial 1.

    If the first v is given or zero, None is returned.
    """
    added = law.loop.one_for_one
    if pilot is not None:
        pilot = arguments.number("pilot", pilot, "a share in (0, 1]", 0, most=1)
        if v is not None or not added:
            raise ValueError(
                f"pilot = {pilot} is a share of the reference, from which v of trial 1 is "
                "made: it needs a loop whose v is added to references, and no v as an "
                "argument"
            )
    elif v is None and law.output_limits is not None and added:
        pilot = law.output_limits.first_share(reference)
    return pilot


def check_between(between: str, loop: Loop, reset: bool) -> None:
    """Refuse a value of `between` that the loop, or trials without reset, do not permit."""
    arguments.choice("between", between, BETWEEN_TRIALS)
    if between == TRANSFER and not (loop.one_for_one and reset):
        raise ValueError(
            "between = 'transfer' needs a v that is added to references, one for each output, "
            "and a reset before each trial"
        )


def _check_output_limits(law, reference, reset):
    """Refuse arguments with which limits of outputs cannot be kept.

    This check is made before any trial.
    """
    if not reset:
        raise ValueError(
            "reset = False, but limits of outputs need trials that start from "
            "rest: take reset=True, or leave these limits out"
        )
    if np.any(reference != reference[0]) and not law.loop.one_for_one:
        raise ValueError(
            "reference changes from trial to trial, and acts on the outputs through other "
            "inputs than v, for which no radius is known: use one reference, or leave out the "
            "limits of outputs"
        )
    for r in reference:
        law.output_limits.check_rest(r)


def disturbances_of(loop: Loop, disturbance, trials: int, samples: int) -> np.ndarray:
    """Return the disturbances of all trials, shape (trial, time, d).

    If `disturbance` is None, all disturbances are zero.
    """
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
    """Learn to follow a reference, part by part, and return the parts.

    The reference has the shape (time, p). With a reset, each part is a trial. The equations are
    those of the paper:

        w_k = r + v_k, or F r + G v_k                                                        (22)
        v_{k+1} = Q (v_k + L e_k),    e_k = r - y_k                                          (23)

    The function `following(parts, upcoming)` computes (23) from all parts so far, see
    :func:`next_v`. The argument `upcoming` is the rest of the reference. The function
    `respond(w, now)` applies w in the samples `now` of the reference, and returns the other
    signals.
    """
    parts, done = [], 0
    while done < len(reference):
        v = following([*past, *parts], reference[done:])[: len(reference) - done]  # (23)
        now = slice(done, done + len(v))
        r = reference[now]
        parts.append({"v": v, "reference": r} | respond(loop.w(r, v), now))  # (22)
        done = now.stop
    return parts


def next_v(
    law: Law,
    first: np.ndarray,
    reset: bool,
    between: str,
    parts: Sequence[Part],
    upcoming: np.ndarray | None = None,
) -> np.ndarray:
    """Compute the next v by (23) of the paper, from the parts so far.

    A part is a trial, or without reset a part of a trial. Without reset, v is returned for as many
    samples as the parts determine. If the reference changes and `between` is "transfer",
    :func:`.transfer` computes v from all parts instead.
    """
    if not parts:
        return first
    if reset:
        return next_step(law, between, parts, upcoming)[0]
    signals = joined(_last(parts, memory(law, len(first))))
    e = signals["reference"] - signals["y"]
    return next_samples(law, law.applied_v(signals), e, first)


def next_step(
    law: Law, between: str, parts: Sequence[Part], upcoming: np.ndarray | None = None
) -> tuple[np.ndarray, Step | None]:
    """Compute v of the next trial, and the step that keeps limits of outputs.

    If there are no limits of outputs, there is no step.
    """
    *past, now = parts
    reference, y = now["reference"], now["y"]
    upcoming = reference if upcoming is None else upcoming[: len(reference)]
    u = None if law.loop is None else law.loop.asked(now)
    v, applied = law.applied(now["v"], u, now.get("applied"))
    if law.L is None:
        return v, None
    if between == TRANSFER and not np.array_equal(upcoming, reference):
        applied_to = np.array([*map(law.applied_v, parts)])
        others = (np.array([part[name] for part in parts]) for name in ("y", "reference"))
        target = fitted(applied_to, *others, upcoming, law.loop.P_v).v
        target[len(target) - law.rest :] = 0
    else:
        began = np.zeros_like(v) if past else _pilot(law, now)
        # The law learns as if trial 1 had had the whole reference, whatever the learning gain is:
        # the part of v that reduced the reference is not kept.
        effect = law.output_limits.region.output(began) if began.any() else 0.0
        target = law.unlimited(v - began, reference - y + effect)
    return law.within_limits(target, v, applied, y, (reference, upcoming), past)


def _pilot(law, first):
    """Return the part of the first v that scales the reference down.

    If the reference is not scaled down, this part is zero.
    """
    v, rise = first["v"], first["reference"] - first["reference"][0]
    if law.output_limits is None or v.shape != rise.shape or not rise.any():
        return np.zeros_like(v)
    less = np.sum(v * rise) / np.sum(rise**2) * rise
    is_one = np.allclose(v, less, rtol=0, atol=ROUNDED_PILOT * np.abs(rise).max())
    return less if is_one else np.zeros_like(v)


def _last(parts, samples):
    """Return the last parts, which together have at least `samples` samples."""
    done = np.cumsum([len(part["v"]) for part in reversed(parts)])
    return parts[-1 - np.searchsorted(done, samples) :]


def joined(parts: Sequence[Part], join: Callable = np.concatenate) -> Part:
    """Join the signals of samples, of parts of a trial, or of trials."""
    return {name: join([part[name] for part in parts]) for name in parts[-1]}
