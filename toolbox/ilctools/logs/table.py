"""Tables that other programs wrote: pandas reads them, and this module names their columns."""

import re
import warnings
from collections.abc import Mapping
from itertools import chain

import pandas as pd
import xarray as xr

from ilctools import arguments
from ilctools.arguments import ROLES
from ilctools.errors import LogError
from ilctools.files import regular
from ilctools.logs.clock import check_start, mean_step, seconds
from ilctools.logs.contents import text_in
from ilctools.logs.format import check_signals, few
from ilctools.logs.reader import OPTIONS, about, numbers_in, trials_of
from ilctools.signals import SIGNALS

SIGNAL_OF = {"outputs": "y", "inputs": "u", "disturbances": "disturbance"}  # by argument
Columns = Mapping[str, str | int]  # titles or numbers of columns, by the names of their signals
WITH_UNIT = re.compile(r"(?s)(.*?)\s*(?:[(\[]([^()\[\]]*)[)\]])?")  # "Heater (%)", "Time [s]"
# the unit at the end of a clock's title, as in "t_ms", with either of the two characters mu
ENDING_IN_UNIT = re.compile(
    r"(?i)(?:\b|_)((?:[nuµ\u03bcm]|milli|micro)?s(?:ec(?:ond)?s?)?|min(?:ute)?|hr?|hour|day)s?\s*$"
)


def read_table(
    path,
    *,
    outputs: Columns,
    inputs: Columns | None = None,
    time: str | int | None = None,
    Ts: float | None = None,
    reference: Columns | None = None,
    v: Columns | None = None,
    disturbances: Columns | None = None,
    measured: Columns | None = None,
    trial: str | int | None = None,
    units: Mapping[str, str] | None = None,
    **options,
) -> xr.Dataset:
    """Read a table that another program wrote, as a log.

    A column is named by its title, with or without the unit in brackets, or by its number from 0
    on. Two signals may share a column.

    Parameters
    ----------
    path : path-like or pandas.DataFrame
        A file that pandas can read, or a table that pandas has read.
    outputs : dict
        The column of each controlled output, by the name that the output gets.
    inputs : dict, optional
        The column of the command to the actuator that controls each output, by the name that the
        command gets. The commands have the order of the outputs. Default: the commands are not
        known.
    time : str or int, optional
        Column of the clock. If `time` is not passed, rows are `Ts` apart. The clock has numbers in
        the unit of its title, such as "t (ms)" or "t_ms", or in the unit that `units` gives; the
        default is s. Instead, the clock may have dates that pandas has parsed, by the options
        ``parse_dates=["t"], date_format="ISO8601"``. A clock that counts from 1970 on in ms, us or
        ns needs its unit.
    Ts : float, optional
        Sampling period, s, which is needed without `time`. Default: the mean step of the clock,
        rounded within the scatter of the steps.
    reference : dict, optional
        Column of the reference of each output. Default: the reference is not known.
    v : dict, optional
        Column of the ILC signal that was added to the reference. Default: zero.
    disturbances, measured : dict, optional
        `disturbances` has the columns of measured inputs that no loop commands. `measured` has the
        columns of further measured signals.
    trial : str or int, optional
        Column of the number of the trial, from 0 or 1 on. Default: all rows are one trial.
    units : dict, optional
        Units by name, and the unit of ``"time"``, instead of the units in the titles. Units are
        labels, except that the clock is converted to s.
    **options
        Options of :func:`pandas.read_csv`, for files that are not comma-separated below one line of
        titles: ``sep=";"``, ``decimal=","``, ``skiprows``, ``encoding="cp1252"``, ...

    Returns
    -------
    xarray.Dataset
        A log as from :func:`load_log`, for :func:`save_log`, :func:`measured_response` and
        :func:`replay`. The log has ``reference``, ``v`` and ``e`` only if there is a reference.

    Raises
    ------
    LogError
        If something is wrong with the table. The error names the column and the row. Row 0 is the
        first row below the titles. If the file is not text in `encoding` (default UTF-8), for
        example a workbook, the error says what to do.

    See Also
    --------
    load_log : reads the format of this package
    measured_response : estimates P from a log

    Notes
    -----
    Clocks jitter. Each step may differ from `Ts` by 10 %, and the mean step by 1 %. The samples
    then count as `Ts` apart, and the attribute ``clock`` says how the clock ran. If rows are lost
    or late, interpolate the table before reading it.

    Examples
    --------
    >>> import pandas as pd
    >>> from ilctools import read_table
    >>> columns = {"t (s)": [0.0, 0.5, 1.0], "heater (%)": [0, 50, 50], "T (K)": [0, 0, 1.2]}
    >>> table = pd.DataFrame(columns)  # or the path of a file
    >>> log = read_table(table, time="t", inputs={"Q": "heater"}, outputs={"T": "T"})
    >>> log.attrs["Ts"], log.y.shape
    (0.5, (1, 3, 1))
    """
    asked = _asked(
        outputs=outputs,
        inputs=inputs,
        reference=reference,
        v=v,
        disturbances=disturbances,
        measured=measured,
    )
    units = arguments.by_name("units", units, [*chain(*asked.values()), "time"])
    if Ts is not None or time is None:
        Ts = arguments.sampling_period("Ts", Ts)
    is_frame = isinstance(path, pd.DataFrame)
    source = path if is_frame else arguments.path("path", path)
    with about("path" if is_frame else source):
        frame, notes = _frame_of(source, options)
        table, signals = _signals(frame, asked, units)
        table["trial"], table["time"] = _clock(frame, trial, time, units.get("time"), Ts)
        Ts = arguments.sampling_period("Ts", Ts or mean_step(table))
        return trials_of(table, signals, Ts, notes)


def _asked(**columns):
    """Return the columns of each argument that was passed, checked."""
    return {
        argument: arguments.by_name(argument, given, given)
        for argument, given in columns.items()
        if given is not None
    }


def _frame_of(source, options):
    """Return the table that pandas reads, or has read, and a note on its origin.

    Rows with more entries than titles are refused, because pandas cuts them off with a warning.
    """
    if isinstance(source, pd.DataFrame):
        return pd.DataFrame(source, **options), {}
    remedy = "pass the encoding of the file to read_table, such as encoding='cp1252' or 'utf-16'"
    try:
        with text_in(options.get("encoding") or "utf-8", remedy), warnings.catch_warnings():
            warnings.filterwarnings("error", "Length of header", pd.errors.ParserWarning)
            frame = pd.read_csv(regular(source), **OPTIONS | options)
    except pd.errors.ParserWarning:
        raise LogError(
            "the rows have more entries than there are titles. If the comma is both the separator "
            "and the decimal mark, export the table with semicolons, and pass sep=';', decimal=','"
        ) from None
    return frame, {"origin": f"read from {source.name}"}


def _signals(frame, asked, units):
    """Return the requested numbers in the columns of a log, and the signals of the log by role."""
    table, signals = pd.DataFrame(index=frame.index), {}
    for argument, columns in asked.items():
        signal = SIGNAL_OF.get(argument, argument)
        names = signals.setdefault(ROLES[SIGNALS[signal]], {})
        for name, title in columns.items():
            column, unit = _column(frame, f"{argument}[{name!r}]", title)
            table[f"{signal}_{name}"] = numbers_in(column)
            known = names.setdefault(name, units.get(name, unit))
            if known and unit and known != unit and name not in units:
                raise LogError(
                    f"{argument}[{name!r}] is in {unit}, but {name} is in {known}: "
                    "state the units by `units`"
                )
    if "reference" in asked and "v" not in asked:
        table[[f"v_{name}" for name in signals["outputs"]]] = 0.0
    check_signals(signals)
    return table, signals


def _column(frame, argument, column):
    """Find a column by its number or title.

    The function returns the column and the unit in its title.
    """
    titles = [*map(str, frame.columns)]
    parts = [WITH_UNIT.fullmatch(title).groups("") for title in titles]
    for written in (range(len(titles)), titles, [name for name, _ in parts]):
        if written.count(column) == 1:
            place = written.index(column)
            return frame.iloc[:, place], parts[place][1]
    raise LogError(
        f"{argument} = {column!r} must be the title of one column, or a number from 0 to "
        f"{len(titles) - 1}. The titles are {few(titles)}: if they are wrong, give sep or "
        "skiprows"
    )


def _clock(frame, trial, time, unit, Ts):
    """Return, for each row, the trial number and the time since the trial began.

    The trial numbers begin with 1. The times are in s.
    """
    number = pd.Series(1.0, frame.index)
    if trial is not None:
        number = numbers_in(_column(frame, "trial", trial)[0])
        number += number.min() == 0
    if time is None:
        return number, Ts * number.groupby(number).cumcount()
    column, titled = _column(frame, "time", time)
    ending = ENDING_IN_UNIT.search(str(column.name))
    unit = unit or titled or (ending[1].lower() if ending else "s")
    if column.dtype.kind == "M":  # dates
        column, unit = (column - column.iloc[0]).dt.total_seconds(), "s"
    moment = seconds(unit) * numbers_in(column)
    if len(moment):
        check_start(moment.iloc[0], seconds(unit))
    return number, moment - moment.groupby(number).transform("first")
