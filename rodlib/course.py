"""Trials under the ILC law for many rods: each trial at once, and several rods side by side."""

from collections.abc import Sequence

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from rodlib.held import HeldRod
from rodlib.specimens import Grid

ALIAS = 1e-9  # what is left of a sample after one turn of the transform
WRAP = 1.6  # lengths of a trial after which its transform begins anew


class Course:
    """A course of trials under the ILC law, simulated around one rod after the other.

    :func:`rodlib.run_trials` needs a model, and goes from sample to sample; here a whole trial is
    computed at once, for rods that have none. On a circle |z| = r > 1 the z-transform of a signal
    that is weighted by r^-p is a Fourier transform, and the loop is a product, if it is stable.
    What wraps around after N samples comes back as r^-N: nothing to speak of. Both filters are
    products, too, since beyond the ends of a trial signals are zero; to filter in time, as
    :func:`rodlib.update` does, would make a study take two thirds longer. The arguments are those
    of :func:`rodlib.run_trials`, checked before, and filters in the place of L.
    """

    def __init__(self, loop, Q, filters, reference, disturbance, trials, rest):
        self.loop, T = loop, len(reference)
        order = max(L.order for L in filters)
        poles = np.concatenate([np.roots(section[3:]) for section in Q.sections])
        tail = int(np.log(ALIAS**3) / np.log(np.abs(poles).max()))  # of Q, as far as it may wrap
        self.samples, self.N = T, next_fast_len(max(int(WRAP * T), T + order + tail), real=True)
        r = ALIAS ** (-1 / self.N)
        self.growth, self.decay = r ** np.arange(max(T, order)), r ** -np.arange(self.N)
        self.kept = T - rest
        omega = rfftfreq(self.N, loop.Ts / (2 * np.pi))
        self.grid = Grid(loop, omega, r)
        z = r * np.exp(1j * omega * loop.Ts)
        self.Q = _butterworth(Q, z) * _butterworth(Q, 1 / z)
        self.ahead = z ** np.arange(1, order + 1)[:, None]
        c = np.zeros((len(filters), *filters[0].coefficients.shape[:2], 2 * order))
        for f, L in enumerate(filters):
            c[f, :, :, : L.order] = L.coefficients
        self.L = np.einsum("fijk,kn->fijn", c[..., :order], self.ahead)
        # q samples before the trial, L sees c_(q + p) e(p).
        self.first = np.lib.stride_tricks.sliding_window_view(c, order, axis=3)[:, :, :, :order]
        self.w = self._transform(reference.T)
        self.d = [None] * trials
        if disturbance is not None:
            d = np.broadcast_to(disturbance, (trials, *disturbance.shape[-2:]))
            self.d = self._transform(np.swapaxes(d, 1, 2))

    def rms(self, rods: Sequence[HeldRod]) -> np.ndarray:
        """RMS(e_k) of every trial, shape (rods, filters, trials)."""
        P, P_d = self._closed(rods)
        V = np.zeros((len(rods), 1, *self.w.shape))  # one filter is like another as yet
        rms = np.empty((len(rods), len(self.L), len(self.d)))
        for k, d in enumerate(self.d):
            Y = np.einsum("gijn,gfjn->gfin", P, self.w + V)
            if d is not None:
                Y += np.einsum("gijn,jn->gin", P_d, d)[:, None]
            e = irfft(self.w - Y, self.N)  # weighted by r^-p
            e[..., self.samples :] = 0
            plain = e[..., : len(self.growth)] * self.growth
            rms[:, :, k] = np.sqrt(np.einsum("gfit,gfit->gf", plain, plain) / self.samples)
            if k + 1 < len(self.d):
                V = V + np.einsum("fijn,gfjn->gfin", self.L, rfft(e)) - self._before(plain)
                v = irfft(self.Q * V, self.N)
                v[..., self.kept :] = 0
                V = rfft(v)  # (23)
        return rms

    def _closed(self, rods):
        m, signals = len(self.w), self.loop.controls
        if self.d[0] is not None:
            signals = [*signals, *self.loop.disturbances]
        G = [self._transform(rod.impulse_response(self.N, signals)) for rod in rods]
        both = [self.grid.closed(each[:, :m], each[:, m:]) for each in G]
        return (np.array(each) for each in zip(*both, strict=True))

    def _before(self, e):
        """What L looks ahead to from before the trial, where it is not applied."""
        first = np.einsum("fijqp,gfjp->gfiq", self.first, e[..., : self.first.shape[-1]])
        return (first @ self.ahead.view(float)).view(complex)

    def _transform(self, signal):
        return rfft(signal * self.decay[: signal.shape[-1]], self.N)


def _butterworth(Q, z):
    """The forward half of the Q-filter."""
    return np.prod([np.polyval(s[:3], z) / np.polyval(s[3:], z) for s in Q.sections], axis=0)
