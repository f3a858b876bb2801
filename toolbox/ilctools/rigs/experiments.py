"""Run an experiment on a rig, trial by trial: learn by the ILC law, or excite the loop."""

from functools import partial

import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.filters import Filter
from ilctools.law.law import Law
from ilctools.law.notes import BEGUN, BETWEEN, NO_RESET, RESET, with_law
from ilctools.loop.closed import Loop, check_loop
from ilctools.measurement.excitation import Excitation, with_excitation
from ilctools.norm_optimal import NormOptimal
from ilctools.rigs.description import RigDescription, described
from ilctools.rigs.protocol import Rig
from ilctools.rigs.trial_by_trial import Experiment
from ilctools.signals import check_match
from ilctools.trials.learn import TRANSFER, asked_of, next_v


def record(
    rig: Rig,
    loop: Loop,
    law: Law,
    reference,
    disturbance=None,
    trials: int = 10,
    *,
    path=None,
    v=None,
    pause: int | None = None,
    reset: bool = True,
    decimals: dict[str, int] | None = None,
    stop: dict[str, tuple[float, float] | None] | None = None,
    pilot: float | None = None,
    between: str = "law",
) -> xr.Dataset:
    """Run an experiment of several trials on a rig and record it.

    Between two trials the controller keeps running and holds the start of the reference, as in the
    paper, until the rig is back where the first trial started. On a terminal, progress is shown.
    However the experiment ends, ``rig.safe()`` leaves the rig in a safe state, see Notes.

    Parameters
    ----------
    rig : Rig
    loop : CurrentTrialLoop or ClosedLoop
        The record takes its names and units.
    law : Law
        The rig's limits hold for commands that the law does not limit. With ``limits={}`` the law
        has no limits at all, and a warning follows if the rig saturates. Commands saturate at the
        limits of the law, and the observer takes the applied commands. With `path`, L must be a
        LearningFilter, the B K of a design, or a NormOptimal.
    reference, trials :
        As for :func:`ilctools.run_trials`.
    disturbance : array_like, shape (time, d) or (trial, time, d), optional
        Values for those of ``loop.disturbances`` that the rig can command. If the rig measures a
        disturbance, the measured values are recorded. The values of all other disturbances must be
        zero. Default: zero.
    path : path-like, optional
        A log file, to which each trial is added when it ends. A fault then costs at most one trial,
        or two trials if `reset` is False. If the file exists, the experiment goes on with its next
        trial, see Notes. Without `path`, a fault costs all trials.
    v : array_like, shape (time, m), optional
        ILC signal of the first trial. Default: zero. If the L of the law is None, this is the
        signal of all trials.
    pause : int, optional
        Number of samples between two trials. By default, the pause ends when the outputs stand
        still where the first trial started, but lasts at most two lengths of a trial. A rig that
        has `begin` makes no pause.
    reset : bool
        Whether each trial starts where the first trial started. If False, a trial starts where the
        last one ended, as for :func:`ilctools.run_trials`. There is then no pause, and v is
        computed while a trial runs.
    decimals : dict, optional
        Number of digits after the point of v, u, delta and measured disturbances. v and u are
        rounded before they act. With too few digits, v may be rounded to zero. Default: all digits.
    stop : dict, optional
        Lowest and highest value of outputs and commands, by name, beyond which the experiment
        stops. None stands for no limit. Default: outputs may exceed all references by five times
        the largest reference in the same unit; commands may span a hundred times the rig's limits.
    pilot, between :
        As for :func:`ilctools.run_trials`.

    Returns
    -------
    xarray.Dataset
        As from :func:`ilctools.run_trials`, with the disturbances that are commanded or measured.
        With limits, `u` is the command that the controller asked for, and `applied` is the command
        that was sent to the rig. For a ClosedLoop there is neither `u` nor `applied`.

    Raises
    ------
    ValueError
        If arguments do not belong together. The error comes before any command is applied.
    RigError
        If a reading is not finite or has the wrong shape. The text begins with the trial and the
        sample. Like any error of a driver or a disk, this error has the earlier trials in its
        attribute ``trials``, and the trial and the sample in a note.
    StoppedError
        If a signal is beyond a limit of `stop`. The text says how to go on. The class is a subclass
        of RigError.

    Warns
    -----
    UserWarning
        After a trial in which samples were late (if the rig has a clock), in which commands
        exceeded the rig's limits, or whose outputs began elsewhere than in the first trial. A
        further warning is given once, if the trials do not converge, if an output does not change,
        or if the plant is not the P of the loop or of the law, see
        :mod:`ilctools.trials.diagnosis`.

    See Also
    --------
    run_trials : simulates trials
    shake : excites a rig, to measure P
    load_log : loads the log at `path`

    Notes
    -----
    *Safety.* ``rig.safe()`` is called after an error, Ctrl-C, ``kill``, the stop of a service, and
    when a terminal is closed. Such a signal raises an exception at once while a method of the
    driver runs. The driver must not handle SIGTERM or SIGHUP by itself. Even if the driver swallows
    the exception, no further command is sent. While ``safe()`` runs, signals wait until its
    ``safe_time`` is over, 10 s by default. The next signal then ends ``safe()``, and a message says
    that the rig may not be safe. If the experiment runs in a thread that is not the main thread,
    the rig is left safe when the process ends by Ctrl-C or by its last line. In this case, ``kill``
    ends the process at once. A forked child leaves the rig to its parent.

    No program can act after ``kill -9``, SIGQUIT, a crash of Python or of the machine, or a power
    cut. The rig then stays at the last command. After Ctrl-Z, the rig stays there until ``fg``. For
    these cases, let a watchdog on the rig switch off if no command has come for some samples.

    *Logs.* The trials of an existing log must be of the same experiment. A last trial that is
    incomplete, or shorter than the first trial, is dropped with a warning. No check can find out
    whether the plant and a commanded disturbance are still the same. Such a change shows only in
    the trials that follow. If the log already has `trials` trials or more, no trial is run, and all
    trials of the log are returned. The folder may then be read-only. While an experiment runs, no
    other process can record to its log, and no other program must write to it. A link is followed.
    A relative path counts from the working directory at the call. Without reset, an experiment that
    is continued in its log begins a new run, with the v that was learned. The log does not say
    where the new run begins, and `replay` and `measured_response` treat the log as one run. In this
    case, use another path.

    Examples
    --------
    >>> import numpy as np
    >>> from ilctools import ClosedLoop, Law, LearningFilter, record, zero_phase_butterworth
    >>> class Axis:  # simulated; yours talks to the drive
    ...     x = 0.0
    ...     def begin(self, trial):
    ...         self.x = 0.0
    ...     def read(self):
    ...         return [self.x]
    ...     def apply(self, w):
    ...         self.x += 0.2 * (w[0] - self.x)
    ...
    >>> loop = ClosedLoop(Ts=0.01, outputs=["x"], units={"x": "mm"})
    >>> Q = zero_phase_butterworth(2, 60.0, loop.Ts)
    >>> law = Law(Q, LearningFilter([[[0.9]]], loop.Ts))
    >>> run = record(Axis(), loop, law, np.sin(np.arange(200) * np.pi / 200) ** 2, trials=4)
    >>> bool(abs(run.e[-1]).max() < 0.1 * abs(run.e[0]).max())
    True
    """
    law = arguments.instance("law", law, Law).bound_to(loop)
    if path is not None and law.L is not None:
        arguments.instance("L", law.L, Filter | NormOptimal)  # the log cannot note another L
    law, reference, first, points = asked_of(law, reference, trials, v, reset, pilot, between)
    about = described(rig, loop, reference, law, stop, decimals, goes_on=not reset)
    law, pause = about.law, _checked_pause(pause, about)
    check_match(law=law, rig=about)
    flows = about.flows_of(disturbance)

    following = partial(next_v, law, first, reset, between)
    notes = with_law(xr.Dataset(), law).attrs
    if v is not None or first.any():
        notes[BEGUN] = "v of trial 1 was given, or lets a share of the reference through"
    if between == TRANSFER:
        notes[BETWEEN] = between
    if not reset:
        notes[RESET] = NO_RESET
    return Experiment(about, reference, flows, following, notes, pause, points).finish(path)


def _checked_pause(pause: int | None, about: RigDescription) -> int | None:
    """Check the length of a pause in samples; None stands for "until the outputs are back"."""
    if about.goes_on and pause is not None:
        raise ValueError(
            f"reset = False, but pause = {pause}: without reset there is no pause "
            "between trials, so leave pause out"
        )
    if pause is None:
        return 0 if about.begin else None
    return arguments.whole("pause", pause, 0)


def shake(
    rig: Rig,
    loop: Loop,
    excitation: Excitation,
    *,
    path=None,
    decimals: dict[str, int] | None = None,
    stop: dict[str, tuple[float, float] | None] | None = None,
) -> xr.Dataset:
    """Excite a loop on a rig by w = v, and record the trials from which P can be estimated.

    Each experiment of the excitation is a trial. The reference is zero, and there is no pause
    between trials. In all other respects, such as errors and warnings, :func:`shake` works like
    :func:`record`.

    Parameters
    ----------
    rig : Rig
        The rig, see :class:`Rig`.
    loop : CurrentTrialLoop or ClosedLoop
        The loop of the running controller. Its names and units become the names and units of the
        record.
    excitation : Excitation
        The excitation, from :func:`multisine`.
    path, decimals, stop
        As in :func:`record`.

    Returns
    -------
    xarray.Dataset
        The trials, as from :func:`record`, for :func:`measured_response`. The metadata contain the
        excitation and the limits of the rig.

    See Also
    --------
    multisine : designs the excitation
    measured_response : estimates P from the record

    Examples
    --------
    >>> import numpy as np
    >>> from ilctools import ClosedLoop, measured_response, multisine, shake
    >>> class Axis:  # simulated; yours talks to the drive
    ...     x, noise = 0.0, np.random.default_rng(0)
    ...     def begin(self, trial):
    ...         self.x = 0.0
    ...     def read(self):
    ...         return [self.x + self.noise.normal(0, 0.001)]
    ...     def apply(self, w):
    ...         self.x += 0.2 * (w[0] - self.x)
    ...
    >>> loop = ClosedLoop(Ts=0.01, outputs=["x"], units={"x": "mm"})
    >>> shaking = multisine(loop, lowest=1.0, highest=100.0, amplitude=1.0, hours=0.02)
    >>> P = measured_response(shake(Axis(), loop, shaking))
    >>> P.response.shape[0] == len(P.omega)
    True
    """
    check_loop(loop)
    shaken = arguments.instance("excitation", excitation, Excitation).signals
    reference = np.zeros((*shaken.shape[:2], len(loop.outputs)))
    # If inputs are no references, they do not show how far outputs may change.
    about = described(rig, loop, shaken if loop.one_for_one else reference, None, stop, decimals)
    check_match(loop=loop, rig=about, excitation=excitation)
    flows = about.flows_of(None)
    notes = with_excitation(xr.Dataset(), excitation, loop, about.limits).attrs

    def following(trials, upcoming):
        return shaken[len(trials)]  # independent of the trials before

    return Experiment(about, reference, flows, following, notes, pause=0).finish(path)
