"""Frequencies that the grid of a problem leaves out: what holds there all the same.

The learning filter is known at all frequencies, and keeps its bound at all of them, also where the
grid is coarse. Where the samples of a plant end below the Nyquist frequency, nothing is known of
the plant; a bound of its size, whatever its phase, bounds M.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.problem import Problem, largest_singular_values

ROUNDING = 1e-9  # of an angle; what is nearer to pi is at the Nyquist frequency


def without_gaps(problem: Problem, beyond=None) -> Problem:
    """The problem with L bounded at further frequencies, where omega is coarse or ends too soon.

    `beyond`: the largest sigma_max(P), in units of `scale`, above the last sample of a plant that
    is no model; by default as there.
    """
    # But for a delay, a filter of n samples is a polynomial of degree (n - 1) / 2 in exp(i angle).
    # Next to its largest value it falls no faster than the cosine of that degree (M. Riesz).
    known, n = problem.angles, problem.order
    near = np.pi / (4 * n)
    size, end = _size_beyond(problem, beyond), known[-1] < np.pi - ROUNDING
    reach = np.concatenate([[known[0]], np.diff(known) / 2, [np.pi - known[-1]]])  # to a sample
    coarse = problem.L_max is not None and reach.max() > near
    if not coarse and size is None:
        return problem
    added = []
    if coarse:
        added += [
            np.linspace(a, b, 1 + int(np.ceil((b - a) / near)))[1:-1] for a, b in pairwise(known)
        ]
        added.append(np.linspace(0, known[0], 1 + int(np.ceil(known[0] / near)))[:-1])
    if end:
        added.append(np.linspace(known[-1], np.pi, 2 + int((np.pi - known[-1]) / near))[1:])
    angles = np.concatenate([known, *added])
    order = np.argsort(angles, kind="stable")
    angles, asked = angles[order], order < len(known)

    def spread(values, axis=0):
        if values is None:
            return None
        shape = list(values.shape)
        shape[axis] = len(angles)
        out = np.zeros(shape, dtype=values.dtype)
        np.moveaxis(out, axis, 0)[asked] = np.moveaxis(values, axis, 0)
        return out

    reach = np.concatenate([[angles[0]], np.diff(angles) / 2, [np.pi - angles[-1]]])
    share = (
        np.cos((n - 1) / 2 * np.maximum(reach[:-1], reach[1:])) if coarse else np.ones(len(asked))
    )
    omega = np.where(asked, spread(problem.omega), angles / problem.Ts)
    limit, basis, findings = np.full(len(angles), np.inf), problem.basis, ()
    if size is not None:
        unknown = angles > known[-1]
        limit[unknown], said, findings = _limit_beyond(problem, omega[unknown], size)
        basis = (*basis, said)
    return replace(
        problem, P=spread(problem.P), Q=spread(problem.Q), omega=omega,
        others=spread(problem.others, axis=1), radius=spread(problem.radius),
        noise=spread(problem.noise), asked=asked, limit_L=limit, share_L=share, basis=basis,
        findings=findings,
    )  # fmt: skip


def _size_beyond(problem, beyond):
    """The largest sigma_max(P) above the last frequency; None if P is known up to Nyquist."""
    sampled = [k for k, model in enumerate(problem.models) if model is None]
    if not sampled or problem.angles[-1] >= np.pi - ROUNDING:
        if beyond is not None:
            raise ValueError(
                f"beyond = {beyond!r} is for plants known as samples up to less than the Nyquist "
                f"frequency, {np.pi / problem.Ts:.6g} rad/s: leave it out"
            )
        return None
    if beyond is not None:
        return arguments.not_negative("beyond", beyond)
    ends = np.array([problem.plant(k)[-1] for k in sampled])
    return largest_singular_values(ends).max() + (
        0 if problem.radius is None else problem.radius[-1]
    )


def _limit_beyond(problem, omega, size):
    """Bounds on sigma_max(L) where P is only known to be at most so large; what to say of that."""
    if problem.butterworth is None:
        Q = np.full(len(omega), np.abs(problem.Q[-1]))
    else:
        Q = np.abs(problem.butterworth.frequency_response(omega))
    with np.errstate(divide="ignore"):  # |Q (I - P L)| <= |Q| (1 + size sigma_max(L))
        limit = np.where(problem.M_max > Q, (problem.M_max / Q - 1) / size, np.inf)
    last = problem.omega[-1]
    said = (
        f"assumed: above {last:.4g} rad/s, where P is not known, sigma_max(P) is {size:.4g} at "
        "most, at any phase"
    )
    if Q.max() < problem.M_max:
        return limit, f"{said}; then sigma_max(M) is M_max at most there", ()
    return (
        limit,
        said,
        (
            f"Q is {Q.max():.4g} above {last:.4g} rad/s, where P is not known: no filter bounds M "
            f"by {problem.M_max:g} there; lower the cut-off of Q, or measure further",
        ),
    )
