"""The picture of a design.

It is drawn anew at each turn of a knob. To find a layout would take as long as the design, so it is
fixed, and limits are round numbers.
"""

import textwrap
from io import BytesIO
from itertools import cycle, product

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ilctools import arguments
from ilctools.synthesis.result import Synthesis
from ilctools.units import with_unit
from rodlib.workbench.outcome import Outcome

SIZE = (7.6, 5.2)  # inches
STYLE = {
    "axes.autolimit_mode": "round_numbers",
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


def plot(design: Synthesis | Outcome, before: Synthesis | Outcome | None = None):
    """Draw a design as one would first look at it.

    Parameters
    ----------
    design : Synthesis or Outcome
        From :func:`ilctools.synthesise` or :func:`rodlib.try_out`: sigma_max(M) and sigma_max(L)
        over frequency, with their bounds and the mean in the band; the coefficients; and RMS(e_k)
        of an outcome's trials.
    before : Synthesis or Outcome, optional
        A design to compare with, in gray.

    Returns
    -------
    matplotlib.figure.Figure
        To change, or to keep by its ``savefig``.

    See Also
    --------
    Synthesis.plot : the singular values alone, on axes of yours
    try_out : a design with its trials

    Examples
    --------
    >>> from ilctools import synthesise, zero_phase_butterworth
    >>> from rodlib import paper_choices, paper_loop, plot
    >>> Q = zero_phase_butterworth(2, 0.1, 1.0)
    >>> figure = plot(synthesise(paper_loop(), Q, **paper_choices()))
    >>> len(figure.axes)
    4
    """
    import matplotlib.pyplot as plt  # here, because it takes long to import

    with mpl.rc_context(STYLE):
        figure = plt.figure(figsize=SIZE, dpi=100, layout="none")
    Picture(figure).show(_outcome("design", design), before and _outcome("before", before))
    if "inline" in mpl.get_backend():
        plt.close(figure)  # or a notebook would show it twice
    return figure


def _outcome(name, item):
    arguments.instance(name, item, Synthesis | Outcome)
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
        rate.set(title=r"rate $\bar\sigma(M)$: what a trial leaves of the error", ylim=(0, 1.05))
        gain.set(title=r"gain $\bar\sigma(L)$ of the learning filter")
        for axes in (rate, gain):
            axes.set(xscale="log", xlabel="frequency (rad/s)")
        trials.set(xlabel="trial", xticks=np.arange(1, 11), xlim=(0.7, 10.3), yscale="log")
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
        key = message = ""
        if outcome.design is None:
            message = textwrap.fill(outcome.message, 80)
        else:
            key = "black: this filter    red: its bounds    dotted: its mean rate in the band"
            if before is not None and _comparable(before, outcome):
                key += "    gray: the filter before"
                self._draw(before, BEFORE)
            self._draw(outcome, DESIGN)
            self._frame(outcome)
        self.key.set_text(key)
        self.message.set_text(message)
        return self

    def _draw(self, outcome, look):
        """The lines of an outcome; the entries of a filter have a look each, unless in gray."""
        (rate, trials), (gain, lags) = self.axes
        design, problem = outcome.design, outcome.design.problem
        rate.plot(design.omega, design.sigma_M, **look)
        gain.plot(design.omega, design.sigma_L, **look)
        if problem.objective == "sum":
            mean = [design.certificate.mean_M] * 2
            rate.plot(problem.band, mean, **look | {"linestyle": ":"})
        numbers = np.arange(1, len(outcome.rms) + 1)
        trials.plot(numbers, outcome.rms, "o-", markersize=4, **look)
        ahead = np.arange(1, design.filter.order + 1)
        looks = cycle(ENTRIES if look is DESIGN else [look])
        for (name, values), look in zip(entries(design).items(), looks, strict=False):
            lags.plot(ahead, values, marker=".", label=name, **look)

    def _frame(self, outcome):
        """Bounds, limits and labels of an outcome, around the lines that are drawn."""
        (rate, trials), (gain, lags) = self.axes
        design, problem = outcome.design, outcome.design.problem
        if problem.objective == "sum":
            rate.axhline(problem.M_max, **BOUND)
        if problem.L_max is not None:
            gain.axhline(problem.L_max, **BOUND)
        for axes in (trials, gain, lags):
            axes.relim()
            axes.autoscale(axis="y")
        gain.set_ylim(bottom=0)
        low, high = np.log10(trials.get_ylim())
        trials.set_ylim(10 ** np.floor(low), 10 ** np.ceil(high))
        for axes in (rate, gain):
            axes.set_xlim(design.omega[[0, -1]])
        # Not halves: with ten coefficients a marker would fall between two pixels, and rounding
        # would decide into which of them.
        lags.set_xlim(0.4, max(len(line.get_xdata()) for line in lags.lines) + 0.6)
        unit = outcome.settings.plant.unit if outcome.rms else ""
        title = f"{with_unit('RMS of the error', unit)}, simulated"
        trials.set_title(title if outcome.rms else "not simulated", parse_math=False)
        lags.legend(
            handles=lags.lines[-len(entries(design)) :],
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
    one, other = before.design.filter, outcome.design.filter
    return one.Ts == other.Ts and len(one.coefficients) == len(other.coefficients)
