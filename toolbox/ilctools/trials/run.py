"""Trials under the ILC law: one trial of the closed loop, and a sequence of them. Section IV."""

import warnings
from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr
from tqdm import tqdm

from ilctools import arguments
from ilctools.law.io import NO_RESET, RESET
from ilctools.law.law import Law
from ilctools.law.limits import CUT_OFF, commands_beyond, realised
from ilctools.law.repetitive import check_period, next_samples
from ilctools.loop.closed import ClosedLoop, Loop, with_noise
from ilctools.models import state_sequence
from ilctools.trials.diagnosis import commands, diagnose
from ilctools.trials.start import Start


def run_trials(
    loop: Loop,
    law: Law,
    reference,
    disturbance=None,
    trials: int = 10,
    *,
    plant=None,
    noise=None,
    initial_state=None,
    v=None,
    reset: bool = True,
) -> xr.Dataset:
    """Simulate trials of the loop (19) under the ILC law (22), (23).

    All signals are in the units of the loop's plant. Labelled signals, by the columns of a
    DataFrame or a coordinate of a DataArray, are matched by name. Of one channel, signals may have
    the shape (time,).

    Parameters
    ----------
    loop : CurrentTrialLoop or ClosedLoop
        With m outputs and d disturbances. Of a ClosedLoop only P is simulated, no disturbance.
    law : Law
        With limits, commands are cut off at them, and the observer is informed of that.
    reference : array_like, shape (time, m) or (trial, time, m)
        Reference trajectory, of all trials or of each.
    disturbance : array_like, shape (time, d) or (trial, time, d), optional
        In the order of ``loop.disturbances``. Default zero.
    trials : int
    plant : control.StateSpace or control.TransferFunction, optional
        Another plant in the place of that of the design, as in :meth:`CurrentTrialLoop.around`; for
        a ClosedLoop, another P.
    noise : array_like, shape (trial, time, m), optional
        Added to what the sensors report: both observer and learning see it; of a ClosedLoop,
        learning only.
    initial_state : array_like, shape (n,), optional
        State at the start of every trial of the plant that is simulated, unknown to the observer,
        or of P. Default zero.
    v : array_like, shape (time, m), optional
        ILC signal of the first trial. Default zero.
    reset : bool
        Whether every trial starts from the initial state. If not, trials are periods of a plant
        that never rests: state and observer go on, and the filters reach across the border, see
        :mod:`ilctools.law.repetitive`. L must be a LearningFilter, ``rest`` zero, a trial longer
        than Q and L look ahead; what they take the `ends` to be has no effect. At limits commands
        are cut off, not projected, and learning goes on from what was applied.

    Returns
    -------
    xarray.Dataset
        The signals reference, v, u, y, delta (the estimate of the input disturbance), disturbance,
        and e = reference - y, the error that the controller sees. Each has the dimensions trial
        (1, 2, ...), time (s), and channel (1, 2, ...) or source, and its unit as an attribute; the
        channels have the coordinates output, control, output_unit and control_unit. Of a
        ClosedLoop there are no u and delta. With limits, applied is what they leave of u.

    Warns
    -----
    UserWarning
        If the trials show that they do not converge, see :mod:`ilctools.trials.diagnosis`; if
        commands are beyond the limits; if a reference starts away from rest, where trials begin.

    Raises
    ------
    ValueError
        If something does not belong together; without reset, if trials are too short.

    See Also
    --------
    record : trials on a rig
    replay : what a log says of the law
    rms : the size of their errors

    Examples
    --------
    >>> import control
    >>> A, B = [[1, 0.01], [0, 1]], [[0], [0.01]]  # a mass of 1 kg, F in N, x in m
    >>> stage = control.ss(A, B, [[1, 0]], 0, 0.01, inputs=["F"], outputs=["x"])
    >>> import numpy as np
    >>> from ilctools import current_trial_loop, rms, run_trials
    >>> from ilctools import synthesise, zero_phase_butterworth
    >>> loop = current_trial_loop(stage, ["F"])
    >>> law = synthesise(loop, zero_phase_butterworth(2, 10.0, 0.01)).law(rest=15)
    >>> reference = np.sin(np.pi * np.clip(np.arange(400) / 300, 0, 1)) ** 4
    >>> trials = run_trials(loop, law, reference, trials=3)
    >>> bool(rms(trials.e)[2] < 0.1 * rms(trials.e)[0])
    True
    """
    law = arguments.instance("law", law, Law).bound_to(loop)
    reset = arguments.flag("reset", reset)
    trials = arguments.whole("trials", trials, 1)
    make_trial, plant_states, states = _simulator(loop, plant, law.actuators)
    r = arguments.each_trial("reference", reference, trials, "time", loop.outputs)
    shape = trials, samples, _ = r.shape
    first = law.first(samples, v)
    names = loop.disturbances
    d = np.zeros((samples, len(names))) if disturbance is None else disturbance
    d = arguments.each_trial("disturbance", d, trials, samples, names)
    noise = np.zeros(shape) if noise is None else noise
    noise = arguments.in_columns("noise", noise, shape, loop.outputs)
    initial = np.zeros(states)
    if initial_state is not None:
        x = arguments.array("initial_state", initial_state, (plant_states,))
        initial[:plant_states] = x
    results, state, applied = [], initial, None

    def run(r, v, d, noise):
        nonlocal state, applied
        if reset:
            state, applied = initial, None
        w = r + v  # (22)
        signals, state = make_trial(w, d, noise, state, applied)
        results.append({"v": v} | signals)
        sent = commands_of(loop, w, signals, law.actuators, applied)
        applied = sent["applied"][-1] if "applied" in sent else None
        return {"e": r - signals["y"] - noise} | sent

    if reset:
        learn(lambda k, v: run(r[k], v, d[k], noise[k]), law, first, trials)
    else:
        check_period(law, samples)
        learn_on(run, law, first, *(s.reshape(trials * samples, -1) for s in (r, d, noise)))
    signals = {
        name: np.concatenate([s[name] for s in results]).reshape(trials, samples, -1)
        for name in results[0]
    }
    signals |= {"y": signals["y"] + noise, "reference": r, "disturbance": d}
    channels = loop.outputs, loop.controls, names
    result = dataset(loop.Ts, *channels, loop.units, **signals)
    if not reset:
        result.attrs[RESET] = NO_RESET
    texts = diagnose(result, law, exact=plant is None)
    if law.actuators is not None:
        beyond = commands_beyond(commands(result, loop)["u"], loop.commands, law.limits)
        texts["limits"] = beyond and beyond + CUT_OFF
    if law.L is not None and initial_state is None and reset:
        rest = Start.of(0 * r[0], r[0], loop)
        texts["start"] = next(filter(None, map(rest.away, r[1:])), "")
    for text in filter(None, texts.values()):
        warnings.warn(text, stacklevel=2)
    return result


def learn(trial: Callable, law: Law, v, trials: int) -> np.ndarray:
    """Errors of trials under the law (23), shape (trial, time, m); v is the first signal.

    trial(k, v) runs trial k, and returns what :meth:`Law.next` needs beside v, by name.
    """
    errors = []
    for k in tqdm(range(trials), "trials", delay=3, disable=None):
        signals = trial(k, v)
        errors.append(signals["e"])
        if k < trials - 1:
            v = law.next(v, **signals)
    return np.array(errors)


def learn_on(run: Callable, law: Law, first, reference, *others) -> None:
    """Run trials without a reset; run(r, v, *others) runs the next samples, as a trial of `learn`.

    Signals are (time, m), of all trials; `first` is v of the first one.
    """
    v, e = np.zeros((2, *reference.shape))
    done = 0
    with tqdm(total=len(v), desc="samples", delay=3, disable=None) as bar:
        while done < len(v):
            new = next_samples(law, v[:done], e[:done], first)[: len(v) - done]
            now = slice(done, done + len(new))
            signals = run(reference[now], new, *(signal[now] for signal in others))
            e[now] = signals.pop("e")
            v[now] = realised(law.loop, new, **signals) if law.actuators else new
            done += len(new)
            bar.update(len(new))


def commands_of(loop: Loop, w, signals: dict, actuators=None, before=None) -> dict:
    """What was asked of the actuators, u or of a ClosedLoop w, and applied, for the law."""
    if isinstance(loop, ClosedLoop):
        return {"u": w} | ({"applied": actuators.follow(w, before)} if actuators else {})
    return {name: signals[name] for name in ("u", "applied") if name in signals}


def _simulator(loop, plant, actuators):
    """A function that simulates a trial, and the numbers of the plant's and of all states.

    From w, d, noise and the initial state it makes the trial's signals, y without noise among them,
    and the state after the last sample.
    """
    if isinstance(loop, ClosedLoop):
        return _simulator_of_P(loop.model(plant), actuators)
    closed, m = with_noise(loop, plant), len(loop.outputs)
    n = closed.nstates - len(loop.KL)
    A, C = closed.A, closed.C
    B, E, K = np.split(closed.B, [m, -m], axis=1)
    D, F, _ = np.split(closed.D, [m, -m], axis=1)

    def controls(w, states):
        x_hat, delta = states[..., n:-m], states[..., -m:]
        return w @ loop.N.T - x_hat @ loop.Ks.T - delta  # (18)

    def within_limits(w, others, state, before):
        """The w with which the loop asks for what is applied, and what it asks for with w."""
        w_applied, u = w.copy(), np.empty_like(w)
        for p in range(len(w)):
            u[p] = controls(w[p], state)
            before = actuators.next(u[p], before)
            w_applied[p] = realised(loop, w[p], u[p], before)
            state = A @ state + B @ w_applied[p] + others[p]
        return w_applied, u

    def make_trial(w, d, noise, initial, before):
        others = d @ E.T + noise @ K.T
        states = state_sequence(A, w @ B.T + others, initial)  # (19)
        u = controls(w, states)
        signals = {}
        if actuators is not None:
            if not actuators.can(u, before=before):
                w, u = within_limits(w, others, initial, before)
                states = state_sequence(A, w @ B.T + others, initial)
            signals["applied"] = actuators.follow(u, before)
        signals |= {"u": u, "delta": states[:, -m:]}
        signals["y"] = states @ C.T + w @ D.T + d @ F.T
        return signals, A @ states[-1] + B @ w[-1] + others[-1]

    return make_trial, n, closed.nstates


def _simulator_of_P(P, actuators):
    def make_trial(w, d, noise, initial, before):
        if d.any():
            raise ValueError("disturbance is not zero, but loop.P has no input for disturbances")
        w = w if actuators is None else actuators.follow(w, before)
        x = state_sequence(P.A, w @ P.B.T, initial)
        return {"y": x @ P.C.T + w @ P.D.T}, P.A @ x[-1] + P.B @ w[-1]

    return make_trial, P.nstates, P.nstates


def dataset(
    Ts: float,
    outputs: Sequence[str],
    controls: Sequence[str],
    sources: Sequence[str],
    units: dict[str, str],
    sensors: Sequence[str] = (),
    **signals,
) -> xr.Dataset:
    """Put the signals that :func:`run_trials` returns together, with coordinates and units."""
    if "reference" in signals:
        signals["e"] = signals["reference"] - signals["y"]
    trials, samples, m = signals["y"].shape
    coordinates = {
        "trial": np.arange(1, trials + 1),
        "time": ("time", Ts * np.arange(samples), {"units": "s"}),
        "channel": np.arange(1, m + 1),
    }
    variables = {}
    for kind, dimension, names, members in (
        ("output", "channel", outputs, ("reference", "v", "y", "e")),
        ("control", "channel", controls, ("u", "applied", "delta")),
        ("source", "source", sources, ("disturbance",)),
        ("sensor", "sensor", sensors, ("measured",)),
    ):
        if not len(names) or signals.keys().isdisjoint(members):
            continue
        labels = [units.get(name, "") for name in names]
        coordinates[kind] = (dimension, list(names))
        coordinates[f"{kind}_unit"] = (dimension, labels)
        unit = labels[0]
        if len(set(labels)) > 1:  # "name: unit" for one after the other
            unit = ", ".join(map("{}: {}".format, names, labels))
        axes = ("trial", "time", dimension)
        for name in members:
            if name in signals:
                variables[name] = (axes, signals[name], {"units": unit})
    return xr.Dataset(variables, coordinates, {"Ts": float(Ts)})


def rms(e: xr.DataArray) -> xr.DataArray:
    """RMS(e_k) of Section IV: root of the mean over time of e'e, summed over the channels.

    `e` is a DataArray with the dimensions time and channel, such as that of a dataset of trials;
    anything else, or a gap in it, raises a ValueError.

    See Also
    --------
    run_trials : trials with an error e

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from ilctools import rms
    >>> e = xr.DataArray(np.ones((2, 9, 2)), dims=("trial", "time", "channel"))
    >>> rms(e).values.round(4)
    array([1.4142, 1.4142])
    """
    arguments.instance("e", e, xr.DataArray)
    if not {"time", "channel"} <= set(e.dims):
        raise ValueError(f"e has dimensions {e.dims}, but must have 'time' and 'channel'")
    arguments.array("e", e.values, (...,))
    return np.sqrt((e**2).sum("channel").mean("time"))
