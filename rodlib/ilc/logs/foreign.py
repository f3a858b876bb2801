"""Tables that others wrote: delimited text of any kind, read by the names of its columns."""

import reprlib
import warnings
from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from rodlib.ilc import arguments
from rodlib.ilc.logs import layout, log, sampling, tables
from rodlib.ilc.logs.log import LogError, refuse
from rodlib.ilc.units import check, is_known, seconds

COLUMNS = {  # by argument: as titles of a log begin, and the role of the signals in its metadata
    "reference": ("reference", None), "v": ("v", None), "inputs": ("u", "controls"),
    "outputs": ("y", "outputs"), "disturbances": ("disturbance", "disturbances"),
    "measured": ("measured", "measured"),
}  # fmt: skip


def read_table(
    path,
    *,
    outputs: Mapping[str, str | int],
    inputs: Mapping[str, str | int] | None = None,
    time: str | int | None = None,
    Ts: float | None = None,
    reference: Mapping[str, str | int] | None = None,
    v: Mapping[str, str | int] | None = None,
    disturbances: Mapping[str, str | int] | None = None,
    measured: Mapping[str, str | int] | None = None,
    trial: str | int | None = None,
    units: Mapping[str, str] | None = None,
    resample: bool = False,
) -> xr.Dataset:
    """Read a table that another program wrote, as a log.

    The text is delimited by commas, semicolons, tabs, bars or blanks; numbers have a point or a
    comma; above the rows may stand one line of titles, with units in brackets, below whatever else.
    A column is told by its title, with or without the unit, or by its number from 0 on.

    Parameters
    ----------
    path : path-like or pandas.DataFrame
        Of the file; or what pandas has read of a file that is no text.
    outputs : dict
        The column of each output that is to be controlled, by the name that it gets.
    inputs : dict, optional
        Of the actuator that controls each output, in their order. Default: not known.
    time : str or int, optional
        Column of the clock: numbers in the unit of its title or of `units`, by default s, or dates
        and times as in ISO 8601. Without it, rows are `Ts` apart.
    Ts : float, optional
        Sampling period, s. Default: the mean step of the clock, rounded as far as steps scatter.
    reference : dict, optional
        Column of what each output should follow. Default: not known.
    v : dict, optional
        Of the ILC signal that was added to the reference. Default: none was, zero.
    disturbances, measured : dict, optional
        Of other inputs of the plant, and of what else was measured.
    trial : str or int, optional
        Column of the number of the trial. Default: all rows are one trial.
    units : dict, optional
        By name, or of ``"time"``: units that the titles do not tell.
    resample : bool
        Interpolate what is not on time: outputs linearly, inputs are held. Rows with gaps count as
        lost. More than half of the samples are not made up.

    Returns
    -------
    xarray.Dataset
        As :func:`load_log` gives it, for :func:`save_log`, :func:`measured_response` and replays;
        ``reference``, ``v`` and ``e`` only if there is a reference, and what the clock shows as the
        attribute ``clock``.

    Raises
    ------
    LogError
        With all that is wrong, by row of the file and column.

    Warns
    -----
    UserWarning
        If the table was resampled, or a unit is none that pint knows: it is left out.

    Notes
    -----
    Clocks jitter. Each step may differ from `Ts` by a tenth of it, and the mean of all by a
    hundredth: the samples then count as `Ts` apart, and what happens within a step as if it had
    taken `Ts`. A clock that stands still or runs back is refused.
    """
    given = {"reference": reference, "v": v, "inputs": inputs, "outputs": outputs}
    given |= {"disturbances": disturbances, "measured": measured}
    wanted = _wanted(given) | {"time": ("time", time), "trial": ("trial", trial)}
    wanted = {title: asked for title, asked in wanted.items() if asked[1] is not None}
    for word, column in wanted.values():
        if not isinstance(column, str | int) or isinstance(column, bool):
            raise ValueError(
                f"{word} = {reprlib.repr(column)} must be a title or a number"
            )
    if Ts is not None:
        Ts = arguments.sampling_period("Ts", Ts)
    elif time is None:
        raise ValueError(
            "Ts = None must be a sampling period in seconds where no time is given"
        )
    names = [
        name
        for word, (_, role) in COLUMNS.items()
        if role
        for name in given[word] or ()
    ]
    if len(set(names)) < len(names):
        raise ValueError(
            "outputs, inputs, disturbances and measured must have different names"
        )
    labels = arguments.by_name("units", units, [*names, "time"])
    check("units", labels)
    resample = arguments.flag("resample", resample)
    if isinstance(path, pd.DataFrame):
        source, notes, content = "path", {}, path.to_csv(index=False).encode()
    else:
        source = arguments.path("path", path)
        notes, content = {"origin": f"read from {source.name}"}, log.content_of(source)

    table, labels = _read(source, content, wanted, labels, resample)
    if time is None:
        starts, rows = (
            sampling.starts_of(table.column("trial")),
            np.arange(len(table.lines)),
        )
        passed = Ts * (rows - starts[np.searchsorted(starts, rows, "right") - 1])
        table.add("time", passed)
    for name in outputs if reference and not v else ():
        table.add(f"v_{name}", np.zeros(len(table.lines)))
    if Ts is None and (Ts := sampling.period_of(table)) is None:
        raise LogError(
            f"{source}: time: the clock stands still, or there is one row: state Ts"
        )
    signals = {}
    for word, (start, role) in COLUMNS.items():
        for name in (given[word] or ()) if role else ():
            label = labels[f"{start}_{name}"]
            if not is_known(label):
                unknown = f"unit {label!r} of {name} is not understood: it is left out"
                warnings.warn(f"{source}: {unknown}, state it by units", stacklevel=2)
            signals.setdefault(role, {})[name] = label if is_known(label) else ""
    trials = log.trials_of(source, table, signals, Ts, notes, resample, anywhere=True)
    if "resampled" in trials.attrs:
        warnings.warn(f"{source}: {trials.attrs['resampled']}", stacklevel=2)
    return trials


def _wanted(given):
    """For each title of the log the argument that says which column it is, and that column."""
    wanted = {}
    for word, (start, _) in COLUMNS.items():
        columns = {} if word != "outputs" and given[word] is None else given[word]
        for name, column in arguments.instance(word, columns, dict).items():
            if not (isinstance(name, str) and name.isprintable() and name):
                odd = reprlib.repr(name)
                raise ValueError(f"{word} names {odd}, but must name signals by text")
            wanted[f"{start}_{name}"] = f"{word}[{name!r}]", column
    outputs, inputs = given["outputs"], given["inputs"]
    if not outputs or (inputs is not None and len(inputs) != len(outputs)):
        raise ValueError(
            f"outputs = {reprlib.repr(outputs)} and inputs = {reprlib.repr(inputs)} must be as "
            "many, one or more: name as outputs what the inputs control, one each; what else was "
            "measured in measured, other inputs in disturbances"
        )
    for word in ("reference", "v"):
        if given[word] is not None and {*given[word]} != {*outputs}:
            raise ValueError(
                f"{word} is of {[*given[word]]}, but outputs are {[*outputs]}"
            )
    if given["v"] is not None and given["reference"] is None:
        raise ValueError("v is given, but no reference, to which it was added")
    return wanted


def _read(source, content, wanted, labels, resample):
    """The table with the titles of a log, its time in s, and the unit of each column."""
    try:
        lines = layout.text_of(content).split("\n")
        laid = layout.layout_of(lines)
    except ValueError as error:
        raise LogError(f"{source}: {error}") from None
    places, problems = {}, []
    for title, (word, column) in wanted.items():
        try:
            place = laid.place(column)
            for other, taken in places.items():
                if taken == place:
                    raise ValueError(f"is the column of {wanted[other][0]}, too")
            places[title] = place
        except ValueError as error:
            problems.append(f"{word} = {column!r} {error}")
    refuse(source, problems)
    table = tables.Table(delimiter=laid.delimiter, decimal=laid.decimal, gaps=resample)
    table.header = [laid.name(place) for place in places.values()]
    table.places, table.width = [*places.values()], len(laid.dated)
    body = laid.body(lines, places.get("time"))
    tables.read_rows(table, body.encode(), laid.first + 1)
    problems = table.problems_of(table.header)
    whole = np.isfinite(table.columns).all(axis=0)
    refuse(source, problems if problems or whole.any() else ["the table has no rows"])
    table.header, table.columns = [*places], table.columns[:, whole]
    table.lines = np.array(table.lines)[whole]
    units = {
        title: labels.get(title.partition("_")[2], laid.unit(places[title]))
        for title in places
    }
    if "trial" not in places:
        table.add("trial", np.ones(len(table.lines)))
    elif table.column("trial").min() == 0:
        table.column("trial")[:] += 1
    if "time" in places and not laid.dated[places["time"]]:
        try:
            table.column("time")[:] *= seconds(
                labels.get("time") or units["time"] or "s"
            )
        except ValueError as error:
            raise LogError(f"{source}: time = {wanted['time'][1]!r}: {error}") from None
    return table, units
