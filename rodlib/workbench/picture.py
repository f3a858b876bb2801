"""The picture of a design: rate and gain over frequency, trials, and coefficients.

To find a layout would take as long as the design, so it is fixed, and limits are round numbers.
"""

import textwrap
from io import BytesIO

import numpy as np
from cycler import cycler
from matplotlib import style
from matplotlib.figure import Figure

from ilctools import arguments
from ilctools.synthesis.result import Synthesis
from ilctools.units import with_unit
from rodlib.paper.figures import ACCENT, SHADES
from rodlib.workbench.outcome import Outcome

STYLE = [
    "rodlib.paper.style",
    {
        "axes.autolimit_mode": "round_numbers",
        "figure.constrained_layout.use": False,
        "savefig.dpi": "figure",
    },
]
BOUND = ACCENT | {"linewidth": 1, "linestyle": "--"}
ENTRIES = cycler(linestyle=["-", ":"]) * (
    cycler(color=["black", *SHADES[2:]]) + cycler(marker=["o", "x", "s", "^", "v"])
)


@style.context(STYLE)
def plot(design: Synthesis | Outcome) -> Figure:
    """Draw a design as one would first look at it.

    Parameters
    ----------
    design : Synthesis or Outcome
        From :func:`ilctools.synthesise` or :func:`rodlib.try_out`: sigma_max(M) and sigma_max(L)
        over frequency, with their bounds and the mean in the band; the coefficients; and RMS(e_k)
        of an outcome's trials. Of an outcome without a design, the message.

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
    arguments.instance("design", design, Synthesis | Outcome)
    outcome = design if isinstance(design, Outcome) else Outcome(None, design)
    figure = Figure((7.6, 5.2), dpi=100)  # inches
    if outcome.design is None:
        text = textwrap.fill(outcome.message, 80)
        figure.text(0.5, 0.5, text, ha="center", va="center", fontsize=12, parse_math=False)
        return figure
    (rate, trials), (gain, lags) = figure.subplots(2, 2)
    figure.subplots_adjust(0.07, 0.09, 0.985, 0.89, wspace=0.2, hspace=0.45)
    figure.text(0.07, 0.96, "dashed: bounds    dotted: mean rate in the band")
    _draw_singular_values(rate, gain, outcome.design)
    _draw_trials(trials, outcome)
    _draw_coefficients(lags, outcome.design)
    return figure


def png(outcome: Outcome) -> bytes:
    """The picture as a PNG file; the same bytes for the same outcome."""
    buffer, figure = BytesIO(), plot(outcome)
    with style.context(STYLE):
        figure.savefig(buffer, pil_kwargs={"compress_level": 1})
    return buffer.getvalue()


def _draw_singular_values(rate, gain, design):
    problem = design.problem
    rate.plot(design.omega, design.sigma_M, color="black")
    gain.plot(design.omega, design.sigma_L, color="black")
    if problem.objective == "sum":
        rate.plot(problem.band, [design.certificate.mean_M] * 2, color="black", linestyle=":")
        rate.axhline(problem.M_max, **BOUND)
    if problem.L_max is not None:
        gain.axhline(problem.L_max, **BOUND)
    for axes in (rate, gain):
        axes.set(xscale="log", xlabel="frequency (rad/s)", xlim=design.omega[[0, -1]])
    rate.set(title=r"rate $\bar\sigma(M)$: what a trial leaves of the error", ylim=(0, 1.05))
    gain.set(title=r"gain $\bar\sigma(L)$ of the learning filter", ylim=(0, None))


def _draw_trials(axes, outcome):
    axes.set(xlabel="trial", xticks=np.arange(1, 11), xlim=(0.7, 10.3), yscale="log")
    if not outcome.rms:
        axes.set_title("not simulated")
        return
    axes.plot(np.arange(1, len(outcome.rms) + 1), outcome.rms, "o-", markersize=4, color="black")
    decades = np.log10(axes.get_ylim())
    axes.set_ylim(10 ** np.floor(decades[0]), 10 ** np.ceil(decades[1]))
    title = with_unit("RMS of the error", outcome.settings.plant.unit)
    axes.set_title(f"{title}, simulated", parse_math=False)


def _draw_coefficients(axes, design):
    """A line for each entry of the filter: its diagonal, then the others if it is full."""
    coefficients = design.filter.coefficients
    m, _, order = coefficients.shape
    entries = sorted(np.ndindex(m, m), key=lambda entry: entry[0] != entry[1])
    axes.set_prop_cycle(ENTRIES)
    for i, j in entries if design.problem.structure == "full" else entries[:m]:
        label = f"$L_{{{i + 1}{j + 1}}}$"
        axes.plot(np.arange(1, order + 1), coefficients[i, j], markersize=4, label=label)
    axes.set(title="coefficients of $L$", xlabel="samples ahead")
    # Not halves: with ten coefficients a marker would fall between two pixels, and rounding
    # would decide into which of them.
    axes.set_xlim(0.4, order + 0.6)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.02, 0.97),
        ncols=5,
        fontsize=8,
        borderpad=0.2,
        handlelength=0.9,
        handletextpad=0.4,
        columnspacing=0.8,
    )
