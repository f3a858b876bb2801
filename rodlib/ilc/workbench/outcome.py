"""From settings to what they give: a filter with its certificate, or the reason why there is none.

Every design is solved from nothing. To start from the last one would take half the time, but the
optimum is flat: coefficients would differ in the third digit with the way by which one came.
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
from rodlib.ilc.workbench.plants import TRIALS, Plant
from rodlib.ilc.workbench.settings import Settings


@dataclass(frozen=True)
class Outcome:
    """What the settings give: a design, or a message that says why there is none."""

    settings: Settings | None  # None if there is not even a plant
    design: Synthesis | None = None
    rms: tuple[
        float, ...
    ] = ()  # of the error by trial, all channels together, if simulated
    message: str = ""  # why there is no filter, and what would help
    M_max: float | None = (
        None  # from which on there is one, if that is all that it takes
    )
    findings: tuple[str, ...] = ()  # what speaks against the trials

    @property
    def line(self) -> str:
        """The certificate in a line, and what was found of a measurement and of the trials."""
        if self.design is None:
            return self.message
        findings = getattr(self.settings.plant.response, "findings", ())
        found = (f"the measurement: {text}" for text in findings)
        watched = (f"the trials: {text}" for text in self.findings)
        return "; ".join([certificate_line(self.design.certificate), *found, *watched])


def try_out(settings: Settings) -> Outcome:
    """Design a filter, certify it and simulate ten trials; never raise because of the settings.

    The same for the same settings, whatever was tried out before.
    """
    arguments.instance("settings", settings, Settings)
    try:
        plant = arguments.instance("plant", settings.plant, Plant)
        Q = settings.Q
        with warnings.catch_warnings(action="ignore"):  # they are in the line
            design = synthesise(
                plant.response, Q, settings.omega, settings.Ts, **settings.problem
            )
    except InfeasibleError as error:
        return Outcome(
            settings, message=str(error), M_max=_remedy(error.smallest_M_max)
        )
    except (ValueError, SolverError) as error:
        return Outcome(settings, message=str(error))
    if plant.loop.P is None:
        return Outcome(settings, design)
    samples, m = plant.reference.shape
    noise = settings.noise * np.random.default_rng(0).standard_normal(
        (TRIALS, samples, m)
    )
    with warnings.catch_warnings(record=True, action="always") as told:
        law = design.law(plant.rest)
        trials = run_trials(
            plant.loop, law, plant.reference, plant.disturbance, TRIALS, noise=noise
        )
    found = tuple(str(warning.message) for warning in told)
    return Outcome(
        settings, design, tuple(rms(trials.e).values.tolist()), findings=found
    )


def _remedy(smallest):
    """The next M_max of three digits that leaves the solver some room; None if there is none."""
    M_max = math.ceil(1000 * smallest + 0.05) / 1000
    return M_max if M_max < 1 else None


def certificate_line(certificate: Certificate) -> str:
    """What is known about a filter, in a line."""
    if certificate.problem.radius is not None:
        rate = f"σ(M) ≤ {certificate.grid_M:.4f} within the radius, at the design frequencies"
    elif certificate.proven:
        rate = f"σ(M) ≤ {certificate.all_M:.4f} at all frequencies"
    else:
        rate = f"σ(M) ≤ {certificate.all_M:.4f} between the samples, estimated"
    gain = f"σ(L) ≤ {certificate.all_L:.4g} at all frequencies"
    mean = f"mean σ(M) over the band {certificate.mean_M:.4f}"
    optimal = (
        f"objective {certificate.value:.4g}, none below {certificate.lower_bound:.4g}"
    )
    warned = [f"warning: {text}" for text in certificate.warnings]
    return "; ".join([rate, gain, mean, optimal, *warned])
