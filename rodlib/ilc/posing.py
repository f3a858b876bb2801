"""Stating a problem: plants in whatever form they are known, on one grid, each argument checked."""

import reprlib
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import control
import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import ZeroPhaseButterworth
from rodlib.ilc.loop import Loop
from rodlib.ilc.models import frequency_response, refuse_foreign
from rodlib.ilc.plausible import doubts_about_P, doubts_about_Q
from rodlib.ilc.problem import ROUNDING, Problem, largest_singular_values

MODELS = (Loop, control.LTI)  # what a plant may be, if not an array
CONFIDENCE = 0.99  # in a measured response, if not said otherwise


@runtime_checkable
class Measured(Protocol):
    """A response that was measured, with the radius in which the truth lies."""

    def on(self, omega, confidence, scale) -> tuple[np.ndarray, np.ndarray]:
        """Response, (n, m, m), and radius, (n,), on omega, in units of `scale`, (m,) or None."""

    def basis(self, omega, confidence) -> tuple[str, ...]:
        """What was measured, and what is assumed beside it on these frequencies."""


def pose(
    P,
    Q,
    omega,
    Ts=None,
    *,
    order=Problem.order,
    M_max=Problem.M_max,
    L_max=Problem.L_max,
    band=Problem.band,
    structure=Problem.structure,
    objective=Problem.objective,
    scale=None,
    uncertainty=None,
    noise=None,
    confidence=None,
    beyond=None,
    everywhere=False,
) -> Problem:
    """State the problem (39), or (45) with (46), and check it; see :func:`rodlib.synthesise`."""
    _refuse_exchanged(Q, omega)
    Ts = arguments.sampling_period("Ts", period(P, Q) if Ts is None else Ts)
    omega = arguments.frequencies("omega", omega, Ts)
    basis, given = (), P
    if isinstance(P, Measured):
        P, uncertainty, basis = _measured(P, omega, uncertainty, confidence, scale)
    elif confidence is not None:
        raise ValueError(
            f"confidence = {reprlib.repr(confidence)} is for a measured response, but P is not "
            "one: pass the radius as uncertainty"
        )
    models, responses = on_grid(plants(P), omega, Ts)
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
    if L_max is not None:
        L_max = arguments.positive("L_max", L_max, "a positive number, or None for no bound")
    arguments.choice("structure", structure, ["diagonal", "full"])
    arguments.choice("objective", objective, ["sum", "peak"])
    band = _band(band, Q, omega, objective)
    radius = _radius(uncertainty, n)
    if scale is None:
        scale = np.ones(m)
    else:
        scale = _scale(scale, m)
        units = scale / scale[:, None]
        P, others = P * units, others * units
        models = [_scaled(model, scale) for model in models]
    _refuse_singular(P, omega)
    doubts = () if isinstance(given, Measured) else _doubts(given, (P, *others), models, omega, Ts)
    doubts += (*doubts_about_Q(Q, omega, _learned(band, omega, objective), Ts),)
    noise = _weights(noise, omega, Ts, m, M_max, scale)
    beyond = _size_beyond(beyond, models, np.concatenate([P[None], others]), radius, omega[-1], Ts)
    return Problem(
        P, Q, omega, Ts, scale, others, tuple(models), q,
        np.ones(n, dtype=bool), np.full(n, np.inf), np.ones(n),
        order, M_max, L_max, band, structure, objective, radius, noise, basis, beyond=beyond,
        everywhere=arguments.flag("everywhere", everywhere), doubts=doubts,
    )  # fmt: skip


def _refuse_exchanged(Q, omega):
    """Refuse Q and omega in each other's place."""
    if isinstance(omega, ZeroPhaseButterworth | control.LTI):
        raise ValueError(f"omega = {reprlib.repr(omega)} is a filter: likely exchanged with Q")
    if _rises(Q) and _axes(omega) == 1 and not _rises(omega):
        raise ValueError("omega does not increase, but Q does: likely they are exchanged")


def _rises(samples):
    """Whether something is a row of increasing numbers."""
    row = np.asarray(samples) if _axes(samples) == 1 else np.empty(0)
    return row.dtype.kind in "iuf" and len(row) > 1 and bool(np.all(np.diff(row) > 0))


def _doubts(P, responses, models, omega, Ts):
    """What speaks against those of the plants that are known as samples."""
    known = zip(plants(P), responses, models, strict=True)
    found = [doubts_about_P(name, p, omega, Ts) for name, p, model in known if model is None]
    return tuple(text for texts in found for text in texts)


def _learned(band, omega, objective):
    """Which frequencies are in the band, if the objective has one."""
    return (omega >= band[0]) & (omega <= band[1]) if objective == "sum" else None


def period(P, Q):
    """The sampling period that Q, or else a plant, knows."""
    several = isinstance(P, list | tuple)
    for thing in (Q, *(P if several else [P])):
        if isinstance(thing, ZeroPhaseButterworth | Loop):
            return thing.Ts
        if isinstance(thing, control.LTI) and thing.dt and thing.dt is not True:
            return thing.dt
    raise ValueError("Ts must be given, as neither P nor Q knows the sampling period")


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


def plants(P):
    """The plants by their names in messages, the nominal one first, from one plant or several."""
    if isinstance(P, Iterator):
        raise ValueError(f"P = {reprlib.repr(P)} can be read only once: pass a list of plants")
    several = isinstance(P, np.ndarray) and P.ndim == 4
    if isinstance(P, list | tuple):
        measured = [isinstance(p, Measured) for p in P]
        if any(measured):
            raise ValueError(
                f"P[{measured.index(True)}] is a measured response, whose radius would count for "
                "all of the list: pass it alone, or P.on(omega, confidence) as arrays"
            )
        several = not P or any(isinstance(p, MODELS) or _axes(p) == 3 for p in P)
    if several and not len(P):
        raise ValueError(f"P = {P!r} holds no plant: pass one or more, the nominal one first")
    return {f"P[{k}]": plant for k, plant in enumerate(P)} if several else {"P": P}


def _axes(value):
    """Number of axes of an array; rows of different lengths are found where they are read."""
    try:
        return np.ndim(value)
    except (TypeError, ValueError):
        return 0


def on_grid(plants, omega, Ts):
    """Each plant as a model, or None, and their frequency responses on omega, (p, n, m, m)."""
    models, responses, shape = [], [], (len(omega), "m", "m")
    for name, plant in plants.items():
        model, response = _response(name, plant, omega, Ts)
        responses.append(arguments.array(name, response, shape, complex))
        models.append(model)
        shape = responses[0].shape
    return models, np.array(responses)


def _response(name, P, omega, Ts):
    """The plant as a model, or None, and its frequency response on omega, not yet checked."""
    refuse_foreign(name, P)
    if isinstance(P, Loop):
        P = P.P
    if isinstance(P, control.FrequencyResponseData):
        return None, _of_frd(name, P, omega, Ts)
    if not isinstance(P, control.TransferFunction | control.StateSpace):
        return None, P
    _check_period(name, P.dt, Ts)
    model = None
    if isinstance(P, control.StateSpace):
        model = arguments.state_space(name, P)
    elif P.ninputs == P.noutputs == 1:
        model = control.ss(P)
    arguments.stable(name, P.poles())
    if model is not None:
        return model, frequency_response(model, omega)
    response = np.reshape(P(np.exp(1j * omega * Ts)), (*P.shape, len(omega)))
    return None, np.moveaxis(response, -1, 0)


def _check_period(name, dt, Ts):
    if dt is True or dt != Ts:  # True, some period, equals 1 s
        raise ValueError(f"{name}.dt = {dt!r} differs from Ts = {Ts!r}: sample the model at Ts")


def _of_frd(name, P, omega, Ts):
    """Samples of python-control's frequency response data, which must be those on omega."""
    if P.dt and P.dt is not True:  # measured ones need not say it
        _check_period(name, P.dt, Ts)
    same = len(P.omega) == len(omega) and np.allclose(P.omega, omega, rtol=1e-9, atol=0)
    if not same:
        raise ValueError(
            f"{name} is known at {len(P.omega)} frequencies from {P.omega[0]:.6g} to "
            f"{P.omega[-1]:.6g} rad/s, which are not those of omega: pass omega = {name}.omega"
        )
    return np.moveaxis(P.frdata, -1, 0)


def Q_on_grid(Q, omega, **known):
    """The Q-filter as a model, or None, and its frequency response; `known`: a sampling period."""
    model = Q if isinstance(Q, ZeroPhaseButterworth) else None
    if model is not None:
        arguments.one_period(**known, Q=Q.Ts)
        Q = Q.frequency_response(omega)
    elif isinstance(Q, control.LTI):
        raise ValueError(
            f"Q = {reprlib.repr(Q)} is a model, which runs in one direction only: pass "
            "zero_phase_butterworth(order, cutoff, Ts), or the samples of |Q|^2 on omega"
        )
    Q = arguments.array("Q", Q, (len(omega),), complex)
    return model, Q if Q.imag.any() else Q.real


def _band(band, Q, omega, objective):
    """The band, which must lie within omega if it is summed over; there is something to learn."""
    low, high = arguments.array("band", band, (2,)).tolist()
    in_band = (omega >= low) & (omega <= high)
    if objective == "sum":
        slack = 1e-9 * omega[-1]
        if not omega[0] - slack <= low < high <= omega[-1] + slack:
            raise ValueError(
                f"band = {band!r} must be two increasing frequencies within omega, "
                f"[{omega[0]:.6g}, {omega[-1]:.6g}] rad/s"
            )
        if not in_band.any():
            raise ValueError(f"band = {band!r} contains none of the frequencies omega")
    learned = np.abs(Q[in_band] if objective == "sum" else Q).max()
    if learned < 1e-6:  # of an error, which the certificate could not tell from nothing
        raise ValueError(
            f"Q has a gain of {learned:.3g} at most where the objective counts: it learns "
            "nothing. Is its cut-off in rad/s?"
        )
    return low, high


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
        raise ValueError(f"scale = {scale.tolist()} must be positive, one number per channel")
    return scale


def _scaled(model, scale):
    """A model, if there is one, with its channels in units of scale."""
    if model is None:
        return None
    S, R = np.diag(scale), np.diag(1 / scale)
    return control.ss(model.A, model.B @ S, R @ model.C, R @ model.D @ S, model.dt)


def _weights(noise, omega, Ts, m, M_max, scale):
    """Weights of |Q P L|^2 that make its sum a mean over all frequencies, for each input of L."""
    if noise is None:
        return None
    n = len(omega)
    shape = (n, m) if _axes(noise) == 2 else (n,)
    noise = arguments.array("noise", noise, shape).reshape(n, -1)
    if noise.min() < 0:
        raise ValueError(f"noise reaches {noise.min():.6g}, but a spectral density is not negative")
    edges = np.concatenate([[0.0], (omega[1:] + omega[:-1]) / 2, [np.pi / Ts]])
    width = np.diff(edges)[:, None] * Ts / np.pi
    weights = width * noise / scale**2 / (1 - M_max**2) * np.ones(m)
    return weights if weights.any() else None


def _refuse_singular(P, omega):
    singular_values = np.linalg.svd(P, compute_uv=False)
    smallest = np.maximum(1e-12 * singular_values[:, 0], 1 / arguments.LARGEST)
    singular = np.flatnonzero(singular_values[:, -1] <= smallest)
    if singular.size:
        raise ValueError(
            f"P is singular at omega = {omega[singular[0]]:.6g} rad/s (smallest singular value "
            f"{singular_values[singular[0], -1]:.3g}): P^-1 in (40) does not exist there"
        )
