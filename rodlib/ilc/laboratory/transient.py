"""A line of a spectrum without the transient, and its noise: from the lines around it."""

from dataclasses import dataclass

import numpy as np

DEGREE = 2  # of the polynomial that the transient is, locally
NEIGHBOURS = 16  # lines at most around one, from which transient and noise are told
# Up to this multiple of a line: from zero on, the mean square of the frequency is then that of the
# line, so that noise is told right that rises with frequency, as below the bandwidth of the loop.
SPAN = np.sqrt(3)


@dataclass(frozen=True)
class Window:
    """The lines around one, and how the transient there follows from them."""

    line: int
    neighbours: np.ndarray
    weights: np.ndarray  # of the neighbours, for the transient at the line
    residual: np.ndarray  # projection: what the polynomial leaves of the neighbours

    @property
    def freedom(self) -> int:
        """Complex degrees of freedom of the noise, for each experiment."""
        return len(self.neighbours) - DEGREE - 1

    @property
    def variance(self) -> float:
        """Of the line without the transient, relative to the noise."""
        return 1 + np.sum(np.abs(self.weights) ** 2)


def windows_of(harmonics, excitation, loop):
    """Of each harmonic the nearest lines that are none."""
    pole = loop.slowest or 1 - 2 * np.pi / excitation.period  # if unknown, as slow as is shaken
    evaluated, windows = excitation.evaluated, []
    for line in excitation.periods * np.array(harmonics):
        lines = np.arange(1, min(int(SPAN * line) + 1, (evaluated + 1) // 2))
        near = nearest(line, lines[lines % excitation.periods > 0])
        z = np.exp(2j * np.pi * np.append(line, near) / evaluated)
        warped = 1 / (1 - pole / z[1:]) - 1 / (1 - pole / z[0])
        powers = np.vander(warped / np.abs(warped).max(), DEGREE + 1, increasing=True)
        inverse = np.linalg.pinv(powers)
        windows.append(Window(line, near, inverse[0], np.eye(len(near)) - powers @ inverse))
    return windows


def nearest(line, lines):
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
        power = np.einsum("eqj,eqk->jk", left, left.conj()) / (len(y) * window.freedom)
        noise.append(window.variance * power)
    freedom = np.array([len(y) * window.freedom for window in windows])
    return np.array(net).transpose(0, 2, 1), np.array(noise), freedom
