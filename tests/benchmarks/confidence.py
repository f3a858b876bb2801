"""How often the truth lies within all radii of a measurement of P, as notebook 10 makes it.

Many virtual rigs, alike but for their noise, are shaken side by side: by
`python tests/benchmarks/confidence.py [SEEDS]`. Some 20 seconds for 1000 seeds.
"""

import sys

import numpy as np

from rodlib import paper_loop
from rodlib.ilc import multisine
from rodlib.ilc.measurement.measurement import _estimate
from rodlib.ilc.measurement.region import radius_of
from rodlib.ilc.measurement.transient import windows_of
from rodlib.rigs import RigParameters, VirtualRig

MODES = 60
SIDE_BY_SIDE = 100
IDEAL = {"noise": 0.0, "quantum": 0.0, "ambient_rate": 0.0}


def shaken(loop, w, seeds, rng=None, restart=False, **parameters):
    """Outputs of many rigs for w (experiment, time, input), (rig, experiment, time, output)."""
    parameters = RigParameters(modes=MODES, **parameters)
    rig, m, n = (
        VirtualRig(parameters=parameters, Ts=loop.Ts),
        len(loop.controls),
        len(loop.Ks.T),
    )
    which = [rig.inputs.index(name) for name in loop.controls]
    held, lagging = rig._held[:, which], rig._lagging[:, which]
    A, B, C = loop.plant.A, loop.plant.B[:, :m], loop.plant.C
    y, time = np.empty((*w.shape, seeds)), 0.0
    for e, p in np.ndindex(w.shape[:2]):
        if p == 0 and (restart or e == 0):
            modes, flows = np.zeros((MODES, seeds)), np.zeros((m, seeds))
            x, delta, time = np.zeros((n, seeds)), np.zeros((m, seeds)), 0.0
        read = rig._sensors @ modes
        if parameters.noise:
            read = read + parameters.noise * rng.standard_normal(read.shape)
        if parameters.quantum:
            read = np.rint(read / parameters.quantum) * parameters.quantum
        y[e, p] = read
        u = loop.N @ w[e, p][:, None] - loop.Ks @ x - delta
        surprise = loop.KL @ (read - C @ x)
        x, delta = A @ x + B @ (u + delta) + surprise[:n], delta + surprise[n:]
        modes = rig._decay[:, None] * modes + held @ u + lagging @ (flows - u)
        modes[0] += rig._air * parameters.ambient_rate * time
        flows, time = u + rig._lag * (flows - u), time + loop.Ts
    return np.moveaxis(y, -1, 0)


def response(loop, omega, samples=4000):
    """The rig's own P, from a pulse in each input."""
    pulses = np.zeros((2, samples, 2))
    pulses[[0, 1], 0, [0, 1]] = 1.0
    h = np.moveaxis(shaken(loop, pulses, 1, restart=True, **IDEAL)[0], 0, -1)
    return np.tensordot(
        np.exp(-1j * loop.Ts * np.outer(omega, np.arange(samples))), h, 1
    )


def main(seeds):
    """Count, and print with one standard deviation."""
    loop, hours = paper_loop(), 6.0
    excitation = multisine(
        loop, 3.3 * 4 * np.pi / (3600 * hours), 0.3, 5.0, hours, lines=60
    )
    truth, windows = (
        response(loop, excitation.omega),
        windows_of(excitation.harmonics, excitation, loop),
    )
    last, n = slice(-excitation.evaluated, None), len(excitation.omega)
    within = {0.9: [], 0.95: [], 0.99: []}
    for batch in range(-(-seeds // SIDE_BY_SIDE)):
        rng = np.random.default_rng([SIDE_BY_SIDE * batch, 7])
        for y in shaken(loop, excitation.signals, SIDE_BY_SIDE, rng):
            of = _estimate(
                excitation.signals[:, last], y[:, last], windows, excitation, loop
            )
            off = np.linalg.norm(of.response - truth, 2, axis=(1, 2))
            for confidence, found in within.items():
                radius = radius_of(
                    of.noise, of.spread, of.freedom, 1 - confidence ** (1 / n)
                )
                found.append(np.all(off <= radius))
    for confidence, found in within.items():
        share = np.mean(found)
        error = np.sqrt(share * (1 - share) / len(found))
        print(f"{confidence:.0%}: {share:.2%} +- {error:.2%} of {len(found)} seeds")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
