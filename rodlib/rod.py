"""The heated rod: its parameters, its partial differential equation, its state-space model.

Section II of the paper. The rod obeys (1)-(4); :func:`midr` turns it into the ordinary
differential equations (8), (9); :func:`exact_response` solves the same equations without
approximation, in the frequency domain, and is what every approximation is measured against;
:func:`sampled_response` is the same behind a digital controller.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import control
import numpy as np
from scipy.interpolate import BPoly

from rodlib import arguments


@dataclass(frozen=True)
class Rod:
    """A metal rod, heated from below in equal sections and cooled from above by the air.

    The defaults are the rig of the paper, Section IV. Lengths are in metres.

    Raises
    ------
    ValueError
        If a material parameter or a dimension is not a positive number, if there is no section
        or no sensor, or if a sensor lies beyond the rod.
    """

    length: float = 0.320  # l, m
    width: float = 0.040  # b, m
    height: float = 0.012  # h, m
    density: float = 7800.0  # rho, kg/m3
    heat_capacity: float = 420.0  # c_p, J/(kg K)
    heat_transfer: float = 150.0  # alpha, W/(m2 K)
    conductivity: float = 55.0  # lambda, W/(m K)
    sections: int = 4  # one Peltier element under each
    sensors: tuple[float, ...] = (0.120, 0.280)  # 3l/8 and 7l/8, m

    def __post_init__(self):
        for field in fields(self)[:7]:
            what = "a positive number (SI units), between 1e-12 and 1e12"
            arguments.number(field.name, getattr(self, field.name), what, 1e-12, 1e12)
        arguments.whole("sections", self.sections, 1, 1000)
        sensors = tuple(arguments.array("sensors", self.sensors, ("sensor",)).tolist())
        if not all(0 <= z <= self.length for z in sensors):
            raise ValueError(
                f"sensors = {sensors} must be positions from 0 to length = {self.length} m"
            )
        object.__setattr__(self, "sensors", sensors)

    @property
    def kappa_1(self) -> float:
        """Volumetric heat capacity rho c_p of (1), J/(m3 K)."""
        return self.density * self.heat_capacity

    @property
    def kappa_2(self) -> float:
        """Heat transfer to the air per volume alpha / h of (1), W/(m3 K)."""
        return self.heat_transfer / self.height

    @property
    def edges(self) -> np.ndarray:
        """Edges z_0 ... z_n of the sections, m."""
        return np.linspace(0, self.length, self.sections + 1)

    @property
    def inputs(self) -> list[str]:
        """Names of the model's inputs: the heat flows Q1, Q2, ... (W), then theta_a (K)."""
        return [f"Q{i + 1}" for i in range(self.sections)] + ["theta_a"]

    @property
    def outputs(self) -> list[str]:
        """Names of the model's outputs: the temperatures y1, y2, ... at the sensors (K)."""
        return [f"y{i + 1}" for i in range(len(self.sensors))]


def bernstein_basis(rod: Rod, degree: int) -> BPoly:
    """Continuous piecewise polynomials in Bernstein form, (5)-(7).

    Parameters
    ----------
    rod : Rod
    degree : int
        Degree M of the polynomials, 1 or more.

    Returns
    -------
    scipy.interpolate.BPoly
        Maps positions z (m) to the values of the ``sections * degree + 1`` basis functions that
        remain when neighbouring sections share their edge coefficient (7). Coefficients are in
        the order of the state vector of (8).
    """
    coefficients = np.zeros((degree + 1, rod.sections, rod.sections * degree + 1))
    for i in range(rod.sections):
        coefficients[:, i, i * degree : (i + 1) * degree + 1] = np.eye(degree + 1)  # (6), (7)
    return BPoly(coefficients, rod.edges)


def midr(rod: Rod, degree: int = 3) -> control.StateSpace:
    """State-space model (8), (9) of the rod by the method of integro-differential relations.

    The temperature is a continuous piecewise polynomial (5). The heat flux follows from it by
    integrating the energy balance (1) from the insulated end z = 0,

        q(z) = int_0^z (mu + kappa_2 (theta_a - theta) - kappa_1 dtheta/dt),

    so that (1) holds exactly, and so does q(0) = 0. What is left is the residual of Fourier's
    law (2), xi = q + lambda dtheta/dz: on each section it is made orthogonal to the polynomials
    of degree M - 1. The insulated end q(l) = 0 is the last equation.

    Parameters
    ----------
    rod : Rod
    degree : int, default 3
        Degree M of the polynomials in each section.

    Returns
    -------
    control.StateSpace
        Inputs Q1, Q2, ... (W) and theta_a (K), outputs y1, y2, ... (K), as deviations from the
        initial ambient temperature; ``sections * degree + 1`` states, which are temperatures (K).

    Raises
    ------
    ValueError
        If `rod` is no :class:`Rod`, or `degree` is not a whole number from 1 to 20; beyond that
        rounding errors take over.

    Notes
    -----
    The paper refers to its reference [8] for the procedure. This reading of it gives the numbers
    that the paper prints, and equals Galerkin's method on the same polynomials.
    """
    arguments.instance("rod", rod, Rod)
    degree = arguments.whole("degree", degree, 1, 20)
    theta = bernstein_basis(rod, degree)
    gradient, integral = theta.derivative(), theta.antiderivative()
    states = rod.sections * degree + 1
    section = rod.length / rod.sections
    area = rod.width * rod.height

    # What q(z) integrates: the storage of heat, the heat flow of each section, the ambient air.
    def stored(z):
        return integral(z)

    def supplied(z):
        return np.clip((z[:, None] - rod.edges[:-1]) / section, 0, 1) / area  # integral of (4)

    # Products with the weights have degree 2M at most: Gauss's rule with M + 1 nodes is exact.
    nodes, gauss = np.polynomial.legendre.leggauss(degree + 1)
    weights = np.polynomial.legendre.legvander(nodes, degree - 1) * gauss[:, None]
    middles = rod.edges[:-1] + section / 2
    z = (middles[:, None] + nodes * section / 2).ravel()

    def project(values):
        on_sections = values.reshape(rod.sections, degree + 1, -1)
        return np.einsum("nw,snx->swx", weights, on_sections).reshape(rod.sections * degree, -1)

    end = np.array([rod.length])
    G = np.vstack([project(stored(z)), stored(end)])
    F = np.vstack([project(gradient(z)), np.zeros(states)])
    S = np.vstack([project(supplied(z)), supplied(end)])
    a = np.vstack([project(z), end[None]])

    # kappa_1 G dx/dt = (lambda F - kappa_2 G) x + S u + kappa_2 a theta_a
    A = np.linalg.solve(G, rod.conductivity * F - rod.kappa_2 * G) / rod.kappa_1
    B = np.linalg.solve(G, np.hstack([S, rod.kappa_2 * a])) / rod.kappa_1
    return control.ss(
        A,
        B,
        theta(np.array(rod.sensors)),  # (9)
        0,
        inputs=rod.inputs,
        outputs=rod.outputs,
        name="rod",
    )


def exact_response(rod: Rod, s) -> np.ndarray:
    """Transfer function of the rod's equation (1)-(4) itself, without approximation.

    With gamma(s)^2 = (kappa_1 s + kappa_2) / lambda the temperature obeys
    theta'' = gamma^2 theta - (mu + kappa_2 theta_a) / lambda with theta'(0) = theta'(l) = 0.
    Integrating its Green's function over a heated section gives quotients of hyperbolic sines.

    Parameters
    ----------
    rod : Rod
    s : array_like, shape (n,)
        Complex frequencies, 1/s; ``1j * omega`` for a frequency response.

    Returns
    -------
    ndarray, shape (n, outputs, inputs), complex
        Inputs and outputs in the order of :func:`midr`.

    Raises
    ------
    ValueError
        If `s` does not hold numbers in a row, or one of them is the pole of the rod's uniform
        mode, s = -kappa_2 / kappa_1.
    """
    arguments.instance("rod", rod, Rod)
    s = arguments.row("s", s, complex)
    pole = -rod.kappa_2 / rod.kappa_1
    if np.any(np.isclose(s, pole, rtol=1e-12, atol=0)):
        raise ValueError(f"s contains {pole:.6g}, where the transfer function has a pole")
    gamma = np.sqrt((rod.kappa_1 * s + rod.kappa_2) / rod.conductivity)[:, None, None]
    length, area = rod.length, rod.width * rod.height

    def sinh_ratio(x):  # sinh(gamma x) / sinh(gamma l), |x| <= l, without overflow
        grown, decayed = np.exp(gamma * (x - length)), np.exp(-gamma * (x + length))
        return (grown - decayed) / -np.expm1(-2 * gamma * length)

    z = np.array(rod.sensors)[:, None]
    start, stop = rod.edges[:-1], rod.edges[1:]
    inner = np.clip(z, start, stop)
    above, below = np.maximum(z, inner), np.minimum(z, inner)  # equal to z where it counts
    left = sinh_ratio(length - above + inner) + sinh_ratio(inner - length + above)
    left -= sinh_ratio(length - above + start) + sinh_ratio(start - length + above)
    right = sinh_ratio(length - inner + below) + sinh_ratio(length - inner - below)
    right -= sinh_ratio(length - stop + below) + sinh_ratio(length - stop - below)
    density = rod.sections / (area * length)  # of a heat flow, (4)
    flows = density * (left + right) / (2 * rod.conductivity * gamma**2)
    air = rod.kappa_2 / (rod.kappa_1 * s + rod.kappa_2)
    return np.concatenate(
        [flows, np.broadcast_to(air[:, None, None], (*flows.shape[:2], 1))], axis=2
    )


def sampled_response(rod: Rod, omega, Ts: float) -> np.ndarray:
    """Frequency response of the rod's equation (1)-(4) between a zero-order hold and a sampler.

    The modes cos(n pi z / l), n = 0, 1, ..., of the rod decay with s_n = -(kappa_2 + lambda
    (n pi / l)^2) / kappa_1. With r_n for the static response of mode n and p_n = exp(s_n Ts),

        G(z) = sum_n r_n (1 - p_n) / (z - p_n).

    The slow modes are summed like that. The others, infinitely many, have decayed after a few
    samples: together they have a short impulse response, g_1 / z + g_2 / z^2 + ... with

        g_k = sum_n r_n (1 - p_n) p_n^(k - 1).

    It falls as exp(-n^2), so that a few hundred modes are all that counts, but for the sum of all
    r_n in g_1. That is what the slow modes leave of :func:`exact_response` at zero.

    Parameters
    ----------
    rod : Rod
    omega : array_like, shape (n,)
        Angular frequencies, rad/s, from 0 to the Nyquist frequency pi / Ts.
    Ts : float
        Sampling period, s.

    Returns
    -------
    ndarray, shape (n, outputs, inputs), complex
        Inputs and outputs in the order of :func:`midr`; theta_a is held like the heat flows.

    Raises
    ------
    ValueError
        If `rod` is no :class:`Rod`, `Ts` is no sampling period or so short that more than
        100,000 modes count, or `omega` does not hold numbers in a row from
        0 to pi / Ts.

    Notes
    -----
    What is left out of g_k, from mode N on, is below 1e-12 of the largest entry at each frequency.
    With r = 1 / (b h l kappa_2) and x = lambda (N pi / l)^2 Ts / kappa_1 there is |r_n| <= 2 r and
    p_n <= exp(-x n^2 / N^2), so that the sum over k of what is left out is at most

        4 r sum_{n >= N} p_n <= 4 r e^-x (1 + N / 2x).

    Slow are the first N / 8 modes. For the others p_n^64 obeys the bound of p_n with N / 8 in the
    place of N, so that what is left out from g_65 on is smaller still.
    The same flow from all sections excites the uniform mode alone, so that the largest entry is
    no smaller than r (1 - p_0) / 2; hence x = 40 - log(1 - p_0). R is rounded to about 1e-16 r,
    which is below 1e-10 of the largest entry if Ts > 1e-5 kappa_1 / kappa_2, 3 ms for the paper's
    rig; with a shorter period that holds at low frequencies only.
    """
    arguments.instance("rod", rod, Rod)
    Ts = arguments.sampling_period("Ts", Ts)
    omega = arguments.row("omega", omega)
    if omega.min() < 0 or omega.max() > np.pi / Ts * (1 + 1e-9):
        raise ValueError(
            f"omega spans [{omega.min():.6g}, {omega.max():.6g}] rad/s, but must lie in "
            f"[0, {np.pi / Ts:.6g}] rad/s, up to the Nyquist frequency of Ts = {Ts} s"
        )
    step = np.expm1(1j * omega * Ts)
    return HeldRod(rod, Ts).response(step, delays(step), rod.inputs)


POWERS = 64  # of 1 / z; the square of a whole number


def delays(step) -> np.ndarray:
    """1 / z, 1 / z^2, ... at z = 1 + `step`, shape (n, POWERS), for :class:`HeldRod`."""
    return np.cumprod(np.broadcast_to(1 / (1 + step[:, None]), (len(step), POWERS)), axis=1)


class HeldRod:
    """The rod of :func:`sampled_response`: its slow modes, and an impulse response for the others.

    Parameters
    ----------
    rod : Rod
    Ts : float
        Sampling period, s.
    gains : sequence of float, optional
        Heat flow that each section gets per heat flow commanded. Default: one.

    Raises
    ------
    ValueError
        If `Ts` is too short for the rod.
    """

    def __init__(self, rod: Rod, Ts: float, gains: Sequence[float] | None = None):
        decay = Ts / rod.kappa_1
        x = 40 - np.log(-np.expm1(-rod.kappa_2 * decay))
        modes = rod.length / np.pi * np.sqrt(x / (rod.conductivity * decay))
        if modes > 1e5:
            raise ValueError(
                f"Ts = {Ts} is too short for this rod: {modes:.3g} modes count, and 100,000 are "
                f"the limit. Take at least {Ts * (modes / 1e5) ** 2:.3g} s"
            )
        n = np.arange(int(np.ceil(modes)))
        slow = int(np.ceil(modes / np.sqrt(POWERS)))
        rate = rod.kappa_2 + rod.conductivity * (n * np.pi / rod.length) ** 2  # -s_n kappa_1
        middles = (np.arange(rod.sections) + 0.5) / rod.sections
        shown = np.cos(np.outer(n * np.pi / rod.length, rod.sensors))
        flows = np.cos(np.outer(n * np.pi, middles)) * np.sinc(n / 2 / rod.sections)[:, None]
        flows *= (np.where(n, 2, 1) / (rod.width * rod.height * rod.length * rate))[:, None]
        r = np.zeros((len(n), len(rod.sensors), rod.sections + 1))
        r[:, :, :-1] = shown[:, :, None] * flows[:, None]
        r[0, :, -1] = 1  # the air excites the uniform mode alone

        gains = np.append(np.ones(rod.sections) if gains is None else gains, 1)
        r *= gains

        less_one = np.expm1(-rate * decay)  # p_n - 1
        first = -less_one[:, None, None] * r  # g_1 of each mode
        powers = np.exp(-np.outer(np.arange(POWERS + 1), rate[slow:] * decay))
        self.names = rod.inputs
        self.less_one, self.decay = less_one[:slow], rate[:slow] * decay
        self.slow, self.fast = first[:slow], np.tensordot(powers[:-1], first[slow:], axes=1)
        # What the slow modes leave of the sum of all r_n; small ones first, for fewer digits go.
        rest = exact_response(rod, 0.0)[0].real * gains - r[:slow][::-1].sum(axis=0)
        self.fast[0] = rest - np.tensordot(powers[1], r[slow:], axes=1)

    def response(self, step, delays, inputs: Sequence[str]) -> np.ndarray:
        """G(z) on the unit circle.

        Parameters
        ----------
        step : ndarray, shape (n,), complex
            z - 1.
        delays : ndarray, shape (n, POWERS), complex
            :func:`delays` of `step`, which many rods can share.
        inputs : sequence of str
            Names of the inputs that are wanted.

        Returns
        -------
        ndarray, shape (n, outputs, inputs), complex
        """
        slow, fast = self._of(inputs)
        response = (1 / (step[:, None] - self.less_one)) @ slow.reshape(len(slow), -1)
        response += delays @ fast.reshape(len(fast), -1)
        return response.reshape(len(step), *slow.shape[1:])

    def impulse_response(self, samples: int, inputs: Sequence[str]) -> np.ndarray:
        """g_0 = 0, g_1, ... of G(z) = g_1 / z + g_2 / z^2 + ..., (outputs, inputs, samples)."""
        slow, fast = self._of(inputs)
        block = int(np.ceil(np.sqrt(samples)))
        steps = np.arange(block) * self.decay[:, None]
        powers = np.exp(-block * steps)[:, :, None] * np.exp(-steps)[:, None]  # p^(block i + j)
        g = np.zeros((*slow.shape[1:], block**2 + 1))
        g[:, :, 1:] = np.tensordot(slow, powers.reshape(len(slow), -1), axes=(0, 0))
        g[:, :, 1 : POWERS + 1] += np.moveaxis(fast, 0, -1)[:, :, : block**2]
        return g[:, :, :samples]

    def _of(self, inputs):
        wanted = [self.names.index(name) for name in inputs]
        return self.slow[:, :, wanted], self.fast[:, :, wanted]
