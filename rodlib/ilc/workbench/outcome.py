"""From settings to their outcome: a filter with its certificate, or why there is none.

Every design is solved from zero. A warm start would take half the time, but the optimum is flat:
coefficients would differ in the third digit with the settings that came before.
"""

import math
import warnings
from dataclasses import dataclass

import numpy as np

from rodlib.ilc import (
    Certificate,
    InfeasibleError,
    SolverError,
    Synthesis,
    arguments,
    synthesise,
)
from rodlib.ilc.trials.run import rms, run_trials
from rodlib.ilc.workbench.plant import TRIALS, Plant
from rodlib.ilc.workbench.settings import Settings


@dataclass(frozen=True)
class Outcome:
    """What settings lead to: a design and its trials, or a message."""

    settings: Settings | None  # None if there is not even a plant
    design: Synthesis | None = None
    rms: tuple[float, ...] = ()  # of the error by trial, all outputs, if simulated
    message: str = ""  # why there is no filter, and the remedy
    M_max: float | None = None  # the smallest feasible, if that is the remedy
    warnings: tuple[str, ...] = ()  # of the trials

    @property
    def line(self) -> str:
        """The certificate in a line, with the warnings; or the message."""
        if self.design is None:
            return self.message
        measurement = getattr(self.settings.plant.response, "findings", ())
        parts = [certificate_line(self.design.certificate)]
        parts += [f"the measurement: {text}" for text in measurement]
        parts += [f"the trials: {text}" for text in self.warnings]
        return "; ".join(parts)


def try_out(settings: Settings) -> Outcome:
    """Design a filter, certify it and simulate ten trials.

    The outcome does not depend on what was tried out before. Settings that lead to no filter are
    not an error: the outcome's message says why.
    """
    arguments.instance("settings", settings, Settings)
    try:
        plant = arguments.instance("plant", settings.plant, Plant)
        noise_std = arguments.not_negative("noise", settings.noise, "zero or more")
        with warnings.catch_warnings(action="ignore"):  # they are in the line
            design = synthesise(
                plant.response,
                settings.Q,
                settings.omega,
                settings.Ts,
                **settings.problem,
            )
    except InfeasibleError as error:
        M_max = _rounded_up(error.smallest_M_max)
        return Outcome(settings, message=str(error), M_max=M_max if M_max < 1 else None)
    except (ValueError, SolverError) as error:
        return Outcome(settings, message=str(error))
    if plant.loop.P is None:
        return Outcome(settings, design)
    shape = TRIALS, *plant.reference.shape
    noise = noise_std * np.random.default_rng(0).standard_normal(shape)
    with warnings.catch_warnings(record=True, action="always") as record:
        trials = run_trials(
            plant.loop, settings.Q, design.filter, plant.reference, plant.disturbance,
            TRIALS, noise=noise, rest=plant.rest,
        )  # fmt: skip
    return Outcome(
        settings,
        design,
        rms=tuple(rms(trials.e).values.tolist()),
        warnings=tuple(str(warning.message) for warning in record),
    )


def _rounded_up(smallest):
    """The next M_max of three digits that leaves the solver some room."""
    return math.ceil(1000 * smallest + 0.05) / 1000


def certificate_line(certificate: Certificate) -> str:
    """The certificate of a filter in a line."""
    if certificate.problem.radius is not None:
        rate = f"{certificate.grid_M:.4f} within the radius, at the design frequencies"
    elif certificate.proven:
        rate = f"{certificate.all_M:.4f} at all frequencies"
    else:
        rate = f"{certificate.all_M:.4f} between the samples, estimated"
    parts = [
        f"σ(M) ≤ {rate}",
        f"σ(L) ≤ {certificate.all_L:.4g} at all frequencies",
        f"mean σ(M) over the band {certificate.mean_M:.4f}",
        f"objective {certificate.value:.4g}, none below {certificate.lower_bound:.4g}",
    ]
    parts += [f"warning: {text}" for text in certificate.warnings]
    return "; ".join(parts)
