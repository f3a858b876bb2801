"""The phase of the all-pass with given poles, and frequency grids with equal steps of this phase.

The all-pass has the poles a_j inside the unit circle, and the zeros 1 / conj(a_j). The increase of
its phase from frequency zero to the angle theta = omega Ts is

    phi(theta) = sum_j integral from 0 to theta of (1 - |a_j|^2) / |exp(j t) - a_j|^2 dt.

A response with the poles a_j can change quickly only where phi changes quickly, by the theorem in
:mod:`.evidence.peak`. Equal steps of phi therefore resolve all resonances. A single pole a
contributes a phase q to phi. Counted from the angle arg a, q runs from -pi to pi in one turn of
theta. This phase is q at the angle

    theta = arg a + 2 arctan((1 - |a|) / (1 + |a|) tan(q / 2)).
"""

import numpy as np

# values of tan(q / 2), from arg a outwards; between the angles of these values, phi is nearly
# linear
TANGENTS = np.append(0, np.outer([-1, 1], np.geomspace(0.05, 1e8, 50)))


def phase(poles, theta):
    """Return the phase phi of the all-pass with these poles at angles theta, (k,)."""
    others = poles[poles != 0]  # a pole at zero, such as of an FIR filter, adds theta to phi
    r, angle = np.abs(others)[:, None], np.angle(others)[:, None]
    shift = theta - angle
    # 1 - r cos(shift), without cancellation for poles next to the circle
    real = (1 - r) + 2 * r * np.sin(shift / 2) ** 2
    return len(poles) * theta + 2 * np.arctan(r * np.sin(shift) / real).sum(axis=0)


def phase_grid(systems, step, most=np.inf) -> np.ndarray:
    """Return angles from 0 to pi, between which phi increases by about `step` for each system.

    `systems` has one array of poles for each system. From 0 to pi, each pole of a real system adds
    pi to phi on average. If this needs more than `most` angles, the steps are larger.
    """
    step = max(step, np.pi * max(map(len, systems)) / most)
    poles = np.unique(np.concatenate(systems))
    r = np.abs(poles)[:, None]
    turns = np.angle(poles)[:, None] + 2 * np.arctan((1 - r) / (1 + r) * TANGENTS)
    turns = np.append(turns % (2 * np.pi), [0, np.pi])
    theta = np.unique(turns[turns <= np.pi])
    for _ in range(2):  # twice, as phi is not exactly linear between angles
        steps = np.max([np.diff(phase(each, theta)) for each in systems], axis=0)
        total = np.append(0, np.cumsum(steps))
        theta = np.interp(np.linspace(0, total[-1], 2 + int(total[-1] / step)), total, theta)
    return theta


def subdivided(omega, parts) -> np.ndarray:
    """Divide each step between neighbouring frequencies into `parts` equal steps."""
    steps = np.linspace(0, 1, parts, endpoint=False)
    return np.append((omega[:-1, None] + np.outer(np.diff(omega), steps)).ravel(), omega[-1])
