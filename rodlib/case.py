"""The paper's case, Section IV: its current-trial loop, with assumed reference and disturbances.

The reference trajectories and disturbances are published only as a plot (Fig. 7).
:func:`assumed_reference` and :func:`assumed_disturbance` therefore replace them.
"""

from collections.abc import Sequence

import control
import numpy as np

from ilctools import arguments
from ilctools.loop.closed import CurrentTrialLoop
from ilctools.loop.design import current_trial_loop
from ilctools.models import minimal_realisation
from rodlib.rod import PAPER_ROD, Rod, midr

MOVES = (  # for each output: up, to the second plateau, down; begin and end of each move, s of 2500
    ((100, 700), (1000, 1400), (1700, 2300)),
    ((200, 900), (1200, 1500), (1700, 2350)),
)


def paper_choices(**changes) -> dict:
    """Return the paper's choices for the synthesis, Section IV-B; arguments replace choices.

    The choices are keyword arguments of :func:`ilctools.synthesise`. L_max is in K/K, and the band
    is in rad/s. The paper's L is a finite filter, which `base` = None asks for. The paper's design
    frequencies are ``np.geomspace(1e-4, np.pi, 1000)`` rad/s.

    See Also
    --------
    synthesise : takes these choices
    paper_loop : the loop for these choices

    Examples
    --------
    >>> from ilctools import synthesise, zero_phase_butterworth
    >>> from rodlib import paper_choices, paper_loop
    >>> Q = zero_phase_butterworth(2, 0.1, 1.0)
    >>> design = synthesise(paper_loop(), Q, **paper_choices(structure="full"))
    >>> round(float(design.sigma_M.max()), 4)
    0.883
    """
    papers = {
        "order": 10,
        "M_max": 0.9,
        "L_max": 50.0,
        "band": (1e-4, 0.02),
        "structure": "diagonal",
        "base": None,
    }
    return papers | changes


def paper_loop(rod: Rod = PAPER_ROD, degree: int = 3, Ts: float = 1.0) -> CurrentTrialLoop:
    """Build the paper's current-trial loop, Section IV.

    Parameters
    ----------
    rod : Rod
        Default: the paper's rig.
    degree : int, default 3
        Degree M of the polynomials in :func:`rodlib.midr`.
    Ts : float, default 1.0
        Sampling period, s.

    Returns
    -------
    CurrentTrialLoop
        The loop has the controls Q1 and Q3 (W), the disturbances theta_a (K), Q2 and Q4 (W), and
        the outputs y1 and y2 (K).

    See Also
    --------
    current_trial_loop : the loop around another plant
    paper_choices : the paper's bounds on the filter

    Examples
    --------
    >>> from rodlib import paper_loop
    >>> paper_loop().N.round(4)
    array([[ 4.6935, -2.4303],
           [ 1.5513,  4.6324]])
    """
    arguments.instance("rod", rod, Rod)
    # Beyond this range, states cannot be distinguished. The poles of the loop would come closer
    # to the unit circle than the square root of rounding, the accuracy of a Riccati solver.
    what = "a sampling period between 1e-5 and 1e4 s"
    Ts = arguments.number("Ts", Ts, what, 1e-5, 1e4)
    if (rod.sections, len(rod.sensors)) != (4, 2):
        raise ValueError(
            f"rod has {rod.sections} sections and {len(rod.sensors)} sensors, but the paper's "
            "loop has the inputs Q1 to Q4 and two sensors: for another rod, use "
            "minimal_realisation and current_trial_loop"
        )
    model = minimal_realisation(midr(rod, degree), ["Q1", "Q3"])
    model = model[:, ["Q1", "Q3", "theta_a", "Q2", "Q4"]]  # d in the order of (10) of the paper
    units = dict.fromkeys(rod.inputs, "W") | dict.fromkeys(["theta_a", *rod.outputs], "K")
    plant = control.sample_system(model, Ts, method="zoh")
    return current_trial_loop(plant, controls=["Q1", "Q3"], units=units)


def assumed_reference(
    samples: int = 2500,
    steepness: float = 1.0,
    plateaus: Sequence[Sequence[float]] = ((10.0, 6.0), (8.0, 10.0)),
) -> np.ndarray:
    """Return an assumed reference trajectory, because the paper gives only a plot (Fig. 7).

    Both outputs start and end at the initial ambient temperature. In between they stay at two
    plateaus. From one level to the next they follow quintic steps, whose first and second
    derivatives are continuous.

    Parameters
    ----------
    samples : int, default 2500
        Length of the trial. The shape is stretched to this length.
    steepness : float, default 1.0
        Steepness of the steps, relative to the default; at least 0.7. The plateaus and the time of
        the middle of each step do not change, but no step begins before the trial.
    plateaus : array_like, shape (2, 2), default ((10, 6), (8, 10))
        The two plateaus of each output, in K above the initial ambient temperature.

    Returns
    -------
    ndarray, shape (samples, 2)
        The reference, in K above the initial ambient temperature.

    See Also
    --------
    assumed_disturbance : the disturbance of the same trials
    run_trials : trials with reference and disturbance

    Examples
    --------
    >>> from rodlib import assumed_reference
    >>> assumed_reference().max(axis=0).round(2)
    array([10., 10.])
    >>> assumed_reference(plateaus=[(12, 6), (8, 4)]).max(axis=0).round(2)
    array([12.,  8.])
    """
    samples = arguments.whole("samples", samples, 1)
    what = "0.7 or more, because slower moves do not end within the trial"
    steepness = arguments.number("steepness", steepness, what, least=0.7)
    plateaus = arguments.array("plateaus", plateaus, (2, 2))
    time = np.arange(samples) / samples * 2500

    def step(start, stop):
        duration = (stop - start) / steepness
        begins = max((start + stop - duration) / 2, 0)
        s = np.clip((time - begins) / duration, 0, 1)
        return s**3 * (10 - 15 * s + 6 * s**2)

    outputs = [
        first * step(*up) + (second - first) * step(*across) - second * step(*down)
        for (first, second), (up, across, down) in zip(plateaus, MOVES, strict=True)
    ]
    return np.stack(outputs, axis=1)


def assumed_disturbance(
    samples: int = 2500,
    trials: int = 10,
    first: int = 5,
    flows: Sequence[float] = (5.0, -4.0),
    duration: float = 0.5,
) -> np.ndarray:
    """Return assumed disturbances for Fig. 7: a pulse of Q2 and Q4, from one trial on.

    Parameters
    ----------
    samples : int, default 2500
        Length of a trial.
    trials : int, default 10
        Number of trials.
    first : int, default 5
        First trial with the disturbance, counted from 1. All later trials have the same
        disturbance.
    flows : array_like, shape (2,), default (5, -4)
        Peaks of Q2 and Q4, in W.
    duration : float, default 0.5
        Length of a pulse, as a share of the trial; at most 0.7. Q2 begins at 0.2 of the trial, and
        Q4 begins at 0.3.

    Returns
    -------
    ndarray, shape (trials, samples, 3)
        Ambient temperature (K, zero) and heat flows Q2 and Q4 (W).

    See Also
    --------
    assumed_reference : the reference of the outputs
    run_trials : trials with reference and disturbance

    Examples
    --------
    >>> from rodlib import assumed_disturbance
    >>> assumed_disturbance(samples=2500, trials=10, first=5).shape
    (10, 2500, 3)
    """
    samples = arguments.whole("samples", samples, 1)
    trials = arguments.whole("trials", trials, 1)
    first = arguments.whole("first", first, 1)
    flows = arguments.array("flows", flows, (2,))
    what = (
        "above 0 and at most 0.7 of the trial, because a longer pulse does not end within the trial"
    )
    duration = arguments.number("duration", duration, what, low=0, most=0.7)
    phase = np.arange(samples) / samples
    pulse = np.clip((phase[:, None] - [0.2, 0.3]) / duration, 0, 1)
    disturbance = np.zeros((trials, samples, 3))
    disturbance[first - 1 :, :, 1:] = flows * np.sin(np.pi * pulse) ** 2
    return disturbance
