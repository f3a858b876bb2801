"""Simulate trials of the loop (19) under the ILC law, Section IV of the paper.

Equation numbers are those of the paper. :func:`.learn` has the equations (22) and (23). Let x be
the states of the plant and of the observer, whose estimates are x-hat and delta. Let w be the
inputs of the loop, d the disturbances, and n the noise of the sensors. With the matrices A to F and
K of the loop, a trial obeys

    x(p+1) = A x(p) + B w(p) + E d(p) + K n(p),    y(p) = C x(p) + D w(p) + F d(p) + n(p)    (19)
    u(p) = N w(p) - K_s x-hat(p) - delta(p)                                                  (18)
"""

from functools import partial

import control
import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.law.law import Law
from ilctools.law.limits import CUT_OFF, commands_beyond
from ilctools.law.notes import BETWEEN, NO_RESET, RESET, with_loop
from ilctools.loop.closed import CurrentTrialLoop, Loop, whole_loop
from ilctools.models import state_sequence
from ilctools.progress import PATIENCE, progress
from ilctools.signals import dataset, with_points
from ilctools.trials.diagnosis import diagnose
from ilctools.trials.learn import TRANSFER, asked_of, disturbances_of, joined, learn, next_v
from ilctools.trials.start import Start
from ilctools.warn import warn


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
    pilot: float | None = None,
    between: str = "law",
) -> xr.Dataset:
    """Simulate trials of a loop under a law: w_k = r + v_k, v_{k+1} = Q (v_k + L e_k).

    These are (22) and (23) of the paper, around the loop (19). All trials have the same initial
    state. For a ClosedLoop that names the inputs of r and of v, w_k = F r + G v_k.

    All signals are in the units of the loop's plant. Labelled signals (columns of a DataFrame, or
    a coordinate of a DataArray) are matched by name. Signals of one channel may have the shape
    (time,). If the times of reference and disturbance are floats, they must agree with Ts, in s.

    Parameters
    ----------
    loop : CurrentTrialLoop or ClosedLoop
        A loop with p outputs, m learned inputs and d disturbances. For a ClosedLoop only P is
        simulated, without disturbances.
    law : Law
        If the law has limits, commands saturate, and the observer takes the applied commands.
    reference : array_like, shape (time, p) or (trial, time, p)
        Reference trajectory of all trials, or of each trial. NaN means that no reference is given
        at a sample: the error is set to zero there, and does not count. NaN needs an L of
        :class:`ilctools.NormOptimal`, and the first sample must be a number. If v is added to the
        reference, straight lines connect the points.
    disturbance : array_like, shape (time, d) or (trial, time, d), optional
        Disturbances of the plant, in the order of ``loop.disturbances``. Default: zero.
    trials : int
        Number of trials.
    plant : control.StateSpace or control.TransferFunction, optional
        The plant that is simulated, as in :meth:`CurrentTrialLoop.around`, or another P for a
        ClosedLoop. Default: the plant of the design.
    noise : array_like, shape (trial, time, p), optional
        Noise of the sensors, which the observer and the law see. For a ClosedLoop, only the law
        sees the noise.
    initial_state : array_like, shape (n,), optional
        State of the simulated plant, or of P, at the start of every trial. The observer does not
        know this state. Default: zero.
    v : array_like, shape (time, m), optional
        ILC signal of the first trial. Default: zero, or what `pilot` says.
    reset : bool
        Whether every trial starts from the initial state. If False, trials are successive periods
        of a plant that never comes to rest, see :mod:`ilctools.law.repetitive`. Then L must be a
        LearningFilter, the law's ``rest`` must be zero, and a trial must be longer than Q and L
        look ahead. If commands exceed their limits, they saturate, and v is not projected; learning
        continues from the applied commands.
    pilot : float, optional
        Share of the reference that drives trial 1. The share is taken of the reference minus its
        first sample, and v subtracts the remainder. Default: the whole reference. With limits of
        outputs, the default is the share that P and its radius allow if no disturbance repeats.
    between : {'law', 'transfer'}
        What computes v if the reference differs from the reference of the trial before. "law" uses
        the law. "transfer" uses :func:`ilctools.transfer`, with all trials so far and with the
        loop's P.

    Returns
    -------
    xarray.Dataset
        The signals reference, v, u, y, delta (the estimate of the input disturbance), disturbance,
        and e = reference - y, the error that the controller sees. Their dimensions are trial
        (1, 2, ...), time (s), and channel (1, 2, ...) or source. Their unit is an attribute.
        Channels have the coordinates output, control, output_unit and control_unit. If v is not
        added to references one for one, its last dimension is input. With limits, applied is the
        saturated u. For a ClosedLoop there are no u, applied and delta.

    Warns
    -----
    UserWarning
        If the trials do not converge, see :mod:`ilctools.trials.diagnosis`. If commands exceed the
        limits. If a reference does not start at rest, where trials begin.

    Raises
    ------
    ValueError
        If arguments do not belong together, or if trials without reset are too short.

    See Also
    --------
    record : runs trials on a rig
    replay : compares a log with its law
    rms : computes the size of errors

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
    simulated = _Simulated(loop, plant, law.actuators, initial_state)
    law, r, first, points = asked_of(law, reference, trials, v, reset, pilot, between)
    d = disturbances_of(loop, disturbance, *r.shape[:2])
    if not simulated.ours and d.any():
        raise ValueError(
            "disturbance is not zero, but loop.P has no input for disturbances: "
            "leave disturbance out, or name the inputs of P for it in "
            "`disturbances`"
        )
    noise = np.zeros(r.shape) if noise is None else noise
    noise = arguments.in_columns("noise", noise, r.shape, loop.outputs)

    following = partial(next_v, law, first, reset, between)
    signals = _learned(simulated, following, reset, r, d, noise)
    result = with_points(_dataset(loop, **signals, disturbance=d), points)
    if not reset:
        result.attrs[RESET] = NO_RESET
    if between == TRANSFER:
        result.attrs[BETWEEN] = between
    for text in _warnings(result, law, plant is None, reset and initial_state is None):
        warn(text)
    return result


def _dataset(loop, **signals):
    """Make a dataset of trials from their signals."""
    names = loop.outputs, loop.controls, loop.disturbances
    learned = () if loop.one_for_one else loop.learned
    result = dataset(loop.Ts, *names, loop.units, learned=learned, **signals)
    # only the note of the loop tells which inputs also take a reference
    return with_loop(result, loop) if learned else result


def _learned(simulated, following, reset, *inputs):
    """Simulate trials under learning.

    The `inputs` are the reference, the disturbance and the noise, each of shape
    (trial, time, channel).
    """
    references, flows, white = map(np.concatenate, inputs)
    with progress(total=len(references), desc="samples", delay=PATIENCE) as bar:

        def respond(w, now):
            bar.update(len(w))
            if reset:
                simulated.reset()
            return simulated.part(w, flows[now], white[now])

        signals = joined(learn(simulated.loop, respond, following, references))  # (22), (23)
    trials, samples, _ = inputs[0].shape
    return {name: x.reshape(trials, samples, -1) for name, x in signals.items()}


class _Simulated:
    """A simulation of trials: of the loop (19) around a plant, or of the P of a ClosedLoop."""

    def __init__(self, loop, plant, actuators, initial_state):
        self.loop, self.actuators = loop, actuators
        self.ours, estimated = isinstance(loop, CurrentTrialLoop), 0
        if self.ours:
            model, estimated = whole_loop(loop, plant), len(loop.KL)
        else:  # its commands are w
            P, one = loop.model(plant), np.eye(len(loop.inputs))
            model = control.append(P, one) * np.vstack([one, one])
        self.model, n = model, model.nstates - estimated
        x = np.zeros(n) if initial_state is None else initial_state
        self.initial = np.append(arguments.array("initial_state", x, (n,)), np.zeros(estimated))
        self.reset()

    def reset(self):
        """Return to the initial state, at the beginning of a trial."""
        self.state = self.initial

    def part(self, w, d, noise):
        """Simulate a trial, or a part of a trial, and return its signals."""
        inputs = np.hstack([w, d, noise])[:, : self.model.ninputs]  # P has no other input than w
        x, y, u = self.response(inputs)
        signals = {"u": u}
        if self.actuators is not None:
            if not self.actuators.can(u):
                inputs, signals["u"] = self.within_limits(inputs)
                x, y, u = self.response(inputs)
            signals["applied"] = self.actuators.follow(signals["u"])
        self.state = self.model.A @ x[-1] + self.model.B @ inputs[-1]
        y = y + noise
        return signals | {"y": y, "delta": x[:, -w.shape[1] :]} if self.ours else {"y": y}

    def response(self, inputs):
        """Compute the states, the outputs y and the commands u.

        The outputs of the model are first y and then u.
        """
        model, p = self.model, len(self.loop.outputs)
        x = state_sequence(model.A, inputs @ model.B.T, self.state)  # (19)
        y_and_u = x @ model.C.T + inputs @ model.D.T  # (18)
        return x, y_and_u[:, :p], y_and_u[:, p:]

    def within_limits(self, inputs):
        """Replace w by the w that asks for the applied commands.

        The function returns the inputs with this w, and the requested commands u.
        """
        model, outputs, m = self.model, len(self.loop.outputs), len(self.loop.inputs)
        inputs, u = inputs.copy(), np.empty((len(inputs), len(self.loop.commands)))
        x = self.state
        for p, now in enumerate(inputs):
            u[p] = model.C[outputs:] @ x + model.D[outputs:] @ now
            applied = self.actuators.follow(u[p])
            # in a loop whose controller is not ours, the commands are w
            now[:m] = self.loop.realised(now[:m], u[p], applied) if self.ours else applied
            x = model.A @ x + model.B @ now
        return inputs, u


def _warnings(result, law, exact, from_rest):
    """Yield warnings about the convergence, the limits and the references of trials."""
    yield from diagnose(result, law, exact=exact).values()
    if law.actuators is not None:
        u = np.asarray(law.loop.asked(result))
        if beyond := commands_beyond(u, law.loop.commands, law.known_limits):
            yield beyond + CUT_OFF
    if not result.y.any() and np.any(law.loop.asked(result)):
        yield (
            f"no output moves in the {result.sizes['time']} samples of a trial: is a trial "
            "shorter than the delay of the plant?"
        )
    if law.L is not None and from_rest:
        r = result.reference.values
        rest = Start.of(0 * r[0], r[0], law.loop)
        yield from [*filter(None, map(rest.away, r[1:]))][:1]
