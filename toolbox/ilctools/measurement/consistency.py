"""Is it one linear plant? Score tests of what a linear plant that stays as it is cannot do.

Of y = X x + Z delta + e, with x ~ N(0, s^2 D) and e ~ N(0, s^2 W^-1), the regression supposes
delta = 0. At its estimate x the score of delta and its information are, without fitting another,

    q = Z' W (y - X x),    J = Z' W Z - Z' W X (X' W X + D^-1)^-1 X' W Z,                       (1)
    F = q' J^-1 q / (k s^2),                                                                    (2)

and F of k columns has an F(k, n) distribution if delta = 0 and n is large (C. R. Rao, Proc.
Cambridge Phil. Soc. 44 (1948) 50-57). One hypothesis, a set of columns Z passed by A, after the
other:

- of one trial only, or times the time in a single trial, the simulated output and its slope:
  another gain, another delay;
- the sign of the last move of each input, as the plant passes it on: of an input through backlash,
  u less half the gap times this sign comes out;
- squares and cubes of the inputs, likewise, and of the simulated output: a curve, a dead zone.

All of these are about P. The simulated output of the first hypothesis is the answer to the
commanded inputs, and the inputs of the others are these. What a known disturbance does is in the
simulated output whose squares and cubes are tested.

What one gain more of each input explains is taken off beforehand: the prior makes gains too small,
and of two levels squares and cubes are gains.

Without a reference in the record u may follow y, and what is estimated is -1 / C: no test of
residuals can distinguish this loop from a plant -1 / C. But plants in which something
lags, without a lead, answer at once by a part of what they answer in the end, a sampled one by
nothing. So it is
said where u(t) explains y(t), by the same F, and the first coefficient of the impulse response is
not between 0 and 1.1 times their sum; from 0.5 on, where u(t) explains a million times what is
left: a proportional controller, or a plant without lags and almost without noise. How far off P is
cannot be known then: by all of it.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import block_diag, helmert, solve_triangular
from scipy.signal import fftconvolve
from scipy.special import fdtrc

from ilctools.measurement.regression import Regression, Trials, contrasts, longest_of, products

FALSE_ALARM = 1e-3  # probability for each output
SEEN = 0.02  # of P: what is smaller is not said
# Of the first coefficient of an impulse response to their sum: what plants do not have, and what
# they do not have where u(t) explains EXACT times the power that is left.
WHOLE, HALF, EXACT = 1.1, 0.5, 1e6
CURVED = "the response to large inputs differs from that to small ones"
PLAY = "the response differs after moves up and down, as with backlash"
FOLLOWS = (
    "u follows y, as in a loop whose reference is not in the log, or the plant has a lead: what is "
    "estimated may be -1/C of a controller. Add the reference (u itself, if nothing is fed back)"
)


def contradictions(
    fit: Regression, groups: Sequence[Trials], reference: bool = True
) -> Iterator[tuple[str, float]]:
    """What contradicts one linear plant, in words, and by how much of P.

    `reference`: whether the reference is in the record, or else u may follow y.
    """
    (m, inputs), parts = fit.channels, [name for group in groups for name in _parts(group)]
    # the columns of each
    gains, sets = [*range(inputs)], dict.fromkeys(parts, 2) | {PLAY: m, CURVED: 2 * m + 2}
    g = fit.impulse(longest_of(groups)).T
    last, n, level = inputs, fit.data.count.sum(), FALSE_ALARM / len(sets)
    if fit.stable:
        q, J, power = _score(fit, groups, _columns(fit, groups, g, len(parts)))
        for name, k in sets.items():
            columns, last = [*range(last, last + k)], last + k
            more = score_test(q, J, power, gains + columns) - score_test(q, J, power, gains)
            more, within = max(more, 0), columns[:1] if name in parts else gains[:m]
            off = np.sqrt(more / power[np.ix_(within, within)].sum())
            if off > SEEN and fdtrc(k, n, n * more / k / fit.posterior.rss) < level:  # (2)
                yield name, off
    if not reference and _at_once(fit, g[:, :m], level):
        yield FOLLOWS, 1.0


def score_test(q, J, power, columns) -> float:
    """q' J^-1 q of some columns; those that others explain, but for a billionth, are nothing."""
    unit, among = np.sqrt(power.diagonal()), np.ix_(columns, columns)
    z, scaled = (q / unit)[columns], (J / unit / unit[:, None])[among]
    return z @ np.linalg.pinv(scaled, 1e-9, True) @ z


def _score(fit, groups, added):
    """q and J, (1), and Z' W Z, of one gain more of each input, and of the columns of records."""
    post, layout, mean, p = fit.posterior, fit.data.layout, fit.mean, len(fit.mean)
    (single, means), _ = products(groups, layout, added)  # of [X, y, columns]
    G = single + post.weight * means
    gains = mean[:, None] * (layout.kind[:, None] == 1 + np.arange(fit.channels.all))
    Z = block_diag(gains, np.eye(len(G) - p)[:, 1:])
    across, power = G[:p] @ Z, Z.T @ G @ Z
    q = Z.T @ G[p] - mean @ across
    known = solve_triangular(post.U, post.size[:, None] * across, trans=1)
    return q, power - known.T @ known, power + 1e-300


def _parts(group):
    """Names of the trials, or of the course of a single one."""
    return group.names if len(group.y) > 1 else [f"the course of {group.names[0]}"]


def _columns(fit, groups, g, parts):
    """Z of each record, transposed, (column, time): of each part, and of other hypotheses."""
    first = 0
    for group in groups:
        K, N, m = group.u.shape
        of_P = g[:, :m]
        answer = _through(of_P, group.u).sum(axis=2, keepdims=True)
        y = answer
        if group.disturbance is not None:
            y = answer + _through(g[:, m:], group.disturbance).sum(axis=2, keepdims=True)
        own = np.concatenate([answer, np.gradient(answer, axis=1)], axis=2)  # other gain or delay
        own *= np.linspace(-1, 1, N)[:, None] if K == 1 else 1.0
        own, *shared = (
            _through(fit.denominator[:, None], z - z[:, :1])
            for z in (own, _through(of_P, _last_move(group.u)), _curve(of_P, group.u, y))
        )
        shared = contrasts(np.concatenate(shared, axis=2))
        of_parts = np.zeros((N, parts, 2))
        for weights, Z in zip(helmert(K, full=True), shared, strict=True):
            of_parts[:, first : first + K] = np.moveaxis(weights[:, None, None] * own, 0, 1)
            yield np.hstack([of_parts.reshape(N, -1), Z]).T
        first += K


def _through(g, z):
    """Signals (trial, time, column) behind impulse responses (time, 1 or column)."""
    return fftconvolve(z, g[None], axes=1)[:, : z.shape[1]]


def _curve(g, u, y):
    """A curve or dead zone before the plant, or behind it: squares and cubes."""
    return np.concatenate([_through(g, u**2), _through(g, u**3), y**2, y**3], axis=2)


def _last_move(u):
    """Backlash: the sign of the last move, less that at the beginning, opposite to the first."""
    moves = np.sign(np.diff(u, axis=1, prepend=0))
    first = np.argmax(moves != 0, axis=1)[:, None]
    moves[:, :1] = -np.take_along_axis(moves, first, 1)
    last = np.maximum.accumulate(np.where(moves, np.arange(u.shape[1])[:, None], 0), axis=1)
    return np.take_along_axis(moves, last, 1) - moves[:, :1]


def _at_once(fit, g, level):
    """Whether y answers a commanded input at once, as by -1 / C: relative to the sum of g."""
    layout, n = fit.data.layout, fit.data.count.sum()
    g = g[: 2 * layout.knots[0][-1]]  # slow parts answer later
    lags = (layout.c == 1)[:, None] & (layout.kind[:, None] == 1 + np.arange(g.shape[1]))
    first = solve_triangular(fit.posterior.U, fit.posterior.size[:, None] * lags, trans=1)
    explained = g[0] ** 2 / np.sum(first**2, axis=0) / fit.posterior.rss
    share = g[0] / g.sum(axis=0)
    odd = (share < 0) | (share > WHOLE) | (share > HALF) & (explained > EXACT)
    return np.any(odd & (fdtrc(1, n, n * explained) < level))
