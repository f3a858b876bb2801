"""Measure P and the radius of its error: from an excited loop, another record, or a table.

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

# Largest difference between w and the excitation, relative to its amplitude: logs hold few digits.
ROUNDING_OF_W = 0.02


def measured_response(
    log, of: str | None = None, uncertainty=None, *, delay=None
) -> ExcitedResponse | EstimatedResponse | TabulatedResponse:
    """Estimate the frequency response of a plant, and how wrong the estimate may be.

    Parameters
    ----------
    log : xarray.Dataset, list of them, or control.FrequencyResponseData
        A record in which the inputs vary, or a list of records of one plant, of any lengths. A
        record may come from :func:`shake`, from :func:`record` (trials under learning), or from
        :func:`load_log` or :func:`read_table` (a step test, or a reference that varies). A table of
        a frequency response may be passed instead. Splines interpolate between the frequencies of
        the table.
    of : {"w", "u"}, optional
        The input: w = reference + v of a closed loop, or the commands u. Default: w if all records
        have a reference, otherwise u. If `of` or `delay` is passed, a record of :func:`shake` is
        estimated like any other record.
    uncertainty : array_like, shape (n,), or float, optional
        For a table only: the radius of the error at the table's frequencies, or one number relative
        to sigma_max(P). Default: the table counts as exact, although it may contain noise.
    delay : int or array_like, shape (inputs,), optional
        Least delay of each input in samples, before which y does not respond to the input. The
        function searches for larger delays. Default: 0.

    Returns
    -------
    ExcitedResponse, EstimatedResponse or TabulatedResponse
        The response with its radius, for :func:`synthesise`. An estimate has the methods
        ``check(log)``, which compares it with another record, ``model()``, ``frd()`` and
        ``plot()``.

    Raises
    ------
    LogError
        If a record of :func:`shake` lacks an experiment, or its w is not the excitation. If an
        input or an output never changes, or changes by less than 1e-30 or more than 1e30. If a
        trial has fewer than 20 samples, or an output does not settle. If P is identified at no
        frequency.

    Warns
    -----
    UserWarning
        If commands of an excited rig exceed its limits. If different trials, or different parts of
        one trial, contradict one linear plant. If an output may not settle. If no linear model
        describes a record of :func:`shake`, so that P is taken at the lines of the excitation
        alone.

    See Also
    --------
    shake : makes a record for this function
    read_table : reads a record that others made
    synthesise : designs a filter for all plants within the radius

    Notes
    -----
    *Method.* The regression :mod:`ilctools.measurement.arx.regression` estimates a regularised ARX
    model of high order for each output. It allows for any initial condition, an offset and a slope
    in each trial, a drift, and a disturbance that repeats. Delays are searched for. A record
    without noise is accepted; rounding then counts as noise.

    *Radius.* The confidence, such as 99 %, is a probability under a prior. By this prior, the
    coefficients of the model decay and are smooth. The radius was scaled on simulated records of
    many kinds, see docs/estimator.md. A plant that the prior holds to be unlikely may lie outside
    the radius more often. One example is a plant with a weak mode below the noise. P may also lie
    outside the radius more often if all trials of the record have converged. Therefore record the
    first trials.

    *Known disturbances.* A log may contain measured inputs that no loop commands, such as the
    ambient temperature (`disturbances` of :func:`read_table`). Each one is a further input of the
    regression, with its own delay. P is the response to the commanded inputs alone. Units and
    offsets of disturbances do not matter. If one of several logs lacks a disturbance, the
    disturbance counts as constant there.

    *Low frequencies.* A record of T seconds resolves frequencies from 2 pi / T on, in rad/s. Below
    this frequency, the record cannot distinguish a slow motion from a drift. The estimate has a
    response and a radius there, too, but :func:`synthesise` chooses the cut-off and the filter from
    the frequencies above.

    *Trials.* Before a trial, w is taken to rest at the first row of the reference, and v is taken
    as zero. Trials without a reset are joined to one record. If the log names its loop and its
    limits, w is reconstructed from the applied commands. For other logs, leave out trials with
    saturated commands. If the input is u and the first log has a reference, y(t) is assumed to
    depend on earlier commands u only. Otherwise y(t) may also depend on the input at the same time
    t.

    *Excited rigs.* A record of :func:`shake` is estimated in two ways. The first way is the
    regression, which also describes P between the lines (the excited frequencies), and describes
    transients, delays and resonances. The second way uses the lines alone
    (:mod:`ilctools.measurement.excited`). The lines show, without a model, how much noise and how
    much nonlinearity there is. The nonlinearity widens the radius of the regression
    (:mod:`ilctools.measurement.distortion`). P is then the best linear approximation for signals of
    the size of the excitation; for smaller signals, the gain may be different. If the lines have
    the smaller radius, P is taken at the lines alone. This may happen if the plant is slow and
    little of the noise repeats. P is also taken at the lines alone, with a warning, if the
    regression does not settle or contradicts the lines. The attribute ``lines`` of the result is
    the response at the lines, with the attributes ``noise`` and ``distortion``. If P is taken at
    the lines alone, known disturbances count as noise or as nonlinearity.

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from ilctools import measured_response, synthesise, zero_phase_butterworth
    >>> omega = np.geomspace(0.01, np.pi, 40)
    >>> table = control.frd(control.ss(0.5, 0.5, 1, 0, 1.0), omega)  # or what you measured
    >>> P = measured_response(table, uncertainty=np.full(40, 0.02))
    >>> design = synthesise(P, zero_phase_butterworth(2, 0.1, 1.0), omega)
    >>> print(P)  # doctest: +ELLIPSIS
    P from a table of 40 frequencies from 0.01 to 3.142 rad/s, with its radius
    assumed: between the lines, the error of the splines of P is not larger than ...
    """
    if isinstance(log, control.FrequencyResponseData):
        for name, value in {"of": of, "delay": delay}.items():
            if value is not None:
                raise ValueError(
                    f"{name} = {reprlib.repr(value)} is for a record, but log is a "
                    f"table: leave {name} out"
                )
        return _warned(tabulated(log, uncertainty))
    logs = log if isinstance(log, list | tuple) and log else [log]
    for one in logs:
        if not isinstance(one, xr.Dataset):
            raise ValueError(
                f"log = {reprlib.repr(one)} must be a Dataset, or a frequency response. Load a "
                "log by load_log(path); read a table by read_table(log, time=..., "
                f"inputs={{...}}, outputs={{...}}); pass a response as control.frd(log, omega, "
                "Ts), its last axis the frequency"
            )
    if uncertainty is not None:
        raise ValueError(
            "uncertainty must be None if log is a record, because the radius is estimated "
            "from the record"
        )
    excitation = None
    if of is None and delay is None and logs is not log:
        excitation = excitation_of(log)
    if excitation is None:
        measured = estimated_response(logs, of, delay)
    elif (loop := loop_of(log)) is None:
        raise LogError(
            "log names no loop in its metadata, so that it is not a log of shake: "
            "state by `of` which signals are the inputs"
        )
    else:
        asked, limits = np.asarray(loop.asked(log)), limits_of(log)
        lines = excited_response(*_signals(log, excitation), asked, limits, excitation, loop)
        measured = combined(log, excitation, lines)
    return _warned(measured)


def _warned(measured):
    """Warn of each finding of a response, and return the response."""
    for finding in measured.findings:
        warn(finding)
    return measured


def _signals(log, excitation):
    """Return the inputs w and the outputs y of the evaluated periods.

    The signals have the shape (experiment, time, channel). If experiments are missing, the log is
    refused.
    """
    shaken = excitation.signals
    if log.trial.values.tolist() != list(range(1, len(shaken) + 1)):
        raise LogError(
            f"log has the experiments {few(log.trial.values.tolist())} of {len(shaken)}: "
            "continue by calling shake with the same path"
        )
    w = log.v if "input" in log.coords else log.reference + log.v
    w = arguments.array("log.v", w.values, shaken.shape)
    off = (np.abs(w - shaken) / excitation.amplitude).max()
    if off > ROUNDING_OF_W:
        raise LogError(
            "w is not the excitation that the log names: it differs from it by "
            f"{off:.2g} of its amplitude"
        )
    y = arguments.array("log.y", log.y.values, (*shaken.shape[:2], "output"))
    check_moved([y], log.output.values, "log.y", "is its sensor connected?")
    return w[:, -excitation.evaluated :], y[:, -excitation.evaluated :]
