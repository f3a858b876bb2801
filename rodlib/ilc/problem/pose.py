"""Stating a problem, each argument checked."""

import reprlib

import control
import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import ZeroPhaseButterworth
from rodlib.ilc.problem import defaults
from rodlib.ilc.problem.problem import ROUNDING, Problem, largest_singular_values
from rodlib.ilc.problem.responses import (
    IMAGINARY,
    Measured,
    Q_on_grid,
    axes,
    on_grid,
    period,
    plants,
)

CONFIDENCE = 0.99  # in a measured response, if not said otherwise


def pose(
    P,
    Q,
    omega=None,
    Ts=None,
    *,
    order=Problem.order,
    M_max=Problem.M_max,
    L_max=defaults.CHOOSE,
    band=None,
    structure=Problem.structure,
    objective=Problem.objective,
    scale=None,
    uncertainty=None,
    confidence=None,
    beyond=None,
    everywhere=False,
) -> Problem:
    """State the problem (39), or (45) with (46), and check it; see :func:`rodlib.synthesise`."""
    _refuse_exchanged(Q, omega)
    Ts = arguments.sampling_period("Ts", period(P, Q) if Ts is None else Ts)
    if omega is None:
        omega = defaults.frequencies([*plants(P).values()], Q, Ts)
    omega = arguments.frequencies("omega", omega, Ts)
    basis = ()
    if isinstance(P, Measured):
        P, uncertainty, basis = _measured(P, omega, uncertainty, confidence, scale)
    elif confidence is not None:
        raise ValueError(
            f"confidence = {reprlib.repr(confidence)} is for a measured response, but P is not "
            "one: pass the radius as uncertainty"
        )
    models, responses = on_grid(plants(P), omega, Ts)
    _refuse_hertz(responses, omega, Ts)
    P, others = responses[0], responses[1:]
    n, m, _ = P.shape
    q, Q = Q_on_grid(Q, omega, P=Ts)
    order = arguments.whole("order", order, 1)
    if order > n:
        raise ValueError(
            f"order = {order} is more than the {n} frequencies of omega tell: take order = {n} or "
            "less, or more frequencies"
        )
    what = "in (0, 1), or the trials do not converge"
    M_max = arguments.number("M_max", M_max, what, 0, 1)
    arguments.choice("structure", structure, ["diagonal", "full"])
    arguments.choice("objective", objective, ["sum", "peak"])
    radius = _radius(uncertainty, n)
    if scale is None:
        scale = np.ones(m)
    else:
        scale = _scale(scale, m)
        units = scale / scale[:, None]
        P, others = P * units, others * units
        models = [_scaled(model, scale) for model in models]
    _refuse_singular(P, omega)
    band, L_max, chosen = _chosen(band, L_max, objective, q, Q, P, omega)
    _check_band(band, Q, omega, objective)
    beyond = _size_beyond(
        beyond, models, np.concatenate([P[None], others]), radius, omega[-1], Ts
    )
    return Problem(
        P, Q, omega, Ts, scale, others, tuple(models), q,
        np.ones(n, dtype=bool), np.full(n, np.inf), np.ones(n), band, L_max,
        order, M_max, structure, objective, radius, (*chosen, *basis), beyond=beyond,
        everywhere=arguments.flag("everywhere", everywhere),
    )  # fmt: skip


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


def _measured(P, omega, uncertainty, confidence, scale):
    """Response and radius of a measurement, and what they rest on."""
    if uncertainty is not None:
        raise ValueError(
            "uncertainty must be None if P is a measured response, which has a radius of its own: "
            "for a larger one, pass both of P.on(omega, confidence) as arrays"
        )
    confidence = CONFIDENCE if confidence is None else confidence
    response, radius = P.on(omega, confidence, None)
    if scale is not None:
        radius = P.on(omega, confidence, _scale(scale, response.shape[1]))[1]
    return response, radius, P.basis(omega, confidence)


def _chosen(band, L_max, objective, butterworth, Q, P, omega):
    """Band and bound on the gain, those that nobody gave by `defaults`, in words."""
    chosen, cutoff = [], defaults.cutoff(butterworth, Q, omega)
    if band is None:
        band = defaults.band(cutoff, omega)
        if objective == "sum":
            chosen.append(
                f"band = ({band[0]:.4g}, {band[1]:.4g}) rad/s, by Q's cut-off"
            )
    if isinstance(L_max, str) and L_max == defaults.CHOOSE:
        L_max = defaults.gain(cutoff, P, omega)
        chosen.append(f"L_max = {L_max:g}, a gain that inverts P at Q's cut-off")
    elif L_max is not None:
        what = f"a positive number, None for no bound, or {defaults.CHOOSE!r}"
        L_max = arguments.positive("L_max", L_max, what)
    low, high = arguments.array("band", band, (2,)).tolist()
    return (low, high), L_max, [f"chosen: {text}" for text in chosen]


def _check_band(band, Q, omega, objective):
    """Check that the band lies within omega, and that Q leaves something to learn there."""
    low, high = band
    in_band = (omega >= low) & (omega <= high) if objective == "sum" else None
    if in_band is not None:
        slack = 1e-9 * omega[-1]
        if not omega[0] - slack <= low < high <= omega[-1] + slack:
            raise ValueError(
                f"band = {band!r} must be two increasing frequencies within omega, "
                f"[{omega[0]:.6g}, {omega[-1]:.6g}] rad/s"
            )
        if not in_band.any():
            raise ValueError(f"band = {band!r} contains none of the frequencies omega")
    learned = np.abs(Q if in_band is None else Q[in_band]).max()
    if learned < 1e-6:  # of an error, which the certificate could not tell from nothing
        raise ValueError(
            f"Q has a gain of {learned:.3g} at most where the objective counts: it learns "
            "nothing. Is its cut-off in rad/s?"
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


def _size_beyond(beyond, models, plants, radius, last, Ts):
    """The largest sigma_max(P) above the last frequency; None if P is known up to Nyquist."""
    if beyond is not None:
        beyond = arguments.not_negative("beyond", beyond)
    sampled = np.array([model is None for model in models])
    if not sampled.any() or last * Ts >= np.pi - ROUNDING:
        if beyond is not None:
            raise ValueError(
                f"beyond = {beyond:.6g} is for plants known as samples up to less than the Nyquist "
                f"frequency, {np.pi / Ts:.6g} rad/s: leave it out"
            )
        return None
    if beyond is not None:
        return beyond
    size = largest_singular_values(plants[sampled, -1]).max()
    return float(size if radius is None else size + radius[-1])


def _scale(scale, m):
    scale = arguments.array("scale", scale, (m,))
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


def _refuse_singular(P, omega):
    singular_values = np.linalg.svd(P, compute_uv=False)
    smallest = np.maximum(1e-12 * singular_values[:, 0], 1 / arguments.LARGEST)
    singular = np.flatnonzero(singular_values[:, -1] <= smallest)
    if not singular.size:
        return
    first = singular[0]
    size = np.abs(P[first])
    dead = [
        f"output {k} answers to none"
        for k in np.flatnonzero(size.max(1) <= smallest[first])
    ]
    dead += [
        f"no output answers to w {k}"
        for k in np.flatnonzero(size.max(0) <= smallest[first])
    ]
    raise ValueError(
        f"P is singular at omega = {omega[first]:.6g} rad/s (smallest singular value "
        f"{singular_values[first, -1]:.3g}): P^-1 in (40) does not exist there"
        f"{''.join(f'; {text}, counted from 0' for text in dead[:1])}"
    )
