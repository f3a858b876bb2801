"""Running an experiment on a rig, trial by trial: learning by the ILC law, or shaking the loop."""

import numpy as np
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.filters import LearningFilter, LearningOperator, ZeroPhaseButterworth
from rodlib.ilc.law.limits import commands_of, projected
from rodlib.ilc.logs.notes import BEGUN, with_excitation, with_law
from rodlib.ilc.loop.closed import Loop
from rodlib.ilc.measurement.excitation import Excitation
from rodlib.ilc.rigs.controlled import ControlledRig
from rodlib.ilc.rigs.protocol import Rig, TrialRig
from rodlib.ilc.rigs.recording import Experiment
from rodlib.ilc.trials.run import check_law, each_trial


def record(
    rig: Rig | TrialRig,
    loop: Loop,
    Q: ZeroPhaseButterworth,
    L: LearningOperator | None,
    reference,
    disturbance=None,
    trials: int = 10,
    pause: int | None = None,
    *,
    path=None,
    rest: int = 0,
    step: float = 1.0,
    decimals: dict[str, int] | None = None,
    stop: dict[str, tuple[float, float] | None] | None = None,
    v=None,
    limits: dict[str, tuple[float, ...]] | str | None = "rig",
    another_law: bool = False,
) -> xr.Dataset:
    """Run an experiment of several trials on a rig and record it.

    Between two trials the controller keeps running and holds the start of the reference, as in the
    paper, until the rig is back where the first trial started. However this ends, the rig is left
    in a safe state. On a terminal, progress is shown.

    Parameters
    ----------
    rig : Rig or TrialRig
    loop : CurrentTrialLoop or ClosedLoop
        Its names and units are those of the record.
    Q, L : ZeroPhaseButterworth, LearningOperator
        L None switches learning off. A log can name no other L than a LearningFilter.
    reference, trials, rest :
        As for :func:`rodlib.run_trials`.
    disturbance : array_like, shape (time, d) or (trial, time, d), optional
        What to command to those of ``loop.disturbances`` that are inputs of the rig. What it
        measures of them is recorded instead of the values given here; of others nothing is known,
        and they must be zero. Further trials than those recorded are ignored. Default zero.
    pause : int, optional
        Samples between two trials. Default: until the outputs are back and still, two trials at
        most; for a rig that has `begin`, none.
    path : path-like, optional
        Of a log, which is written anew when a trial ends, so that a fault costs one trial at most;
        without it, all. If the log is there, its trials must be of the same experiment, and the
        next one follows; a last trial that is shorter than the first is dropped. If it has `trials`
        or more, none is run, and all of them are returned. Meanwhile no other process can record
        to it.
    step : float
        Of :func:`rodlib.update`, in (0, 1], the same after every trial.
    decimals : dict, optional
        Of v, u (rounded before they act), delta and measured disturbances. Default: all digits.
    stop : dict, optional
        Lowest and highest of outputs and commands, by name, beyond which the experiment stops; None
        stands for no limit. Default: outputs may be beyond all references by five times the largest
        in the same unit, if it is not zero; commands may span a hundred times the rig's limits.
    v : array_like, shape (time, m), optional
        ILC signal of the first trial. Default zero. With L None, that of all trials.
    limits : dict, optional
        Of the commands, as for :func:`rodlib.update_within`: they are cut off there, the observer
        is told, and v is learned within. Default: those of the rig. None leaves them out: then the
        rig cuts off what it must, which is warned of, and the law (23) does not know.
    another_law : bool
        Whether a log that is there may be gone on with by another Q, L, rest, step or limits. The
        earlier ones, and for how many trials they held, stay in its metadata.

    Returns
    -------
    xarray.Dataset
        As from :func:`rodlib.run_trials`, with the disturbances that are commanded or measured;
        with limits, `u` is what was asked for, and `applied` what was sent to the rig.

    Raises
    ------
    ValueError
        If something does not belong together; before anything is applied.
    RigError
        If a reading is not finite or has the wrong shape: the trial ends, those before it stay.
    StoppedError
        If something is beyond a limit of `stop`, which it says how to go on from. It is a RigError,
        and has the trials before in its attribute ``trials``.

    Warns
    -----
    UserWarning
        After a trial in which samples were not on time, if the rig has a clock, or commands beyond
        what it follows, if it has limits, once if v is learned within them; that started elsewhere
        than the first; once, if the trials show that they do not converge, see
        :mod:`rodlib.ilc.trials.diagnosis`.
    """
    controlled = ControlledRig(rig, loop, decimals, limits)
    check_law(loop, Q, L, rig=controlled.Ts)
    if path is not None and L is not None:
        arguments.instance(
            "L", L, LearningFilter
        )  # or the log could not say what made it
    trials = arguments.whole("trials", trials, 1)
    pause = None if pause is None else arguments.whole("pause", pause, 0)
    if pause and controlled.whole:
        raise ValueError(
            f"pause = {pause}, but rig.run begins where every trial begins: leave it"
        )
    pause = (
        0 if pause is None and (controlled.whole or hasattr(rig, "begin")) else pause
    )
    another_law = arguments.flag("another_law", another_law)
    reference = each_trial("reference", reference, trials, "time", loop.outputs)
    samples = reference.shape[1]
    rest = arguments.whole("rest", rest, 0, samples - 1)
    first = np.zeros(reference.shape[1:]) if v is None else v
    first = arguments.in_columns("v", first, reference.shape[1:], loop.outputs)
    first[samples - rest :] = 0
    step = arguments.share("step", step)
    commanded = controlled.commanded(disturbance, trials, samples)

    def following(signals):
        done = len(signals["y"])
        if L is None or not done:
            return signals["v"][-1] if done else first
        r, v, y = reference[done - 1], signals["v"][-1], signals["y"][-1]
        told = (signals[name][-1] for name in ("u", "applied") if name in signals)
        commands = commands_of(loop, controlled.actuators, r + v, *told)
        return projected(
            v, r - y, commands, Q, L, loop, controlled.actuators, rest, step
        )

    notes = with_law(xr.Dataset(), Q, L, rest, loop, step, controlled.kept).attrs
    notes |= {} if v is None else {BEGUN: "v of trial 1 was given"}
    controlled.stop_at(stop, reference)
    made = (
        controlled,
        reference,
        commanded,
        following,
        notes,
        None if L is None else (Q, L),
    )
    return Experiment(*made, another_law=another_law).run(pause, path)


def shake(
    rig: Rig | TrialRig,
    loop: Loop,
    excitation: Excitation,
    *,
    path=None,
    decimals: dict[str, int] | None = None,
    stop: dict[str, tuple[float, float] | None] | None = None,
) -> xr.Dataset:
    """Shake the loop on a rig, w = v, and record it: the trials from which P can be estimated.

    Each experiment of the excitation is a trial; the reference is zero, there is no pause. All else
    is as in :func:`record`, also what is refused and warned of.

    Parameters
    ----------
    rig : Rig
    loop : CurrentTrialLoop or ClosedLoop
        Of the controller that runs, whose names and units are those of the record.
    excitation : Excitation
        From :func:`multisine`.
    path, decimals, stop
        As in :func:`record`.

    Returns
    -------
    xarray.Dataset
        As from :func:`record`, with the excitation and the limits of the rig noted in the metadata.
        For :func:`measured_response`.
    """
    controlled = ControlledRig(rig, loop, decimals)
    arguments.instance("excitation", excitation, Excitation)
    arguments.one_period(loop=loop.Ts, rig=controlled.Ts, excitation=excitation.Ts)
    shaken = excitation.signals
    m = len(loop.outputs)
    if excitation.channels != m:
        raise ValueError(
            f"excitation is for {excitation.channels} channels, but the loop has {m}"
        )
    commanded = controlled.commanded(None, *shaken.shape[:2])
    followed = {
        n: controlled.limits[n] for n in loop.controls if n in controlled.limits
    }

    notes = with_excitation(xr.Dataset(), excitation, loop, followed).attrs

    def following(signals):
        return shaken[len(signals["y"])]

    controlled.stop_at(stop, shaken)
    reference = np.zeros(shaken.shape)
    made = controlled, reference, commanded, following, notes
    return Experiment(*made, alike=False).run(0, path)
