"""Make the design problem from the user's arguments, and check each argument."""

import numpy as np

from ilctools import arguments
from ilctools.base import base_of_models, base_of_samples
from ilctools.filters import LearningFilter
from ilctools.problem import defaults
from ilctools.problem.bounds import Bounds
from ilctools.problem.lowpass import lowpass_of
from ilctools.problem.problem import Objective, Problem
from ilctools.problem.reference import error_weights, first_error, reachable
from ilctools.response.response import SAME_ANGLE, Response
from ilctools.singular_values import largest_singular_values

STATES = 100  # most states of the models in B, which take a second; with more, B is an FIR filter
SINGULAR = 1e-12  # of the largest singular value: smaller values are rounding
LONGEST_FILTER = 300  # samples: the design takes 16 s for one channel, and grows as their cube


def pose(
    response: Response,
    Q,
    *,
    order=None,
    M_max=0.9,
    L_max=defaults.CHOOSE,
    L_high=None,
    band=None,
    reference=None,
    structure="full",
    objective="sum",
    everywhere=False,
    base=None,
    reach=None,
) -> Problem:
    """Make and check the problem (39), or (45) with (46), of the paper.

    The arguments are as for :func:`ilctools.synthesise`.
    """
    lowpass, asked_order, chosen = lowpass_of(Q, response.omega), order, []
    cutoff, base = lowpass.cutoff, _asked_base(base, order, response)
    pooled, M_max = base == defaults.CHOOSE, checked_M_max(M_max)
    gain = _gain(response, lowpass, M_max, pooled)
    structure = _asked_structure(structure, response)
    reach = None if reach is None else arguments.whole("reach", reach, 1)
    order = _order(response, cutoff, order, base, chosen)
    Q = lowpass.frequency_response(response.omega)
    objective = _objective(response, cutoff, Q, objective, band, reference, chosen)
    L_high, everywhere = _bound_from(L_high, response), arguments.flag("everywhere", everywhere)
    bounds = Bounds(M_max, _L_max(L_max, gain, pooled, chosen), L_high, everywhere)
    B = None
    if base is not None:
        B = _base(response, lowpass, structure, base, bounds.L_max or gain, reach, chosen)
    return Problem(
        response,
        lowpass,
        Q,
        objective,
        bounds,
        order,
        structure,
        B,
        formula_will_do=pooled
        and asked_order is None
        and reference is None
        and objective.kind == "sum",
        defaults_chosen=tuple(chosen),
    )


def _asked_base(base, order, response):
    """Check `base`, and return "auto", a number or None.

    If P is square and an order is given, "auto" becomes None.
    """
    if base == defaults.CHOOSE:
        p, m = response.P.shape[2:]
        return None if p == m and order is not None else base
    if base is None:
        return None
    return arguments.number("base", base, "in (0, 1), None or 'auto'", 0, 1)


def _asked_structure(structure, response):
    """Check the structure.

    The structure "diagonal" needs as many inputs as outputs.
    """
    p, m = response.P.shape[2:]
    if arguments.choice("structure", structure, ["diagonal", "full"]) == "diagonal" and p != m:
        raise needs_square("structure = 'diagonal'", p, m)
    return structure


def needs_square(what: str, p: int, m: int) -> ValueError:
    """Return the error for an argument `what` that needs as many inputs as outputs."""
    return ValueError(
        f"{what} needs as many learned inputs as outputs, but P has {m} inputs and {p} "
        "outputs: leave it out"
    )


def checked_M_max(M_max) -> float:
    """Check that the bound on sigma_max(M) is between 0 and 1."""
    return arguments.number("M_max", M_max, "in (0, 1), or the trials do not converge", 0, 1)


def _base(response, lowpass, structure, share, L_max, reach, chosen):
    """Make B of L = B K, the regularised inverse (P* P + b^2)^-1 P*.

    If `share` is "auto", b is 1 / (2 L_max). B is then made for all plants, and the gain of L = B
    is at most L_max. If `share` is a number, b is this share of the largest sigma_max(P) up to the
    cut-off of Q.
    """
    pooled = share == defaults.CHOOSE
    if pooled:
        models, b, why = response.models, 1 / (2 * L_max), "1 / (2 L_max)"
    else:
        below = response.omega <= max(lowpass.cutoff, response.omega[0])
        b = share * largest_singular_values(response.P[0, below]).max()
        models, why = response.models[:1], f"{share:g} of its largest gain"
    exact = reach is None and None not in models and any(P.nstates for P in models)
    most = STATES if pooled else np.inf
    base = base_of_models(models, b, structure, most) if exact else None
    if base is None and (pooled or not exact):
        base = base_of_samples(response, lowpass, b, reach, len(models), structure)
    if base is None:
        raise ValueError(
            f"base = {share} is too small for this plant, because rounding then decides the "
            "factors of B: take a larger base, or None"
        )
    kind = "for a trial with ends"
    if isinstance(base, LearningFilter):
        kind = f"a finite filter that reaches {-base.first} samples each way"
    of = "all plants" if len(models) > 1 else "the plant"
    product = "B K" if response.P.shape[-1] >= response.P.shape[-2] else "K B"
    chosen.append(f"L = {product}, where B inverts {of} with b = {b:.3g}, which is {why}, {kind}")
    return base


def _order(response, cutoff, order, base, chosen):
    """Choose or check the order of L or K, which is at most the number of frequencies."""
    n = len(response.omega)
    if order is None and base is not None:
        order = min(defaults.TAPS_OF_K, n)
        if base != defaults.CHOOSE:
            chosen.append(f"order = {order} of K, in L = B K")
    if order is None:
        delay = defaults.delay(response.P[0], response.omega, response.Ts, cutoff)
        order = defaults.order(cutoff, delay, response.Ts, n)
        chosen.append(
            f"order = {order}, from the cut-off of Q and the delay of P there, {delay} samples"
        )
    order = arguments.whole("order", order, 1)
    if order > LONGEST_FILTER:
        raise ValueError(
            f"order = {order} is more than {LONGEST_FILTER}, beyond which a design takes "
            "minutes: leave order out, so that L = B reaches as far as P needs, or sample "
            "more slowly"
        )
    if order > n:
        raise ValueError(
            f"order = {order} is more than the {n} frequencies of omega can determine: take "
            f"order = {n} or less, or more frequencies"
        )
    return order


def _objective(response, cutoff, Q, kind, band, reference, chosen):
    """Make the objective: a peak, a sum over a band, or a sum weighted by the first error."""
    summed = arguments.choice("objective", kind, ["sum", "peak"]) == "sum"
    error = None
    if reference is None:
        band, weights = _of_band(response.omega, cutoff, band, summed, chosen)
    elif band is not None or not summed:
        raise ValueError(
            f"reference replaces the band in the sum (39), but band = {band!r} and objective = "
            f"{kind!r} are given: leave these out, or leave the reference out"
        )
    else:
        p = len(response.scale.y)
        names = response.signals.labels[:p] or arguments.names_of(reference) or range(p)
        r = arguments.in_columns("reference", reference, ("time", p), names) / response.scale.y
        arguments.representable("reference", r, "in another unit")
        error = first_error(response, r)
        weights = error_weights(reachable(response, error), response.angles)
    largest = np.abs(Q[weights > 0] if summed else Q).max()
    if largest < 1e-6:  # no L would change the objective visibly
        raise ValueError(
            f"Q has a gain of at most {largest:.3g} at the frequencies of the objective, so "
            "that nothing is learned: is its cut-off in rad/s?"
        )
    return Objective(kind, weights, band, error)


def _of_band(omega, cutoff, band, summed, chosen):
    """Return the band, and weights that are one inside the band.

    If the objective is a sum, omega must contain the band.
    """
    if band is None:
        band = defaults.band(cutoff, omega)
        if summed:
            chosen.append(f"band = ({band[0]:.4g}, {band[1]:.4g}) rad/s, up to the cut-off of Q")
    low, high = band = tuple(arguments.array("band", band, (2,)).tolist())
    inside = (omega >= low) & (omega <= high)
    slack = SAME_ANGLE * omega[-1]
    if summed and not omega[0] - slack <= low < high <= omega[-1] + slack:
        raise ValueError(
            f"band = {band!r} must be two increasing frequencies within omega, "
            f"[{omega[0]:.6g}, {omega[-1]:.6g}] rad/s"
        )
    if summed and not inside.any():
        raise ValueError(f"band = {band!r} contains none of the frequencies omega")
    return band, inside.astype(float)


def _L_max(L_max, gain, close, chosen):
    """Choose or check the bound on sigma_max(L).

    None stands for no bound.
    """
    if isinstance(L_max, str) and L_max == defaults.CHOOSE:
        L_max, room = gain, f"at most {defaults.ROOM_OF_BASE}" if close else defaults.ROOM
        chosen.append(
            f"L_max = {L_max:g}, {room} times a gain that inverts P up to the cut-off of Q"
        )
    what = f"a positive number, None for no bound, or {defaults.CHOOSE!r}"
    return None if L_max is None else arguments.positive("L_max", L_max, what)


def _bound_from(L_high, response):
    """Check `L_high`, which is a frequency and the bound on sigma_max(L) above it, or None."""
    if L_high is None:
        return None
    lowest, gain = arguments.array("L_high", L_high, (2,)).tolist()
    if not 0 < lowest <= response.omega[-1] or gain <= 0:
        raise ValueError(
            f"L_high = ({lowest:g}, {gain:g}) must be two positive numbers: a frequency up to "
            f"the last one of omega, {response.omega[-1]:.6g} rad/s, and a bound on "
            "sigma_max(L) at and above this frequency"
        )
    return lowest, gain


def _gain(response, lowpass, M_max, pooled):
    """Compute the default L_max.

    If `pooled` is true, L_max determines b of the regularised inverse B.
    """
    omega, cutoff = response.omega, lowpass.cutoff
    # The true singular value may be zero if the computed one is below the radius. The radius
    # therefore replaces smaller values.
    smallest = np.maximum(_smallest_singular_values(response, cutoff), response.radii)
    if not pooled:
        return defaults.gain(cutoff, smallest, omega)
    Q = np.abs(lowpass.frequency_response(omega))
    return defaults.gain_of_base(cutoff, smallest, omega, Q, M_max)


def _smallest_singular_values(response, cutoff):
    """Compute the smallest singular value of the nominal plant at each frequency, (n,).

    A singular plant is refused.
    """
    omega, singular_values = response.omega, np.linalg.svdvals(response.P[0])
    # Up to the cut-off, `size` is the largest singular value at all frequencies. Above the cut-off,
    # it is the largest singular value at the same frequency.
    size = np.where(omega <= cutoff, singular_values.max(), singular_values[:, 0])
    singular = np.flatnonzero(singular_values[:, -1] <= SINGULAR * size)
    if singular.size:
        raise _singular("P", omega[singular[0]], singular_values[singular[0], -1])
    return singular_values[:, -1]


def refuse_singular(response):
    """Refuse plants that are singular at all frequencies, because they allow no cut-off."""
    for k, P in enumerate(response.P):
        values = np.linalg.svdvals(P)
        if np.all(values[:, -1] <= SINGULAR * values.max()):
            name = "P" if len(response.P) == 1 else f"P[{k}]"
            raise _singular(name, response.omega[0], values[0, -1])


def _singular(name, omega, value):
    """Return the error for a plant that is singular at a frequency."""
    return ValueError(
        f"{name} is singular at omega = {omega:.6g} rad/s (its smallest singular value is "
        f"{value:.3g}), so that P^-1 in (40) does not exist there. Does each output respond to "
        "an input, and does each input act on an output? Channels in units that differ by a "
        "factor of millions need `scale`. If P passes nothing there, sigma_max(M) is |Q| for "
        "every L: leave such frequencies out"
    )
