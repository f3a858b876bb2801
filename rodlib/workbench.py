"""The workbench: move a slider and see what it does to the filter, in JupyterLab.

:func:`try_out` designs a filter and simulates trials with it, :func:`plot` draws both, and
:func:`open_workbench` puts a slider in front of each choice.
"""

import warnings
from functools import partial

import numpy as np
import xarray as xr
from cycler import cycler
from matplotlib import style
from matplotlib.figure import Figure

from ilctools import arguments, rms, run_trials, synthesise, zero_phase_butterworth
from ilctools.problem.pose import pose
from ilctools.synthesis.result import Synthesis
from ilctools.units import with_unit
from rodlib.paper.figures import ACCENT, SHADES

FREQUENCIES = 200  # of the design; the paper's 1000 would take longer than one waits for a picture
LIVELY = 20  # largest order by default, for the same reason
TRIALS = 10
STYLE = ["rodlib.paper.style", {"axes.autolimit_mode": "round_numbers"}]
BOUND = ACCENT | {"linewidth": 1, "linestyle": "--"}
ENTRIES = cycler(linestyle=["-", ":"]) * (
    cycler(color=["black", *SHADES[2:]]) + cycler(marker=["o", "x", "s", "^", "v"])
)


def try_out(
    loop,
    reference,
    disturbance=None,
    *,
    cutoff,
    Q_order=2,
    uncertainty=0.0,
    noise=0.0,
    rest=15,
    **choices,
) -> tuple[Synthesis, xr.Dataset]:
    """Design a filter for a loop with a model P, and simulate ten trials with it.

    Parameters
    ----------
    loop, reference, disturbance
        As for :func:`ilctools.run_trials`.
    cutoff, Q_order : float, int
        Cut-off frequency (rad/s) and order of the Butterworth filter Q.
    uncertainty : float
        Radius around P, as a share of ||P||. With none, bounds hold between the design
        frequencies, too; with one, nothing bounds P there.
    noise : float
        Standard deviation of white noise in each output, in its unit, new in every trial.
    rest : int
        Samples at the end of a trial in which v is zero.
    **choices
        Of :func:`ilctools.synthesise`: order, M_max, L_max, band, structure, ...

    Returns
    -------
    design : Synthesis
        With its certificate; where there is no filter, the synthesis says why, in an error.
    trials : xarray.Dataset
        As :func:`ilctools.run_trials` returns them.

    See Also
    --------
    plot : a picture of both
    open_workbench : the same by sliders

    Examples
    --------
    >>> from rodlib import assumed_reference, paper_choices, paper_loop, try_out
    >>> choices = paper_choices(M_max=0.95)
    >>> design, trials = try_out(paper_loop(), assumed_reference(), cutoff=0.1, **choices)
    >>> design.filter.order, trials.sizes["trial"]
    (10, 10)
    """
    Q = zero_phase_butterworth(Q_order, cutoff, loop.Ts)
    omega = np.geomspace(1e-4, np.pi, FREQUENCIES) / loop.Ts
    if uncertainty:
        size = np.linalg.norm(loop.frequency_response(omega), 2, axis=(1, 2))
        choices = choices | {"uncertainty": uncertainty * size}
    with warnings.catch_warnings(action="ignore"):  # the certificate has them
        design = synthesise(loop, Q, omega, **{"everywhere": not uncertainty} | choices)
    noise = noise * np.random.default_rng(0).standard_normal((TRIALS, *np.shape(reference)))
    law = design.law(rest=rest)
    return design, run_trials(loop, law, reference, disturbance, TRIALS, noise=noise)


def open_workbench(loop, reference, disturbance=None, **choices):
    """Sliders for the choices of :func:`try_out`; below them its picture and certificate.

    Where there is no filter, the reason stands in their place.

    Parameters
    ----------
    loop, reference, disturbance
        As for :func:`try_out`.
    **choices
        Of :func:`try_out`, to begin with; those without a slider stay. Default: M_max = 0.9, a
        cut-off of 0.1 / Ts, and L_max and order as :func:`ilctools.synthesise` chooses them.

    Returns
    -------
    ipywidgets.interactive
        For the last line of a cell. Its `result` is the design that is shown, or None.

    See Also
    --------
    try_out : one choice, without widgets

    Examples
    --------
    >>> from contextlib import redirect_stdout
    >>> from io import StringIO
    >>> from rodlib import assumed_reference, open_workbench, paper_choices, paper_loop
    >>> with redirect_stdout(StringIO()):  # as we are outside JupyterLab
    ...     panel = open_workbench(paper_loop(), assumed_reference(), **paper_choices())
    ...
    >>> panel.result.law(rest=15).rest
    15
    """
    # Here, because these come with the extra "notebooks".
    from IPython.core.pylabtools import print_figure
    from IPython.display import Image, display
    from ipywidgets import interactive

    def show(**knobs):
        try:
            with warnings.catch_warnings(action="always"):  # of the trials
                design, trials = try_out(loop, reference, disturbance, **choices | knobs)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            print(error)
            return None
        display(Image(print_figure(plot(design, trials), bbox_inches=None)))
        print(design.certificate)
        return design

    panel = interactive(show, **_knobs(loop, np.abs(reference).max(), choices))
    panel.layout.flex_flow = "row wrap"  # sliders side by side, as many as there is room for
    panel.out.layout.width = "100%"
    return panel


def _knobs(loop, largest, choices):
    """A widget for each choice, which acts when it is let go; `largest` of the reference."""
    from ipywidgets import Dropdown, FloatLogSlider, FloatSlider, IntSlider

    start = {
        "M_max": 0.9,
        "cutoff": 0.1 / loop.Ts,
        "Q_order": 2,
        "structure": "diagonal",
        "uncertainty": 0.0,
        "noise": 0.0,
    } | choices
    problem = pose(loop, zero_phase_butterworth(start["Q_order"], start["cutoff"], loop.Ts))
    start = {"L_max": problem.L_max, "order": min(problem.order, LIVELY)} | start
    gain, cutoff = np.log10([start["L_max"], start["cutoff"]])
    number = partial(FloatSlider, readout_format=".3g")
    ranges = {  # least, most, step; of the logarithms, a decade to both sides
        "M_max": (number, 0.05, 0.999, 0.001),
        "L_max": (FloatLogSlider, gain - 1, gain + 1, 0.02),
        "cutoff": (FloatLogSlider, cutoff - 1, cutoff + 1, 0.02),
        "Q_order": (IntSlider, 1, 6, 1),
        "order": (IntSlider, 1, max(20, 2 * start["order"]), 1),
        "uncertainty": (number, 0, 0.2, 0.005),
        "noise": (number, 0, largest / 10, largest / 1000),
    }
    knobs = {
        name: kind(value=start[name], min=least, max=most, step=step, continuous_update=False)
        for name, (kind, least, most, step) in ranges.items()
    }
    return knobs | {"structure": Dropdown(options=["diagonal", "full"], value=start["structure"])}


@style.context(STYLE)
def plot(design: Synthesis, trials: xr.Dataset) -> Figure:
    """Draw a design of (39) as one would first look at it, with trials of its law.

    Parameters
    ----------
    design : Synthesis
        Its sigma_max(M) and sigma_max(L) over frequency, with their bounds and the mean in the
        band, and its coefficients are drawn.
    trials : xarray.Dataset
        From :func:`ilctools.run_trials`: RMS(e_k) of each trial.

    Returns
    -------
    matplotlib.figure.Figure
        To change, or to keep by its ``savefig``.

    See Also
    --------
    try_out : a design with its trials

    Examples
    --------
    >>> from rodlib import assumed_reference, paper_choices, paper_loop, plot, try_out
    >>> figure = plot(*try_out(paper_loop(), assumed_reference(), cutoff=0.1, **paper_choices()))
    >>> len(figure.axes)
    4
    """
    arguments.instance("design", design, Synthesis)
    figure = Figure((7.6, 5.2), dpi=100, layout="none")  # inches; to find a layout takes long
    (rate, errors), (gain, lags) = figure.subplots(2, 2)
    figure.subplots_adjust(0.07, 0.09, 0.985, 0.89, wspace=0.2, hspace=0.45)
    figure.text(0.07, 0.96, "dashed: bounds    dotted: mean rate in the band")
    problem, certificate = design.problem, design.certificate
    _draw_singular_values(rate, design.omega, design.sigma_M, problem.M_max)
    rate.plot(problem.objective.band, [certificate.mean_M] * 2, color="black", linestyle=":")
    rate.set(title=r"rate $\bar\sigma(M)$: what a trial leaves of the error", ylim=(0, 1.05))
    _draw_singular_values(gain, design.omega, design.sigma_L, problem.L_max)
    gain.set(title=r"gain $\bar\sigma(L)$ of the learning filter", ylim=(0, None))
    _draw_errors(errors, trials)
    _draw_coefficients(lags, design.filter.coefficients)
    for axes in figure.axes:
        axes.autoscale_view()  # now, while the style is in force
    return figure


def _draw_singular_values(axes, omega, sigma, bound):
    axes.plot(omega, sigma, color="black")
    axes.axhline(bound, **BOUND)
    axes.set(xscale="log", xlabel="frequency (rad/s)", xlim=omega[[0, -1]])


def _draw_errors(axes, trials):
    numbers, units = trials.trial.values, sorted({*trials.output_unit.values})
    axes.semilogy(numbers, rms(trials), "o-", markersize=4, color="black")
    axes.set(xlabel="trial", xticks=numbers, xlim=(numbers[0] - 0.3, numbers[-1] + 0.3))
    title = with_unit("RMS of the error", ", ".join(units))
    axes.set_title(f"{title}, simulated", parse_math=False)


def _draw_coefficients(axes, coefficients):
    """A line for each entry of the filter that is not zero, its diagonal first."""
    m, _, order = coefficients.shape
    axes.set_prop_cycle(ENTRIES)
    for i, j in sorted(np.ndindex(m, m), key=lambda entry: entry[0] != entry[1]):
        if coefficients[i, j].any():
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
