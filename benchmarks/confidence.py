"""How often the truth lies within all radii of a measurement of P, as notebook 10 makes it.

The virtual rig is shaken with other noise again and again. Some four minutes for 100 seeds on two
cores; notebook 10 has the shares.
"""

import numpy as np
from runner import run

from ilctools import measured_response, multisine, shake
from rodlib import paper_loop
from rodlib.rigs import RigParameters, VirtualRig

SEEDS = 100
CONFIDENCES = (0.9, 0.95, 0.99)
HOURS = 6.0
LOOP = paper_loop()
EXCITATION = multisine(LOOP, 6.05 * 4 * np.pi / (3600 * HOURS), 0.3, 5.0, HOURS, lines=60)


def measured(seed, **parameters):
    rig = VirtualRig(parameters=RigParameters(modes=60, **parameters), seed=seed)
    return measured_response(shake(rig, LOOP, EXCITATION))


def response_and_radii(seed):
    response = measured(seed)
    return response.response, [response.radius(share, jointly=True) for share in CONFIDENCES]


def main(seeds=SEEDS):
    """Count, and print with one standard deviation."""
    # Without noise the measurement is within 1e-5 of P, a hundredth of the radii.
    truth = measured(0, noise=0.0, quantum=0.0, ambient_rate=0.0).response
    within = []
    for response, radii in run(response_and_radii, range(seeds)):
        off = np.linalg.norm(response - truth, 2, axis=(1, 2))
        within.append([np.all(off <= radius) for radius in radii])
    for confidence, share in zip(CONFIDENCES, np.mean(within, axis=0), strict=True):
        error = np.sqrt(share * (1 - share) / seeds)
        print(f"{confidence:.0%}: {share:.2%} +- {error:.2%} of {seeds} seeds")


if __name__ == "__main__":
    main()
