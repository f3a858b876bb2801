"""What each constant of the estimator changes: the radius, and the worst error relative to it.

Halved and doubled, on 10 records each of three kinds; both are medians over the records, at 99 %
for all frequencies together.
"""

import warnings
from itertools import product

import numpy as np
from regions import KINDS, response
from runner import publish, run, table

from ilctools import measured_response
from ilctools.measurement import estimation
from ilctools.measurement.arx import delay, likelihood, quadrature, unknowns

RECORDS = 10
CHOSEN = "steps", "resonance, noise", "learning, 2 trials"
CONSTANTS = {
    "SHARE_OF_LAGS": unknowns,
    "CLOSE_KNOTS": unknowns,
    "KNOTS_STEP": unknowns,
    "DRIFT_KNOTS": unknowns,
    "HEAVY": quadrature,
    "LEAST_DELAY": delay,
    "CURVATURE_STEP": likelihood,
    "INDEPENDENT": estimation,
    "JOINT": estimation,
}


def worst(kind, seed):
    """The median radius, and the largest error relative to it."""
    log, plants = KINDS[kind](np.random.default_rng([seed, len(kind)]))
    with warnings.catch_warnings(action="ignore"):
        P = measured_response(log)
    radius = P.radius(0.99, jointly=True)
    off = np.linalg.norm(P.response - response(plants, P.omega), 2, axis=(1, 2))
    return np.median(radius), np.max(off / radius)


def changed(name, factor):
    """Of each kind, by a constant that is changed."""
    module = CONSTANTS[name]
    value = getattr(module, name)
    setattr(module, name, type(value)(value * factor))
    try:
        found = [[worst(kind, seed) for seed in range(RECORDS)] for kind in CHOSEN]
        return np.median(found, axis=1)
    finally:
        setattr(module, name, value)


def main():
    cases = [("SHARE_OF_LAGS", 1), *product(CONSTANTS, (0.5, 2))]
    (usual, *others), rows = run(changed, cases), []
    for (name, factor), found in zip(cases[1:], others, strict=True):
        relative = zip(found[:, 0] / usual[:, 0], found[:, 1], strict=True)
        cells = [f"{radius:.2f}, {off:.2f}" for radius, off in relative]
        rows.append([name, f"{getattr(CONSTANTS[name], name):g}", f"{factor:g}", *cells])
    rows.append(["none", "", "", *(f"1, {off:.2f}" for _, off in usual)])
    publish("constants", table(["constant", "value", "times", *CHOSEN], rows))


if __name__ == "__main__":
    main()
