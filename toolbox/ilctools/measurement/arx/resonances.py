"""Find resonances that the residual shows, and add resonant parts at their frequencies.

By the prior, coefficients decay over some samples. A lightly damped resonance decays far more
slowly. If its peak is below the noise, or next to a larger peak, the regression smooths the peak,
and its radius does not show this error. The residual of the regression then depends on the input.
A test at each frequency of a grid shows this dependence (residual analysis, L. Ljung, System
Identification, 1999, section 16.6). The test is the score test (1) and (2) in
:mod:`..consistency`. Its columns Z are the answers of the resonant parts to all inputs, filtered by
A.

A frequency is noticeable if F has a peak there that is larger than chance allows. A finer grid
around the peak gives the frequency of the resonance. The regression gets resonant parts (see
`parts`) at the frequencies of the highest peaks, and the test is repeated with the new residual.

*Where the test is not made.* In learning, the input of a trial follows from the outputs of earlier
trials of its group, and therefore contains what repeats in the outputs. The residual then depends
on the input even without a resonance. Groups of several trials are not tested for this reason. In
very long trials the test would take too much time.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import find_peaks, lfilter
from scipy.special import fdtri

from ilctools.measurement.arx.likelihood import Fit, likeliest
from ilctools.measurement.arx.parts import RESONANT, answers, resonant_poles
from ilctools.measurement.arx.posterior import Posterior, posterior
from ilctools.measurement.arx.regressors import Data, Regressors, data_of, line_of
from ilctools.measurement.arx.trials import Trials, longest_of, series_of

TESTS = 2  # how often the residual is tested: the second test finds what a larger peak had hidden
# Expected number of noticeable frequencies without a resonance. What is added then changes little.
BY_CHANCE = 0.05
# Least frequency that is tested, in 1 / (the longest trial). A trial has six of its periods; with
# fewer, a resonance is like any other response.
LOWEST = 40.0
MOST_AT_ONCE = 6  # resonances that one test may add, because they take time
SAMPLES_PER_FREQUENCY = 4  # of the longest trial, for each frequency that is tested
LONGEST_TESTED = 4096  # samples of a trial, because the time grows with their square
FINER = np.linspace(-0.5, 0.5, 9)  # the finer grid around a peak, in steps of the first grid
FREQUENCIES_AT_ONCE = 64  # whose columns Z are in memory together
DEPENDENT = 1e-9  # relative to Z' W Z: a smaller J is rounding


def with_resonances(fit: Fit, groups: Sequence[Trials], direct: bool, gain=()) -> Fit:
    """Add resonant parts to a fit where the residual shows resonances.

    `data_of` explains `direct` and `gain`.
    """
    alone = all(len(group.y) == 1 for group in groups)
    for _ in range(TESTS if alone and longest_of(groups) <= LONGEST_TESTED else 0):
        more = noticeable(fit, groups)
        if not len(more):
            break
        layout = fit.data.layout
        resonances = np.append(layout.resonances, more)
        data = data_of(groups, direct, layout.delays, gain, resonances)
        fit = likeliest(data, [fit.eta])
    return fit


def noticeable(fit: Fit, groups: Sequence[Trials]) -> np.ndarray:
    """Find the angles omega Ts of resonances that the residual of a fit shows."""
    longest, at = longest_of(groups), posterior(fit.eta, fit.data)
    step = np.pi * SAMPLES_PER_FREQUENCY / longest
    omega = np.arange(step, np.pi, step)
    omega = omega[omega > LOWEST / longest]
    F, k, n = statistic(fit.data, at, groups, omega)
    most = fdtri(k, n, 1 - BY_CHANCE / max(len(omega), 1))
    peaks, _ = find_peaks(np.pad(F, 1), height=most)  # local maxima, counted from one
    found = omega[peaks - 1][np.argsort(-F[peaks - 1])][:MOST_AT_ONCE]
    near = found[:, None] + step * FINER
    F = statistic(fit.data, at, groups, near.ravel()).F.reshape(near.shape)
    return near[np.arange(len(near)), np.argmax(F, axis=1)]


class Sums(NamedTuple):
    """Sums over all series, for the k columns Z of each of n frequencies."""

    q: np.ndarray  # Z' W (y - X x), (n, k)
    ZZ: np.ndarray  # Z' W Z, (n, k, k)
    XZ: np.ndarray  # X' W Z, (unknown, n, k)


class Statistic(NamedTuple):
    """The F of each frequency, and the degrees of freedom of its distribution by chance."""

    F: np.ndarray  # (frequency,)
    k: int
    n: int


def statistic(data: Data, at: Posterior, groups: Sequence[Trials], omega: np.ndarray) -> Statistic:
    """Compute F, (2) in consistency, at each angle omega Ts."""
    q, ZZ, XZ = _sums(data, at.mean, groups, omega)
    k = q.shape[1]
    known = at.whitened(XZ.reshape(len(XZ), -1)).reshape(XZ.shape)
    J = ZZ - np.einsum("xni,xnj->nij", known, known)  # (1) in consistency
    J += DEPENDENT * np.einsum("nii->n", ZZ)[:, None, None] * np.eye(k)
    explained = np.einsum("ni,ni->n", q, np.linalg.solve(J, q[..., None])[..., 0])
    return Statistic(data.n * explained / (k * at.r), k, data.n)  # (2) in consistency


def _sums(data, mean, groups, omega):
    """Compute the sums; the groups have one trial each, whose weight W is one."""
    layout, inputs = data.layout, groups[0].u.shape[2]
    poles, A = resonant_poles(longest_of(groups), omega), layout.denominator(mean)
    n, k = len(omega), 2 * len(RESONANT) * inputs
    sums = Sums(np.zeros((n, k)), np.zeros((n, k, k)), np.zeros((layout.size, n, k)))
    for series in series_of(groups):
        X, y = Regressors(series, layout).rows()[:, layout.skipped :], series.y[layout.skipped :]
        line = line_of(len(y))
        X, y = (signal - signal @ line @ line.T for signal in (X, y))
        Au = lfilter(A, [1], series.u, axis=0)
        for first in range(0, n, FREQUENCIES_AT_ONCE):
            now = slice(first, first + FREQUENCIES_AT_ONCE)
            Z = _columns(poles[now], Au)[..., layout.skipped :]
            on_line = Z @ line
            sums.q[now] += Z @ (y - mean @ X)
            sums.ZZ[now] += Z @ Z.swapaxes(1, 2) - on_line @ on_line.swapaxes(1, 2)
            sums.XZ[:, now] += np.tensordot(X, Z, (1, 2))
    return sums


def _columns(poles, Au):
    """Compute the transpose of Z for each frequency, shape (frequency, k, time)."""
    s = np.concatenate([answers(poles, u) for u in Au.T], axis=1)
    return np.concatenate([s.real, s.imag], axis=1)
