"""Outputs that are not measured: what the observer makes of them, and learning on combinations.

The temperature along a rod is more than a loop measures. Its observer (16) has z-hat = C_z x-hat,
and trials can learn on that: J. Wallén, M. Norrlöf and S. Gunnarsson, A framework for analysis of
observer-based ILC, Asian Journal of Control 13 (2011) 3-14. m inputs reach m combinations of it.
"""

import warnings

import control
import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.loop.closed import ClosedLoop, CurrentTrialLoop
from ilctools.loop.notes import loop_note, loop_of
from ilctools.models import sampled_plant, state_sequence
from ilctools.signals import Signals, check_match

CONDITION = 1e6  # of the response at rest, beyond which errors of the model take over
DEPARTS = 1e-3  # of the largest u, that a recorded delta may be off


def estimated(
    trials: xr.Dataset, loop: CurrentTrialLoop, model: control.StateSpace
) -> xr.DataArray:
    """What the observer (16) of a loop knew of outputs z in trials that were simulated or recorded.

    It puts down what `model` does not explain to the controls. A disturbance that enters elsewhere
    makes z-hat wrong, even where y-hat = y; a simulation with it shows how wrong.

    Parameters
    ----------
    trials : xarray.Dataset
        With reference, v and y, from :func:`ilctools.run_trials`, record or load_log.
    loop : CurrentTrialLoop
        Of the trials; if they note theirs, it must be the same.
    model : control.StateSpace
        The loop's plant, state by state, with the outputs z: `loop` is made of the rows that are
        measured, ``current_trial_loop(model[measured, :], controls)``.

    Returns
    -------
    xarray.DataArray
        z-hat, with the dimensions trial, time and estimate, which has the names of z.

    Warns
    -----
    UserWarning
        If the recorded delta shows that the observer was not at rest when a trial began, or that
        the trials are of another loop.

    See Also
    --------
    combinations : what one can learn on

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from ilctools import Law, current_trial_loop, estimated, run_trials, zero_phase_butterworth
    >>> model = control.ss(
    ...     [[0.9, 0.05], [0.05, 0.9]], [[0.1], [0.0]], np.eye(2), 0, 1.0, outputs=["T", "core"]
    ... )
    >>> loop = current_trial_loop(model[[0], :])
    >>> law = Law(zero_phase_butterworth(2, 0.1, 1.0), None)
    >>> trials = run_trials(loop, law, np.ones((50, 1)), trials=1)
    >>> estimated(trials, loop, model).estimate.values.tolist()
    ['T', 'core']
    """
    arguments.instance("trials", trials, xr.Dataset)
    arguments.instance("loop", loop, CurrentTrialLoop)
    model, n = sampled_plant(model, "model"), loop.plant.nstates
    if not np.array_equal(model.A, loop.plant.A):
        raise ValueError(
            f"model has {model.nstates} states, which are not those of loop.plant: make both of "
            "one, current_trial_loop(model[measured, :], controls)"
        )
    if missing := [name for name in ("reference", "v", "y") if name not in trials]:
        raise ValueError(f"trials have no {missing}: pass what run_trials or record returns")
    check_match(trials=Signals.of_log(trials), loop=loop)
    noted = loop_of(trials)
    if noted is not None and loop_note(noted) != loop_note(loop):
        raise ValueError("loop is not that of trials, which they note: pass law_of(trials).loop")
    trials = trials.transpose("trial", "time", ...)
    size = trials.sizes["trial"], trials.sizes["time"]
    signals = {"w": trials.reference + trials.v, "y": trials.y}
    w, y = (arguments.each_trial(f"trials.{k}", x, *size, loop.outputs) for k, x in signals.items())
    # c is x-hat and delta; (16) with u of (18): c(p+1) = A c(p) + B w(p) + K_L y(p)
    A, B = (loop.closed.A[n:, n:], np.hstack([loop.closed.B[n:, : len(loop.outputs)], loop.KL]))
    forcing = np.concatenate([w, y], axis=2) @ B.T
    c = np.stack([state_sequence(A, each, np.zeros(len(A))) for each in forcing])
    if {"delta", "u"} <= {*trials}:
        off = np.abs(c[..., n:] - trials.delta.values).max(axis=(1, 2))
        late = np.flatnonzero(off > DEPARTS * np.abs(trials.u.values).max())
        if late.size:
            warnings.warn(
                f"in trial {trials.trial.values[late[0]]} the observer was not at rest at first: "
                f"delta is off by up to {off.max():.3g}, and estimates are wrong until it settles; "
                "or the trials are of another loop",
                stacklevel=2,
            )
    coordinates = {"trial": trials.trial, "time": trials.time, "estimate": model.output_labels}
    return xr.DataArray(c[..., :n] @ model.C.T, coordinates, ("trial", "time", "estimate"))


def combinations(P: control.StateSpace, weights=None) -> tuple[np.ndarray, ClosedLoop]:
    """As many combinations T z of outputs as there are inputs, and the loop from w to them.

    T = (G' W G)^-1 G' W with G = P(1), the response at rest: if T (r - z) = 0 there, no w leaves
    less of (r - z)' W (r - z). If r moves, another may: see :class:`ilctools.NormOptimal`. With T r
    and T z, measured or estimated, in the place of r and y, all works that wants p = m.

    Parameters
    ----------
    P : control.StateSpace or control.TransferFunction
        From w, m inputs, to z, p >= m outputs, in discrete time and stable: any loop with more
        sensors than inputs; or ``control.ss(loop.P.A, loop.P.B, model.C, 0, loop.Ts)`` with the
        model of :func:`ilctools.estimated`.
    weights : array_like, shape (p,), optional
        The diagonal of W. Default: all one.

    Returns
    -------
    T : ndarray, shape (m, p)
        The combinations of a signal of shape (time, p) are ``signal @ T.T``.
    loop : ClosedLoop
        Its P is T P, which is I at rest; outputs c1, c2, ...

    See Also
    --------
    estimated : outputs that are not measured
    NormOptimal : where the reference moves

    Examples
    --------
    >>> import control
    >>> from ilctools import combinations
    >>> P = control.ss(0.5, 0.5, [[1.0], [3.0]], 0, 1.0)  # one input, two sensors
    >>> T, loop = combinations(P)
    >>> T, float(loop.P(1.0).real.round(6))
    (array([[0.1, 0.3]]), 1.0)
    """
    P = sampled_plant(P, "P")
    arguments.stable("P", P.poles())
    p, m = P.shape
    if p < m:
        raise ValueError(
            f"P has {p} outputs for {m} inputs, which they do not distinguish: leave inputs out, "
            f"or drive all by {p} patterns"
        )
    weights = np.ones(p) if weights is None else arguments.array("weights", weights, (p,))
    if weights.min() < 0:
        raise ValueError(f"weights reach {weights.min():.6g}, but must be 0 or more")
    G = np.sqrt(weights)[:, None] * P(1.0).real.reshape(p, m)
    if not (condition := np.linalg.cond(G)) < CONDITION:
        raise ValueError(
            f"P at rest, by weights, has a condition of {condition:.3g}: some inputs move the same "
            "outputs, or none. Leave inputs out, or give them units in which they count alike"
        )
    T = np.linalg.pinv(G) * np.sqrt(weights)
    model = control.ss(P.A, P.B, T @ P.C, T @ P.D, P.dt, inputs=P.input_labels)
    return T, ClosedLoop(model, outputs=[f"c{i + 1}" for i in range(m)])
