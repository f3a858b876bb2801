"""Frequencies that the grid of a problem leaves out: what holds there all the same.

The learning filter is known at all frequencies, and keeps its bound at all of them, also where the
grid is coarse. Where the samples of a plant end below the Nyquist frequency, nothing is known of
the plant; a bound of its size, whatever its phase, bounds M.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem.problem import ROUNDING, Problem

VALUES = (
    "P",
    "Q",
    "omega",
    "others",
    "radius",
    "asked",
)  # by frequency
LEAST = 1e-6  # gain of P L that is always let be, so that what is left of M_max may be nothing


def without_gaps(problem: Problem) -> Problem:
    """The problem with L bounded at further frequencies, where omega is coarse or ends too soon."""
    # But for a delay, a filter of n samples is a polynomial of degree (n - 1) / 2 in exp(i angle).
    # Next to its largest value it falls no faster than the cosine of that degree (M. Riesz).
    known, near = problem.angles, np.pi / (4 * problem.order)
    coarse = problem.L_max is not None and _reach(known).max() > near
    if not coarse and problem.beyond is None:
        return problem
    end = 0 if coarse else known[problem.asked][-1]
    gaps = [
        (a, b) for a, b in pairwise([0, *known, np.pi]) if a >= end and b - a > ROUNDING
    ]
    added = [np.linspace(a, b, 1 + int(np.ceil((b - a) / near)))[1:-1] for a, b in gaps]
    ends = np.array([0, np.pi])
    added.append(ends[(ends >= end) & (np.abs(ends - known[[0, -1]]) > ROUNDING)])
    added = np.sort(np.concatenate(added)) / problem.Ts
    problem = (
        refined(problem, added) if problem.everywhere else _with(problem, added)[0]
    )
    if (
        coarse and not problem.everywhere
    ):  # which finds where L passes its bound all the same
        share = np.cos((problem.order - 1) / 2 * _reach(problem.angles))
        problem = replace(problem, share_L=share)
    return problem if problem.beyond is None else _bounded_beyond(problem, near)


def refined(problem: Problem, omega, P=None, Q=0) -> Problem:
    """The problem with its bounds at further frequencies, too.

    There M is that of the plants that are models. What is known as samples only, or within a
    radius, is not known there: `P`, of all plants, and `Q` stand for it, in the order of the
    frequencies, or else a model; or nothing, so that L alone is bounded.
    """
    omega, models = np.sort(omega), {}
    if problem.butterworth is not None:
        models = {
            k: model for k, model in enumerate(problem.models) if model is not None
        }
    known = {k: frequency_response(model, omega) for k, model in models.items()}
    if P is None:
        P = np.array(
            [next(iter(known.values()), 0 * problem.P[:1])] * len(problem.models)
        )
    if known:
        Q = problem.butterworth.frequency_response(omega)
    for k, response in known.items():
        P[k] = response
    problem, new = _with(problem, omega)
    problem.P[new], problem.others[:, new], problem.Q[new] = P[0], P[1:], Q
    return problem


def _reach(angles):
    """The farthest from each sample that another angle can be and have no nearer sample."""
    between = np.diff(angles) / 2
    return np.maximum([angles[0], *between], [*between, np.pi - angles[-1]])


def _with(problem, omega):
    """The problem with further frequencies, where all stands as zero, and which those are."""
    order = np.argsort(np.append(problem.omega, omega), kind="stable")
    new, wide = order >= len(problem.omega), {}
    unbounded = {"limit_L": np.inf, "share_L": 1}
    for name in (*VALUES, *unbounded):
        values, axis = getattr(problem, name), int(name == "others")
        if values is not None:
            shape = (*values.shape[:axis], len(new), *values.shape[axis + 1 :])
            wide[name] = np.full(shape, unbounded.get(name, 0), dtype=values.dtype)
            wide[name][(slice(None),) * axis + (~new,)] = values
    wide["omega"][new] = omega
    return replace(problem, **wide), new


def _bounded_beyond(problem, near):
    """The problem with L bounded above the last sample so that M is, whatever the phase of P."""
    unknown = np.arange(len(problem.omega)) >= np.flatnonzero(problem.asked)[-1]
    omega = problem.omega[unknown]
    Q, (last, *_) = problem.Q_beyond(omega), omega
    below = np.maximum.accumulate(
        np.append(Q[0], Q[:-1])
    )  # M must keep its bound in between
    with np.errstate(divide="ignore"):  # |Q (I - P L)| <= |Q| (1 + size sigma_max(L))
        room = np.maximum(problem.M_max / np.maximum(below, 1e-300) - 1, LEAST)
        limit = np.cos((problem.order - 1) / 4 * near) * room / problem.beyond
    limits = problem.limit_L.copy()
    limits[unknown] = np.where(below < problem.M_max, limit, np.inf)
    findings = ()
    if Q.max() >= problem.M_max:
        findings = (
            f"Q is {Q.max():.4g} above {last:.4g} rad/s, where P is not known: no filter bounds M "
            f"by {problem.M_max:g} there; lower the cut-off of Q, or measure further",
        )
    return replace(problem, limit_L=limits, findings=findings)
