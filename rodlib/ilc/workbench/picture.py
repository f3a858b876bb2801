"""The picture of an outcome: the singular values with their bounds, the filter, ten trials.

A layout that is found anew takes as long as the design. Here it is fixed, and limits are round
numbers.
"""

import textwrap
from io import BytesIO
from itertools import cycle, islice, product

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from rodlib.ilc import arguments
from rodlib.ilc.workbench.outcome import Outcome

SIZE = (7.6, 5.2)  # inches, of 100 pixels each
STYLE = {
    "font.size": 9, "axes.titlesize": 9, "axes.titlelocation": "left", "axes.grid": True,
    "axes.titley": 1.0,  # fixed: to look for what may be in its way takes long
    "grid.color": "0.9", "legend.frameon": False, "lines.linewidth": 1.3,
}  # fmt: skip
BEFORE = {"color": "0.75", "linewidth": 2.4}
BOUND = {"color": "tab:red", "linewidth": 1, "linestyle": "--"}
ROUND = np.array([1, 1.5, 2, 3, 5, 7, 10])
SHADES = ("black", "tab:red", "tab:blue", "tab:green", "tab:orange")
ENTRIES = [  # how those of a filter look; gray is for the filter before
    {"color": shade, "linestyle": style} for style, shade in product(("-", ":"), SHADES)
]


class Picture:
    """Four axes whose lines are replaced from outcome to outcome: its `figure` is Matplotlib's."""

    @mpl.rc_context(STYLE)
    def __init__(self):
        self.figure = Figure(SIZE, dpi=100, layout="none")
        FigureCanvasAgg(self.figure)
        self.axes = self.figure.subplots(2, 2)
        (rate, trials), (gain, lags) = self.axes
        self.figure.subplots_adjust(0.07, 0.09, 0.985, 0.89, wspace=0.2, hspace=0.45)
        rate.set(
            title=r"rate $\bar\sigma(M)$: what a trial leaves of the error",
            ylim=(0, 1.05),
        )
        gain.set(title=r"gain $\bar\sigma(L)$ of the learning filter")
        lags.set(title="coefficients of $L$", xlabel="samples ahead")
        for axes in (rate, gain):
            axes.set(xscale="log", xlabel="frequency (rad/s)")
        trials.set(
            xlabel="trial", xticks=np.arange(1, 11), xlim=(0.7, 10.3), yscale="log"
        )
        self._words = self.figure.text(0.07, 0.96, "")
        self._message = self.figure.text(
            0.5, 0.5, "", ha="center", va="center", fontsize=12, linespacing=1.5,
            parse_math=False,  # it may name a file
        )  # fmt: skip

    @mpl.rc_context(STYLE)
    def show(self, outcome: Outcome, before: Outcome | None = None) -> "Picture":
        """Put in the lines of an outcome, and of one before it in gray; or why there is no filter.

        The one before is left out if it has other channels or another sampling period.
        """
        arguments.instance("outcome", outcome, Outcome)
        if before is not None:
            arguments.instance("before", before, Outcome)
        for axes in self.axes.flat:
            axes.set_visible(outcome.design is not None)
            for line in [*axes.lines]:
                line.remove()
        self._message.set_text("")
        self._words.set_text("")
        if outcome.design is None:
            self._message.set_text(textwrap.fill(outcome.message, 80))
            return self
        shown = [outcome]
        if before is not None and _alike(before, outcome):
            shown.append(before)
            self._draw(before, before=True)
        self._draw(outcome)
        self._fit(shown)
        gray = "    gray: the filter before" if len(shown) > 1 else ""
        self._words.set_text(
            f"black: this filter    red: its bounds    dotted: its mean rate in the band{gray}"
        )
        return self

    def _draw(self, outcome, before=False):
        """The lines of an outcome."""
        (rate, trials), (gain, lags) = self.axes
        design, look = outcome.design, BEFORE if before else {"color": "black"}
        rate.plot(design.omega, design.sigma_M, **look)
        gain.plot(design.omega, design.sigma_L, **look)
        trials.plot(
            np.arange(1, len(outcome.rms) + 1), outcome.rms, "o-", markersize=4, **look
        )
        ahead = np.arange(1, design.filter.order + 1)
        for entry, own in zip(entries(outcome).values(), cycle(ENTRIES), strict=False):
            lags.plot(ahead, entry, marker=".", **(look if before else own))
        mean = design.certificate.mean_M
        rate.plot(design.problem.band, [mean, mean], **look | {"linestyle": ":"})
        if not before:
            rate.axhline(design.problem.M_max, **BOUND)
            gain.axhline(design.problem.L_max, **BOUND)

    def _fit(self, outcomes):
        """Limits that hold all outcomes, and labels of the first."""
        (rate, trials), (gain, lags) = self.axes
        designs = [outcome.design for outcome in outcomes]
        for axes in (rate, gain):
            axes.set_xlim(designs[0].omega[[0, -1]])
        gain.set_ylim(
            0, _round_up(max(max(d.sigma_L.max(), d.problem.L_max) for d in designs))
        )
        values = np.concatenate([outcome.rms or [1.0] for outcome in outcomes])
        low, high = np.log10([max(values.min(), 1e-15), max(values.max(), 1e-15)])
        trials.set_ylim(10 ** np.floor(low), 10 ** (np.floor(high) + 1))
        unit = outcomes[0].settings.plant.unit
        unit = f" ({unit})" if unit else ""
        simulated = f"RMS of the error{unit}, simulated"
        none = "not simulated: the loop has no P"
        trials.set_title(simulated if outcomes[0].rms else none, parse_math=False)
        coefficients = np.concatenate([d.filter.coefficients.ravel() for d in designs])
        least, most = coefficients.min(), coefficients.max()
        lags.set_ylim(
            -_round_up(-least) if least < 0 else 0, _round_up(most) if most > 0 else 0
        )
        # Not halves: with ten coefficients a marker would fall between two pixels, and rounding
        # would say into which of them.
        lags.set_xlim(0.4, max(d.filter.order for d in designs) + 0.6)
        lags.xaxis.get_major_locator().set_params(integer=True)
        names = [*entries(outcomes[0])]
        handles = [
            Line2D([], [], **look) for look in islice(cycle(ENTRIES), len(names))
        ]
        lags.legend(
            handles, names, loc="lower right", bbox_to_anchor=(1.02, 0.97), ncols=5, fontsize=8,
            borderpad=0.2, handlelength=0.9, handletextpad=0.4, columnspacing=0.8,
            labelspacing=0.2,
        )  # fmt: skip

    @mpl.rc_context(STYLE)
    def png(self) -> bytes:
        """The picture as a PNG file; the same bytes for the same outcomes."""
        self.figure.canvas.draw()
        buffer, opaque = (
            BytesIO(),
            np.asarray(self.figure.canvas.buffer_rgba())[..., :3],
        )
        Image.fromarray(opaque).save(buffer, "png", compress_level=1)
        return buffer.getvalue()


def entries(outcome: Outcome) -> dict[str, np.ndarray]:
    """Coefficients of the learning filter by entry, without those that the structure leaves out."""
    coefficients = outcome.design.filter.coefficients
    m = len(coefficients)
    places = [(i, i) for i in range(m)]
    if outcome.settings.structure == "full":
        places += [(i, j) for i in range(m) for j in range(m) if i != j]
    return {f"$L_{{{i + 1}{j + 1}}}$": coefficients[i, j] for i, j in places}


def _alike(before, outcome):
    """Whether two filters can stand in the same axes."""
    sizes = [len(each.design.filter.coefficients) for each in (before, outcome)]
    return sizes[0] == sizes[1] and before.settings.Ts == outcome.settings.Ts


def _round_up(value):
    """The next round number that leaves some room above a positive one."""
    decade = 10 ** np.floor(np.log10(1.05 * value))
    enough = 1.05 * value / decade <= ROUND * (1 + 1e-9)
    return float(ROUND[enough][0] * decade)
