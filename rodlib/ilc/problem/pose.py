"""Stating a problem, each argument checked."""

import reprlib
from dataclasses import replace

import control
import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import ZeroPhaseButterworth
from rodlib.ilc.problem import defaults
from rodlib.ilc.problem.problem import (
    ROUNDING,
    Choices,
    Problem,
    largest_singular_values,
)
from rodlib.ilc.problem.responses import (
    IMAGINARY,
    Measured,
    Q_on_grid,
    axes,
    on_grid,
    period,
    plants,
)
from rodlib.ilc.signals import Signals

CONFIDENCE = 0.99  # in a measured response


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
    _refuse_exchanged(Q, omega)
    Ts = arguments.sampling_period("Ts", period(P, Q) if Ts is None else Ts)
    if omega is None:
        omega = defaults.frequencies([*plants(P).values()], Q, Ts)
    omega = arguments.increasing_frequencies("omega", omega, Ts)
    n = len(omega)
    choices = _checked(Choices(**choices), n)
    basis = ()
    if isinstance(P, Measured):
        P, uncertainty, basis = _measured(P, omega, uncertainty, scale)
    models, responses = on_grid(plants(P), omega, Ts)
    _refuse_hertz(responses, omega, Ts)
    butterworth, Q = Q_on_grid(Q, omega, P=Signals(Ts))
    radius = _radius(uncertainty, n)
    m = responses.shape[-1]
    if scale is None:
        scale = np.ones(m)
    else:
        scale = _scale(scale, m)
        responses = responses * (scale / scale[:, None])
        models = [_scaled(model, scale) for model in models]
    singular_values = np.linalg.svd(responses[0], compute_uv=False)
    _refuse_singular(responses[0], singular_values, omega)
    cutoff = defaults.cutoff(butterworth, Q, omega)
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
    _check_band(band, Q, omega, choices.objective)
    return Problem(
        **vars(choices),
        plants=responses,
        Q=Q,
        omega=omega,
        Ts=Ts,
        scale=scale,
        models=tuple(models),
        butterworth=butterworth,
        band=band,
        L_max=L_max,
        further=np.empty(0),
        share_L=np.ones(n),
        limit_L=np.full(n, np.inf),
        radius=radius,
        beyond=_size_beyond(models, responses, radius, omega[-1], Ts),
        basis=(*[f"chosen: {text}" for text in by_default], *basis),
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


def _refuse_exchanged(Q, omega):
    """Refuse Q and omega in each other's place."""
    if isinstance(omega, ZeroPhaseButterworth | control.LTI):
        raise ValueError(
            f"omega = {reprlib.repr(omega)} is a filter: likely exchanged with Q"
        )
    if _rises(Q) and axes(omega) == 1 and not _rises(omega):
        raise ValueError(
            "omega does not increase, but Q does: likely they are exchanged"
        )


def _rises(samples):
    """Whether something is a row of increasing numbers."""
    row = np.asarray(samples) if axes(samples) == 1 else np.empty(0)
    return row.dtype.kind in "iuf" and len(row) > 1 and bool(np.all(np.diff(row) > 0))


def _refuse_hertz(responses, omega, Ts):
    """Refuse frequencies in Hz: up to 1 / (2 Ts), where P is real, as z is -1 there."""
    imaginary = np.abs(responses.imag).max(axis=(2, 3))
    rounding = IMAGINARY * np.abs(responses).max()
    real_at_last_only = (imaginary[:, -1] <= rounding) & (imaginary.max(1) > rounding)
    if abs(omega[-1] * Ts - 0.5) < IMAGINARY and real_at_last_only.any():
        raise ValueError(
            f"omega ends at {omega[-1]:.6g} = 1 / (2 Ts), and P is real there, as at the "
            "Nyquist frequency: omega is in Hz, multiply it by 2 pi"
        )


def _measured(P, omega, uncertainty, scale):
    """Response and radius of a measurement, and what they rest on."""
    if uncertainty is not None:
        raise ValueError(
            "uncertainty must be None if P is a measured response, which has a radius of its own: "
            "for a larger one, pass both of P.on(omega, confidence) as arrays"
        )
    response, radius = P.on(omega, CONFIDENCE)
    if scale is not None:  # the response is scaled with those of other plants
        scale = _scale(scale, response.shape[1])
        radius = P.on(omega, CONFIDENCE, scale)[1]
    return response, radius, P.basis(omega, CONFIDENCE)


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


def _radius(uncertainty, n):
    """Radius at each frequency; None if it is zero throughout."""
    if uncertainty is None:
        return None
    radius = arguments.array("uncertainty", uncertainty, (...,))
    if radius.shape != (n,):
        size = f"= {radius}" if radius.ndim == 0 else f"has shape {radius.shape}, but"
        raise ValueError(
            f"uncertainty {size} must have shape ({n},), the largest ||Delta|| at each frequency: "
            f"np.full({n}, r) is a radius r at all frequencies"
        )
    if radius.min() < 0:
        raise ValueError(
            f"uncertainty reaches {radius.min():.6g}, but a radius cannot be negative: pass the "
            "largest ||Delta|| at each frequency"
        )
    return radius if radius.any() else None


def _size_beyond(models, responses, radius, last, Ts):
    """The largest sigma_max(P) above the last frequency; None if P is known up to Nyquist."""
    sampled = [model is None for model in models]
    if not any(sampled) or last * Ts >= np.pi - ROUNDING:
        return None
    size = largest_singular_values(responses[sampled, -1]).max()
    return float(size if radius is None else size + radius[-1])


def _scale(scale, m):
    scale = arguments.row("scale", scale)
    if len(scale) != m:
        raise ValueError(f"scale has {len(scale)} numbers, but P has {m} channels")
    if scale.min() <= 0:
        raise ValueError(
            f"scale = {scale.tolist()} must be positive, one number per channel"
        )
    return scale


def _scaled(model, scale):
    """A model, if there is one, with its channels in units of scale."""
    if model is None:
        return None
    S, R = np.diag(scale), np.diag(1 / scale)
    return control.ss(model.A, model.B @ S, R @ model.C, R @ model.D @ S, model.dt)


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
