"""From a shaken loop, another record or a table to P, with the region in which the truth lies.

The notes of :func:`measured_response` state the methods.
"""

import reprlib

import control
import numpy as np
import xarray as xr

from ilctools import arguments
from ilctools.errors import LogError
from ilctools.law.notes import limits_of, loop_of
from ilctools.logs.format import few
from ilctools.measurement.distortion import combined
from ilctools.measurement.estimation import EstimatedResponse, estimated_response
from ilctools.measurement.excitation import excitation_of
from ilctools.measurement.excited import ExcitedResponse, excited_response
from ilctools.measurement.record import check_moved
from ilctools.measurement.tabulated import TabulatedResponse, tabulated
from ilctools.warn import warn

# How far w may be from the excitation, relative to its amplitude: logs hold few digits.
ROUNDING_OF_W = 0.02


def measured_response(
    log, of: str | None = None, uncertainty=None, *, delay=None
) -> ExcitedResponse | EstimatedResponse | TabulatedResponse:
    """Make a measured response, with the region in which the truth lies, of what there is.

    Parameters
    ----------
    log : xarray.Dataset, list of them, or control.FrequencyResponseData
        A record: of :func:`shake`; or any other in which the input moved, as trials under learning,
        from :func:`record`, a reference that moves, or a step test, from :func:`load_log` or
        :func:`read_table`; several of one plant, of any lengths. The known disturbances of a
        record are inputs of its estimate, see Notes. Or a table of a frequency response, which is
        splined between its lines.
    of : {"w", "u"}, optional
        Whether P is from w = reference + v to y, in a closed loop, or from the commands u.
        Default: from w, if all records have a reference. If this or `delay` is given, a record of
        :func:`shake` is estimated like any other, and what is not linear is not in the radius.
    uncertainty : array_like, shape (n,), or float, optional
        Of a table: the radius at its lines, or one number, relative to sigma_max(P). Default: they
        count as exact, noise and all, and nothing says if they scatter: then pass a radius.
    delay : int or array_like, shape (inputs,), optional
        Samples after which y answers to each input at the earliest, if it is known; further delay
        is searched for. Default: 0.

    Returns
    -------
    ExcitedResponse, EstimatedResponse or TabulatedResponse
        For :func:`synthesise`, and checks. Of a record of :func:`shake` it is an estimate, or its
        lines alone, see Notes. An estimate has
        ``check(log)``, against a record that it was not made of, ``model()``, ``frd()`` and
        ``plot()``.

    Raises
    ------
    LogError
        If a record of :func:`shake` lacks an experiment, or w is not the excitation; if an input or
        an output never moved, or moves by less than 1e-30 or more than 1e30 in its unit; of other
        records, if a trial has fewer than 20 samples, an output does not settle, or P is identified
        nowhere: also where a known disturbance moves exactly as inputs do. A record without noise
        is accepted: rounding counts as its noise.

    Warns
    -----
    UserWarning
        Each of the findings: commands of a shaken rig beyond the limits; trials, or the course of
        one, that contradict one linear plant; an output that may not settle; a shaken rig whose P
        is taken at its lines because no linear model describes the record. A rig that is not linear
        widens the radius, and print says so.

    See Also
    --------
    shake : a record made for it
    read_table : one that others made
    synthesise : a filter for all within the radius

    Notes
    -----
    Records are estimated by
    :mod:`ilctools.measurement.arx.regression`: A(z) y = B(z) u + e, of high order and regularised,
    each input with a delay if correlations show one, from any start, with offset and slope in each
    trial, a drift that trials of one length have in common, and, over these, of all logs,
    what repeats at each sample with a variance that the data determine.
    The radius is Bayesian: "99 %" is a probability under a prior, by which coefficients of A and B
    decay and are smooth, and the posterior is normal, with the prior's parameters at the maximum
    of their own posterior and about it. For plants as they come it was checked on records of many
    kinds, by which the radius was scaled; a plant that the prior holds to be unlikely, such as one
    with a weak mode below the noise, may lie outside more often, and so may a slow one at low
    frequencies, most if trials under learning have converged: record the first ones. See
    :mod:`ilctools.measurement.estimation` for the radius.
    A log may have known disturbances: inputs that no loop commands and that were measured, such as
    a third heater or the ambient temperature, by `disturbances` of :func:`read_table`. Each that
    moves within a trial is one more input of the regression, with its own coefficients and its own
    delay, which is searched for. P is the response to the commanded inputs alone, and what the
    known disturbances did is no longer noise. Their units do not matter, nor do their offsets. A
    log of several that lacks a disturbance counts as one in which it rests.

    A record of T seconds resolves frequencies from 2 pi / T on, of which a period fits into it.
    Below, it cannot tell a slow motion from a drift. An estimate has a response and a radius there,
    but :func:`synthesise` chooses cut-off and filter from 2 pi / T on, and then says what the
    filter may do below.

    Before a trial w rests at the reference's first row, and v is zero; trials without reset are
    joined. Where a log names its loop and limits, w is what asks for what was applied; of others,
    leave out trials in which commands were cut off. Of commands in a loop whose reference is in the
    first log, y(t) depends on earlier u only, and else on u(t), too.

    A record of :func:`shake` is estimated in two ways. The regression connects the lines of the
    excitation, and knows transients, delays and resonances. The lines by themselves (the robust
    method, :mod:`ilctools.measurement.excited`) show how much noise there is, and what is not
    linear, without a model. What is not linear is added to the radius of the regression, see
    :mod:`ilctools.measurement.distortion`. P is then the best linear approximation for signals of
    the size of the excitation: smaller ones may see another gain. If the lines by themselves have
    the smaller radius, as where the plant is slow and little noise repeats, P is taken at the lines
    and runs along splines between them. So it is, with a warning, if the regression does not settle
    or contradicts the lines. The attribute ``lines`` has P at the lines, ``noise`` and
    ``distortion`` in each case. The lines by themselves take no known disturbances: what these do
    counts as noise, or as what is not linear.

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from ilctools import measured_response, synthesise, zero_phase_butterworth
    >>> omega = np.geomspace(0.01, np.pi, 40)
    >>> table = control.frd(control.ss(0.5, 0.5, 1, 0, 1.0), omega)  # or what you measured
    >>> P = measured_response(table, uncertainty=np.full(40, 0.02))
    >>> design = synthesise(P, zero_phase_butterworth(2, 0.1, 1.0), omega)
    >>> print(P)
    P from a table of 40 frequencies from 0.01 to 3.142 rad/s, with its radius
    assumed: splines miss P by no more than they miss lines that are left out
    """
    asked = {"of": of, "delay": delay}
    asked = {name: value for name, value in asked.items() if value is not None}
    if isinstance(log, control.FrequencyResponseData):
        for name, value in asked.items():
            raise ValueError(f"{name} = {reprlib.repr(value)} is for a record, not for a table")
        return _warned(tabulated(log, uncertainty))
    logs = log if isinstance(log, list | tuple) and log else [log]
    for one in logs:
        if not isinstance(one, xr.Dataset):
            raise ValueError(
                f"log = {reprlib.repr(one)} must be a Dataset: load_log(path), or of a table "
                "read_table(log, time=..., inputs={...}, outputs={...}); or a response, its "
                "frequency last, as control.frd(log, omega, Ts)"
            )
    if uncertainty is not None:
        raise ValueError(
            "uncertainty must be None where log is a record, from which the radius is estimated"
        )
    excitation = None if asked or logs is log else excitation_of(log)
    if excitation is None:
        measured = estimated_response(logs, **asked)
    elif (loop := loop_of(log)) is None:
        raise LogError("log names no loop in its metadata: it is not of shake; or say `of`")
    else:
        asked, limits = np.asarray(loop.asked(log)), limits_of(log)
        lines = excited_response(*_signals(log, excitation), asked, limits, excitation, loop)
        measured = combined(log, excitation, lines)
    return _warned(measured)


def _warned(measured):
    """A response for whoever called the caller, with a warning for each of its findings."""
    for finding in measured.findings:
        warn(finding)
    return measured


def _signals(log, excitation):
    """w (experiment, time, m) and y of the periods that are evaluated, if all are there."""
    shaken = excitation.signals
    if log.trial.values.tolist() != list(range(1, len(shaken) + 1)):
        raise LogError(
            f"log has the experiments {few(log.trial.values.tolist())} of {len(shaken)}: go on "
            "with shake and the same path"
        )
    w = log.v if "input" in log.coords else log.reference + log.v
    w = arguments.array("log.v", w.values, shaken.shape)
    off = (np.abs(w - shaken) / excitation.amplitude).max()
    if off > ROUNDING_OF_W:
        raise LogError(f"w is not the excitation: it is off by {off:.2g} of its amplitude")
    y = arguments.array("log.y", log.y.values, (*shaken.shape[:2], "output"))
    check_moved([y], log.output.values, "log.y", "is it connected?")
    return w[:, -excitation.evaluated :], y[:, -excitation.evaluated :]
