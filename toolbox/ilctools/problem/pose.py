"""Stating a problem, each argument checked."""

from dataclasses import replace

import numpy as np

from ilctools import arguments
from ilctools.problem import defaults
from ilctools.problem.problem import ROUNDING, Choices, Problem, largest_singular_values
from ilctools.problem.reference import first_error
from ilctools.problem.responses import on_one_grid

OUTERMOST = 0.05  # share of the weights that the ends of omega may have unsaid


def pose(
    P,
    Q,
    omega=None,
    Ts=None,
    *,
    order=None,
    L_max=defaults.CHOOSE,
    band=None,
    reference=None,
    scale=None,
    uncertainty=None,
    **choices,
) -> Problem:
    """State the problem (39), or (45) with (46), and check it; see :func:`ilctools.synthesise`.

    `choices` are those of :class:`Choices`.
    """
    samples = on_one_grid(P, Q, omega, Ts, uncertainty, scale)
    nominal, omega, n = samples.plants[0], samples.omega, len(samples.omega)
    singular_values = np.linalg.svd(nominal, compute_uv=False)
    _refuse_singular(nominal, singular_values, omega)
    cutoff = defaults.cutoff(samples.butterworth, samples.Q, omega)
    by_default, power, assumed = [], None, []
    if order is None:
        delay = defaults.delay(nominal, omega, samples.Ts, cutoff)
        order = defaults.order(cutoff, delay, samples.Ts, n)
        by_default.append(f"order = {order}, by Q's cut-off and P's lag of {delay} samples there")
    choices = _checked(Choices(order=order, **choices), n)
    if band is None and reference is None:
        band = defaults.band(cutoff, omega)
        if choices.objective == "sum":
            low, high = band
            by_default.append(f"band = ({low:.4g}, {high:.4g}) rad/s, to Q's cut-off")
    if isinstance(L_max, str) and L_max == defaults.CHOOSE:
        # What is not known beyond its radius is not worth inverting.
        radius = 0 if samples.radius is None else samples.radius
        smallest = np.maximum(singular_values[:, -1], radius)
        L_max = defaults.gain(cutoff, smallest, omega)
        by_default.append(
            f"L_max = {L_max:g}, {defaults.ROOM} times a gain that inverts P up to Q's cut-off"
        )
    elif L_max is not None:
        what = f"a positive number, None for no bound, or {defaults.CHOOSE!r}"
        L_max = arguments.positive("L_max", L_max, what)
    if reference is None:
        band = tuple(arguments.array("band", band, (2,)).tolist())
        weights = _in_band(band, omega, choices.objective)
    else:
        _refuse_other_weights(band, choices.objective)
        power, weights = first_error(samples, reference)
        outer, (low, high) = weights[[0, -1]].sum(), omega[[0, -1]]
        if outer > OUTERMOST:
            assumed.append(
                f"assumed: next to and beyond {low:.4g} and {high:.4g} rad/s, which have "
                f"{outer:.0%} of the weight, P is as there"
            )
    _refuse_idle(samples.Q if choices.objective == "peak" else samples.Q[weights > 0])
    chosen = [f"chosen: {text}" for text in by_default]
    basis = (*chosen, *assumed, *samples.basis)
    return Problem(
        **vars(choices),
        **vars(replace(samples, basis=basis)),
        band=band,
        first_error=power,
        weights=weights,
        L_max=L_max,
        further=np.empty(0),
        share_L=np.ones(n),
        limit_L=np.full(n, np.inf),
        beyond=_size_beyond(samples),
    )


def _checked(choices, n):
    """The choices, checked for n frequencies."""
    order = arguments.whole("order", choices.order, 1)
    if order > n:
        raise ValueError(
            f"order = {order} is more than the {n} frequencies of omega determine: take "
            f"order = {n} or less, or more frequencies"
        )
    what = "in (0, 1), or the trials do not converge"
    M_max = arguments.number("M_max", choices.M_max, what, 0, 1)
    arguments.choice("structure", choices.structure, ["diagonal", "full"])
    arguments.choice("objective", choices.objective, ["sum", "peak"])
    everywhere = arguments.flag("everywhere", choices.everywhere)
    return replace(choices, order=order, M_max=M_max, everywhere=everywhere)


def _refuse_other_weights(band, objective):
    """Refuse what a reference cannot be combined with."""
    if band is not None or objective != "sum":
        raise ValueError(
            f"reference takes the place of the band in the sum (39), but band = {band!r} and "
            f"objective = {objective!r}: leave these out, or the reference"
        )


def _in_band(band, omega, objective):
    """Ones in the band, which must lie within omega if there is a sum."""
    low, high = band
    inside = (omega >= low) & (omega <= high)
    if objective == "sum":
        slack = 1e-9 * omega[-1]
        if not omega[0] - slack <= low < high <= omega[-1] + slack:
            raise ValueError(
                f"band = {band!r} must be two increasing frequencies within omega, "
                f"[{omega[0]:.6g}, {omega[-1]:.6g}] rad/s"
            )
        if not inside.any():
            raise ValueError(f"band = {band!r} contains none of the frequencies omega")
    return inside.astype(float)


def _refuse_idle(Q):
    """Refuse a Q that leaves nothing to learn where the objective counts."""
    largest = np.abs(Q).max()
    if largest < 1e-6:  # the certificate could not distinguish the objective from L = 0
        raise ValueError(
            f"Q has a gain of {largest:.3g} at most where the objective counts, so that nothing "
            "is learned: its cut-off must be in rad/s"
        )


def _size_beyond(samples):
    """The largest sigma_max(P) above the last frequency; None if P is known up to Nyquist."""
    sampled = [model is None for model in samples.models]
    if not any(sampled) or samples.omega[-1] * samples.Ts >= np.pi - ROUNDING:
        return None
    size = largest_singular_values(samples.plants[sampled, -1]).max()
    return float(size if samples.radius is None else size + samples.radius[-1])


def _refuse_singular(P, singular_values, omega):
    smallest = np.maximum(1e-12 * singular_values[:, 0], 1 / arguments.LARGEST)
    singular = np.flatnonzero(singular_values[:, -1] <= smallest)
    if not singular.size:
        return
    first = singular[0]
    zero = np.abs(P[first]) <= smallest[first]
    cause = ""
    if zero.all(axis=1).any():
        cause = f"; output {zero.all(axis=1).argmax()} does not respond to any input"
    elif zero.all(axis=0).any():
        cause = f"; w {zero.all(axis=0).argmax()} has no effect on any output"
    raise ValueError(
        f"P is singular at omega = {omega[first]:.6g} rad/s (smallest singular value "
        f"{singular_values[first, -1]:.3g}): P^-1 in (40) does not exist there{cause}"
        f"{', counted from 0' if cause else ''}"
    )
