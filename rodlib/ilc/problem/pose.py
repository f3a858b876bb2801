"""Stating a problem, each argument checked."""

from dataclasses import replace

import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.problem import defaults
from rodlib.ilc.problem.problem import (
    ROUNDING,
    Choices,
    Problem,
    largest_singular_values,
)
from rodlib.ilc.problem.responses import IMAGINARY, on_one_grid


def pose(
    P,
    Q,
    omega=None,
    Ts=None,
    *,
    L_max=defaults.CHOOSE,
    band=None,
    scale=None,
    uncertainty=None,
    **choices,
) -> Problem:
    """State the problem (39), or (45) with (46), and check it; see :func:`rodlib.synthesise`.

    `choices` are those of :class:`Choices`.
    """
    samples = on_one_grid(P, Q, omega, Ts, uncertainty, scale)
    nominal, omega, n = samples.plants[0], samples.omega, len(samples.omega)
    choices = _checked(Choices(**choices), n)
    _refuse_hertz(samples)
    singular_values = np.linalg.svd(nominal, compute_uv=False)
    _refuse_singular(nominal, singular_values, omega)
    cutoff = defaults.cutoff(samples.butterworth, samples.Q, omega)
    by_default = []
    if band is None:
        band = defaults.band(cutoff, omega)
        if choices.objective == "sum":
            low, high = band
            by_default.append(f"band = ({low:.4g}, {high:.4g}) rad/s, by Q's cut-off")
    if isinstance(L_max, str) and L_max == defaults.CHOOSE:
        L_max = defaults.gain(cutoff, singular_values[:, -1], omega)
        by_default.append(f"L_max = {L_max:g}, a gain that inverts P at Q's cut-off")
    elif L_max is not None:
        what = f"a positive number, None for no bound, or {defaults.CHOOSE!r}"
        L_max = arguments.positive("L_max", L_max, what)
    band = tuple(arguments.array("band", band, (2,)).tolist())
    _check_band(band, samples.Q, omega, choices.objective)
    basis = (*[f"chosen: {text}" for text in by_default], *samples.basis)
    return Problem(
        **vars(choices),
        **vars(replace(samples, basis=basis)),
        band=band,
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


def _refuse_hertz(samples):
    """Refuse frequencies in Hz: up to 1 / (2 Ts), where P is real, as z is -1 there."""
    P, last = samples.plants, samples.omega[-1]
    imaginary = np.abs(P.imag).max(axis=(2, 3))
    rounding = IMAGINARY * np.abs(P).max()
    real_at_last_only = (imaginary[:, -1] <= rounding) & (imaginary.max(1) > rounding)
    if abs(last * samples.Ts - 0.5) < IMAGINARY and real_at_last_only.any():
        raise ValueError(
            f"omega ends at {last:.6g} = 1 / (2 Ts), and P is real there, as at the "
            "Nyquist frequency: omega is in Hz, multiply it by 2 pi"
        )


def _check_band(band, Q, omega, objective):
    """Check that the band lies within omega, and that Q leaves something to learn there."""
    if objective == "sum":
        low, high = band
        slack = 1e-9 * omega[-1]
        if not omega[0] - slack <= low < high <= omega[-1] + slack:
            raise ValueError(
                f"band = {band!r} must be two increasing frequencies within omega, "
                f"[{omega[0]:.6g}, {omega[-1]:.6g}] rad/s"
            )
        Q = Q[(omega >= low) & (omega <= high)]
        if not Q.size:
            raise ValueError(f"band = {band!r} contains none of the frequencies omega")
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
