"""The door: plants in whatever form they are known become one Response."""

import reprlib
from dataclasses import replace
from numbers import Real

import control
import numpy as np

from ilctools import arguments, labels
from ilctools.filters import ZeroPhaseButterworth
from ilctools.loop.closed import CurrentTrialLoop, Loop
from ilctools.models import model_and_response, refuse_foreign
from ilctools.response.measured import CONFIDENCE, Measured, radius_of, with_phase
from ilctools.response.response import LOW, Response
from ilctools.response.samples import SAME, Samples
from ilctools.signals import Signals, check_match

FREQUENCIES = 1000  # of a grid that is chosen, as of the paper's
LOWEST = 1e-4  # of the Nyquist frequency: the lowest cut-off of a Q that is chosen
DECADES = 3  # of it below the cut-off of Q, as in the paper: from 1e-4 to 0.1 rad/s
FROM_ONE = 0.3  # up to which P counts as the identity
MOST_APART = 1e100  # of a scale: products with it stay doubles
PRINTED = 1e-6  # relative, of a table: digits of its last frequency, and of P, which is real there


def response_of(
    P, omega=None, Ts=None, uncertainty=None, scale=None, Q=None, names=None
) -> Response:
    """What is known of P, which must match Q, if there is one; arguments of `synthesise`.

    `names`, of outputs and then of inputs: the order of a design, in which labelled arrays are put.
    """
    plants = named(P)
    if isinstance(Q, control.LTI | Real):
        raise ValueError(
            f"Q = {reprlib.repr(Q)} is no filter, or one that runs in one direction only: pass "
            "zero_phase_butterworth(order, cutoff, Ts), or the samples of |Q|^2 on omega"
        )
    if isinstance(omega, ZeroPhaseButterworth):
        raise ValueError(
            f"omega = {reprlib.repr(omega)}: Q comes second, as synthesise(P, Q, omega)"
        )
    if Ts is None:
        Ts = _period(Q, *plants.values())
    Ts = arguments.sampling_period("Ts", Ts)
    if omega is None:
        labelled = plants | {"Q": Q, "uncertainty": uncertainty}
        own = (labels.frequencies_of(name, value) for name, value in labelled.items())
        omega = next((known for known in own if known is not None), None)
    else:
        labels.refuse_other_unit("omega", str(getattr(omega, "attrs", {}).get("units", "")))
    if omega is None:
        omega = frequencies(plants.values(), Ts, Q)
    omega = arguments.increasing_frequencies("omega", omega, Ts)
    uncertainty = labels.matched("uncertainty", uncertainty, {labels.FREQUENCY: omega})
    plants = _matched(plants, omega, names)
    known, assumptions, low = plants, (), None
    if isinstance(P, Measured):
        if uncertainty is not None:
            raise ValueError(
                "uncertainty must be None if P is a measured response, which has a radius of its "
                "own: for a larger one, pass both of P.on(omega, confidence) as arrays"
            )
        known = {"P": P.on(omega, CONFIDENCE)[0]}
        _, uncertainty = P.on(omega, CONFIDENCE, scale)
        assumptions = P.basis(omega, CONFIDENCE)
        low = _continued(P, omega[0], scale)
    models, responses = _on_grid(known, omega, Ts)
    signals = {name: Signals.of_plant(plant, Ts) for name, plant in plants.items()}
    check_match(**signals, Q=Q, grid=Signals(Ts))
    own = (P.omega, P.response) if isinstance(P, Measured) else (omega, responses[0])
    _refuse_other_units(*own, Ts)
    nominal, *_ = signals.values()
    outputs, inputs = nominal.channels_of(responses.shape[-1])
    if outputs is None and (outputs := labels.channels_of(scale, labels.OUTPUT)) is not None:
        nominal = replace(nominal, labels=[*outputs, *(inputs or ())])
    scale = labels.by_channel("scale", scale, outputs, inputs)
    models, responses, scale = _in_units(scale, models, responses)
    arguments.representable("P", responses, "in units in which its gain is nearer to one")
    if uncertainty is not None:
        if np.ndim(uncertainty) == 0:
            assumptions = (f"the radius is {uncertainty} sigma_max(P), at each frequency",)
        uncertainty = radius_of(uncertainty, responses[0])
    return Response(
        omega=omega,
        P=responses,
        Ts=Ts,
        models=tuple(models),
        radius=uncertainty if np.any(uncertainty) else None,
        scale=scale,
        signals=nominal,
        assumptions=assumptions,
        measured=isinstance(P, Measured) and P.estimated,
        one_at_first=_is_one(getattr(P, "loop", None), omega[:1]),
        low=low,
    )


def _is_one(loop, omega):
    """Whether a loop that integrates makes its P the identity, at one frequency."""
    if not isinstance(loop, CurrentTrialLoop):
        return False
    [P] = loop.frequency_response(omega)
    return bool(np.linalg.norm(P - np.eye(len(P)), 2) < FROM_ONE)


def _continued(measured, first, scale) -> Samples | None:
    """A measured response from zero to the first frequency, if it says more than a table does."""
    if not measured.estimated or first <= 0:
        return None
    omega = np.linspace(0, first, LOW)
    return Samples(omega, *measured.on(omega, CONFIDENCE, scale))


def named(P) -> dict:
    """The plants by their names in messages, the nominal one first, from one plant or several."""
    several = isinstance(P, np.ndarray) and P.ndim == 4
    if labels.is_labelled(P) and labels.PLANT in getattr(P, "dims", ()):
        P, several = [P.isel({labels.PLANT: k}) for k in range(P.sizes[labels.PLANT])], True
    if isinstance(P, list | tuple):
        measured = [isinstance(p, Measured) for p in P]
        if any(measured):
            raise ValueError(
                f"P[{measured.index(True)}] is a measured response, whose radius would count for "
                "all of the list: pass it alone, or P.on(omega, confidence) as arrays"
            )
        several = not P or any(isinstance(p, Loop | control.LTI) or _axes(p) == 3 for p in P)
        if not several and any(map(labels.is_labelled, P)):
            raise ValueError(
                "P is a list of labelled arrays of one frequency each: pass one DataArray with the "
                f"dimensions {labels.FREQUENCY}, {labels.OUTPUT}, {labels.INPUT}"
            )
    if several and not len(P):
        raise ValueError(
            f"P = {reprlib.repr(P)} holds no plant: pass one or more, the nominal one first"
        )
    plants = {f"P[{k}]": plant for k, plant in enumerate(P)} if several else {"P": P}
    for name, plant in plants.items():
        refuse_foreign(name, plant)
        if not isinstance(plant, Loop | control.LTI | Measured):
            arguments.array(name, plant, ("omega", "outputs", "inputs"), complex)
    return plants


def _matched(plants, omega, names):
    """The plants, with labelled arrays as python-control's data, their channels in one order."""
    tables, known = {}, names
    for name, plant in plants.items():
        if labels.is_labelled(plant):
            plant = _table(name, plant, omega, *(known or (None, None)))
        tables[name] = plant
        own = plant.names if isinstance(plant, Measured) else _names_of(plant)
        known = known or (own if any(own) else None)
    return tables


def _table(name, P, omega, outputs, inputs):
    """A labelled array as frequency response data, in the order of some names, if there are any."""
    axes = (labels.FREQUENCY, labels.OUTPUT, labels.INPUT)
    if inputs is not None and (own := labels.channels_of(P, labels.INPUT)) is not None:
        # v may be named after the references to which it is added
        inputs = outputs if sorted(own) == sorted(outputs or ()) else inputs
    outputs = outputs or labels.channels_of(P, labels.OUTPUT)
    inputs = labels.paired(outputs, inputs or labels.channels_of(P, labels.INPUT))
    values = labels.matched(name, P, dict(zip(axes, (omega, outputs, inputs), strict=True)))
    values = arguments.array(name, values, (len(omega), "outputs", "inputs"), complex)
    given = {"outputs": outputs, "inputs": inputs}
    given = {kind: own for kind, own in given.items() if own is not None}
    return control.frd(np.moveaxis(values, 0, -1), omega, True, **given)


def _names_of(plant):
    """Names that somebody has given to the outputs and to the inputs of a plant."""
    outputs = getattr(plant, "output_labels", getattr(plant, "outputs", None))
    inputs = getattr(plant, "input_labels", getattr(plant, "references", None))
    return labels.given_names(outputs), labels.given_names(inputs)


def _axes(value):
    """Number of axes of an array; rows of different lengths are found where they are read."""
    try:
        return np.ndim(value)
    except (TypeError, ValueError):
        return 0


def _period(*systems):
    """The sampling period that Q, or else a plant, knows."""
    for system in systems:
        system = system.loop if isinstance(system, Measured) else system
        if isinstance(system, ZeroPhaseButterworth | Loop):
            return system.Ts
        if isinstance(system, control.LTI) and system.dt and system.dt is not True:
            return system.dt
    raise ValueError("Ts must be given, as neither P nor Q knows the sampling period")


def frequencies(plants, Ts, Q=None) -> np.ndarray:
    """Design frequencies, rad/s: of samples their own, of models a logarithmic grid up to Nyquist.

    Of a measured plant the grid begins where it is resolved; without Q, as for the lowest cut-off.
    """
    sampled = [plant for plant in plants if not isinstance(plant, Loop | control.LTI)]
    for plant in plants:
        if isinstance(plant, control.FrequencyResponseData):
            return plant.omega
    if not all(isinstance(plant, Measured) for plant in sampled):
        raise ValueError("omega must be given: P is an array, which does not know its frequencies")
    if not isinstance(Q, ZeroPhaseButterworth | None):
        arguments.array("Q", Q, ("frequency",), complex)
        raise ValueError(
            "omega must be given, as Q holds samples: or pass zero_phase_butterworth(order, "
            "cutoff, Ts), from whose cut-off a grid is chosen"
        )
    cutoff = LOWEST * np.pi / Ts if Q is None else Q.cutoff
    first = max([cutoff / 10**DECADES, *(_first_of(plant, Q) for plant in sampled)])
    return np.geomspace(first, np.pi / Ts, FREQUENCIES)


def _first_of(measured, Q):
    """The frequency from which on a measured response is asked.

    That is where it is resolved, unless Q has its cut-off below.
    """
    omega = measured.omega
    known = omega[getattr(measured, "known", omega > 0)][0]
    resolved = omega[getattr(measured, "resolved", omega > 0)][0]
    below = Q is not None and Q.cutoff < resolved * (1 - SAME)
    return known if below else max(known, resolved)


def _on_grid(plants, omega, Ts):
    """Each plant as a model, or None, and their frequency responses on omega, (p, n, m, m)."""
    models, responses, shape = [], [], (len(omega), "m", "m")
    for name, plant in plants.items():
        P = plant.P if isinstance(plant, Loop) else plant
        model, response = model_and_response(name, P, omega, Ts)
        if _axes(response) == 3 and len(response) == len(omega):
            _, outputs, inputs = np.shape(response)
            arguments.square(name, inputs, outputs)
        responses.append(with_phase(name, arguments.array(name, response, shape, complex)))
        models.append(model)
        shape = responses[0].shape
    return models, np.array(responses)


def _in_units(scale, models, responses):
    """The plants in units of `scale`, and these; one where there is none."""
    m = responses.shape[-1]
    if scale is None:
        return models, responses, np.ones(m)
    scale = arguments.array("scale", scale, (m,))
    if scale.min() <= 0:
        raise ValueError(f"scale = {scale.tolist()} must be positive numbers")
    if scale.max() > MOST_APART * scale.min():
        raise ValueError(
            f"scale = {scale.tolist()} spans more than {MOST_APART:g}, in which rounding hides the "
            "small channels: pass what is equally large in each"
        )
    S, R = np.diag(scale), np.diag(1 / scale)
    models = [
        model and control.ss(model.A, model.B @ S, R @ model.C, R @ model.D @ S, model.dt)
        for model in models
    ]
    return models, responses * (scale / scale[:, None]), scale


def in_own_units(response: Response) -> Response:
    """A response in the plants' own units; its radius covers that in units of `scale`."""
    scale, radius = response.scale, response.radius
    models, P, _ = _in_units(1 / scale, response.models, response.P)
    widest, low = scale.max() / scale.min(), response.low
    if radius is not None:
        radius = radius * widest
    if low is not None:
        low = Samples(low.omega, low.P * (scale[:, None] / scale), low.radius * widest)
    one = np.ones(len(scale))
    return replace(response, models=tuple(models), P=P, radius=radius, scale=one, low=low)


def _refuse_other_units(omega, P, Ts):
    """Refuse frequencies in Hz or rad/sample: up to Nyquist's, where P is real, as z is -1."""
    rounding = PRINTED * np.abs(P[-1]).max()
    if not np.abs(P[-1].imag).max() <= rounding < np.abs(P.imag).max():
        return
    for end, what, unit in ((0.5 / Ts, "1 / (2 Ts)", "Hz"), (np.pi, "pi", "rad/sample")):
        factor = np.pi / Ts / end
        if abs(omega[-1] / end - 1) < PRINTED < abs(factor - 1):
            raise ValueError(
                f"omega ends at {omega[-1]:.6g}, by {what} = {end:.6g}, where P is real, as at "
                f"the Nyquist frequency: omega is in {unit}, multiply it by {factor:.6g}"
            )
