"""Convert plants, which may be models, loops, tables or measured responses, into one Response."""

import reprlib
from dataclasses import replace
from numbers import Real
from typing import NamedTuple

import control
import numpy as np

from ilctools import arguments, labels
from ilctools.filters import ZeroPhaseButterworth
from ilctools.loop.closed import CurrentTrialLoop, Loop
from ilctools.models import model_and_response, refuse_foreign
from ilctools.response.directions import Directions
from ilctools.response.measured import CONFIDENCE, Measured, radius_of, with_phase
from ilctools.response.response import POINTS_BELOW, Response
from ilctools.response.samples import SAME_FREQUENCY, Assumed, Samples
from ilctools.response.scale import Scale, scale_of
from ilctools.signals import Signals, check_match

CHOSEN_FREQUENCIES = 1000  # number of frequencies of the default grid, as in the paper
LOWEST_CUTOFF = 1e-4  # share of the Nyquist frequency: the lowest default cut-off of Q
DECADES = 3  # of the default grid below the cut-off of Q, as in the paper: 1e-4 to 0.1 rad/s
FROM_ONE = 0.3  # distance from the identity up to which P counts as the identity
# Relative accuracy of the last frequency of a table, and of P at the Nyquist frequency, where P is
# real.
PRINTED_DIGITS = 1e-6


class Accuracy(NamedTuple):
    """How accurately P is known, in units of `scale`, as fields of :class:`.Response`."""

    radius: np.ndarray | None = None
    assumptions: tuple[str | Assumed, ...] = ()
    low: Samples | None = None


class References(NamedTuple):
    """How the plant responds to references, as fields of :class:`.Response`."""

    added: bool
    of_reference: control.StateSpace | None = None


def response_of(
    P, omega=None, Ts=None, uncertainty=None, scale=None, Q=None, like: Response | None = None
) -> Response:
    """Check a plant P, or a list of plants, and convert it into one Response.

    The arguments are as for `synthesise`. If `Ts` is not passed, the sampling period is taken from
    Q or P. If `omega` is not passed, the frequencies are taken from P, or chosen from the cut-off
    of Q. If another response `like` is passed, its scale and its directions are used.
    """
    plants = named(P)
    _refuse_no_filter(Q)
    Ts = _period(Q, *plants.values()) if Ts is None else Ts
    Ts = arguments.sampling_period("Ts", Ts)
    plants, uncertainty, omega = _on_omega(plants, uncertainty, omega, Ts, Q)
    models, responses = _responses(plants, omega, Ts)
    signals = {name: Signals.of_plant(plant, Ts) for name, plant in plants.items()}
    check_match(**signals, Q=Q, grid=Signals(Ts))
    _refuse_other_units(P, omega, responses[0], Ts)
    nominal, *_ = signals.values()
    units = _units(like, scale, nominal, *responses.shape[2:])
    models, responses = _in_units(units, models, responses)
    directions = like.directions if like else Directions.passed_by(responses)
    first = next(iter(plants.values()))
    response = Response(
        omega,
        responses,
        Ts,
        tuple(models),
        scale=units,
        signals=nominal,
        one_at_first=_is_one(getattr(P, "loop", None), omega[:1]),
        **_references(getattr(P, "loop", first), units)._asdict(),
        **_accuracy(P, responses[0], omega, uncertainty, units)._asdict(),
    )
    return response if directions is None else _along(response, directions)


def _units(like, scale, signals, p, m) -> Scale:
    """Return the scale of `like` if `like` is passed, else the scale that the user stated."""
    if like is None:
        return scale_of(scale, *signals.channels(p, m))
    outputs, inputs = like.scale.of_P.shape
    if (p, m) != (outputs, inputs):
        raise ValueError(
            f"P has {p} outputs and {m} inputs, but the design has {outputs} and {inputs}"
        )
    return like.scale


def _refuse_no_filter(Q):
    """Refuse a Q that is a number, or a filter that runs in one direction only."""
    if isinstance(Q, control.LTI | Real):
        raise ValueError(
            f"Q = {reprlib.repr(Q)} is no filter, or a filter that runs in one direction only: "
            "pass zero_phase_butterworth(order, cutoff, Ts), or the samples of |Q|^2 on omega"
        )


def _on_omega(plants, uncertainty, omega, Ts, Q):
    """Return plants and radius with their axes in order, and the omega that all plants share."""
    if isinstance(omega, ZeroPhaseButterworth):
        raise ValueError(
            f"omega = {reprlib.repr(omega)} must be frequencies: Q comes second, as in "
            "synthesise(P, Q, omega)"
        )
    if omega is not None:
        omega = labels.in_radians("omega", omega)
    tables = {}
    for name, plant in plants.items():
        tables[name], omega = labels.table_of(name, plant, omega)
    _, omega = labels.on("Q", Q, omega)
    uncertainty, omega = labels.on("uncertainty", uncertainty, omega)
    if omega is None:
        omega = frequencies(tables.values(), Ts, Q)
    return tables, uncertainty, arguments.increasing_frequencies("omega", omega, Ts)


def _accuracy(P, nominal, omega, uncertainty, scale):
    """Return the radius that a measured response or the user states, with its assumptions."""
    if isinstance(P, Measured):
        if uncertainty is not None:
            raise ValueError(
                "uncertainty must be None if P is a measured response, which has its own "
                "radius: for a larger radius, pass both arrays of P.on(omega, confidence)"
            )
        _, radius = P.on(omega, CONFIDENCE, scale)
        low = None
        if P.estimated:  # an estimate from a record also gives P below omega, a table does not
            below = np.linspace(0, omega[0], POINTS_BELOW)
            low = Samples(below, *P.on(below, CONFIDENCE, scale))
        return Accuracy(_unless_zero(radius), P.statements(omega, CONFIDENCE), low)
    if uncertainty is None:
        return Accuracy()
    relative = f"the radius is {uncertainty} sigma_max(P) at each frequency"
    radius = _unless_zero(radius_of(uncertainty, nominal))
    return Accuracy(radius, (relative,) if np.ndim(uncertainty) == 0 else ())


def _unless_zero(radius):
    return radius if radius.any() else None


def _references(plant, scale) -> References:
    """Return whether v is added to references, and if not, the loop's response to references.

    If the loop does not state its response to references, this response is None. A model that is
    not square is taken to have no references.
    """
    if not isinstance(plant, Loop):
        return References(len(scale.y) == len(scale.v))
    if plant.one_for_one or plant.P_r is None:
        return References(plant.one_for_one)
    return References(False, np.diag(1 / scale.y) * plant.P_r * np.diag(scale.y))


def _is_one(loop, omega):
    """Check if the P of an integrating loop is near the identity at a frequency omega, (1,)."""
    if not isinstance(loop, CurrentTrialLoop):
        return False
    [P] = loop.frequency_response(omega)
    return bool(np.linalg.norm(P - np.eye(len(P)), 2) < FROM_ONE)


def named(P) -> dict:
    """Return a dict of the plants by the names that messages use, with the nominal plant first."""
    if isinstance(P, np.ndarray) and P.ndim == 4:
        P = [*P]
    elif labels.PLANT in getattr(P, "dims", ()):
        P = [*P.transpose(labels.PLANT, ...)]
    several = isinstance(P, list | tuple) and (not P or any(map(_is_plant, P)))
    plants = {f"P[{k}]": plant for k, plant in enumerate(P)} if several else {"P": P}
    if not plants:
        raise ValueError("P = [] holds no plant: pass one or more plants, the nominal one first")
    for name, plant in plants.items():
        refuse_foreign(name, plant)
        if several and isinstance(plant, Measured):
            raise ValueError(
                f"{name} is a measured response, whose radius would count for all plants of "
                "the list: pass it alone, or pass the arrays of P.on(omega, confidence)"
            )
        if not isinstance(plant, Loop | control.LTI | Measured):
            arguments.array(name, plant, ("omega", "outputs", "inputs"), complex)
    return plants


def _is_plant(value):
    """Check if an entry of a list is a plant, not the response of a plant at one frequency."""
    known = isinstance(value, Loop | control.LTI | Measured) or labels.is_labelled(value)
    try:
        return known or np.ndim(value) == 3
    except (TypeError, ValueError):  # rows of unequal lengths are refused later, by `named`
        return False


def _period(*systems):
    """Return the sampling period of the first system, Q or a plant, that has one."""
    for system in systems:
        system = getattr(system, "loop", system)  # of a measured response
        period = getattr(system, "Ts", getattr(system, "dt", None))
        if period and period is not True:
            return period
    raise ValueError("Ts must be given, because neither P nor Q states the sampling period")


def frequencies(plants, Ts, Q=None) -> np.ndarray:
    """Choose the design frequencies, rad/s.

    If a plant is a table of python-control, the frequencies of the table are used. Otherwise the
    grid is logarithmic and ends at the Nyquist frequency. The grid begins `DECADES` decades below
    the cut-off of Q. If Q is None, the grid begins `DECADES` decades below the lowest default
    cut-off. If a plant is a measured response, the grid does not begin below the first frequency
    that its record resolves.
    """
    sampled = [plant for plant in plants if not isinstance(plant, Loop | control.LTI)]
    for plant in plants:
        if isinstance(plant, control.FrequencyResponseData):
            return plant.omega
    if not all(isinstance(plant, Measured) for plant in sampled):
        raise ValueError("omega must be given: P is an array, which does not state its frequencies")
    if not isinstance(Q, ZeroPhaseButterworth | None):
        arguments.array("Q", Q, ("frequency",), complex)
        raise ValueError(
            "omega must be given, because Q holds samples: pass omega, or "
            "zero_phase_butterworth(order, cutoff, Ts), from whose cut-off a grid is chosen"
        )
    cutoff = LOWEST_CUTOFF * np.pi / Ts if Q is None else Q.cutoff
    first = max([cutoff / 10**DECADES, *(_first_of(plant, Q) for plant in sampled)])
    return np.geomspace(first, np.pi / Ts, CHOSEN_FREQUENCIES)


def _first_of(measured, Q):
    """Return the lowest frequency at which a measured response is used.

    This is the first frequency that the record resolves. If the cut-off of Q is lower, the first
    frequency at which the response is known is used instead.
    """
    omega = measured.omega
    known = omega[getattr(measured, "known", omega > 0)][0]
    resolved = omega[getattr(measured, "resolved", omega > 0)][0]
    below = Q is not None and Q.cutoff < resolved * (1 - SAME_FREQUENCY)
    return known if below else max(known, resolved)


def _responses(plants, omega, Ts):
    """Return models of the plants, and their responses on omega, (plants, n, p, m).

    The model of a plant that is known by samples is None.
    """
    models, responses, shape = [], [], (len(omega), "outputs", "inputs")
    for name, plant in plants.items():
        if isinstance(plant, Measured):
            plant, _ = plant.on(omega, CONFIDENCE)
        P = plant.P_v if isinstance(plant, Loop) else plant
        model, response = model_and_response(name, P, omega, Ts)
        response = arguments.array(name, response, shape, complex)
        shape = response.shape
        responses.append(with_phase(name, response))
        models.append(model)
    return models, np.array(responses)


def _in_units(scale, models, responses):
    """Return models and responses of the plants in units of `scale`."""
    responses = responses * scale.of_P
    arguments.representable("P", responses, "in units in which its gain is nearer to one")
    if scale.is_one:
        return models, responses
    S, R = np.diag(scale.v), np.diag(1 / scale.y)
    return [model and R * model * S for model in models], responses


def _along(response, directions) -> Response:
    """Return a response in the given directions, U' P V, see `directions`."""
    low = response.low
    if low is not None:
        low = Samples(low.omega, directions.of(low.P), low.radius)
    models = tuple(model and directions.of_model(model) for model in response.models)
    P = directions.of(response.P)
    return replace(response, P=P, models=models, low=low, directions=directions)


def in_all_directions(response: Response) -> Response:
    """Return a response for all channels, including the directions that were left out."""
    if response.directions is None:
        return response
    return replace(_along(response, response.directions.back), directions=None)


def in_own_units(response: Response) -> Response:
    """Return a response in the plants' own units.

    All plants within the radius in scaled units are within the returned radius.
    """
    response = in_all_directions(response)
    back, radius, low = response.scale.inverse, response.radius, response.low
    models, P = _in_units(back, response.models, response.P)
    widest = back.of_P.max()
    if radius is not None:
        radius = radius * widest
    if low is not None:
        low = Samples(low.omega, low.P * back.of_P, low.radius * widest)
    one = Scale(*(np.ones(len(size)) for size in back))
    return replace(response, models=tuple(models), P=P, radius=radius, scale=one, low=low)


def _refuse_other_units(plant, omega, P, Ts):
    """Refuse omega that ends at the Nyquist frequency, but in Hz or rad/sample.

    Omega is refused only if P is real at the last frequency, as P is at the Nyquist frequency.
    """
    if isinstance(plant, Measured):
        omega, P = plant.omega, plant.response
    rounding = PRINTED_DIGITS * np.abs(P[-1]).max()
    if not np.abs(P[-1].imag).max() <= rounding < np.abs(P.imag).max():
        return
    for end, what, unit in ((0.5 / Ts, "1 / (2 Ts)", "Hz"), (np.pi, "pi", "rad/sample")):
        factor = np.pi / Ts / end
        if abs(omega[-1] / end - 1) < PRINTED_DIGITS < abs(factor - 1):
            raise ValueError(
                f"omega ends at {omega[-1]:.6g}, near {what} = {end:.6g}, where P is real, as "
                f"at the Nyquist frequency: omega is in {unit}, multiply it by {factor:.6g}"
            )
