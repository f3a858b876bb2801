"""Plants and Q in whatever form they are known, on one grid of frequencies."""

import reprlib
from collections.abc import Iterator

import control
import numpy as np
from scipy.interpolate import make_interp_spline

from ilctools import arguments
from ilctools.filters import ZeroPhaseButterworth
from ilctools.loop.closed import Loop
from ilctools.models import frequency_response, refuse_foreign
from ilctools.problem.problem import Samples
from ilctools.signals import Signals, check_match

CONFIDENCE = 0.99  # in a measured response
FREQUENCIES = 1000  # of a grid that is chosen
DECADES = 3  # of it below the cut-off of Q
MODELS = (Loop, control.LTI)  # what a plant may be, if not an array
RIPPLE = 1.2  # of a low-pass filter without taper, applied twice: the largest sensible |Q|
IMAGINARY = 1e-6  # relative imaginary part below which a response counts as real


class Measured:
    """A response as known at some frequencies, and the region in which the truth lies.

    A kind has `response` (n, m, m) at `omega` (n,), rad/s, the `loop` whose response it is, and
    `findings`, which speak against it. It says what the doors here ask by ``_radius(confidence,
    jointly)``, ``_on(omega, confidence)``, ``_basis(omega, confidence)`` and ``_scaled(scale)``.
    """

    findings = ()

    def radius(self, confidence: float = 0.95, jointly: bool = False) -> np.ndarray:
        """Radius of ||Delta||, the largest singular value, that covers the truth.

        Parameters
        ----------
        confidence : float
            Probability, between 0 and 1, that the truth lies within.
        jointly : bool
            Whether within all radii at once, rather than within each.

        Returns
        -------
        ndarray, shape (n,)
            At `omega`.
        """
        return self._radius(probability(confidence), arguments.flag("jointly", jointly))

    def on(self, omega, confidence: float = 0.95, scale=None) -> tuple[np.ndarray, np.ndarray]:
        """Response and radius on other frequencies, for the synthesis.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Frequencies, rad/s.
        confidence : float
            Probability that the truth lies within the radius at all frequencies that are known.
        scale : array_like, shape (m,), optional
            Units of the channels, of both response and radius; see :func:`ilctools.synthesise`.

        Returns
        -------
        response : ndarray, shape (n, m, m), complex
        radius : ndarray, shape (n,)
            What is assumed between and beyond the frequencies measured, :meth:`basis` says.
        """
        omega, own = np.abs(arguments.row("omega", omega)), self
        if scale is not None:
            own = self._scaled(arguments.array("scale", scale, (self.response.shape[1],)))
        return own._on(omega, probability(confidence))

    def basis(self, omega, confidence: float = 0.95) -> tuple[str, ...]:
        """What is known, and what :meth:`on` assumes beside it on `omega`; the findings last."""
        lines = self._basis(arguments.row("omega", omega), probability(confidence))
        return (*lines, *self.findings)

    def __repr__(self):
        return "\n".join(self.basis(self.omega))


def probability(confidence) -> float:
    """A confidence, that of a region."""
    return arguments.number("confidence", confidence, "between 0 and 1", 0, 1)


def interpolated(knots, P, at) -> tuple[np.ndarray, np.ndarray]:
    """A cubic spline through P, (n, m, m), and by how much it differs from straight lines."""
    spline, straight = (make_interp_spline(knots, P, k)(at) for k in (3, 1))
    return spline, np.linalg.norm(spline - straight, 2, axis=(1, 2))


def on_one_grid(P, Q, omega=None, Ts=None, uncertainty=None, scale=None) -> Samples:
    """P and Q, in any form, on one grid, and P in units of `scale`; arguments of `pose`."""
    named = plants(P)
    nominal, *_ = named.values()
    if omega is None:
        omega = _frequencies(named.values(), Q)
    if Ts is None:
        Ts = _period(Q, *named.values())
    Ts = arguments.sampling_period("Ts", Ts)
    omega = arguments.increasing_frequencies("omega", omega, Ts)
    basis = ()
    if isinstance(P, Measured):
        if uncertainty is not None:
            raise ValueError(
                "uncertainty must be None if P is a measured response, which has a radius of its "
                "own: for a larger one, pass both of P.on(omega, confidence) as arrays"
            )
        check_match(P=P.loop, Q=Signals(Ts))
        _refuse_hertz("P.omega", P.omega, P.response[None], Ts)
        named["P"], uncertainty = P.on(omega, CONFIDENCE)
        basis = P.basis(omega, CONFIDENCE)
        if scale is not None:  # the response is scaled with those of other plants
            uncertainty = P.on(omega, CONFIDENCE, scale)[1]
    models, responses = on_grid(named, omega, Ts)
    _refuse_hertz("omega", omega, responses, Ts)
    butterworth, Q = Q_on_grid(Q, omega, P=Signals(Ts))
    if scale is None:
        scale = np.ones(responses.shape[-1])
    else:
        scale = arguments.array("scale", scale, responses.shape[-1:])
        if scale.min() <= 0:
            raise ValueError(f"scale = {scale.tolist()} must be positive numbers")
        responses = responses * (scale / scale[:, None])
        models = [model and _scaled(model, scale) for model in models]
    if uncertainty is not None:
        uncertainty = arguments.array("uncertainty", uncertainty, omega.shape)
        if uncertainty.min() < 0:
            raise ValueError(
                f"uncertainty reaches {uncertainty.min():.6g}, but a radius cannot be negative"
            )
    return Samples(
        plants=responses,
        models=tuple(models),
        Q=Q,
        butterworth=butterworth,
        omega=omega,
        Ts=Ts,
        scale=scale,
        radius=uncertainty if np.any(uncertainty) else None,
        basis=basis,
        labels=Signals.of_plant(nominal),
    )


def _refuse_hertz(name, omega, responses, Ts):
    """Refuse frequencies in Hz: up to 1 / (2 Ts), where P is real, as z is -1 there."""
    imaginary = np.abs(responses.imag).max(axis=(2, 3))
    rounding = IMAGINARY * np.abs(responses).max()
    real_at_last_only = (imaginary[:, -1] <= rounding) & (imaginary.max(1) > rounding)
    if abs(omega[-1] * Ts - 0.5) < IMAGINARY and real_at_last_only.any():
        raise ValueError(
            f"{name} ends at {omega[-1]:.6g} = 1 / (2 Ts), and P is real there, as at the "
            "Nyquist frequency: omega is in Hz, multiply it by 2 pi"
        )


def _scaled(model, scale):
    """A model in units of `scale`."""
    S, R = np.diag(scale), np.diag(1 / scale)
    return control.ss(model.A, model.B @ S, R @ model.C, R @ model.D @ S, model.dt)


def _period(*systems):
    """The sampling period that Q, or else a plant, knows."""
    for system in systems:
        if isinstance(system, ZeroPhaseButterworth | Loop):
            return system.Ts
        if isinstance(system, control.LTI) and system.dt and system.dt is not True:
            return system.dt
    raise ValueError("Ts must be given, as neither P nor Q knows the sampling period")


def _frequencies(P, Q) -> np.ndarray:
    """Design frequencies, rad/s: of samples their own, of models a logarithmic grid up to Nyquist.

    Of a measured plant the grid begins where it is known.
    """
    sampled = [plant for plant in P if not isinstance(plant, Loop | control.LTI)]
    for plant in P:
        if isinstance(plant, control.FrequencyResponseData):
            return plant.omega
    if not all(isinstance(plant, Measured) for plant in sampled):
        raise ValueError("omega must be given: P is an array, which does not know its frequencies")
    if not isinstance(Q, ZeroPhaseButterworth):
        raise ValueError(
            f"omega must be given, as Q = {reprlib.repr(Q)} is no filter, from whose cut-off a "
            "grid could be chosen"
        )
    lowest = [Q.cutoff / 10**DECADES]
    for plant in sampled:
        known = getattr(plant, "known", plant.omega > 0)
        lowest.append(plant.omega[known][0])
    return np.geomspace(max(lowest), np.pi / Q.Ts, FREQUENCIES)


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
        raise ValueError(
            f"P = {reprlib.repr(P)} holds no plant: pass one or more, the nominal one first"
        )
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
        if axes(response) == 3 and len(response) == len(omega):
            _, outputs, inputs = np.shape(response)
            arguments.square(name, inputs, outputs)
        responses.append(arguments.array(name, response, shape, complex))
        models.append(model)
        shape = responses[0].shape
    check_match(**{name: Signals.of_plant(plant) for name, plant in plants.items()})
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
    """Refuse a model of another sampling period."""
    if dt is True or dt != Ts:  # True, some period, equals 1 s
        raise ValueError(
            f"{name}.dt = {dt!r} differs from Ts = {Ts!r}: control.sample_system samples at Ts"
        )


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
    """The Q-filter as a model, or None, and its response on omega; `known`: whose period it has."""
    model = Q if isinstance(Q, ZeroPhaseButterworth) else None
    if model is not None:
        check_match(**known, Q=Q)
        Q = Q.frequency_response(omega)
    elif isinstance(Q, control.LTI):
        raise ValueError(
            f"Q = {reprlib.repr(Q)} is a model, which runs in one direction only: pass "
            "zero_phase_butterworth(order, cutoff, Ts), or the samples of |Q|^2 on omega"
        )
    Q = arguments.array("Q", Q, (len(omega),), complex)
    if (largest := np.abs(Q).max()) > RIPPLE:
        raise ValueError(
            f"Q has a gain of {largest:.4g} at {omega[np.abs(Q).argmax()]:.4g} rad/s: pass a "
            "low-pass filter whose gain is one at most, or v overshoots what cancels the error"
        )
    if np.abs(Q.imag).max() > IMAGINARY * np.abs(Q).max():
        raise ValueError(
            f"Q turns the phase by up to {np.abs(np.angle(Q)).max():.2g} rad, as a filter does "
            "that runs in one direction only: pass |Q|^2 of it, or zero_phase_butterworth"
        )
    return model, Q.real
