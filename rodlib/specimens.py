"""Rods as they may be: drawn at random, and one controller around each of them.

A specimen is a rod whose parameters are off, with Peltier elements whose gains are off. What is
asked of it is answered for its partial differential equation itself behind a zero-order hold,
:func:`rodlib.sampled_response`. The controller stays as it was designed on the nominal model.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import control
import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from rodlib import arguments
from rodlib.feedback import CurrentTrialLoop, frequency_response, reply
from rodlib.filters import LearningFilter
from rodlib.rod import Rod, delays, held_response

MATERIAL = ("density", "heat_capacity", "heat_transfer", "conductivity")
STEP = 1.0  # rad, by which the return difference may turn between two frequencies
NO_PAD = ((0, 0), (0, 0))
ALIAS = 1e-9  # what is left of a sample after one turn of the transform


@dataclass(frozen=True)
class Spread:
    """How far off a rod may be: each parameter by itself, uniformly from -spread to +spread.

    Attributes
    ----------
    density, heat_capacity, heat_transfer, conductivity : float
        Of the material parameters, relative: 0.2 is 20 %.
    gains : float
        Of the heat flow that each Peltier element delivers for the one commanded, relative.
    sensors : float
        Of the position of each sensor, m.

    Raises
    ------
    ValueError
        If a spread is negative, or a relative one is not below 1.
    """

    density: float = 0.0
    heat_capacity: float = 0.0
    heat_transfer: float = 0.0
    conductivity: float = 0.0
    gains: float = 0.0
    sensors: float = 0.0

    def __post_init__(self):
        for field in fields(self):
            metres = field.name == "sensors"
            what = "a length in metres, 0 or more" if metres else "from 0 to below 1 (0.2 is 20 %)"
            value = arguments.number(field.name, getattr(self, field.name), what)
            if not 0 <= value < (np.inf if metres else 1):
                raise ValueError(f"{field.name} = {value} must be {what}")
            object.__setattr__(self, field.name, value)

    @classmethod
    def of_all(cls, share: float, rod: Rod | None = None) -> "Spread":
        """Everything off by the same share; the sensors by that of half a section of `rod`."""
        rod = arguments.instance("rod", Rod() if rod is None else rod, Rod)
        share = arguments.number("share", share, "from 0 to below 1 (0.2 is 20 %)", -1e-300, 1)
        return cls(*[share] * 5, sensors=share * rod.length / rod.sections / 2)


@dataclass(frozen=True)
class Specimen:
    """A rod as it may be.

    Attributes
    ----------
    rod : Rod
    gains : tuple of float
        Heat flow that each Peltier element delivers per heat flow commanded.
    """

    rod: Rod
    gains: tuple[float, ...]


def draw(spread: Spread, number: int, root: int = 0, nominal: Rod | None = None) -> Specimen:
    """Draw a rod by number.

    Parameters
    ----------
    spread : Spread
    number, root : int
        Number of the rod, and of the sequence to which it belongs, 0 or more. Another spread
        stretches the same rod's deviations.
    nominal : Rod, optional
        The one that it was meant to be. Default: the paper's.

    Returns
    -------
    Specimen

    Raises
    ------
    ValueError
        If a number is not whole or negative, or the spread would move a sensor beyond the rod.
    """
    arguments.instance("spread", spread, Spread)
    nominal = arguments.instance("nominal", Rod() if nominal is None else nominal, Rod)
    seed = [arguments.whole("number", number, 0), arguments.whole("root", root, 0)]
    least, most = min(nominal.sensors), max(nominal.sensors)
    room = min(least, nominal.length - most)
    if spread.sensors > room:
        raise ValueError(
            f"spread.sensors = {spread.sensors} m would move a sensor of the nominal rod beyond "
            f"its end: at most {room:.6g} m"
        )
    off = np.random.default_rng(seed).uniform(
        -1, 1, len(MATERIAL) + nominal.sections + len(nominal.sensors)
    )
    material, gains, sensors = np.split(off, [len(MATERIAL), len(MATERIAL) + nominal.sections])
    changed = {
        name: getattr(nominal, name) * (1 + getattr(spread, name) * by)
        for name, by in zip(MATERIAL, material, strict=True)
    }
    places = np.clip(nominal.sensors + spread.sensors * sensors, 0, nominal.length)  # of rounding
    rod = replace(nominal, **changed, sensors=tuple(places))
    return Specimen(rod, tuple((1 + spread.gains * gains).tolist()))


class Around:
    """The loop as designed, on a circle of the z-plane, ready for other plants in its place.

    With G_0 for the plant of the design, G for the other one and D = G - G_0, the observer sees
    D u + G_d d more than it expects, and the loop answers

        u = U w - R (D u + G_d d),   so that   u = X (U w - R G_d d),   X = (I + R D)^-1.

    U and R belong to the loop as designed: stable, and finite at z = 1 too, where the controller
    itself is not. Arrays have the frequencies last, as numpy is then fastest.

    Parameters
    ----------
    loop : CurrentTrialLoop
        The controls and disturbances are heat flows of a rod and theta_a, by name.
    omega : ndarray, shape (n,)
        Angular frequencies, rad/s.
    growth : float
        z = exp((growth + j omega) Ts), 1/s, 0 or more.
    """

    def __init__(self, loop: CurrentTrialLoop, omega, growth: float = 0.0):
        self.loop, self.omega = loop, omega
        self.step = np.expm1((growth + 1j * omega) * loop.Ts)
        self.delays = delays(self.step)
        m = loop.plant.noutputs

        def response(model):  # z I - A = r (exp(j omega Ts) I - A / r)
            r = np.exp(growth * loop.Ts)
            scaled = control.ss(model.A / r, model.B / r, model.C, model.D, model.dt)
            return _last(frequency_response(scaled, omega))

        self.G0 = response(loop.plant[:, :m])
        self.U, minus_R = np.split(response(reply(loop)), 2, axis=1)
        self.R = -minus_R

    def plant(self, specimen: Specimen, signals: Sequence[str]) -> np.ndarray:
        """The response of a specimen without a controller to some inputs, (m, signals, n)."""
        wanted = [specimen.rod.inputs.index(name) for name in signals]
        G = held_response(specimen.rod, self.loop.Ts, self.step, self.delays, wanted)
        return _last(G * np.append(specimen.gains, 1)[wanted])

    def return_difference(self, specimen: Specimen) -> np.ndarray:
        """det(I + R D), shape (n,)."""
        loaded = self._loaded(self.plant(specimen, self.loop.controls))
        return np.linalg.det(np.moveaxis(loaded, -1, 0))

    def closed(self, specimen: Specimen, disturbed: bool = False):
        """From w to y, shape (m, m, n), and if `disturbed` from d to y, shape (m, d, n)."""
        m = len(self.loop.controls)
        signals = [*self.loop.controls, *(self.loop.disturbances if disturbed else [])]
        G, G_d = np.split(self.plant(specimen, signals), [m], axis=1)
        GX = _times(G, _inverse(self._loaded(G)))
        return _times(GX, self.U), G_d - _times(GX, _times(self.R, G_d))

    def _loaded(self, G):
        loaded = _times(self.R, G - self.G0)
        loaded[range(len(G)), range(len(G))] += 1
        return loaded


def _last(response):
    return np.ascontiguousarray(np.moveaxis(response, 0, -1))


def _times(A, B):
    return np.einsum("ijn,jkn->ikn", A, B)


def _inverse(A):
    if len(A) != 2:
        return _last(np.linalg.inv(np.moveaxis(A, -1, 0)))
    (a, b), (c, d) = A  # in closed form ten times faster
    return np.array([[d, -b], [-c, a]]) / (a * d - b * c)


def responses(loop: CurrentTrialLoop, specimens: Iterable[Specimen], omega) -> np.ndarray:
    """P of (31) around each specimen: what ``synthesise([...])`` takes as plants.

    Parameters
    ----------
    loop : CurrentTrialLoop
    specimens : iterable of Specimen
    omega : array_like, shape (n,)
        Angular frequencies, rad/s, from 0 to the Nyquist frequency.

    Returns
    -------
    ndarray, shape (specimens, n, m, m), complex
        A response tells nothing if the loop is not stable: see :func:`unstable_poles`.
    """
    around = Around(loop, arguments.row("omega", omega))
    return np.array([np.moveaxis(around.closed(each)[0], -1, 0) for each in specimens])


def unstable_poles(loop: CurrentTrialLoop, specimens: Iterable[Specimen]) -> np.ndarray:
    """Number of poles outside the unit circle of the loop around each specimen, shape (specimens,).

    Notes
    -----
    det(I + R D) is the quotient of the characteristic polynomials of the loop around the specimen
    and of the loop as designed, times that of the two plants without a controller. All but the
    first have their zeros inside the unit circle, and far outside the quotient is one. So it winds
    around zero, along the unit circle, once clockwise for every unstable pole. Between two
    frequencies it must turn by less than `STEP`; where it does not, more are taken. As the rod has
    infinitely many poles, there is no matrix whose eigenvalues could tell.
    """
    around = Around(loop, np.append(0, np.geomspace(1e-5, 1, 300) * np.pi / loop.Ts))
    return np.array([_winding(around, each) for each in specimens])


def _winding(around, specimen):
    omega, F = around.omega, around.return_difference(specimen)
    for _ in range(40):
        turns = np.angle(F[1:] / F[:-1])
        wide = np.flatnonzero(np.abs(turns) > STEP)
        if not wide.size:
            return round(-turns.sum() / np.pi)  # on the other half circle as much again
        between = (omega[wide] + omega[wide + 1]) / 2
        values = Around(around.loop, between).return_difference(specimen)
        omega, F = np.insert(omega, wide + 1, between), np.insert(F, wide + 1, values)
    return 1  # a pole on the unit circle, up to rounding


class Course:
    """A course of trials under the ILC law, simulated around one specimen after the other.

    What :func:`rodlib.run_trials` computes sample by sample is computed for a whole trial at once.
    On a circle |z| = r > 1 the z-transform of a signal that is weighted by r^-p is a Fourier
    transform, the loop is a product, and what wraps around after N samples comes back as r^-N:
    nothing to speak of. That holds for any plant, stable or not. Both filters are products, too,
    since beyond the ends of a trial signals are zero.

    Parameters
    ----------
    loop, Q, reference, disturbance, trials, rest
        As for :func:`rodlib.run_trials`, checked before.
    filters : sequence of LearningFilter
    """

    def __init__(self, loop, Q, filters, reference, disturbance, trials, rest):
        T, m = reference.shape
        order = max(L.order for L in filters)
        poles = np.concatenate([np.roots(section[3:]) for section in Q.sections])
        tail = int(np.log(ALIAS**3) / np.log(np.abs(poles).max()))  # of Q, as far as it may wrap
        self.samples, self.N = T, next_fast_len(max(2 * T, T + order + tail), real=True)
        growth = -np.log(ALIAS) / self.N / loop.Ts
        self.weight = np.exp(-growth * loop.Ts * np.arange(T))
        self.kept = np.arange(T) < T - rest
        self.around = Around(loop, np.linspace(0, np.pi / loop.Ts, self.N // 2 + 1), growth)
        z = 1 + self.around.step
        self.Q = _butterworth(Q, z) * _butterworth(Q, 1 / z)
        ahead = z ** np.arange(1, order + 1)[:, None]
        c = np.array([np.pad(L.coefficients, (*NO_PAD, (0, order - L.order))) for L in filters])
        self.L = np.einsum("fijk,kn->fijn", c, ahead)
        self.before = np.zeros((len(c), m, order, m, len(z)), dtype=complex)
        for p in range(order):  # L makes of e(p) what belongs before the trial, and is cut off
            self.before[:, :, p] = np.einsum("fijk,kn->fjin", c[..., p:], ahead[: order - p])
        self.reference = reference.T
        self.R = self._transform(self.reference)
        if disturbance is not None:
            disturbance = np.swapaxes(disturbance, -1, -2)
            disturbance = np.broadcast_to(disturbance, (trials, *disturbance.shape[-2:]))
        self.D = [None] * trials if disturbance is None else self._transform(disturbance)

    def rms(self, specimens: Sequence[Specimen]) -> np.ndarray:
        """RMS(e_k) of every trial, shape (specimens, filters, trials)."""
        around = [self.around.closed(each, self.D[0] is not None) for each in specimens]
        P = np.array([P for P, _ in around])
        P_d = np.array([P_d for _, P_d in around])
        V = np.zeros((len(P), *self.L.shape[:2], self.L.shape[3]))
        rms = []
        for D in self.D:
            Y = np.einsum("gijn,gfjn->gfin", P, self.R + V)
            if D is not None:
                Y += np.einsum("gijn,jn->gin", P_d, D)[:, None]
            e = self.reference - self._signal(Y)
            rms.append(np.sqrt(np.einsum("gfit,gfit->gf", e, e) / self.samples))
            if len(rms) < len(self.D):
                V = V + np.einsum("fijn,gfjn->gfin", self.L, self._transform(e)) - self._before(e)
                V = self._transform(self._signal(self.Q * V) * self.kept)  # (23)
        return np.stack(rms, axis=2)

    def _before(self, e):
        first = np.swapaxes(e[..., : self.before.shape[2]], 0, 1)
        flat = self.before.reshape(len(first), first[0, 0].size, -1).view(float)
        cut = first.reshape(*first.shape[:2], -1) @ flat  # real numbers: half the work
        return np.swapaxes(cut.view(complex).reshape(*first.shape[:3], -1), 0, 1)

    def _transform(self, signal):
        return rfft(signal * self.weight, self.N)

    def _signal(self, transform):
        return irfft(transform, self.N)[..., : self.samples] / self.weight


def _butterworth(Q, z):
    """The forward half of the Q-filter."""
    return np.prod([np.polyval(s[:3], z) / np.polyval(s[3:], z) for s in Q.sections], axis=0)
