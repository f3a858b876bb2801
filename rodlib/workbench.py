"""The workbench for JupyterLab: move a slider and see its effect on the filter.

:func:`try_out` designs a filter and simulates trials with the filter. :func:`plot` draws the design
and the trials. :func:`open_workbench` adds a slider for each choice.
"""

import warnings
from functools import partial

import numpy as np
import xarray as xr
from cycler import cycler
from matplotlib import style
from matplotlib.figure import Figure

from ilctools import rms, run_trials, synthesise, zero_phase_butterworth
from ilctools.problem.pose import pose
from ilctools.response.door import response_of
from ilctools.synthesis.result import Synthesis
from ilctools.units import with_unit
from rodlib.paper.figures import ACCENT, SHADES

DESIGN_FREQUENCIES = (
    236  # frequencies of the design: filters of ten samples need no more; the paper has 1000
)
TRIALS, REST = 10, 15  # REST: samples at the end of a trial in which v is zero
LOOK = {"axes.autolimit_mode": "round_numbers", "axes.prop_cycle": cycler(color=SHADES)}
BOUND = ACCENT | {"linewidth": 1, "linestyle": "--"}


def try_out(
    loop, reference, disturbance=None, *, cutoff, noise=0.0, **choices
) -> tuple[Synthesis, xr.Dataset]:
    """Design a filter for a loop with a model P, and simulate ten trials.

    Parameters
    ----------
    loop, reference, disturbance
        As for :func:`ilctools.run_trials`.
    cutoff : float
        Cut-off frequency (rad/s) of the Butterworth filter Q of second order.
    noise : float
        Standard deviation of white noise in each output, in the unit of the output. Each trial has
        new noise.
    **choices
        Arguments of :func:`ilctools.synthesise`: order, M_max, L_max, band, structure, ... By
        default, the bounds also hold between the design frequencies.

    Returns
    -------
    design : Synthesis
        The design, with its certificate. If no filter meets the bounds, the synthesis raises an
        error that says why.
    trials : xarray.Dataset
        As :func:`ilctools.run_trials` returns them.

    See Also
    --------
    plot : a picture of design and trials
    open_workbench : a design with its trials, chosen by sliders

    Examples
    --------
    >>> from rodlib import assumed_reference, paper_choices, paper_loop, try_out
    >>> choices = paper_choices(M_max=0.95)
    >>> design, trials = try_out(paper_loop(), assumed_reference(), cutoff=0.1, **choices)
    >>> design.filter.order, trials.sizes["trial"]
    (10, 10)
    """
    Q = zero_phase_butterworth(2, cutoff, loop.Ts)
    omega = np.geomspace(1e-4, np.pi, DESIGN_FREQUENCIES) / loop.Ts
    with warnings.catch_warnings(action="ignore"):  # the certificate has them
        design = synthesise(loop, Q, omega, **{"everywhere": True} | choices)
    noise = noise * np.random.default_rng(0).standard_normal((TRIALS, *np.shape(reference)))
    law = design.law(rest=REST)
    return design, run_trials(loop, law, reference, disturbance, TRIALS, noise=noise)


def open_workbench(loop, reference, disturbance=None, **choices):
    """Show sliders for the choices of :func:`try_out`, above the picture and the certificate.

    If no filter meets the bounds, the reason is shown instead of picture and certificate.

    Parameters
    ----------
    loop, reference, disturbance
        As for :func:`try_out`.
    **choices
        Initial choices of :func:`try_out`. Choices without a slider do not change. Default:
        M_max = 0.9, ten samples, a cut-off of 0.1 / Ts, and L_max as :func:`ilctools.synthesise`
        chooses it.

    Returns
    -------
    ipywidgets.interactive
        The sliders, for the last line of a cell. Their `result` is the design that is shown, or
        None.

    See Also
    --------
    try_out : a single design with its trials, without widgets

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
    # Imported here, because these packages come with the extra "notebooks".
    from IPython.core.pylabtools import print_figure
    from IPython.display import Image, display
    from ipywidgets import interactive

    def show(**knobs):
        try:
            design, trials = try_out(loop, reference, disturbance, **choices | knobs)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            print(error)
            return None
        display(Image(print_figure(plot(design, trials), bbox_inches=None)))
        print(design.certificate)
        return design

    start = {"M_max": 0.9, "cutoff": 0.1 / loop.Ts, "order": 10, "noise": 0.0} | choices
    Q = zero_phase_butterworth(2, start["cutoff"], loop.Ts)
    start = {"L_max": pose(response_of(loop, Q=Q), Q).L_max, "structure": "diagonal"} | start
    return interactive(show, **_knobs(start, most_noise=np.abs(reference).max() / 10))


def _knobs(start, most_noise):
    """Make a slider for each choice, at the initial value of the choice.

    A slider acts when it is released.
    """
    from ipywidgets import Dropdown, FloatSlider, IntSlider

    gain, cutoff = start["L_max"], start["cutoff"]
    real = partial(FloatSlider, readout_format=".3g")
    ranges = {  # kind of slider; least, most, step
        "M_max": (real, 0.05, 0.999, 0.001),
        "L_max": (real, gain / 50, 4 * gain, gain / 50),
        "cutoff": (real, cutoff / 50, 4 * cutoff, cutoff / 50),
        "order": (IntSlider, 1, 2 * start["order"], 1),
        "noise": (real, 0, most_noise, most_noise / 100),
    }
    sliders = {
        name: kind(value=start[name], min=least, max=most, step=step, continuous_update=False)
        for name, (kind, least, most, step) in ranges.items()
    }
    structure = Dropdown(options=["diagonal", "full"], value=start["structure"])
    return sliders | {"structure": structure}


@style.context(["rodlib.paper.style", LOOK])
def plot(design: Synthesis, trials: xr.Dataset) -> Figure:
    """Draw a first overview of a design of (39) of the paper, with trials of its law.

    Parameters
    ----------
    design : Synthesis
        The design. The plot shows its sigma_max(M) and sigma_max(L) over frequency, with their
        bounds and the mean in the band, and its coefficients.
    trials : xarray.Dataset
        Trials from :func:`ilctools.run_trials`. The plot shows RMS(e_k) of each trial.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, to change or to save by ``savefig``.

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
    figure = Figure((7.6, 5.2), dpi=100, layout="none")  # inches; to find a layout takes long
    (rate, errors), (gain, lags) = figure.subplots(2, 2)
    figure.subplots_adjust(0.07, 0.09, 0.985, 0.94, wspace=0.2, hspace=0.45)
    problem, omega, mean = design.problem, design.omega, design.certificate.mean_M
    rate.plot(omega, design.sigma_M)
    rate.plot(problem.objective.band, [mean, mean], color="black", linestyle=":")
    rate.axhline(problem.M_max, **BOUND)
    gain.plot(omega, design.sigma_L)
    gain.axhline(problem.L_max, **BOUND)
    for axes in (rate, gain):
        axes.set(xscale="log", xlabel="frequency (rad/s)", xlim=omega[[0, -1]], ylim=(0, None))
    rate.set_title(r"rate $\bar\sigma(M)$, its bound, its mean in the band")
    gain.set_title(r"gain $\bar\sigma(L)$, its bound")
    errors.semilogy(trials.trial, rms(trials), "o-", markersize=4)
    title = with_unit("RMS of the error", ", ".join(dict.fromkeys(trials.output_unit.values)))
    errors.set(title=f"{title}, simulated", xlabel="trial", xticks=trials.trial)
    _draw_coefficients(lags, design.filter.coefficients)
    for axes in figure.axes:
        axes.autoscale_view()  # now, while the style is in force
    return figure


def _draw_coefficients(axes, coefficients):
    """Draw a line for each entry of the filter that is not zero."""
    order = coefficients.shape[-1]
    for i, j in np.argwhere(coefficients.any(axis=-1)):
        look, label = "o-" if i == j else "x:", f"$L_{{{i + 1}{j + 1}}}$"
        axes.plot(np.arange(1, order + 1), coefficients[i, j], look, markersize=4, label=label)
    # The limits are not at halves. With ten coefficients, a marker would then fall between two
    # pixels, and rounding would choose the pixel.
    axes.set(title="coefficients of $L$", xlabel="samples ahead", xlim=(0.4, order + 0.6))
    axes.legend(fontsize=8)
