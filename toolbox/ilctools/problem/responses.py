"""Plants and Q in whatever form they are known, on one grid of frequencies."""

import reprlib

import control
import numpy as np

from ilctools import arguments
from ilctools.filters import ZeroPhaseButterworth
from ilctools.loop.closed import Loop
from ilctools.models import model_and_response, refuse_foreign
from ilctools.problem.measured import CONFIDENCE, Measured
from ilctools.problem.problem import Problem
from ilctools.problem.roughness import scatter
from ilctools.signals import Signals, check_match
from ilctools.singular_values import largest_singular_values

FREQUENCIES = 1000  # of a grid that is chosen, as of the paper's
# of sigma_max(P) / |Q|: by how much P and its radius may be off a straight line between two design
# frequencies, if more of them help; M is then off by as much, times sigma_max(Q P L)
BEND = 2e-3
ROUNDS = 5  # in which each interval with more is halved
LOWEST = 1e-4  # of the Nyquist frequency: the lowest cut-off of a Q that is chosen
DECADES = 3  # of it below the cut-off of Q, as in the paper: from 1e-4 to 0.1 rad/s
RIPPLE = 1.2  # of a low-pass filter without taper, applied twice: the largest sensible |Q|
# relative: imaginary part that the rounding of a table may leave of a real response
IMAGINARY = 1e-6
SCATTERED = 4  # times the RMS by which the lines scatter, that noise may


def on_one_grid(P, Q, omega=None, Ts=None, uncertainty=None, scale=None) -> Problem:
    """P and Q, in any form, on one grid, and P in units of `scale`; arguments of `pose`."""
    named = plants(P)
    nominal, *_ = named.values()
    if omega is None:
        omega = frequencies(named.values(), Q)
    if Ts is None:
        Ts = _period(Q, *named.values())
    Ts = arguments.sampling_period("Ts", Ts)
    omega = arguments.increasing_frequencies("omega", omega, Ts)
    basis, parties = (), {"Q": Q}
    if isinstance(P, Measured):
        if uncertainty is not None:
            raise ValueError(
                "uncertainty must be None if P is a measured response, which has a radius of its "
                "own: for a larger one, pass both of P.on(omega, confidence) as arrays"
            )
        named["P"], uncertainty = _measured(P, omega, Ts, scale)
        basis = P.basis(omega, CONFIDENCE)
        parties = {"P": P.loop, "Q": Q, "grid": Signals(Ts)}
    models, responses = on_grid(named, omega, Ts, **parties)
    butterworth, Q = Q_on_grid(Q, omega)
    models, responses, scale = _in_units(scale, models, responses)
    if uncertainty is not None:
        uncertainty = arguments.array("uncertainty", uncertainty, omega.shape)
        if uncertainty.min() < 0:
            raise ValueError(
                f"uncertainty reaches {uncertainty.min():.6g}, but a radius cannot be negative"
            )
    return Problem(
        plants=responses,
        models=tuple(models),
        Q=Q,
        butterworth=butterworth,
        omega=omega,
        Ts=Ts,
        scale=scale,
        radius=uncertainty if np.any(uncertainty) else None,
        basis=basis,
        labels=Signals.of_plant(nominal, Ts),
    )


def _measured(P, omega, Ts, scale):
    """A measured response on omega, and its radius in units of `scale`."""
    _refuse_other_units("P.omega", P.omega, P.response[None], Ts)
    response, _ = P.on(omega, CONFIDENCE)
    _, radius = P.on(omega, CONFIDENCE, scale)
    return response, radius


def _in_units(scale, models, responses):
    """The plants in units of `scale`, and these; one where there is none."""
    m = responses.shape[-1]
    if scale is None:
        return models, responses, np.ones(m)
    scale = arguments.array("scale", scale, (m,))
    if scale.min() <= 0:
        raise ValueError(f"scale = {scale.tolist()} must be positive numbers")
    S, R = np.diag(scale), np.diag(1 / scale)
    models = [
        model and control.ss(model.A, model.B @ S, R @ model.C, R @ model.D @ S, model.dt)
        for model in models
    ]
    return models, responses * (scale / scale[:, None]), scale


def _refuse_other_units(name, omega, responses, Ts):
    """Refuse frequencies in Hz or rad/sample: up to Nyquist's, where P is real, as z is -1."""
    for end, what, unit in ((0.5 / Ts, "1 / (2 Ts)", "Hz"), (np.pi, "pi", "rad/sample")):
        if abs(omega[-1] / end - 1) > IMAGINARY or abs(omega[-1] * Ts - np.pi) < IMAGINARY:
            continue
        imaginary, size = (np.abs(x).max(axis=(2, 3)) for x in (responses.imag, responses))
        noise = np.array([scatter(omega, P) for P in responses]) * size[:, -1]
        rounding = np.maximum(IMAGINARY * size.max(), SCATTERED * noise)
        if np.any((imaginary[:, -1] <= rounding) & (imaginary.max(1) > rounding)):
            raise ValueError(
                f"{name} ends at {omega[-1]:.6g} = {what}, and P is real there, as at the Nyquist "
                f"frequency: omega is in {unit}, multiply it by {np.pi / Ts / end:.6g}"
            )


def lowest_and_period(P, omega=None, Ts=None) -> tuple[float, float]:
    """The lowest frequency at which P is known, or LOWEST of the Nyquist frequency; and Ts."""
    named = plants(P).values()
    Ts = arguments.sampling_period("Ts", _period(*named) if Ts is None else Ts)
    lowest = [LOWEST * np.pi / Ts]
    if omega is None:
        lowest += [_lowest(plant) for plant in named if hasattr(plant, "omega")]
    else:
        omega = arguments.increasing_frequencies("omega", omega, Ts)
        lowest.append(omega[omega > 0][0])
    return float(max(lowest)), Ts


def _lowest(plant):
    """The lowest frequency at which a plant that has some is known."""
    return plant.omega[getattr(plant, "known", plant.omega > 0)][0]


def _period(*systems):
    """The sampling period that Q, or else a plant, knows."""
    for system in systems:
        system = system.loop if isinstance(system, Measured) else system
        if isinstance(system, ZeroPhaseButterworth | Loop):
            return system.Ts
        if isinstance(system, control.LTI) and system.dt and system.dt is not True:
            return system.dt
    raise ValueError("Ts must be given, as neither P nor Q knows the sampling period")


def frequencies(P, Q) -> np.ndarray:
    """Design frequencies, rad/s: of samples their own, of models a logarithmic grid up to Nyquist.

    Of a measured plant the grid begins where it is known; an estimate, which is known everywhere,
    adds frequencies where it bends.
    """
    sampled = [plant for plant in P if not isinstance(plant, Loop | control.LTI)]
    for plant in P:
        if isinstance(plant, control.FrequencyResponseData):
            return plant.omega
    if not all(isinstance(plant, Measured) for plant in sampled):
        raise ValueError("omega must be given: P is an array, which does not know its frequencies")
    if not isinstance(Q, ZeroPhaseButterworth):
        _samples_of_Q(Q)
        raise ValueError(
            "omega must be given, as Q holds samples: or pass zero_phase_butterworth(order, "
            "cutoff, Ts), from whose cut-off a grid is chosen"
        )
    lowest = max([Q.cutoff / 10**DECADES, *map(_lowest, sampled)])
    omega = np.geomspace(lowest, np.pi / Q.Ts, FREQUENCIES)
    for plant in sampled:
        if plant.continuous:
            omega = _where_it_bends(plant, Q, omega)
    return omega


def _where_it_bends(P, Q, omega):
    """Frequencies, and the middle of each interval between two in which P or its radius bends."""
    low, high = omega[:-1], omega[1:]
    for _ in range(ROUNDS):
        middle, n = np.sqrt(low * high), len(low)
        response, radius = P.on(np.concatenate([low, middle, high]), CONFIDENCE)
        bend, of_radius = (x[n:-n] - (x[:n] + x[-n:]) / 2 for x in (response, radius))
        bend = largest_singular_values(bend) + np.abs(of_radius)
        bent = Q.frequency_response(middle) * bend > BEND * largest_singular_values(response[n:-n])
        if not bent.any():
            break
        low, middle, high = low[bent], middle[bent], high[bent]
        omega = np.append(omega, middle)
        low, high = np.append(low, middle), np.append(middle, high)
    return np.sort(omega)


def plants(P):
    """The plants by their names in messages, the nominal one first, from one plant or several."""
    several = isinstance(P, np.ndarray) and P.ndim == 4
    if isinstance(P, list | tuple):
        measured = [isinstance(p, Measured) for p in P]
        if any(measured):
            raise ValueError(
                f"P[{measured.index(True)}] is a measured response, whose radius would count for "
                "all of the list: pass it alone, or P.on(omega, confidence) as arrays"
            )
        several = not P or any(isinstance(p, Loop | control.LTI) or axes(p) == 3 for p in P)
    if several and not len(P):
        raise ValueError(
            f"P = {reprlib.repr(P)} holds no plant: pass one or more, the nominal one first"
        )
    named = {f"P[{k}]": plant for k, plant in enumerate(P)} if several else {"P": P}
    for name, plant in named.items():
        refuse_foreign(name, plant)
        if not isinstance(plant, Loop | control.LTI | Measured):
            arguments.array(name, plant, ("omega", "outputs", "inputs"), complex)
    return named


def axes(value):
    """Number of axes of an array; rows of different lengths are found where they are read."""
    try:
        return np.ndim(value)
    except (TypeError, ValueError):
        return 0


def on_grid(plants, omega, Ts, **parties):
    """Each plant as a model, or None, and their frequency responses on omega, (p, n, m, m).

    The parties are what they must match beside each other.
    """
    models, responses, shape = [], [], (len(omega), "m", "m")
    for name, plant in plants.items():
        P = plant.P if isinstance(plant, Loop) else plant
        model, response = model_and_response(name, P, omega, Ts)
        if axes(response) == 3 and len(response) == len(omega):
            _, outputs, inputs = np.shape(response)
            arguments.square(name, inputs, outputs)
        responses.append(arguments.array(name, response, shape, complex))
        models.append(model)
        shape = responses[0].shape
    known = {name: Signals.of_plant(plant, Ts) for name, plant in plants.items()}
    check_match(**(known | parties))
    _refuse_other_units("omega", omega, np.array(responses), Ts)
    return models, np.array(responses)


def _samples_of_Q(Q):
    """Samples of Q as an array."""
    if isinstance(Q, control.LTI):
        raise ValueError(
            f"Q = {reprlib.repr(Q)} is a model, which runs in one direction only: pass "
            "zero_phase_butterworth(order, cutoff, Ts), or the samples of |Q|^2 on omega"
        )
    return arguments.array("Q", Q, ("frequency",), complex)


def Q_on_grid(Q, omega):
    """The Q-filter as a model, or None, and its response on omega."""
    model = Q if isinstance(Q, ZeroPhaseButterworth) else None
    if model is not None:
        Q = Q.frequency_response(omega)
    Q = arguments.array("Q", _samples_of_Q(Q), (len(omega),), complex)
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
