"""Evidence for a learning filter that does not come from the solver.

Three questions, each answered by code of its own; the function for the singular values of a matrix
is all that it shares with the solvers:

- *Is it optimal?* :func:`lower_bound` turns the solver's multipliers, whatever their quality, into
  a bound on the objective that no filter of the same structure and order can beat.
- *Are the bounds met between the samples?* The constraints of (39) hold on a grid;
  :func:`peak_gain` gives the peak over all frequencies, with a proof, if the plant is a model.
- *Does the finite trial converge?* Lemma 1 is about signals without end; :func:`trial_norm` is
  the norm of what one trial of the ILC law really does, its two ends included.
"""

from dataclasses import dataclass

import control
import numpy as np
import scipy.sparse.linalg as sparse
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import schur
from scipy.sparse import diags_array, eye_array

from rodlib import arguments
from rodlib.filters import LearningFilter, ZeroPhaseButterworth

CHUNK = 2**21  # numbers held at a time while frequency responses are computed
CLOSEST = 20  # poles next to the unit circle at which rounding is looked into
LANCZOS = 60  # vectors that the Lanczos iteration keeps
# Relative duality gap, and relative violation of a bound on the grid, that are accepted.
GAP = 1e-6
VIOLATION = 1e-9
LARGEST = 1e7  # gain of Q P L from which on the rounding of coefficients shows
# Share of 1 - sigma_max(M) that splines may miss: a narrow resonance shows little on its flanks.
COARSE = 0.25


@dataclass(frozen=True)
class Certificate:
    """What is known about a learning filter, by evidence independent of the solver.

    Attributes
    ----------
    structure, order : str, int
        Of the learning filter, "diagonal" or "full", and how many samples it looks ahead.
    value, lower_bound : float
        The objective reached, and what no such filter within the bounds can go below.
    idle : float
        The objective without learning, L = 0.
    M_max, L_max : float, float or None
        The bounds.
    grid_M, grid_L : float
        Peaks of sigma_max(M), sigma_max(L) on the design grid.
    all_M, all_L : float
        Upper bounds, to 1e-8, of the peaks over all frequencies; see `proven`.
    place : float
        Frequency of `all_M`, rad/s.
    proven : bool
        False if P or Q were given as samples: `all_M` is then an estimate from splines, for the
        frequencies from the first to the last sample. All others remain unknown.
    sampled, nyquist : (float, float), float
        First and last design frequency, and pi / Ts, rad/s.
    missed : float
        By how much such splines miss M, in its largest singular value, at samples that are left
        out; infinite for fewer than four samples, NaN if proven.
    tolerances : (float, float)
        Relative duality gap, and violation of a bound on the grid, that are accepted.
    trial : float
        2-norm of the map of one finite trial, :func:`trial_norm`; NaN if not asked for.
    samples : int or None
        Length of that trial.
    rest : int
        Number of samples at its end in which v is held at zero.
    """

    structure: str
    order: int
    value: float
    lower_bound: float
    idle: float
    M_max: float
    L_max: float | None
    grid_M: float
    grid_L: float
    all_M: float
    all_L: float
    place: float
    sampled: tuple[float, float]
    nyquist: float
    proven: bool = True
    missed: float = np.nan
    tolerances: tuple[float, float] = (GAP, VIOLATION)
    trial: float = np.nan
    samples: int | None = None
    rest: int = 0

    @property
    def gap(self) -> float:
        """Distance of value and lower bound, relative to the value.

        Below a thousandth of the objective without learning, it is relative to that: a billionth
        of the objective without learning is as good as nothing.
        """
        return (self.value - self.lower_bound) / max(self.value, 1e-3 * self.idle)

    @property
    def failures(self) -> list[str]:
        """What speaks against the filter; empty if it holds."""
        gap, violation = self.tolerances
        tests = {
            f"relative duality gap {self.gap:.1e} > {gap:g}": self.gap > gap,
            f"sigma_max(M) = {self.grid_M:.12g} > M_max = {self.M_max} on the grid": (
                self.grid_M > self.M_max * (1 + violation)
            ),
            f"sigma_max(L) = {self.grid_L:.12g} > L_max = {self.L_max} on the grid": (
                self.L_max is not None and self.grid_L > self.L_max * (1 + violation)
            ),
            f"sigma_max(M) reaches {self.all_M:.9g} at {self.place:.6g} rad/s, not in omega: "
            "Lemma 1 does not hold; add frequencies there": self.proven and self.all_M >= 1,
        }
        return [text for text, failed in tests.items() if failed]

    @property
    def warnings(self) -> list[str]:
        """What speaks against the estimate of M between the samples; empty if it is proven."""
        margin = 1 - self.all_M
        too_coarse = margin > 0 and self.missed > COARSE * margin
        tests = {
            f"sigma_max(M) may reach {self.all_M:.4g} at {self.place:.4g} rad/s, between the "
            "samples, where Lemma 1 would not hold; measure there": margin <= 0,
            f"the samples are too coarse: splines miss M by {self.missed:.2g} at samples left out, "
            f"and 1 - sigma_max(M) is {margin:.2g}; measure at more frequencies": too_coarse,
        }
        return [] if self.proven else [text for text, warned in tests.items() if warned]

    @property
    def unknown(self) -> str:
        """The frequencies at which nothing is known of M if P or Q were given as samples."""
        low, high = self.sampled
        parts = [f"below {low:.4g} rad/s"] if low > 0 else []
        parts += [f"above {high:.4g} rad/s"] if high < self.nyquist * (1 - 1e-9) else []
        return ", ".join([*parts, "at resonances that no sample shows"])

    def __repr__(self):
        bound = "none" if self.L_max is None else f"{self.L_max:g}"
        rows = [
            ("", "sigma_max(M)", "sigma_max(L)"),
            ("bound", f"{self.M_max:g}", bound),
            ("on the design grid", f"{self.grid_M:.8f}", f"{self.grid_L:.7g}"),
            (
                "over all frequencies",
                f"{self.all_M:.8f}" if self.proven else "not known",
                f"{self.all_L:.7g}",
            ),
        ]
        lines = ["{:<22}{:>14}{:>14}".format(*row) for row in rows]
        if not self.proven:
            low, high = self.sampled
            lines += [
                f"sigma_max(M) from {low:.4g} to {high:.4g} rad/s, between the samples: "
                f"{self.all_M:.4f}, estimated",
                f"sigma_max(M) unknown: {self.unknown}",
            ]
        compared = "" if self.L_max is not None else f" with a gain of Q P L up to {LARGEST:.0e}"
        lines.append(
            f"objective {self.value:.8g}, no {self.structure} filter of order {self.order}"
            f"{compared} below {self.lower_bound:.8g}"
        )
        if self.samples:
            rest = f", the last {self.rest} at rest" if self.rest else ""
            lines.append(f"norm of one trial of {self.samples} samples{rest}: {self.trial:.4f}")
        lines += [f"WARNING: {text}" for text in self.warnings]
        return "\n".join([*lines, *(f"FAILS: {text}" for text in self.failures)])


def weight_of_L(P, Q, L_max) -> np.ndarray:
    """W such that sigma_max(W L) <= 1 is the bound on the learning filter.

    That is I / L_max. Without a bound (46), filters are still compared only up to where their
    coefficients, held in doubles, determine M to about 1e-9: up to a gain of 1e7 of Q P L, counted
    for each input by itself. What larger ones could gain on paper, no computer can apply.

    Parameters
    ----------
    P : ndarray, shape (n, m, m)
    Q : ndarray, shape (n,)
    L_max : float or None

    Returns
    -------
    ndarray, shape (m, m), diagonal
    """
    m = P.shape[1]
    if L_max is not None:
        return np.eye(m) / L_max
    gains = np.linalg.norm(Q[:, None, None] * P, axis=1).max(axis=0)
    return np.diag(gains / np.abs(Q).max() / LARGEST)


def lower_bound(
    P, Q, angles, U, V, *, order, M_max, L_max, band_mask, structure, objective
) -> float:
    """Lower bound on the optimum of (39) or (45), from multipliers and linear algebra alone.

    For all filters that meet the bounds, and all U_i, V_i with sum_i Re tr(U_i^H dM_i) +
    Re tr(V_i^H dL_i) = 0 for every change of the coefficients,

        sum_i Re tr(U_i^H Q_i) = sum_i Re tr(U_i^H M_i) + Re tr(V_i^H L_i)
                               <= sum_i |U_i| sigma_max(M_i) + sum_i |W^-1 V_i|

    with nuclear norms |.| and W of :func:`weight_of_L`. Where |U_i| exceeds the weight of
    sigma_max(M_i) in the objective, the excess is bounded with M_max. U and V are first projected
    on those that fulfil the condition, so the bound holds, up to rounding, whatever was passed. A
    coefficient of L_jk acts on column k of M and L only, so the columns are projected one by one.

    Parameters
    ----------
    P : ndarray, shape (n, m, m)
    Q : ndarray, shape (n,)
    angles : ndarray, shape (n,)
        omega Ts.
    U, V : ndarray, shape (n, m, m); V may be None
        Multipliers of the bounds on M and on L. With V None, no bound on L is used at all.
    order : int
    M_max, L_max : float, float or None
    band_mask : ndarray of bool, shape (n,)
        Frequencies over which "sum" sums; not used for "peak".
    structure : {"diagonal", "full"}
    objective : {"sum", "peak"}

    Returns
    -------
    float
    """
    n, m, _ = P.shape
    T, N = -Q[:, None, None] * P, np.array(U, dtype=complex)
    if V is not None:  # in units of the bound, so that both parts have the size of the objective
        W = weight_of_L(P, Q, L_max)
        T = np.concatenate([T, np.broadcast_to(W, (n, m, m))])
        N = np.concatenate([N, np.linalg.solve(W, V)])
        angles = np.concatenate([angles, angles])
    groups = [list(range(m))] if structure == "full" else [[k] for k in range(m)]
    for group in groups:
        changes = _changes(T[:, :, group], angles, order)
        part = _rows(N[:, :, group])
        for _ in range(2):
            part -= (part @ changes.T) @ changes
        N[:, :, group] = part.view(complex).reshape(-1, len(N), m).transpose(1, 2, 0)
    norms = np.linalg.svd(N, compute_uv=False).sum(axis=1)
    bound = (np.trace(N[:n].conj(), axis1=1, axis2=2) * Q).real.sum() - norms[n:].sum()
    if objective == "peak":
        return float(bound / norms[:n].sum())
    return float(bound - M_max * np.maximum(norms[:n] - band_mask, 0).sum())


def _changes(T, angles, order):
    """Orthonormal rows that span what the coefficients can do to T L, shape (n, m, q).

    The powers of z are nearly dependent at low frequencies. Arnoldi's process never forms them: it
    multiplies the last rows by z - 1 and makes the result orthogonal to all before, which spans
    the same space and needs no more than doubles.
    """
    rows = _rows(T * np.exp(1j * angles)[:, None, None])
    step = np.repeat(np.expm1(1j * angles), T.shape[1])
    done = np.empty((0, rows.shape[1]))
    for _ in range(order):
        for _ in range(2):  # once leaves what rounding has put back
            rows = np.linalg.qr((rows - (rows @ done.T) @ done).T)[0].T
        done = np.vstack([done, rows])
        rows = (np.ascontiguousarray(rows).view(complex) * step).view(float)
    return done


def _rows(X):
    """Columns of all X as one real row each, real and imaginary parts in turn: (n, m, q)."""
    rows = X.transpose(2, 0, 1).reshape(X.shape[2], -1)
    return np.ascontiguousarray(rows, dtype=complex).view(float)


def peak_gain(
    system: control.StateSpace, tolerance: float = 1e-8, max_points: int = 2_000_000
) -> tuple[float, float]:
    """Peak over all frequencies of the largest singular value, as an upper bound with a proof.

    Parameters
    ----------
    system : control.StateSpace
        Stable, in discrete time, with a sampling period in seconds; any number of inputs and
        outputs.
    tolerance : float
        Relative; from 1e-12 to 1. The cost grows like its inverse square root.
    max_points : int
        Frequencies to be looked at before giving up.

    Returns
    -------
    gain : float
        At least the supremum of sigma_max(G(exp(j omega Ts))) over 0 <= omega <= pi / Ts. Above
        (1 + tolerance) times it only by a bound of the rounding error, see Notes. In the unit of
        the output per unit of the input.
    omega : float
        Where the largest value was found, rad/s.

    Raises
    ------
    ValueError
        If the system is not in discrete time with a sampling period, is unstable or not finite,
        or the tolerance is out of range.
    RuntimeError
        If `max_points` does not suffice: sigma_max is equal to its peak, or nearly so, over a
        wide range (an all-pass filter, say). The message gives the interval found so far. Or if
        poles are so close to the unit circle that rounding could move one across.

    Notes
    -----
    No grid is fine enough by itself; what can happen between two samples must be bounded. Here
    the poles bound it. Let a_1 ... a_n be the eigenvalues of A, and

        phi(theta) = sum_j integral from 0 to theta of (1 - |a_j|^2) / |exp(j t) - a_j|^2 dt,

    the phase of the all-pass B(z) = prod_j (z - a_j) / (1 - conj(a_j) z). It increases. Let g be
    the peak of sigma_max and theta* = omega* Ts a place where it is attained. Then

        sigma_max(theta) >= g cos(phi(theta) - phi(theta*))  if  |phi(theta) - phi(theta*)| <= pi.

    *Proof.* Take the unit vectors u, v with u* G(theta*) v = g and let T(theta) = Re u* G v / g.
    Then |T| <= sigma_max / g <= 1 everywhere and T(theta*) = 1. T is a trigonometric polynomial
    of degree n or less over W(theta) = prod_j |exp(j theta) - a_j|^2, and so is
    S(theta) = cos(phi(theta) - phi(theta*)) = Re(B(exp(j theta)) / B(exp(j theta*))), and hence
    D = S - T, which has no more than 2n zeros in a period unless it is zero throughout. S runs
    through +1 and -1 in turn at theta* = t_0 < t_1 < ... < t_2n = t_0 + 2 pi. Because |T| <= 1, D
    is >= 0 at t_0, t_2, ... and <= 0 at t_1, t_3, ..., so each of the 2n - 2 intervals
    [t_1, t_2] ... [t_2n-2, t_2n-1] holds a zero. If it is at an end, T = +1 or -1 is stationary
    there, as S is; the zero is double and counts once for each of the two intervals it belongs
    to. So is the zero at t_0. These are 2n. If T < S at some place in (t_0, t_1), D > 0 there
    and D(t_1) <= 0, which makes one more zero in (t_0, t_1]: contradiction. The other side is
    the mirror image. (This is the inequality of Bernstein and Szego for rational functions; see
    Borwein and Erdelyi, Mathematika 43 (1996) 413-423. For a finite impulse response of length
    n + 1, phi = n theta and it is Riesz's lemma of 1914.)

    So if theta* lies between two samples a < b with h = phi(b) - phi(a) < pi / 2, the peak is no
    higher than the sinusoid in phi through (0, sigma_max(a)) and (h, sigma_max(b)), or than the
    higher of the two if the sinusoid has its crest elsewhere. An interval is dropped once that
    bound is within the tolerance of the highest value seen, and halved if not. When none is
    left, the bound is proven; near the peak h is then about sqrt(8 tolerance). Real systems
    have the same singular values at negative frequencies, so [0, pi / Ts] is enough.

    Rounding: the values are those of a Schur form of A, whose diagonal holds the very poles that
    the bound uses. The proof is therefore exact for a system whose matrices differ from the given
    ones by rounding. Where that matters most, at the peak and at the angles of the poles closest to
    the circle, the gain is computed once more from A itself, with a bound of its error: if R
    approximates (z I - A)^-1 and leaves the residual S = I - (z I - A) R, then

        C (z I - A)^-1 B = C R B + C R (S + S^2 + ...) B.

    What this adds to the peak is added to the gain. It is 1e-9 of it or less for the paper's M.
    No eigenvalue has to be told apart from the unit circle, as in the level-set methods of Boyd,
    Balakrishnan, Bruinsma and Steinbuch: that decision is worth no more than half the digits
    where the level touches the curve.
    """
    Ts = _sampling_period("system", system)
    if not 1e-12 <= tolerance <= 1:
        raise ValueError(f"tolerance = {tolerance!r} must be in [1e-12, 1]")
    if not all(np.isfinite(X).all() for X in (system.A, system.B, system.C, system.D)):
        raise ValueError("system must be finite, but its matrices hold NaN or infinite values")
    if system.nstates == 0:
        return float(np.linalg.norm(system.D, 2)), 0.0
    # in units in which inputs and outputs are of order one
    v, u = (
        2.0 ** np.round(np.log2(max(np.abs(X).max(), np.abs(system.D).max()) or 1))
        for X in (system.B, system.C)
    )
    matrices = *_balanced(system.A, system.B / v, system.C / u), system.D / v / u
    poles, sigma = _gain_function(*matrices)
    radius = np.abs(poles).max()
    if radius >= 1:
        raise ValueError(f"system is unstable: it has a pole of modulus {radius:.6g}, 1 or more")

    theta = np.linspace(0, np.pi, 4 * len(poles) + 1)
    value, phase = sigma(theta), _phase(poles, theta)
    best = value.argmax()
    peak, place = value[best], theta[best]
    left, right = (np.stack([x[s] for x in (theta, value, phase)])
                   for s in (slice(None, -1), slice(1, None)))  # fmt: skip
    bound, points = peak, theta.size
    while True:
        ceiling = _ceiling(left[1], right[1], right[2] - left[2])
        keep = ceiling > peak * (1 + tolerance)
        bound = max(bound, ceiling[~keep].max(initial=0))
        left, right = left[:, keep], right[:, keep]
        if not left.size:
            closest = poles[np.argsort(-np.abs(poles))][:CLOSEST]
            doubtful = {place, *np.abs(np.angle(closest))}
            highest = max(_rounded_up(*matrices, angle) for angle in doubtful)
            if highest == np.inf:
                raise RuntimeError(
                    f"the peak gain, {peak * u * v:.6g} as computed, cannot be told: system has a "
                    f"pole of modulus {radius:.17g}, which rounding of its matrices could make "
                    "unstable"
                )
            return float((bound + max(highest - peak, 0)) * u * v), float(place / Ts)
        middle = (left[0] + right[0]) / 2
        points += middle.size
        if points > max_points or np.any((middle == left[0]) | (middle == right[0])):
            raise RuntimeError(
                f"the peak gain is between {peak * u * v:.12g} and "
                f"{max(bound, ceiling.max()) * u * v:.12g}; "
                f"to close in further takes more than {max_points} frequencies: "
                f"raise max_points or tolerance = {tolerance:.1e}"
            )
        middle = np.stack([middle, sigma(middle), _phase(poles, middle)])
        best = middle[1].argmax()
        if middle[1, best] > peak:
            peak, place = middle[1, best], middle[0, best]
        left, right = np.hstack([left, middle]), np.hstack([middle, right])


def _ceiling(a, b, h):
    """Highest peak that a curve through a and b, a phase h apart, can have in between."""
    with np.errstate(divide="ignore", invalid="ignore"):
        crest = np.hypot(a - b, 2 * np.sqrt(a) * np.sqrt(b) * np.sin(h / 2)) / np.sin(h)
    inside = np.minimum(a, b) > np.maximum(a, b) * np.cos(h)
    return np.where(h < np.pi / 2, np.where(inside, crest, np.maximum(a, b)), np.inf)


def _phase(poles, theta):
    """Phase phi of the all-pass with these poles, of :func:`peak_gain`, shape of theta."""
    r, angle = np.abs(poles)[:, None], np.angle(poles)[:, None]
    shift = theta - angle
    # 1 - r cos(shift), without cancellation for poles next to the circle
    real = (1 - r) + 2 * r * np.sin(shift / 2) ** 2
    return len(poles) * theta + 2 * np.arctan(r * np.sin(shift) / real).sum(axis=0)


def _gain_function(A, B, C, D):
    """Poles of a system, and a function for sigma_max at an array of angles omega Ts."""
    T, Z = schur(A, output="complex")
    B, C = Z.conj().T @ B, C @ Z
    n, m = B.shape

    def sigma(theta):
        step = max(1, CHUNK // (n * m))
        parts = [part(theta[i : i + step]) for i in range(0, len(theta), step)]
        return np.concatenate(parts)

    def part(theta):
        z = np.exp(1j * theta)
        X = np.empty((n, m * len(z)), dtype=complex)
        # (z I - T) X = B, from the last row up, for all frequencies at once
        for i in range(n - 1, -1, -1):
            row = (T[i, i + 1 :] @ X[i + 1 :]).reshape(m, -1) + B[i, :, None]
            X[i] = (row / (z - T[i, i])).ravel()
        G = (C @ X).reshape(-1, m, len(z)) + D[:, :, None]
        return largest_singular_values(np.moveaxis(G, -1, 0))

    return np.diag(T), sigma


def _rounded_up(A, B, C, D, theta):
    """Upper bound of sigma_max at one angle whatever the rounding, of :func:`peak_gain`."""
    unit, z = (len(A) + 2) * np.finfo(float).eps, np.exp(1j * theta)
    identity = np.eye(len(A))
    R = np.linalg.inv(z * identity - A)
    a, b, c, r = (np.abs(X) for X in (A, B, C, R))
    residual = np.abs(identity - (z * R - A @ R)) + unit * (identity + r + a @ r)
    size = np.linalg.norm(residual)
    if not size < 1:
        return np.inf
    left = C @ R
    error = np.abs(left) @ residual @ b + unit * (c @ r @ b + np.abs(D))
    further = np.abs(left).sum() * size**2 / (1 - size) * b.sum()
    return np.linalg.norm(left @ B + D, 2) + np.linalg.norm(error, 2) + further


def largest_singular_values(G):
    """Largest singular value of each matrix, shape (n, p, m) to (n,)."""
    if min(G.shape[1:]) > 2:
        return np.linalg.norm(G, 2, axis=(1, 2))
    # Below three by three the Hermitian eigenvalue problem has a closed form, ten times faster.
    G = G if G.shape[1] <= G.shape[2] else np.swapaxes(G, 1, 2)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        power = (G.real**2 + G.imag**2).sum(axis=2)
        total = power.sum(axis=1)
        if G.shape[1] == 1:
            sigma = np.sqrt(total)
        else:
            coupling = np.abs((G[:, 0] * G[:, 1].conj()).sum(axis=1))
            sigma = np.sqrt(total / 2 + np.hypot((power[:, 0] - power[:, 1]) / 2, coupling))
    if not (total.min(initial=1) > 1e-280 and total.max(initial=1) < 1e280):
        extreme = ~((total > 1e-280) & (total < 1e280))  # the squares may have left the doubles
        sigma[extreme] = np.linalg.norm(G[extreme], 2, axis=(1, 2))
    return sigma


def _balanced(A, B, C):
    """Scale the states by powers of two so that no entry of A is large merely by its unit.

    The error of a Schur form is relative to the largest entry of A. If one state is counted in
    units of 1e-8, the others lose eight digits.
    """
    A, B, C = (np.array(X, dtype=float) for X in (A, B, C))
    for _ in range(100):
        done = True
        for i in range(len(A)):
            rest = np.arange(len(A)) != i
            row = max(np.abs(A[i, rest]).max(initial=0), np.abs(B[i]).max())
            column = max(np.abs(A[rest, i]).max(initial=0), np.abs(C[:, i]).max())
            known = row > 0 and column > 0
            exponent = np.round((np.log2(row) - np.log2(column)) / 2) if known else 0
            if exponent:
                scale, done = 2.0**exponent, False
                A[i] /= scale
                B[i] /= scale
                A[:, i] *= scale
                C[:, i] *= scale
        if done:
            break
    return A, B, C


def _sampling_period(name, system):
    if not (system.isdtime(strict=True) and system.dt is not True):
        raise ValueError(f"{name}.dt = {system.dt!r} must be a sampling period in seconds")
    return float(system.dt)


def _common(P, Q, L):
    """Sampling period and number of channels that a plant and the two filters share."""
    Ts, m = _sampling_period("P", P), len(L.coefficients)
    if (P.noutputs, P.ninputs) != (m, m):
        raise ValueError(f"P is {P.noutputs} by {P.ninputs}, but L is {m} by {m}")
    if not np.allclose([Q.Ts, L.Ts], Ts, rtol=1e-12, atol=0):
        raise ValueError(f"P.dt = {Ts} s, Q.Ts = {Q.Ts} s and L.Ts = {L.Ts} s must be equal")
    return Ts, m


def learning_model(L: LearningFilter) -> control.StateSpace:
    """Causal model of z^-n_L L(z), whose singular values are those of L of (44).

    Parameters
    ----------
    L : LearningFilter
        Of order n_L with m channels: L(z) = sum_k c_k z^k, k = 1 ... n_L.

    Returns
    -------
    control.StateSpace
        y(p) = c_nL e(p) + c_(nL-1) e(p - 1) + ... + c_1 e(p - nL + 1), with m (n_L - 1) states:
        e(p - 1), e(p - 2), ... A delay has gain one at every frequency, so it changes no
        singular value.
    """
    m, _, order = L.coefficients.shape
    newest_first = np.concatenate([L.coefficients[:, :, k] for k in range(order - 1, -1, -1)], 1)
    states = m * (order - 1)
    return control.ss(
        np.eye(states, k=-m), np.eye(states, m), newest_first[:, m:], newest_first[:, :m], L.Ts
    )


def convergence_model(
    P: control.StateSpace, Q: ZeroPhaseButterworth, L: LearningFilter
) -> control.StateSpace:
    """Causal, stable model with the singular values of M = Q (I - P L), (40), at every frequency.

    Parameters
    ----------
    P : control.StateSpace
        Stable, in discrete time, m inputs (w) and m outputs (y): :func:`reduced_loop` for the
        paper's. Its states are taken over as they are.
    Q : ZeroPhaseButterworth
    L : LearningFilter

    Returns
    -------
    control.StateSpace
        H(z)^2 z^-n_L (I - P(z) L(z)), H being the Butterworth filter whose squared magnitude is
        Q: |H(z)^2| = |H(z)|^2 = Q(z) and |z| = 1 on the unit circle, and both are scalars. With
        n states of P it has m n_L + n + 2 n_Q m states, which is the least possible unless
        poles and zeros happen to cancel: the taps of z^-n_L L and the delay of the direct path
        share one chain.

    Raises
    ------
    ValueError
        If P is not in discrete time, or not as large as L, or the sampling periods differ.

    Notes
    -----
    P L and L P have different singular values: this is the operator on the error, as in Lemma 1,
    not Q (I - L P), which acts on the ILC signal.
    """
    Ts, m = _common(P, Q, L)

    # The chain holds e(p - 1) ... e(p - n_L). L in a unit that makes its taps of order one, and P
    # in its inverse, so that the entries of A below are, too; see _balanced.
    unit = 2.0 ** np.round(np.log2(np.abs(L.coefficients).max() or 1))
    taps, chain = learning_model(LearningFilter(L.coefficients / unit, Ts)), m * L.order
    P_C, P_D = unit * P.C, unit * P.D
    taps_C = np.hstack([taps.C, np.zeros((m, m))])
    delay_C = np.eye(m, chain, k=chain - m)
    I_minus_PL = control.ss(
        np.block([[np.eye(chain, k=-m), np.zeros((chain, P.nstates))], [P.B @ taps_C, P.A]]),
        np.vstack([np.eye(chain, m), P.B @ taps.D]),
        np.hstack([delay_C - P_D @ taps_C, -P_C]),
        -P_D @ taps.D,
        Ts,
    )
    for section in [*Q.sections, *Q.sections]:
        I_minus_PL = _diagonal(section, m, Ts) * I_minus_PL
    return I_minus_PL


def _diagonal(section, m, Ts):
    """A second-order section (first-order, if it is one) on each of m channels."""
    numerator, denominator = section[:3], section[3:]
    if numerator[2] == denominator[2] == 0:
        numerator, denominator = numerator[:2], denominator[:2]
    order = len(denominator) - 1
    A = np.eye(order, k=1)  # observer form: A has no entry larger than those of the denominator
    A[:, 0] = -denominator[1:]
    B = (numerator - numerator[0] * denominator)[1:, None]
    each = np.eye(m)
    return control.ss(
        np.kron(each, A), np.kron(each, B), np.kron(each, np.eye(1, order)), numerator[0] * each, Ts
    )


def trial_operators(
    P: control.StateSpace, Q: ZeroPhaseButterworth, L: LearningFilter, samples: int
) -> tuple[sparse.LinearOperator, sparse.LinearOperator, sparse.LinearOperator]:
    """P, Q and L as they act on a trial of finite length, each with its adjoint.

    Parameters
    ----------
    P : control.StateSpace
        In discrete time, m inputs (w), m outputs (y); acts from rest, for the length of the trial.
    Q, L : ZeroPhaseButterworth, LearningFilter
        Act as in :func:`rodlib.update`, with their own `ends`.
    samples : int
        Length of the trial.

    Returns
    -------
    P_N, Q_N, L_N : scipy.sparse.linalg.LinearOperator, shape (samples m, samples m)
        On signals of shape (samples, m), raveled. P_N is a lower triangular block Toeplitz
        matrix. Q_N and L_N are block Toeplitz if `ends` is "zero"; if it is "hold", what the
        matrix would do to the samples beyond an end is added to its first or last block column.

    Raises
    ------
    ValueError
        If P is not in discrete time or not as large as L, or `samples` is not positive.
    """
    _, m = _common(P, Q, L)
    samples = arguments.whole("samples", samples, 1)

    length = next_fast_len(2 * samples, real=True)
    spectrum = rfft(impulse_response(P, samples), length, axis=0)

    def P_apply(signal, spectrum=spectrum):
        product = spectrum @ rfft(signal, length, axis=-2)[..., None]
        return irfft(product[..., 0], length, axis=-2)[..., :samples, :]

    def P_adjoint(signal):  # the adjoint of a convolution runs backward in time
        transposed = np.swapaxes(spectrum, -1, -2)
        return np.flip(P_apply(np.flip(signal, axis=-2), transposed), axis=-2)

    reach = _reach(Q)
    two_sided = ZeroPhaseButterworth(Q.order, Q.cutoff, Q.Ts, "zero")

    def Q_adjoint(signal):
        if Q.ends == "zero":  # a symmetric Toeplitz matrix
            return Q.apply(signal)
        padding = [(0, 0)] * (signal.ndim - 2) + [(reach, reach), (0, 0)]
        return _fold(two_sided.apply(np.pad(signal, padding)), reach, reach)

    def L_adjoint(signal):
        out = np.zeros((*signal.shape[:-2], samples + L.order, m))
        for k in range(1, L.order + 1):
            out[..., k : k + samples, :] += signal @ L.coefficients[:, :, k - 1]
        return _fold(out, 0, L.order) if L.ends == "hold" else out[..., :samples, :]

    pairs = [(P_apply, P_adjoint), (Q.apply, Q_adjoint), (L.apply, L_adjoint)]
    return tuple(_operator(apply, adjoint, samples, m) for apply, adjoint in pairs)


def impulse_response(P: control.StateSpace, samples: int) -> np.ndarray:
    """Markov parameters D, C B, C A B, ... of P, shape (samples, outputs, inputs)."""
    h = np.empty((samples, P.noutputs, P.ninputs))
    h[0], X = P.D, P.B
    for p in range(1, samples):
        h[p], X = P.C @ X, P.A @ X
    return h


def trial_map(
    P: control.StateSpace,
    Q: ZeroPhaseButterworth,
    L: LearningFilter,
    samples: int,
    rest: int = 0,
) -> sparse.LinearOperator:
    """T = Q_N (I - L_N P_N): what a trial of the ILC law (23) makes of v_k - v_inf.

    Parameters and errors as for :func:`trial_operators`; in the last `rest` samples of each
    trial, v is held at zero.

    Returns
    -------
    scipy.sparse.linalg.LinearOperator, shape (samples m, samples m)
        v_{k+1} - v_inf = T (v_k - v_inf) and e_k - e_inf = -P_N (v_k - v_inf), exactly.

    Notes
    -----
    The error alone has no such map. P_N maps the last sample of v to zero (P has a delay), and
    maps the exponentials z^p of its zeros z outside the unit circle, which live at the end of
    the trial, to next to nothing; Q_N then moves them to where they show. So M = P Q (P^-1 - L)
    of (35) does not carry over, and Q_N (I - P_N L_N) is not the operator of any trial.
    """
    P_N, Q_N, L_N = trial_operators(P, Q, L, samples)
    rest = arguments.whole("rest", rest, 0, samples - 1)
    active = np.repeat(np.arange(samples) < samples - rest, len(L.coefficients))
    active = sparse.aslinearoperator(diags_array(active.astype(float)))
    T = Q_N @ (sparse.aslinearoperator(eye_array(P_N.shape[0])) - L_N @ P_N)
    return active @ T @ active if rest else T


def trial_norm(
    P: control.StateSpace,
    Q: ZeroPhaseButterworth,
    L: LearningFilter,
    samples: int,
    trials: int = 1,
    rest: int = 0,
) -> tuple[float, np.ndarray, np.ndarray]:
    """2-norm of the trial-to-trial map of the ILC signal on a finite trial.

    Parameters
    ----------
    P, Q, L, samples, rest :
        As for :func:`trial_map`.
    trials : int
        Number of trials in a row: the norm of T^trials.

    Returns
    -------
    norm : float
        Largest ||v_{k+trials} - v_inf|| / ||v_k - v_inf||. Below one for trials = 1, v converges
        monotonically. Lanczos approaches it from below; short trials have an SVD.
    before, after : ndarray, shape (samples, m)
        The unit v_k - v_inf that is amplified most, and what becomes of it.

    Raises
    ------
    ValueError
        As :func:`trial_operators`.
    RuntimeError
        If the Lanczos iteration does not converge.
    """
    trials = arguments.whole("trials", trials, 1)
    T = trial_map(P, Q, L, samples, rest) ** trials
    size = T.shape[1]
    if size <= LANCZOS:
        before = np.linalg.svd(T @ np.eye(size))[2][0]
    else:
        start = np.random.default_rng(0).standard_normal(size)  # the same result in every run
        try:
            _, vectors = sparse.eigsh(T.H @ T, k=1, v0=start, tol=1e-8, ncv=LANCZOS)
        except sparse.ArpackNoConvergence as error:
            raise RuntimeError(f"the Lanczos iteration did not converge: {error}") from error
        before = vectors[:, 0]
    after = T.matvec(before)
    return float(np.linalg.norm(after)), before.reshape(samples, -1), after.reshape(samples, -1)


def _operator(apply, adjoint, samples, m):
    def on_columns(function):
        def matmat(X):
            signals = np.moveaxis(np.reshape(X, (samples, m, -1)), -1, 0)
            return np.moveaxis(function(signals), 0, -1).reshape(samples * m, -1)

        return matmat

    forward, backward = on_columns(apply), on_columns(adjoint)
    return sparse.LinearOperator(
        (samples * m,) * 2,
        matvec=forward,
        rmatvec=backward,
        matmat=forward,
        rmatmat=backward,
        dtype=float,
    )


def _fold(signal, before, after):
    """Adjoint of holding the ends: what lies beyond an end is added to the sample at the end."""
    samples = signal.shape[-2] - before - after
    out = signal[..., before : before + samples, :].copy()
    out[..., 0, :] += signal[..., :before, :].sum(axis=-2)
    out[..., -1, :] += signal[..., before + samples :, :].sum(axis=-2)
    return out


def _reach(Q):
    """Number of samples after which the impulse response of the Q-filter is at rounding level."""
    radius = max(np.abs(np.roots(section[3:])).max(initial=0) for section in Q.sections)
    return int(np.ceil(np.log(1e-18) / np.log(radius)))
