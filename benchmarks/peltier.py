"""What helps on a rig with Peltier elements: ten draws of the noise, 40 trials, two hard cases.

It is what notebook 16 shows of fewer draws and trials: filters from measurements, anew in each
draw, others with other bounds, half the gain, and the inverse map from heat flow to current. The
table goes to figures/performance.md.
"""

import warnings
from dataclasses import replace

import numpy as np
from runner import publish, table

from ilctools import Law, measured_response, multisine, shake, synthesise, zero_phase_butterworth
from rodlib import (
    PeltierParameters,
    RestartingPeltierRig,
    Specimen,
    assumed_reference,
    paper_choices,
    paper_loop,
    responses,
)
from rodlib.peltier_rig import PeltierRigs, Recorded, learning_trials, one_trial

DRAWS, TRIALS, SEED, REST = 10, 40, 1, 15
CASES = {  # resistance of the elements, size of the reference
    "feasible": (2.0, 3.0),
    "not feasible": (6.0, 1.5),
}
OMEGA = np.geomspace(1e-4, np.pi, 250)
HOURS, AMPLITUDE, SHARE = 6.0, 3.0, 0.4  # of shaking; of the most that an element cools
LOOP, Q, R = paper_loop(), zero_phase_butterworth(2, 0.1, 1.0), assumed_reference()
P = PeltierParameters()
TWIN = RestartingPeltierRig().linearised


def parameters(resistance, inverse):
    """Of a rig with such elements, and with the inverse map or the proportional one."""
    element = replace(P.element, resistance=resistance)
    known = element if inverse else replace(element, resistance=0.0)
    return replace(P, element=element, known=known)


def shaken(draws):
    """P as measured at rest, and where elements 1 and 3 cool, in each draw."""
    own, inverse = (parameters(2.0, known) for known in (False, True))
    most = RestartingPeltierRig(parameters=inverse).limits["Q1"][0]
    flows = np.repeat([0.0, SHARE * most], draws)[:, None] * [1.0, 0.0, 1.0, 0.0]
    seeds = [*range(SEED, SEED + draws)] * 2
    rigs = PeltierRigs([replace(own, ambient_rate=0.0)] * len(seeds), seeds)
    plan = multisine(LOOP, 3.3 * 4 * np.pi / (3600 * HOURS), 0.3, AMPLITUDE, HOURS, lines=60)
    w = np.concatenate(plan.signals)
    around = Around(rigs, flows)
    signals = one_trial(around, LOOP, np.broadcast_to(w, (len(seeds), *w.shape)))
    experiments = zip(*(np.split(each, len(plan.signals), axis=1) for each in signals), strict=True)
    experiments, measured = [*experiments], []
    for i in range(len(seeds)):
        own = [(y[i], u[i]) for y, u in experiments]
        log = shake(Recorded(own, LOOP.controls, restarts=False), LOOP, plan)
        measured.append(measured_response(log))
    return measured[:draws], measured[draws:]


class Around:
    """Rigs about the point to which heat flows bring them."""

    def __init__(self, rigs, flows):
        self.inputs, self.rigs, self.flows = rigs.inputs, rigs, flows
        for _ in range(3000):
            rigs.apply(flows)
        self.level = np.mean([rigs.read() for _ in range(400)], axis=0)

    def read(self):
        """What differs from that point."""
        return self.rigs.read() - self.level

    def apply(self, commands):
        """Heat flows besides those of that point."""
        self.rigs.apply(self.flows + commands)


def frozen(*slopes):
    """P with each slope for each of the two elements."""
    gains = [(first, 1.0, third, 1.0) for first in slopes for third in slopes]
    return responses(LOOP, [Specimen(TWIN, each) for each in gains], OMEGA)


def designs_of(draws):
    """Designs of one law for all draws, or of one for each."""
    at_rest, cooling = shaken(draws)
    bounds = {"omega": OMEGA, "Ts": LOOP.Ts} | paper_choices(M_max=0.95, L_max=50.0)
    plants = [LOOP.frequency_response(OMEGA), *frozen(0.3, 1.0, 1.5)]
    return {
        "the paper's": [synthesise(LOOP, Q, OMEGA, LOOP.Ts, **paper_choices())],
        "measured at rest": [synthesise(each, Q, **bounds) for each in at_rest],
        "measured cooling": [synthesise(each, Q, **bounds) for each in cooling],
        "model, 0.95": [synthesise(LOOP, Q, **bounds)],
        "cooling, 4 L_max": [synthesise(cooling[0], Q, **bounds | {"L_max": 200.0})],
        "robust": [synthesise(plants, Q, **bounds | {"M_max": 0.98})],
    }


def learned(ways, draws, trials):
    """RMS, shape (case, way, draw, trial); and of each case the controls of a first trial."""
    laws = [law for of in ways.values() for law in np.resize(of, draws)] * len(CASES)
    each = [
        parameters(resistance, name == "inverse map")
        for resistance, _ in CASES.values()
        for name in ways
        for _ in range(draws)
    ]
    seeds = [SEED + draw for draw in range(draws)] * (len(laws) // draws)
    tasks = [size * R for _, size in CASES.values()]
    tasks = np.repeat(tasks, len(ways) * draws, axis=0)
    errors, first = [], None
    for y, u in learning_trials(PeltierRigs(each, seeds), LOOP, laws, tasks, trials):
        errors.append(np.sqrt(np.mean(np.sum((tasks - y) ** 2, axis=2), axis=1)))
        first = u[:: len(ways) * draws] if first is None else first
    errors = np.transpose(errors).reshape(len(CASES), len(ways), draws, trials)
    return errors, first


def rate(design, resistance, controls):
    """That of the filter over the slopes of a trial, each for each of the two elements."""
    flow = P.element.seebeck * P.temperature  # W/A
    ends = np.array([controls.min(), controls.max()]).clip(-6 * flow, 6 * flow)
    low, high = 1 + resistance * ends / flow**2
    return design.check(frozen(low, 1.0, high), OMEGA).gamma if low > 0 else np.inf


def ends(values):
    """The least and the largest."""
    return " to ".join(dict.fromkeys(f"{end:.2g}" for end in (min(values), max(values))))


TITLES = ["case", "way", "rate", "RMS of trial 10 (K)", "trial 20", "least", "last"]


def rows(draws, trials):
    """The rows of the table, case by case."""
    designs = designs_of(draws)
    ways = {
        name: [Law(Q, design.filter, REST, limits={}) for design in of]
        for name, of in designs.items()
    }
    (law,) = ways["the paper's"]
    ways |= {"gain 0.5": [replace(law, gain=0.5)], "inverse map": [law]}
    cases = zip(CASES.items(), *learned(ways, draws, trials), strict=True)
    for (case, (resistance, _)), errors, controls in cases:
        for name, e in zip(ways, errors, strict=True):
            of = designs.get(name, [])
            rates = [rate(design, resistance, controls) for design in of]
            found = (*(e[:, min(trials, k) - 1] for k in (10, 20)), e.min(axis=1), e[:, -1])
            yield [case, name, ends(rates) if rates else "", *map(ends, found)]


if __name__ == "__main__":
    with warnings.catch_warnings(action="ignore"):  # of what was shaken
        publish("peltier", table(TITLES, [*rows(DRAWS, TRIALS)]) + "\n")
