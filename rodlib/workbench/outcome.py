"""From settings to their outcome: a filter with its certificate, or why there is none."""

import math
import warnings
from dataclasses import dataclass

import numpy as np

from ilctools import InfeasibleError, arguments, synthesise
from ilctools.synthesis.result import Synthesis
from ilctools.trials.run import rms, run_trials
from rodlib.workbench.plant import TRIALS, Plant
from rodlib.workbench.settings import FREQUENCIES, Settings


@dataclass(frozen=True)
class Outcome:
    """What settings lead to: a design and its trials, or a message."""

    settings: Settings | None
    design: Synthesis | None = None
    rms: tuple[float, ...] = ()  # of the error by trial, all outputs
    message: str = ""  # why there is no filter
    M_max: float | None = None  # the smallest feasible, if that is the remedy
    warnings: tuple[str, ...] = ()  # of the trials

    @property
    def text(self) -> str:
        """The certificate, with what speaks against the trials; or the message."""
        if self.design is None:
            return self.message
        spoken = [f"WARNING: the trials: {text}" for text in self.warnings]
        return "\n".join([str(self.design.certificate), *spoken])


def try_out(settings: Settings) -> Outcome:
    """Design a filter, certify it and simulate ten trials.

    The outcome does not depend on what was tried out before. Settings that lead to no filter are
    not an error: the outcome's message says why.

    See Also
    --------
    Settings : the knobs
    plot : a picture of the outcome
    open_workbench : by hand

    Examples
    --------
    >>> from rodlib import Settings, paper_loop, try_out
    >>> from rodlib.workbench.plant import Plant
    >>> plant = Plant("rodlib.paper_loop()", paper_loop())
    >>> outcome = try_out(Settings.of(plant, order=10, M_max=0.8))
    >>> outcome.design.filter.order, len(outcome.rms)
    (10, 10)
    """
    arguments.instance("settings", settings, Settings)
    try:
        plant = arguments.instance("plant", settings.plant, Plant)
        noise_std = arguments.not_negative("noise", settings.noise, "zero or more")
        with warnings.catch_warnings(action="ignore"):  # the certificate has them
            design = synthesise(plant.loop, settings.Q, settings.omega, **settings.problem)
    except InfeasibleError as error:
        # The next bound of three digits that leaves the solver some room.
        M_max = math.ceil(1000 * error.smallest_M_max + 0.05) / 1000
        return Outcome(settings, message=_said(error), M_max=M_max if M_max < 1 else None)
    except (ValueError, ArithmeticError, RuntimeError) as error:
        return Outcome(settings, message=_said(error))
    law, reference = design.law(rest=plant.rest), plant.reference
    noise = noise_std * np.random.default_rng(0).standard_normal((TRIALS, *reference.shape))
    with warnings.catch_warnings(record=True, action="always") as record:
        trials = run_trials(plant.loop, law, reference, plant.disturbance, TRIALS, noise=noise)
    spoken = tuple(str(warning.message) for warning in record)
    return Outcome(settings, design, tuple(rms(trials.e).values.tolist()), warnings=spoken)


def _said(error):
    """An error of the synthesis, and where its arguments are that are no knobs."""
    beyond = "everywhere" in str(error) or "frequencies" in str(error)
    where = f". Here are {FREQUENCIES} frequencies, and bounds between them: others by synthesise"
    return f"{error}{where if beyond else ''}"
