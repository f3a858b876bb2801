"""Plants and Q in whatever form they are known, on one grid of frequencies."""

import reprlib
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import control
import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.filters import ZeroPhaseButterworth
from rodlib.ilc.loop import Loop
from rodlib.ilc.models import frequency_response, refuse_foreign

MODELS = (Loop, control.LTI)  # what a plant may be, if not an array


@runtime_checkable
class Measured(Protocol):
    """A response that was measured, with the radius in which the truth lies."""

    def on(self, omega, confidence, scale) -> tuple[np.ndarray, np.ndarray]:
        """Response, (n, m, m), and radius, (n,), on omega, in units of `scale`, (m,) or None."""

    def basis(self, omega, confidence) -> tuple[str, ...]:
        """What was measured, and what is assumed beside it on these frequencies."""


def period(P, Q):
    """The sampling period that Q, or else a plant, knows."""
    several = isinstance(P, list | tuple)
    for thing in (Q, *(P if several else [P])):
        if isinstance(thing, ZeroPhaseButterworth | Loop):
            return thing.Ts
        if isinstance(thing, control.LTI) and thing.dt and thing.dt is not True:
            return thing.dt
    raise ValueError("Ts must be given, as neither P nor Q knows the sampling period")


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
        several = not P or any(isinstance(p, MODELS) or axes(p) == 3 for p in P)
    if several and not len(P):
        raise ValueError(f"P = {P!r} holds no plant: pass one or more, the nominal one first")
    return {f"P[{k}]": plant for k, plant in enumerate(P)} if several else {"P": P}


def axes(value):
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
            f"{P.omega[-1]:.6g} rad/s, which are not those of omega: pass omega = {name}.omega, or "
            f"{name} = measured_response({name}), which is splined between them"
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
