"""The picture of a design, or of trials.

The picture of a design is drawn anew at each turn of a knob. To find a layout would take as long as
the design, so it is fixed, and limits are round numbers.
"""

import reprlib
import textwrap
from io import BytesIO
from itertools import cycle, product

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rodlib.ilc import Synthesis, arguments
from rodlib.ilc.logs.log import signals_of
from rodlib.ilc.report import by_unit, rms_by_trial, with_unit
from rodlib.ilc.workbench.outcome import Outcome

SIZE = (7.6, 5.2)  # inches, of a design
WIDTH, HEIGHT = 7.2, 2.3  # inches, of one axes of trials
STYLE = {
    "axes.grid": True,
    "axes.titlelocation": "left",
    "axes.titlesize": 9,
    "axes.titley": 1.0,  # fixed: to look for what may be in its way takes long
    "font.size": 9,
    "grid.color": "0.9",
    "legend.frameon": False,
    "lines.linewidth": 1.3,
}
DESIGN = {"color": "black"}
BEFORE = {"color": "0.75", "linewidth": 2.4}
BOUND = {"color": "tab:red", "linewidth": 1, "linestyle": "--"}
SHADES = ("black", "tab:red", "tab:blue", "tab:green", "tab:orange")
ENTRIES = [  # of a filter
    {"color": shade, "linestyle": style} for style, shade in product(("-", ":"), SHADES)
]
ROUND = np.array([1, 1.5, 2, 3, 5, 7, 10])


def plot(
    item: Synthesis | Outcome | xr.Dataset, before: Synthesis | Outcome | None = None
):
    """Draw a design, or trials, as one would first look at them.

    Parameters
    ----------
    item : Synthesis, Outcome or xarray.Dataset
        From :func:`rodlib.synthesise` or :func:`rodlib.try_out`: sigma_max(M) and sigma_max(L) over
        frequency, with their bounds and the mean in the band; the coefficients; and RMS(e_k) of an
        outcome's trials. From :func:`rodlib.run_trials`, :func:`rodlib.record` or
        :func:`rodlib.load_log`: RMS(e_k) by trial and the signals of the last trial, outputs with
        their reference; signals with different units stand in different axes.
    before : Synthesis or Outcome, optional
        A design to compare with, in gray.

    Returns
    -------
    matplotlib.figure.Figure
        To change, or to keep by its ``savefig``.
    """
    import matplotlib.pyplot as plt  # here, because it takes long to import

    kinds = Synthesis | Outcome | xr.Dataset
    if not isinstance(item, kinds):
        raise ValueError(
            f"item = {reprlib.repr(item)} must be a Synthesis, an Outcome or a Dataset "
            "of trials"
        )
    if before is not None and not isinstance(before, Synthesis | Outcome):
        raise ValueError(
            f"before = {reprlib.repr(before)} must be a Synthesis or an Outcome"
        )
    with mpl.rc_context(STYLE):
        if isinstance(item, xr.Dataset):
            figure = _of_trials(plt, item)
        else:
            figure = plt.figure(figsize=SIZE, dpi=100, layout="none")
            Picture(figure).show(_outcome(item), before and _outcome(before))
    if "inline" in mpl.get_backend():
        plt.close(figure)  # or a notebook would show it twice
    return figure


def _outcome(item):
    return item if isinstance(item, Outcome) else Outcome(None, item)


class Picture:
    """Four axes in a figure, whose lines are replaced from outcome to outcome."""

    @mpl.rc_context(STYLE)
    def __init__(self, figure: Figure | None = None):
        if figure is None:  # without a window
            figure = Figure(SIZE, dpi=100, layout="none")
            FigureCanvasAgg(figure)
        self.figure, self.axes = figure, figure.subplots(2, 2)
        (rate, trials), (gain, lags) = self.axes
        figure.subplots_adjust(0.07, 0.09, 0.985, 0.89, wspace=0.2, hspace=0.45)
        rate.set(
            title=r"rate $\bar\sigma(M)$: what a trial leaves of the error",
            ylim=(0, 1.05),
        )
        gain.set(title=r"gain $\bar\sigma(L)$ of the learning filter")
        for axes in (rate, gain):
            axes.set(xscale="log", xlabel="frequency (rad/s)")
        trials.set(
            xlabel="trial", xticks=np.arange(1, 11), xlim=(0.7, 10.3), yscale="log"
        )
        lags.set(title="coefficients of $L$", xlabel="samples ahead")
        lags.xaxis.get_major_locator().set_params(integer=True)
        self.key = figure.text(0.07, 0.96, "")
        self.message = figure.text(
            0.5,
            0.5,
            "",
            ha="center",
            va="center",
            fontsize=12,
            linespacing=1.5,
            parse_math=False,  # it may name a file
        )

    @mpl.rc_context(STYLE)
    def show(self, outcome: Outcome, before: Outcome | None = None) -> "Picture":
        """Draw an outcome, and in gray a design before; or the message, if there is no design.

        The one before is left out if it has other channels or another sampling period.
        """
        arguments.instance("outcome", outcome, Outcome)
        for axes in self.axes.flat:
            axes.set_visible(outcome.design is not None)
            for line in [*axes.lines]:
                line.remove()
        self.key.set_text("")
        self.message.set_text("")
        if outcome.design is None:
            self.message.set_text(textwrap.fill(outcome.message, 80))
            return self
        outcomes = [outcome]
        key = (
            "black: this filter    red: its bounds    dotted: its mean rate in the band"
        )
        if before is not None and _comparable(before, outcome):
            outcomes.append(before)
            self._draw(before, BEFORE)
            key += "    gray: the filter before"
        self._draw(outcome, DESIGN)
        self._draw_bounds(outcome.design.problem)
        self._set_limits(outcomes)
        self._set_labels(outcome)
        self.key.set_text(key)
        return self

    def _draw(self, outcome, look):
        """The lines of an outcome; the entries of a filter have a look each, unless in gray."""
        (rate, trials), (gain, lags) = self.axes
        design = outcome.design
        rate.plot(design.omega, design.sigma_M, **look)
        gain.plot(design.omega, design.sigma_L, **look)
        if design.problem.objective == "sum":
            mean = [design.certificate.mean_M] * 2
            rate.plot(design.problem.band, mean, **look | {"linestyle": ":"})
        numbers = np.arange(1, len(outcome.rms) + 1)
        trials.plot(numbers, outcome.rms, "o-", markersize=4, **look)
        ahead = np.arange(1, design.filter.order + 1)
        looks = cycle(ENTRIES if look is DESIGN else [look])
        for (name, values), look in zip(entries(design).items(), looks, strict=False):
            lags.plot(ahead, values, marker=".", label=name, **look)

    def _draw_bounds(self, problem):
        (rate, _), (gain, _) = self.axes
        if problem.objective == "sum":
            rate.axhline(problem.M_max, **BOUND)
        if problem.L_max is not None:
            gain.axhline(problem.L_max, **BOUND)

    def _set_limits(self, outcomes):
        """Limits that hold the lines of all outcomes."""
        (rate, trials), (gain, lags) = self.axes
        designs = [outcome.design for outcome in outcomes]
        for axes in (rate, gain):
            axes.set_xlim(designs[0].omega[[0, -1]])
        gains = [line.get_ydata() for line in gain.lines]
        gain.set_ylim(0, _round_up(np.max(np.concatenate(gains))))
        values = np.concatenate([outcome.rms or [1.0] for outcome in outcomes])
        low, high = np.log10(np.maximum([values.min(), values.max()], 1e-15))
        trials.set_ylim(10 ** np.floor(low), 10 ** (np.floor(high) + 1))
        coefficients = np.concatenate([d.filter.coefficients.ravel() for d in designs])
        lags.set_ylim(-_round_up(-coefficients.min()), _round_up(coefficients.max()))
        # Not halves: with ten coefficients a marker would fall between two pixels, and rounding
        # would decide into which of them.
        lags.set_xlim(0.4, max(design.filter.order for design in designs) + 0.6)

    def _set_labels(self, outcome):
        """The legend of the coefficients, and what the trials are."""
        (_, trials), (_, lags) = self.axes
        title = "not simulated"
        if outcome.rms:
            unit = outcome.settings.plant.unit
            title = f"{with_unit('RMS of the error', unit)}, simulated"
        trials.set_title(title, parse_math=False)
        count = len(entries(outcome.design))
        lags.legend(
            handles=lags.lines[-count:],
            loc="lower right",
            bbox_to_anchor=(1.02, 0.97),
            ncols=5,
            fontsize=8,
            borderpad=0.2,
            handlelength=0.9,
            markerscale=0,
            handletextpad=0.4,
            columnspacing=0.8,
            labelspacing=0.2,
        )

    @mpl.rc_context(STYLE)
    def png(self) -> bytes:
        """The picture as a PNG file; the same bytes for the same outcomes."""
        buffer = BytesIO()
        self.figure.canvas.print_png(buffer, pil_kwargs={"compress_level": 1})
        return buffer.getvalue()


def entries(design: Synthesis) -> dict[str, np.ndarray]:
    """Coefficients by entry of the filter: its diagonal, then the others if it is full."""
    coefficients = design.filter.coefficients
    m = len(coefficients)
    places = [(i, i) for i in range(m)]
    if design.problem.structure == "full":
        places += [(i, j) for i in range(m) for j in range(m) if i != j]
    return {f"$L_{{{i + 1}{j + 1}}}$": coefficients[i, j] for i, j in places}


def _comparable(before, outcome):
    """Whether two designs can stand in the same axes."""
    if before.design is None:
        return False
    filters = before.design.filter, outcome.design.filter
    channels = {len(L.coefficients) for L in filters}
    return len(channels) == 1 and len({L.Ts for L in filters}) == 1


def _round_up(value):
    """The next round number that leaves some room above; 0 if the value is not positive."""
    if value <= 0:
        return 0.0
    decade = 10 ** np.floor(np.log10(1.05 * value))
    enough = 1.05 * value / decade <= ROUND * (1 + 1e-9)
    return float(ROUND[enough][0] * decade)


def _of_trials(plt, trials):
    """The RMS of the errors by trial, and the signals of the last trial, by unit."""
    signals_of(trials, "reference", "v")  # which checks that trials are complete
    errors, panels = rms_by_trial(trials.e), _signals_by_unit(trials)
    count = len(errors.columns) + len(panels)
    size = WIDTH, HEIGHT * count
    figure, axes = plt.subplots(
        count, figsize=size, squeeze=False, layout="constrained"
    )
    axes = iter(axes.flat)
    for label, values in errors.items():
        ax = next(axes)
        ax.semilogy(errors.index, values, "o-")
        ax.set(xlabel="trial", ylabel=_plain(label))
        ax.xaxis.get_major_locator().set_params(integer=True)
    for label, lines in panels.items():
        ax = next(axes)
        for name, values, style in lines:
            ax.plot(trials.time, values, style, label=_plain(name))
        ax.set(xlabel="time (s)", ylabel=_plain(label))
        ax.legend(ncols=2)
    return figure


def _signals_by_unit(trials) -> dict[str, list]:
    """Name, values and style of the lines of the last trial, by the label of their axes."""
    panels, last = {}, trials.isel(trial=-1).transpose("time", ...)
    for signal, role in (("y", "output"), ("v", "output"), ("u", "control")):
        if signal not in trials:
            continue
        for unit, channels in by_unit(trials[f"{role}_unit"].values.tolist()).items():
            label = with_unit(f"{signal} in trial {int(last.trial)}", unit)
            lines = panels.setdefault(label, [])
            for i in channels:
                name = f"{signal}: {trials[role].values[i]}"
                lines.append((name, last[signal].values[:, i], f"C{i}"))
                if signal == "y":
                    lines.append(("reference", last.reference.values[:, i], f"C{i}--"))
    return panels


def _plain(text):
    """A name of a signal may contain a dollar, which must not begin a formula."""
    return text.replace("$", r"\$")
