"""The phase of poles on the unit circle, and frequency grids with equal steps of this phase.

    phi(theta) = sum_j integral from 0 to theta of (1 - |a_j|^2) / |exp(j t) - a_j|^2 dt

The poles a_j lie inside the unit circle. The phase phi limits how fast a response can bend, by the
theorem in :mod:`.evidence.peak`. The phase q of a single pole, counted from arg a, runs from -pi to
pi in one turn. The pole reaches q at the angle

    theta = arg a + 2 arctan((1 - |a|) / (1 + |a|) tan(q / 2)).
"""

import numpy as np

# tan(q / 2), from the middle of a turn to far from its pole, between which phi is nearly straight
TANGENTS = np.append(0, np.outer([-1, 1], np.geomspace(0.05, 1e8, 50)))


def phase(poles, theta):
    """Return the phase phi of the all-pass with these poles, at angles theta, (k,)."""
    others = poles[poles != 0]  # a pole at zero, as of each tap, adds theta alone
    r, angle = np.abs(others)[:, None], np.angle(others)[:, None]
    shift = theta - angle
    # 1 - r cos(shift), without cancellation for poles next to the circle
    real = (1 - r) + 2 * r * np.sin(shift / 2) ** 2
    return len(poles) * theta + 2 * np.arctan(r * np.sin(shift) / real).sum(axis=0)


def phase_grid(systems, step, most=np.inf) -> np.ndarray:
    """Return angles from 0 to pi, with steps of about `step` in the phase of each set of poles.

    The phase of each pole of a real system turns by pi. If steps of `step` would need more than
    `most` angles, the steps are larger.
    """
    step = max(step, np.pi * max(map(len, systems)) / most)
    poles = np.unique(np.concatenate(systems))
    r = np.abs(poles)[:, None]
    turns = np.angle(poles)[:, None] + 2 * np.arctan((1 - r) / (1 + r) * TANGENTS)
    turns = np.append(turns % (2 * np.pi), [0, np.pi])
    theta = np.unique(turns[turns <= np.pi])
    for _ in range(2):  # between such shares phi is not quite straight
        steps = np.max([np.diff(phase(each, theta)) for each in systems], axis=0)
        total = np.append(0, np.cumsum(steps))
        theta = np.interp(np.linspace(0, total[-1], 2 + int(total[-1] / step)), total, theta)
    return theta


def subdivided(omega, parts) -> np.ndarray:
    """Divide each step of a row of frequencies into `parts` equal steps."""
    steps = np.linspace(0, 1, parts, endpoint=False)
    return np.append((omega[:-1, None] + np.outer(np.diff(omega), steps)).ravel(), omega[-1])
