"""Trials under the ILC law: one trial of the closed loop, and a sequence of them. Section IV."""

import warnings
from collections.abc import Sequence

import numpy as np
import xarray as xr
from tqdm import tqdm

from rodlib.ilc import arguments
from rodlib.ilc.filters import (
    LearningOperator,
    ZeroPhaseButterworth,
    check_learning,
    check_Q,
)
from rodlib.ilc.law.actuators import Actuators
from rodlib.ilc.law.limits import commands_of, projected, realised
from rodlib.ilc.loop.closed import ClosedLoop, Loop, check_loop, with_noise
from rodlib.ilc.models import state_sequence
from rodlib.ilc.trials.diagnosis import Course, rates_of


def run_trials(
    loop: Loop,
    Q: ZeroPhaseButterworth,
    L: LearningOperator | None,
    reference,
    disturbance=None,
    trials: int = 10,
    *,
    plant=None,
    noise=None,
    initial_state=None,
    rest: int = 0,
    step=1.0,
    v=None,
    limits: dict[str, tuple[float, ...]] | None = None,
) -> xr.Dataset:
    """Simulate trials of the loop (19) under the ILC law (22), (23).

    All signals are in the units of the loop's plant. What says whose its channels are, as the
    columns of a DataFrame or a coordinate of a DataArray do, is matched by that. Of one channel,
    signals may have the shape (time,).

    Parameters
    ----------
    loop : CurrentTrialLoop or ClosedLoop
        With m outputs and d disturbances. Of a ClosedLoop only P is simulated, no disturbance.
    Q, L : ZeroPhaseButterworth, LearningOperator
        L None switches learning off: v stays what it is.
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
        State of the plant that is simulated at the start of every trial, unknown to the observer,
        or of P. Default zero.
    rest : int
        Number of samples at the end of every trial in which v is held at zero.
    step : float or array_like, shape (trials - 1,)
        Of :func:`rodlib.update`, in (0, 1], or one from each trial to the next.
    v : array_like, shape (time, m), optional
        ILC signal of the first trial. Default zero.
    limits : dict, optional
        Of the actuators, as for :func:`rodlib.update_within`, by which v then follows from trial to
        trial. Commands are cut off at them, and the observer is told. Default: there are none.

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
        If the trials show that they do not converge, see :mod:`rodlib.ilc.trials.diagnosis`.
    """
    check_law(loop, Q, L)
    actuators = None if limits is None else Actuators.of("limits", limits, loop)
    simulate, n, nx = _simulation(loop, plant, actuators)
    trials = arguments.whole("trials", trials, 1)
    r = each_trial("reference", reference, trials, "time", loop.outputs)
    shape = trials, samples, _ = r.shape
    rest = arguments.whole("rest", rest, 0, samples - 1)
    d = (
        np.zeros((samples, len(loop.disturbances)))
        if disturbance is None
        else disturbance
    )
    d = each_trial("disturbance", d, trials, samples, loop.disturbances)
    noise = np.zeros(shape) if noise is None else noise
    noise = arguments.in_columns("noise", noise, shape, loop.outputs)
    chi = np.zeros(nx)
    if initial_state is not None:
        chi[:n] = arguments.array("initial_state", initial_state, (n,))
    first = np.zeros(shape[1:]) if v is None else v
    first = arguments.in_columns("v", first, shape[1:], loop.outputs)
    first[samples - rest :] = 0

    v, y, made, steps = np.zeros(shape), np.zeros(shape), [], _steps(step, trials)

    def run(k, v_k):
        v[k] = v_k
        w = r[k] + v_k  # (22)
        y[k], more = simulate(w, d[k], noise[k], chi)
        made.append(more)
        return r[k] - y[k] - noise[k]

    def following(k, v_k, e_k):
        if L is None:
            return v_k
        return projected(v_k, e_k, commands(k), Q, L, loop, actuators, rest, steps[k])

    def commands(k):
        return commands_of(
            loop, actuators, r[k] + v[k], made[k].get("u"), made[k].get("applied")
        )

    errors = learn(run, first, following, trials)
    if L is not None:
        P, names = loop.P, loop.outputs
        units, rates = [loop.units[name] for name in names], rates_of(P, Q, L)
        if actuators is not None:
            learned = np.stack(
                [realised(loop, v[k], *commands(k)) for k in range(trials)]
            )
        given = v if actuators is None else learned, errors, r, names, units, 1
        course = Course(*given, None if plant is None else P, *rates)
        for finding in course.all_findings().values():
            warnings.warn(finding, stacklevel=2)
    more = {name: np.array([trial[name] for trial in made]) for name in made[0]}
    return dataset(
        loop.Ts, loop.outputs, loop.controls if more else [], loop.disturbances, loop.units,
        reference=r, v=v, y=y + noise, disturbance=d, **more,
    )  # fmt: skip


def _simulation(loop, plant, actuators):
    """What makes a trial of w, d and noise, and the numbers of the plant's and of all states."""
    if isinstance(loop, ClosedLoop):
        P = loop.model(plant)

        def answer(w, d, noise, x):
            if d.any():
                raise ValueError(
                    "disturbance is not zero, but loop.P says nothing of disturbances"
                )
            w = w if actuators is None else actuators.follow(w)
            return state_sequence(P.A, w @ P.B.T, x) @ P.C.T + w @ P.D.T, {}

        return answer, P.nstates, P.nstates

    closed, m = with_noise(loop, plant), len(loop.outputs)
    n = closed.nstates - len(loop.KL)
    B, E, K = np.split(closed.B, [m, -m], axis=1)
    D, F, _ = np.split(closed.D, [m, -m], axis=1)

    def asked(w, states):
        return w @ loop.N.T - states[..., n:-m] @ loop.Ks.T - states[..., -m:]  # (18)

    def simulate(w, d, noise, chi):
        others = d @ E.T + noise @ K.T
        states = state_sequence(closed.A, w @ B.T + others, chi)  # (19)
        u, more = asked(w, states), {}
        if actuators is not None:
            if not actuators.can(u):
                w, u = cut_off(w, others, chi)
                states = state_sequence(closed.A, w @ B.T + others, chi)
            more["applied"] = actuators.follow(u)
        more |= {"u": u, "delta": states[:, -m:]}
        return states @ closed.C.T + w @ D.T + d @ F.T, more

    def cut_off(w, others, chi):
        """The w with which the loop asks for what the actuators follow, and what it asked for."""
        done, u, before = w.copy(), np.empty_like(w), None
        for p in range(len(w)):
            u[p] = asked(w[p], chi)
            before = actuators.next(u[p], before)
            done[p] = realised(loop, w[p], u[p], before)
            chi = closed.A @ chi + B @ done[p] + others[p]
        return done, u

    return simulate, n, closed.nstates


def learn(run, v, following, trials) -> np.ndarray:
    """Errors of all trials; run(k, v) makes that of trial k, following(k, v, e) the next v."""
    errors = [run(0, v)]
    for k in tqdm(range(1, trials), "trials", delay=3, disable=None):
        v = following(k - 1, v, errors[-1])
        errors.append(run(k, v))
    return np.array(errors)


def each_trial(name, signal, trials, samples, names):
    """A signal of all trials, or of each, with the trial as the first axis."""
    signal = arguments.in_columns(name, signal, (...,), names)
    shape = (samples, len(names))
    signal = arguments.array(
        name, signal, shape if signal.ndim < 3 else (trials, *shape)
    )
    return np.broadcast_to(signal, (trials, *signal.shape[-2:]))


def _steps(step, trials):
    """The steps from each trial to the next, from one for all or one for each."""
    given = arguments.array("step", step, (...,))
    if given.ndim == 0:
        return np.full(trials - 1, arguments.share("step", step))
    steps = arguments.array("step", given, (trials - 1,))
    return np.array([arguments.share(f"step[{k}]", a) for k, a in enumerate(steps)])


def check_law(loop, Q, L, **periods: float) -> None:
    """Check that a loop, the filters of the law and further sampling periods fit together."""
    check_loop(loop)
    check_Q(Q)
    if L is not None:
        check_learning(L, len(loop.outputs))
        periods["L"] = L.Ts
    arguments.one_period(loop=loop.Ts, Q=Q.Ts, **periods)


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
        own = [units.get(name, "") for name in names]
        coordinates[kind] = (dimension, list(names))
        coordinates[f"{kind}_unit"] = (dimension, own)
        each = ", ".join(
            f"{name}: {unit}" for name, unit in zip(names, own, strict=True)
        )
        # where units differ, "name: unit" for one after the other
        attributes = {"units": own[0] if len(set(own)) == 1 else each}
        for name in members:
            if name in signals:
                variables[name] = (
                    ("trial", "time", dimension),
                    signals[name],
                    attributes,
                )
    return xr.Dataset(variables, coordinates, {"Ts": float(Ts)})


def rms(e: xr.DataArray) -> xr.DataArray:
    """RMS(e_k) of Section IV: root of the mean over time of e'e, summed over the channels.

    `e` is a DataArray with the dimensions time and channel, such as that of a dataset of trials;
    anything else, or a gap in it, raises a ValueError.
    """
    arguments.instance("e", e, xr.DataArray)
    if not {"time", "channel"} <= set(e.dims):
        raise ValueError(
            f"e has dimensions {e.dims}, but must have 'time' and 'channel'"
        )
    arguments.array("e", e.values, (...,))
    return np.sqrt((e**2).sum("channel").mean("time"))
