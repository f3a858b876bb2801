"""A line of a spectrum without the transient, and its noise: from the lines around it."""

from dataclasses import dataclass

import numpy as np

from ilctools.loop.closed import CurrentTrialLoop, with_noise
from ilctools.models import frequency_response

DEGREE = 2  # of the polynomial that the transient is, locally
NEIGHBOURS = 16  # lines at most around one, which estimate transient and noise
# Up to this multiple of a line: from zero on, the mean square of the frequency is then that of the
# line, so that the mean of noise is right that rises with frequency, as below the loop's bandwidth.
SPAN = np.sqrt(3)


@dataclass(frozen=True)
class Window:
    """The lines around one, and how the transient there follows from them."""

    line: int
    neighbours: np.ndarray
    weights: np.ndarray  # of the neighbours, for the transient at the line
    residual: np.ndarray  # projection: what the polynomial leaves of the neighbours
    power: np.ndarray  # of the noise at the neighbours, relative to the line, (neighbour, output)

    @property
    def left(self) -> np.ndarray:
        """Power of the noise in what the polynomial leaves, likewise, (output,)."""
        return np.diag(self.residual).real @ self.power

    @property
    def freedom(self) -> float:
        """Complex degrees of freedom of the noise, for each experiment."""
        # Satterthwaite's; neighbours minus coefficients where all of them have the same noise.
        squares = np.einsum("qj,qr,rj->j", self.power, np.abs(self.residual) ** 2, self.power)
        return float(np.min(self.left**2 / squares))

    @property
    def variance(self) -> np.ndarray:
        """Of the line without the transient, relative to the noise at it, (output,)."""
        return 1 + np.abs(self.weights) ** 2 @ self.power


def windows_of(harmonics, excitation, loop):
    """Of each harmonic the nearest lines that are none."""
    model = loop.closed if isinstance(loop, CurrentTrialLoop) else loop.P
    pole = 0 if model is None else np.abs(model.poles()).max(initial=0)
    pole = pole or 1 - 2 * np.pi / excitation.period  # if unknown, as slow as is shaken
    evaluated, windows = excitation.evaluated, []
    for line in excitation.periods * np.array(harmonics):
        lines = np.arange(1, min(int(SPAN * line) + 1, (evaluated + 1) // 2))
        near = nearest_lines(line, lines[lines % excitation.periods > 0])
        z = np.exp(2j * np.pi * np.append(line, near) / evaluated)
        warped = 1 / (1 - pole / z[1:]) - 1 / (1 - pole / z[0])
        powers = np.vander(warped / np.abs(warped).max(), DEGREE + 1, increasing=True)
        inverse = np.linalg.pinv(powers)
        omega = 2 * np.pi * np.append(line, near) / (evaluated * loop.Ts)
        passed = noise_passed(loop, omega)
        residual = np.eye(len(near)) - powers @ inverse
        windows.append(Window(line, near, inverse[0], residual, passed[1:] / passed[0]))
    return windows


def noise_passed(loop, omega):
    """Power of what white sensor noise leaves in each output; as white, if the loop is not ours."""
    m = len(loop.outputs)
    if not isinstance(loop, CurrentTrialLoop):
        return np.ones((len(omega), m))
    response = np.eye(m) + frequency_response(with_noise(loop)[:, -m:], omega)
    return np.abs(np.einsum("rjj->rj", response)) ** 2


def nearest_lines(line, lines):
    """Those of some lines that are nearest to one."""
    return lines[np.argsort(np.abs(lines - line), kind="stable")[:NEIGHBOURS]]


def separated(y, windows):
    """Lines without transient (line, output, experiment), their noise, its degrees of freedom."""
    Y = np.fft.rfft(y, axis=1)
    net, noise = [], []
    for window in windows:
        around = Y[:, window.neighbours]
        net.append(Y[:, window.line] - np.einsum("r,erj->ej", window.weights, around))
        left = np.einsum("qr,erj->eqj", window.residual, around)
        power = np.einsum("eqj,eqk->jk", left, left.conj()) / len(y)
        scale = np.sqrt(window.variance / window.left)
        noise.append(scale[:, None] * power * scale)
    freedom = np.array([len(y) * window.freedom for window in windows])
    return np.array(net).transpose(0, 2, 1), np.array(noise), freedom
