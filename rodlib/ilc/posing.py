"""Stating a problem: plants in whatever form they are known, on one grid, each argument checked."""

import reprlib
from collections.abc import Iterator, Sequence
from typing import Protocol, runtime_checkable

import control
import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import ZeroPhaseButterworth
from rodlib.ilc.loop import CurrentTrialLoop
from rodlib.ilc.models import frequency_response
from rodlib.ilc.problem import Problem

MODELS = (CurrentTrialLoop, control.LTI)  # what a plant may be, if not an array
CONFIDENCE = 0.99  # in a measured response, if not said otherwise


@runtime_checkable
class Measured(Protocol):
    """A response that was measured, with the radius in which the truth lies."""

    def on(self, omega, confidence, scale) -> tuple[np.ndarray, np.ndarray]:
        """Response, shape (n, m, m), and radius, shape (n,), on the design frequencies.

        Both of the channels in units of `scale`, shape (m,), or their own if that is None.
        """

    def basis(self, omega, confidence) -> tuple[str, ...]:
        """What was measured, and what is assumed beside it on these frequencies."""


def pose(
    P,
    Q,
    omega,
    Ts,
    *,
    order=10,
    M_max=0.9,
    L_max=50.0,
    band=(1e-4, 0.02),
    structure="diagonal",
    objective="sum",
    scale=None,
    uncertainty=None,
    noise=None,
    confidence=None,
) -> Problem:
    """State the problem (39), or (45) with (46), and check it.

    Parameters, their defaults and errors as for :func:`rodlib.ilc.synthesise`.

    Returns
    -------
    Problem
    """
    Ts = arguments.sampling_period("Ts", Ts)
    omega = arguments.frequencies("omega", omega, Ts)
    basis = ()
    if isinstance(P, Measured):
        P, uncertainty, basis = _measured(P, omega, uncertainty, confidence, scale)
    elif confidence is not None:
        raise ValueError(
            f"confidence = {reprlib.repr(confidence)} is for a measured response, but P is not "
            "one: pass the radius as uncertainty"
        )
    given = _plants(P)
    plant, P = _response("P" if len(given) == 1 else "P[0]", given[0], omega, Ts)
    q, Q = _q_response(Q, omega, Ts)
    order = arguments.whole("order", order, 1, len(omega))
    what = "in (0, 1), or the trials do not converge"
    M_max = arguments.number("M_max", M_max, what, 0, 1)
    if L_max is not None:
        L_max = arguments.positive("L_max", L_max, "a positive number, or None for no bound")
    arguments.choice("structure", structure, ["diagonal", "full"])
    arguments.choice("objective", objective, ["sum", "peak"])
    in_band = _in_band(Q, omega, band, objective)
    n, m, _ = P.shape
    radius, scale = _radius(uncertainty, n, m), _scale(scale, m)
    others = np.empty((len(given) - 1, n, m, m), dtype=complex)
    other_models = []
    for k, other in enumerate(given[1:], 1):
        model, response = _response(f"P[{k}]", other, omega, Ts)
        others[k - 1] = arguments.array(f"P[{k}]", response, (n, m, m), complex)
        other_models.append(model)
    if scale is not None:
        units = scale / scale[:, None]
        P, others = P * units, others * units
        plant, *other_models = (_scaled(model, scale) for model in (plant, *other_models))
        if radius is not None and radius.ndim == 3:
            radius = radius * units
    else:
        scale = np.ones(m)
    _refuse_singular(P, omega)
    model = None if plant is None or q is None else (plant, q)
    return Problem(
        P, Q, omega, Ts, order, M_max, L_max, in_band, structure, objective, scale, model,
        others, tuple(other_models), radius, _weights(noise, omega, Ts, m, M_max, scale), basis,
    )  # fmt: skip


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
        scale = _scale(scale, response.shape[1])
        radius = P.on(omega, confidence, scale)[1]
    return response, radius, P.basis(omega, confidence)


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


def _plants(P):
    """A list of plants, the nominal one first, from one plant or several."""
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
    return [*P] if several else [P]


def _axes(value):
    """Number of axes of an array; rows of different lengths are found where they are read."""
    try:
        return np.ndim(value)
    except (TypeError, ValueError):
        return 0


def _scaled(model, scale):
    if model is None:
        return None
    S, R = np.diag(scale), np.diag(1 / scale)
    return control.ss(model.A, model.B @ S, R @ model.C, R @ model.D @ S, model.dt)


def _radius(uncertainty, n, m):
    """Radius at each frequency, of the norm or entry by entry; None if it is zero throughout."""
    if uncertainty is None:
        return None
    radius = arguments.array("uncertainty", uncertainty, (...,))
    if radius.shape not in [(n,), (n, m, m)]:
        size = f"= {radius}" if radius.ndim == 0 else f"has shape {radius.shape}, but"
        raise ValueError(
            f"uncertainty {size} must have shape ({n},), a radius of the norm at each frequency, "
            f"or ({n}, {m}, {m}), of each entry: np.full({n}, r) is a radius r at all frequencies"
        )
    if radius.min() < 0:
        raise ValueError(
            f"uncertainty reaches {radius.min():.6g}, but a radius cannot be negative: pass the "
            "largest ||Delta|| (or |Delta_ij|) at each frequency"
        )
    return radius if radius.any() else None


def _response(name, P, omega, Ts):
    """The plant as a model, or None, and its frequency response on omega."""
    if isinstance(P, CurrentTrialLoop):
        P = P.P
    model = None
    if isinstance(P, control.FrequencyResponseData):
        P = _of_frd(name, P, omega, Ts)
    elif isinstance(P, control.TransferFunction | control.StateSpace):
        _check_period(name, P.dt, Ts)
        if isinstance(P, control.StateSpace):
            model = arguments.state_space(name, P)
        elif P.ninputs == P.noutputs == 1:
            model = control.ss(P)
        arguments.stable(name, P.poles())
        if model is not None:
            P = frequency_response(model, omega)
        else:
            P = np.moveaxis(np.reshape(P(np.exp(1j * omega * Ts)), (*P.shape, len(omega))), -1, 0)
    return model, arguments.array(name, P, (len(omega), "m", "m"), complex)


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


def _q_response(Q, omega, Ts):
    """The Q-filter as a model, or None, and its frequency response."""
    model = Q if isinstance(Q, ZeroPhaseButterworth) else None
    if model is not None:
        arguments.one_period(P=Ts, Q=Q.Ts)
        Q = Q.frequency_response(omega)
    Q = arguments.array("Q", Q, (len(omega),), complex)
    return model, Q if Q.imag.any() else Q.real


def _in_band(Q, omega, band, objective):
    """Which frequencies lie in the band, if it is summed over; there must be something to learn."""
    low, high = arguments.array("band", band, (2,))
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
            f"Q has a gain of {learned:.3g} at most where the objective counts: it learns nothing"
        )
    return in_band


def _scale(scale: Sequence[float] | None, m):
    if scale is None:
        return None
    scale = arguments.array("scale", scale, (m,))
    if scale.min() <= 0:
        raise ValueError(f"scale = {scale.tolist()} must be positive, one number per channel")
    return scale


def _refuse_singular(P, omega):
    singular_values = np.linalg.svd(P, compute_uv=False)
    smallest = np.maximum(1e-12 * singular_values[:, 0], 1 / arguments.LARGEST)
    singular = np.flatnonzero(singular_values[:, -1] <= smallest)
    if singular.size:
        raise ValueError(
            f"P is singular at omega = {omega[singular[0]]:.6g} rad/s (smallest singular value "
            f"{singular_values[singular[0], -1]:.3g}): P^-1 in (40) does not exist there"
        )
