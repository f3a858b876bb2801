"""Test trials: does the error grow, does the plant differ from the model, is an output dead?

Let P be the response of the loop, v_k and e_k the ILC signal and the error of trial k, and e_free
the error without learning. Q and L are the filters of the law. If the ends of a trial are
neglected, trial k obeys

    e_{k+1} = M e_k + (1 - Q) e_free,    M = Q (I - P L).                                      (1)

Therefore, the errors in each band of frequencies obey
||e_{k+1}|| <= sigma_max(M) ||e_k|| + ||(1 - Q) e_free||. For a trial with its ends, and with the
recorded v, the model predicts the error

    e_{k+1} = e_free - P v_{k+1},    e_free = e_k + P v_k.                                     (2)

The plant is said to differ from the model if errors exceed both (1) and (2) by more than noise
explains. The error is said to grow if its RMS rises by more than noise explains. The size of the
noise is estimated from the trials themselves. Noise is the part of the error that does not repeat
and that v does not explain. The noise may have any spectrum.

P is taken from the design, with its radius, or else from the loop. If the loop has no P, nothing is
known about the error of the P in the law. Then (2) is evaluated for all plants (I + Delta) P with a
relative error ||Delta|| of at most PLANT_ERROR. These plants change the prediction by at most
PLANT_ERROR times P (v_{k+1} - v_k). If the plant differs from P by a quarter, the error falls more
slowly, but there is no warning. If a signal is in another unit, Delta is near -I, and there is a
warning.

An output is dead if it does not move in a trial in which P predicts a movement.
"""

from collections.abc import Callable
from functools import partial

import control
import numpy as np
import xarray as xr
from scipy.special import factorial, fdtrc

from ilctools.base import RegularisedInverse
from ilctools.evidence.robustness import within_radius
from ilctools.law.law import Law
from ilctools.models import frequency_response
from ilctools.response.door import in_own_units, response_of
from ilctools.signals import ASKED, TRIAL_AXES
from ilctools.trials.at_limits import limits_not_kept, stands_still
from ilctools.trials.parts import from_rest_to_rest, successions
from ilctools.trials.rms import (
    SMALLEST_DIVISOR,
    harmonics,
    noise_std,
    octaves,
    rms_by_octave,
    rms_of,
)
from ilctools.units import by_unit

SIGNIFICANCE = 1e-4  # probability of a false warning by noise, in a test
NOTABLE_GROWTH = 1.5  # ratio of RMS errors that is worth a warning,
RISES = 3  # if the error rose so many times in succession;
JUMP = 3.0  # ratio to the largest earlier error if it rose once, as by a new disturbance
AMPLIFICATION = 5.0  # errors below so many times the noise are fine: learning amplifies noise
EXCESS = 0.05  # smallest error beyond the predicted one that counts, relative to the first error
PLANT_ERROR = 0.5  # allowed relative error of P, if only the law has a P
STILL = 0.05  # smallest predicted movement of an output that must show, relative to the reference's
ROUNDED_ERROR = 1e-9  # size of a rounding error, relative to the largest signal
GRID = np.geomspace(1e-4, 1, 200) * np.pi  # omega Ts of the predicted rate


def diagnose(trials: xr.Dataset, law: Law, first: int = 2, exact: bool = False) -> dict[str, str]:
    """Look for evidence, in the signals of trials, that their law does not converge.

    Parameters
    ----------
    trials : xarray.Dataset
        Successive trials, as from :func:`ilctools.run_trials`.
    law : Law
        If the design of the law was for more than a single exact model, the trials are compared
        with the plants of the design. A warning requires that the trials contradict every plant of
        the design. Otherwise the trials are compared with the P of the loop, the model of the
        design, or the model in L. See :func:`known_plants`.
    first : int
        The first trial to be judged, counted from 1.
    exact : bool
        Whether the trials were simulated on the model itself. The model is then not checked.

    Returns
    -------
    dict
        The first warning of each kind: "growth", "dead" and "model". A warning "dead" replaces
        "model". With limits of outputs there are also the kinds "beyond" and "still".
    """
    at_limits = {"beyond": limits_not_kept(trials, law, first), "still": stands_still(trials, law)}
    at_limits = {kind: text for kind, text in at_limits.items() if text}
    if law.L is None:
        return at_limits
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # errors may be 1e200
        found = {"growth": _first_finding(error_grows, forgetting(trials, law), first)}
        # between points of a reference the model predicts no error
        for P in [] if exact or ASKED in trials.coords else known_plants(law):
            with_P = predicted(trials, law, P)
            differs = partial(plant_differs, law, largest_M(law, P))
            found["dead"] = _first_finding(dead_outputs, with_P, first)
            found["model"] = {} if found["dead"] else _first_finding(differs, with_P, first)
            if not (found["dead"] or found["model"]):
                break
    texts = {kind: WARNINGS[kind].format(**values) for kind, values in found.items() if values}
    return texts | at_limits


def _first_finding(test, trials, first):
    """Return the first finding of a test in successive trials.

    Outputs of one unit are tested together. The variable `rms` is their RMS(e_k).
    """
    groups = by_unit(trials.output_unit.values.tolist()).values()
    for channels in groups:
        alike = trials.isel(channel=channels)
        alike = alike.assign(rms=rms_of(alike.e))
        where = f"{', '.join(alike.output.values)}: " if len(groups) > 1 else ""
        for k, since in enumerate(successions(trials)):
            if k >= first - 1 and (values := test(alike.isel(trial=slice(since, k + 1)))):
                return {"where": where} | values
    return {}


def forgetting(trials: xr.Dataset, law: Law) -> xr.Dataset:
    """Add the signals (1 - Q) v and Q L e to trials.

    The law removes (1 - Q) v from v, and adds Q L e.
    """
    v, e = trials.v.values, np.nan_to_num(trials.e.values)
    forgotten, learned = v - law.Q.apply(v), law.Q.apply(law.L.apply(e))
    axes = trials.v.dims
    return trials.assign(forgotten=(axes, forgotten), learned=(axes, learned))


def error_grows(trials: xr.Dataset) -> dict:
    """Test whether the error grows from trial to trial, by more than noise explains.

    The null hypothesis is that errors of trials with one reference are noise of one variance. The
    test is made if the error rose several times in succession up to the last trial. The test is
    also made if the error rose at once to a multiple of its largest earlier value.
    """
    largest = np.abs(trials.reference.values).max()
    trials = trials.isel(trial=slice(first_judged(trials), None))
    e, size = trials.e.values, trials.rms.values
    if len(size) < 2:
        return {}
    size = np.maximum(size, ROUNDED_ERROR * max(largest, *size))
    before = np.append(-1, np.flatnonzero(np.diff(size) <= 0))[-1] + 1  # the rise begins here
    rises, least = len(size) - 1 - before, NOTABLE_GROWTH
    if rises < RISES:
        before, rises, least = size[:-1].argmax(), 1, JUMP
    growth, noise = size[-1] / size[before], np.linalg.norm(noise_std(e[0]))
    if growth < least or size[-1] < AMPLIFICATION * noise:
        return {}
    freedom = degrees_of_freedom(np.abs(harmonics(e[-1] - e[-2])) ** 2).item()
    if chance(growth, freedom, rises + 1) >= SIGNIFICANCE:
        return {}
    return {"trials": trials.trial.values[[before, -1]], "rms": size[[before, -1]]}


def first_judged(trials: xr.Dataset) -> int:
    """Find the first trial in which Q removes from v little more than learning adds.

    The trials before this trial are not judged. In these trials, v still contains a signal that
    another law or another task has left, and Q removes this signal. If e = -P v, the condition
    sigma_max(M) >= 1 means |Q L e| >= |(1 - Q) v|.
    """
    signals = (trials[name].values for name in ("forgotten", "learned"))
    taken, added = (np.sum(x**2, axis=(1, 2)) for x in signals)
    return np.append(taken > NOTABLE_GROWTH**2 * added, False).argmin()


def chance(ratio: float, freedom: float, trials: int) -> float:
    """Compute the probability that errors of equal variance increase and reach `ratio`.

    The ratio of two mean squares with `freedom` degrees of freedom has an F distribution. The
    largest and the smallest are one of n (n - 1) ordered pairs (Bonferroni). Whatever their sizes
    are, n errors are in increasing order with probability 1 / n!.
    """
    pairs = trials * (trials - 1)
    exceeds = pairs * fdtrc(freedom, freedom, min(ratio, 1e100) ** 2)
    return min(1.0, exceeds) / factorial(trials)


def known_plants(law: Law) -> list[Callable]:
    """Return, for each plant, a function that computes P and its radius at omega.

    The trials are compared with these plants. The plants of the design are taken, unless they are a
    single exact model. Otherwise the P of the loop is taken. If the P of the loop is not known, the
    model of the design is taken. If neither is known, as for a law that was read from a file, the
    model in L is taken.
    """
    region, model = _region(law), getattr(law.loop, "P_v", None)
    if region is None and model is None:
        model = model_in(law.L)
    alone = region is None or (
        region.radius is None and not region.sampled and len(region.models) == 1
    )
    if alone and model is not None:
        region = in_own_units(response_of(model, GRID / law.Ts))
    count = 0 if region is None else len(region.models)
    return [partial(region.anywhere, k) for k in range(count)]


def _region(law):
    """Return the plants of a law's design.

    A law from a file has these plants only if it limits outputs.
    """
    return law.region or (law.output_limits and law.output_limits.region)


def model_in(L) -> control.StateSpace | None:
    """Return the model in norm-optimal learning or in the base B of L, in the outputs' own units.

    If B has several plants, the model is their mean, E^T P in the notation of :mod:`ilctools.base`.
    A diagonal filter of several channels has no model, because the coupling is not known.
    """
    B = getattr(L, "B", L)
    P = getattr(B, "P", None)
    if not isinstance(B, RegularisedInverse):
        return P
    mean = B.scale_y[:, None] * B.E.T
    model = mean * P * np.diag(1 / B.scale)
    if model.ninputs != model.noutputs:
        return model
    coupling = frequency_response(model, GRID / P.dt) * (1 - np.eye(P.ninputs))
    return model if P.ninputs == 1 or coupling.any() else None


def plant_error(law: Law) -> float:
    """Return the allowed relative error of P.

    The error is zero if the loop has a P, or if P has a radius.
    """
    model, radius = getattr(law.loop, "P_v", None), getattr(_region(law), "radius", None)
    return PLANT_ERROR if model is None and radius is None else 0.0


def predicted(trials: xr.Dataset, law: Law, P: Callable) -> xr.Dataset:
    """Add to trials the signals that the model P predicts from v.

    The signal `effect` is P v from rest, by which v lowers the error. The signal `spread` is what
    the radius may add to P v. The signal `kept` is the part of the error without v that Q never
    learns. The signal `moves` is the response of P to w = r + v, from rest at the first value of w.
    If v is not added to references, `moves` is the response to v alone.
    """
    parts = from_rest_to_rest(trials)
    v = np.array([*map(law.applied_v, parts)])
    w = v + [part["reference"] for part in parts] if "input" not in trials.v.dims else v
    samples = v.shape[1]
    # transforms have twice the length of a trial, in which the impulse response has decayed
    response, radius = P(2 * np.pi * np.fft.rfftfreq(2 * samples, law.Ts))

    def through(gain, signals):
        spectra = gain @ np.fft.rfft(signals, 2 * samples, axis=1)[..., None]
        made = np.fft.irfft(spectra[..., 0], axis=1)[:, :samples]
        return made.reshape(*trials.e.shape[:2], -1)

    effect, moves = through(response, v), through(response, w - w[:, :1])
    spread = through(radius[:, None, None] * np.eye(v.shape[2]), v)
    free = trials.e.values + effect
    return trials.assign(
        effect=(TRIAL_AXES, effect),
        moves=(TRIAL_AXES, moves),
        kept=(TRIAL_AXES, free - law.Q.apply(free)),  # (1 - Q) e_free
        spread=(("trial", "time", "learned"), spread),
    )


def dead_outputs(trials: xr.Dataset) -> dict:
    """Find outputs that are constant in the last trial, although P predicts a change.

    The range of a signal is its highest value minus its lowest value. An output is examined only if
    its predicted range is more than the fraction STILL of the range of the reference. Otherwise a
    sensor could be called dead because a small change stays within its resolution.
    """
    last = trials.isel(trial=-1)
    y, wanted, moves = (np.ptp(last[name].values, axis=0) for name in ("y", "reference", "moves"))
    dead = (y == 0) & (wanted > 0) & (moves > STILL * wanted)
    if not dead.any():
        return {}
    outputs = ", ".join(last.output.values[dead])
    return {"trial": last.trial.item(), "outputs": outputs, "moves": moves[dead].max()}


def largest_M(law: Law, P: Callable) -> np.ndarray:
    """Compute the largest sigma_max(M) within the radius of P, at the angles of GRID."""
    omega = GRID / law.Ts
    response, radius = P(omega)
    Q, L = law.Q.frequency_response(omega), law.L.frequency_response(omega)
    return within_radius(response, Q, L, radius, 0)


def errors_by_octave(law: Law, sigma, trials: xr.Dataset, before: int, k: int) -> dict:
    """Compare the error of trial k with the error of trial `before`, octave by octave.

    Errors are relative to the error of trial `before`. The value `frequency` is the upper end of
    each octave, in rad/s. The value `predicted` follows from (2), with the ends of the trial and
    with the error that P may have. The value `bound` is the larger of `predicted` and the bound by
    (1), from sigma_max(M) and from what Q leaves. The value `measured` is the error of trial k. The
    value `excess` is the RMS by which the measured error exceeds the bound.
    """
    e, kept, first = trials.e.values, trials.kept.values, octaves(trials.e.shape[1])
    frequency = first * 2 * np.pi / e.shape[1]  # times Ts
    sigma = np.maximum.reduceat(sigma, np.searchsorted(GRID, frequency))
    size = np.maximum(rms_by_octave(e[before]), SMALLEST_DIVISOR)
    change, spread = (x[k] - x[before] for x in (trials.effect.values, trials.spread.values))
    uncertain = rms_by_octave(spread) + plant_error(law) * rms_by_octave(change)
    promised = (rms_by_octave(e[before] - change) + uncertain) / size  # (2)
    bound = 1 - law.gain + law.gain * (sigma + rms_by_octave(kept[before]) / size)  # (1)
    # (1) applies only if M acts on the error
    bound = promised if law.L.rows < law.L.columns else np.maximum(bound, promised)
    measured = rms_by_octave(e[k]) / size
    return {
        "bound": bound,
        "predicted": promised,
        "measured": measured,
        "frequency": np.append(frequency[1:], np.pi) / law.Ts,
        "excess": size * np.maximum(measured - bound, 0),
    }


def plant_differs(law: Law, sigma, trials: xr.Dataset) -> dict:
    """Test by an F test in each octave whether errors exceed the prediction of the model.

    The prediction starts from an earlier trial. The last trial is compared with the previous trial,
    and with the trial of the smallest error so far. The second trial is compared with the first,
    because most is learned in this step. The null hypothesis is that trials differ from the model's
    prediction for three reasons only. The first reason is noise that is independent from trial to
    trial. The second reason is a model error that the bound allows. The third reason is a
    disturbance that grows by the same amount in each trial.
    """
    e, size, last = trials.e.values, rms_of(trials.e).values, len(trials.e) - 1
    if last < 2:  # the noise is estimated from two changes or more
        return {}
    expected = -np.diff(trials.effect.values, axis=0)
    came, noise, freedom = unexplained(np.diff(e, axis=0), expected)
    wrong = plant_error(law)
    for before, k in ((last - 1, last), (size[:last].argmin(), last), (0, 1)):
        errors = errors_by_octave(law, sigma, trials, before, k)
        p = chance_of_excess(errors["excess"] / (k - before), noise, freedom, last)
        significant = errors["excess"] * (p < SIGNIFICANCE)
        worst = significant.argmax()
        if significant[worst] > EXCESS * size[0]:
            channel = np.abs(came[worst] - 1).argmax()
            return {
                "trials": trials.trial.values[[before, k]],
                "came": came[worst, channel],
                "output": trials.output.values[channel],
                "even": f", even if P is wrong by {wrong:.0%}" if wrong else "",
                **{name: values[worst] for name, values in errors.items()},
            }
    return {}


def unexplained(changes, expected) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit changes between trials by a gain and a phase for each octave and output.

    Signals have the shape (trial, time, channel). The function returns the real parts of the fitted
    gains, shape (octave, channel). The other results are the mean square of the remainder in a
    trial, by octaves, and the degrees of freedom of the remainder.
    """
    first, Y, X = octaves(changes.shape[1]), harmonics(changes), harmonics(expected)
    XY, XX = (np.add.reduceat(np.sum(X.conj() * Z, axis=0), first) for Z in (Y, X))
    gain = XY / np.maximum(XX.real, SMALLEST_DIVISOR)
    remainder = Y - np.repeat(gain, np.diff(first, append=Y.shape[1]), axis=0) * X
    power = np.mean(np.abs(remainder) ** 2, axis=0)
    return gain.real, np.add.reduceat(power.sum(axis=1), first), degrees_of_freedom(power, first)


def degrees_of_freedom(power, first=(0,)) -> np.ndarray:
    """Compute the degrees of freedom of a mean square, by octave.

    The argument `power` has the shape (harmonic, channel).
    """
    total, squares = (np.add.reduceat(values.sum(axis=1), first) for values in (power, power**2))
    return np.maximum(2, 2 * total**2 / np.maximum(squares, SMALLEST_DIVISOR))


def chance_of_excess(excess, variance, freedom, trials: int) -> np.ndarray:
    """Compute, for each octave, the probability that noise alone causes such an excess.

    The square of the excess has the n degrees of freedom of one trial in this octave. The variance
    is estimated from `trials` changes between trials. The variance has `trials` times n degrees of
    freedom, less 2 for a gain and a phase. Bonferroni corrects for the number of octaves, because
    any octave may show an excess.
    """
    others = trials * freedom - 2
    F = excess**2 / variance * others / (trials * freedom)
    return len(excess) * fdtrc(freedom, others, F)


WARNINGS = {
    "growth": (
        "{where}the error grows by more than noise explains: its RMS was {rms[0]:.3g} in "
        "trial {trials[0]} and is {rms[1]:.3g} in trial {trials[1]}. Unless there was a new "
        "disturbance, the law diverges, or the plant differs from the model: measure P "
        "(shake), or learn less, by a lower cut-off of Q or a smaller learning gain. If "
        "sigma_max(M) is below 1, the ends of a trial may be the cause: bound L (L_max) so "
        "that trial_norm is below 1, too, or let reference and v be constant there"
    ),
    "dead": (
        "{outputs} did not move in trial {trial}, where the model predicts a movement of "
        "{moves:.3g}: is a sensor dead or not connected, or an actuator switched off? If an "
        "output does not move, the v that is learned from it grows in each trial without "
        "reducing an error"
    ),
    "model": (
        "{where}the convergence rate is not the predicted one: up to {frequency:.2g} rad/s, "
        "trial {trials[1]} has {measured:.2f} of the error of trial {trials[0]}, but the "
        "model predicts {predicted:.2f}, and at most {bound:.2f}{even}; noise explains less. "
        "Unless there was a new disturbance, the plant differs from the model: {output} "
        "changed by {came:.2g} times the change that the model predicts. Is a signal in "
        "another unit (y in m, r in mm), is a sensor dead, or is a sensor or an actuator at "
        "its limit, exchanged or reversed? Otherwise measure P (shake), or accept this rate, "
        "if it is below one"
    ),
}
