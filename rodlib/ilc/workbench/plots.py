"""The first picture of a design, or of trials, labelled with the units that they have."""

import reprlib
from collections.abc import Iterator

import xarray as xr

from rodlib.ilc import Synthesis
from rodlib.ilc.logs.format import signals_of
from rodlib.ilc.logs.replay import rms_by_trial
from rodlib.ilc.units import by_unit, with_unit

WIDTH, HEIGHT = 7.2, 2.3  # inches, of one axes


def plot(shown: Synthesis | xr.Dataset):
    """Draw a design, or trials, as one would first look at them.

    Parameters
    ----------
    shown : Synthesis or xarray.Dataset
        From :func:`rodlib.synthesise`: sigma_max(M) and sigma_max(L) over frequency, with their
        bounds and the band. From :func:`rodlib.run_trials`, :func:`rodlib.record` or
        :func:`rodlib.load_log`: RMS(e_k) by trial and the signals of the last trial, outputs with
        their reference; what has different units stands in different axes.

    Returns
    -------
    matplotlib.figure.Figure
        To change, or to keep by its ``savefig``.
    """
    import matplotlib  # here, because it takes long to import
    import matplotlib.pyplot as plt

    if not isinstance(shown, Synthesis | xr.Dataset):
        raise ValueError(
            f"shown = {reprlib.repr(shown)} must be a Synthesis or a Dataset of trials"
        )
    with plt.rc_context(
        {"axes.grid": True, "grid.color": "0.9", "legend.frameon": False}
    ):
        figure = (
            _of_design(plt, shown)
            if isinstance(shown, Synthesis)
            else _of_trials(plt, shown)
        )
    if "inline" in matplotlib.get_backend():
        plt.close(figure)  # or a notebook would show it twice
    return figure


def _axes(plt, count):
    size = (WIDTH, HEIGHT * count)
    figure, axes = plt.subplots(
        count, 1, figsize=size, squeeze=False, layout="constrained"
    )
    return figure, axes[:, 0]


def _of_design(plt, design):
    problem, omega = design.problem, design.omega
    figure, axes = _axes(plt, 2)
    rows = ("M", design.sigma_M, problem.M_max), ("L", design.sigma_L, problem.L_max)
    for ax, (name, sigma, bound) in zip(axes, rows, strict=True):
        ax.plot(omega, sigma, label=rf"$\bar\sigma({name})$")
        if bound is not None and (name == "L" or problem.objective == "sum"):
            words = rf"bound, ${name}_\mathrm{{max}}$ = {bound:g}"
            ax.axhline(bound, color="tab:red", linestyle="--", label=words)
        if problem.objective == "sum":
            ax.axvspan(*problem.band, color="0.93", zorder=0, label="band")
        ax.set(
            xscale="log",
            xlabel="frequency (rad/s)",
            ylabel=rf"$\bar\sigma({name})$",
            ylim=(0, None),
        )
        ax.legend()
    return figure


def _of_trials(plt, trials):
    signals_of(
        trials, "reference", "v"
    )  # which checks that it has all that trials have
    errors, rows = rms_by_trial(trials.e), [*_rows(trials)]
    figure, axes = _axes(plt, len(errors.columns) + len(rows))
    for ax, (label, values) in zip(axes, errors.items(), strict=False):
        ax.semilogy(errors.index, values, "o-")
        ax.set(xlabel="trial", ylabel=_plain(label))
        ax.xaxis.get_major_locator().set_params(integer=True)
    for ax, (label, lines) in zip(axes[len(errors.columns) :], rows, strict=True):
        for name, values, style in lines:
            ax.plot(trials.time, values, style, label=_plain(name))
        ax.set(xlabel="time (s)", ylabel=_plain(label))
        ax.legend(ncols=2)
    return figure


def _rows(trials) -> Iterator[tuple[str, list]]:
    """A label, and the lines, of each axes of the last trial, one for a signal and a unit."""
    last = trials.isel(trial=-1).transpose("time", ...)
    for signal, role in (("y", "output"), ("v", "output"), ("u", "control")):
        if signal not in trials:
            continue
        for unit, channels in by_unit(trials[f"{role}_unit"].values.tolist()).items():
            lines = []
            for i in channels:
                name = f"{signal}: {trials[role].values[i]}"
                lines.append((name, last[signal].values[:, i], f"C{i}"))
                if signal == "y":
                    lines.append(("reference", last.reference.values[:, i], f"C{i}--"))
            yield with_unit(f"{signal} in trial {int(last.trial)}", unit), lines


def _plain(text):
    """A text from outside, which is no formula."""
    return text.replace("$", r"\$")
