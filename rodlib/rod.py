"""The heated rod: its parameters, its partial differential equation, its state-space model.

Equation numbers are those of the paper. Section II describes the rod by (1)-(4). :func:`midr` turns
(1)-(4) into the ordinary differential equations (8), (9). :func:`exact_response` solves (1)-(4)
without approximation, in the frequency domain, and every approximation is compared with this
solution. :func:`rodlib.sampled_response` is the same solution behind a digital controller.
"""

from dataclasses import dataclass, fields

import control
import numpy as np
from scipy.interpolate import BPoly

from ilctools import arguments


@dataclass(frozen=True)
class Rod:
    """A metal rod, heated from below in equal sections and cooled from above by the air.

    The defaults describe the rig of the paper, Section IV. Lengths are in metres.

    See Also
    --------
    midr : a model of finite order
    exact_response : the response without approximation

    Examples
    --------
    >>> from rodlib import Rod, midr
    >>> copper = Rod(density=8960.0, heat_capacity=385.0, conductivity=380.0)
    >>> midr(copper).nstates
    13
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
        vars(self)["sensors"] = sensors

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


PAPER_ROD = Rod()  # Section IV of the paper


def bernstein_basis(rod: Rod, degree: int) -> BPoly:
    """Return continuous piecewise polynomials in Bernstein form, (5)-(7), as functions of z (m).

    Neighbouring sections share their edge coefficient (7), so that ``sections * degree + 1`` basis
    functions remain. Coefficients are in the order of the state vector of (8).
    """
    coefficients = np.zeros((degree + 1, rod.sections, rod.sections * degree + 1))
    for i in range(rod.sections):
        coefficients[:, i, i * degree : (i + 1) * degree + 1] = np.eye(degree + 1)  # (6), (7)
    return BPoly(coefficients, rod.edges)


def midr(rod: Rod, degree: int = 3) -> control.StateSpace:
    """Model the rod in state space, (8), (9), by the method of integro-differential relations.

    The temperature is a continuous piecewise polynomial (5). The heat flux follows from it by
    integrating the energy balance (1) from the insulated end z = 0,

        q(z) = int_0^z (mu + kappa_2 (theta_a - theta) - kappa_1 dtheta/dt),

    so that (1) holds exactly, and so does q(0) = 0. Fourier's law (2) leaves the residual
    xi = q + lambda dtheta/dz. On each section, xi is made orthogonal to the polynomials of degree
    M - 1. The insulated end q(l) = 0 is the last equation.

    Parameters
    ----------
    rod : Rod
    degree : int, default 3
        Degree M of the polynomials in each section, 20 or less. Above 20, rounding dominates.

    Returns
    -------
    control.StateSpace
        The model has the inputs Q1, Q2, ... (W) and theta_a (K), and the outputs y1, y2, ... (K).
        Temperatures are deviations from the initial ambient temperature. The
        ``sections * degree + 1`` states are temperatures (K).

    See Also
    --------
    exact_response : the response without approximation
    finite_volumes : a model by cells

    Notes
    -----
    The paper refers to its reference [8] for the procedure. As read here, the procedure gives the
    numbers that the paper prints, and equals Galerkin's method on the same polynomials.

    Examples
    --------
    >>> from rodlib import Rod, midr
    >>> model = midr(Rod(), degree=3)
    >>> model.nstates, model.output_labels
    (13, ['y1', 'y2'])
    """
    arguments.instance("rod", rod, Rod)
    degree = arguments.whole("degree", degree, 1, 20)
    theta = bernstein_basis(rod, degree)
    section = rod.length / rod.sections

    def supplied(z):  # integral of the heat flow of each section, (4)
        return np.clip((z[:, None] - rod.edges[:-1]) / section, 0, 1) / (rod.width * rod.height)

    # q(z) integrates the storage of heat, the heat flows and the ambient air.
    G = _weighted(rod, degree, theta.antiderivative())
    S = _weighted(rod, degree, supplied)
    a = _weighted(rod, degree, lambda z: z[:, None])
    F = _weighted(rod, degree, theta.derivative())
    F[-1] = 0  # q(l) = 0

    # (8): kappa_1 G dx/dt = (lambda F - kappa_2 G) x + S u + kappa_2 a theta_a
    A = np.linalg.solve(G, rod.conductivity * F - rod.kappa_2 * G) / rod.kappa_1
    B = np.linalg.solve(G, np.hstack([S, rod.kappa_2 * a])) / rod.kappa_1
    return labelled(rod, A, B, theta(np.array(rod.sensors)))  # (9)


def _weighted(rod, degree, function):
    """Integrate a function of z, times polynomials, on each section.

    The polynomials are Legendre's, of degree M - 1 or less. The last row of the result is the value
    of the function at z = l.
    """
    # The products have degree 2M at most: Gauss's rule with M + 1 nodes is exact.
    nodes, gauss = np.polynomial.legendre.leggauss(degree + 1)
    weights = np.polynomial.legendre.legvander(nodes, degree - 1) * gauss[:, None]
    half = rod.length / rod.sections / 2
    z = rod.edges[:-1, None] + half + nodes * half
    *inside, end = function(np.append(z, rod.length))
    on_sections = np.reshape(inside, (*z.shape, -1))
    integrals = np.einsum("nw,snx->swx", weights, on_sections)
    return np.vstack([*integrals, end])


def modes(rod: Rod, n) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return s, B, C of the modes cos(n pi z / l) of (1)-(4) for each number n.

    The temperature theta is the sum of T_n cos(n pi z / l). The amplitudes T_n obey
    dT_n/dt = s_n T_n + (B u)_n. Here u are the inputs of :func:`midr`, and
    -kappa_1 s_n = kappa_2 + lambda (n pi / l)^2. The outputs are C T. The air excites the uniform
    mode alone.
    """
    waves, middles = np.pi / rod.length * n, rod.edges[:-1] + rod.length / rod.sections / 2
    means = np.cos(np.outer(waves, middles)) * np.sinc(n / 2 / rod.sections)[:, None]
    # width and height times the integral of the square of the mode
    norm = np.where(n, 0.5, 1) * rod.width * rod.height * rod.length
    B = np.column_stack([means / norm[:, None], rod.kappa_2 * (n == 0)]) / rod.kappa_1
    s = -(rod.kappa_2 + rod.conductivity * waves**2) / rod.kappa_1
    return s, B, np.cos(np.outer(rod.sensors, waves))


def finite_volumes(rod: Rod, cells: int) -> control.StateSpace:
    """Model a rod in state space by the average temperatures of equal cells.

    Fourier's law (2) holds between the middles of two cells, whose distance is dz,

        kappa_1 dx_i/dt = lambda (x_(i-1) - 2 x_i + x_(i+1)) / dz^2 + mu_i + kappa_2 (theta_a - x_i)

    without a neighbour at the ends. A sensor between the middles of two cells reads the linear
    interpolation between them. Beyond the middle of an outer cell, a sensor reads the average of
    this cell. In this model, heating makes no cell colder.

    Parameters
    ----------
    rod : Rod
    cells : int
        Number of cells in each section, 1000 or fewer.

    Returns
    -------
    control.StateSpace
        The model is as from :func:`midr`, with ``sections * cells`` states (K). The error falls
        with the square of `cells`.

    See Also
    --------
    midr : a model by polynomials
    PeltierRig : a rig made of cells

    Examples
    --------
    >>> from rodlib import Rod, finite_volumes
    >>> finite_volumes(Rod(), cells=16).nstates
    64
    """
    arguments.instance("rod", rod, Rod)
    n = rod.sections * arguments.whole("cells", cells, 1, 1000)
    dz, each = rod.length / n, np.eye(n)
    slope = np.diff(each, axis=0) / dz  # from one cell to the next
    A = -(rod.conductivity * slope.T @ slope + rod.kappa_2 * each) / rod.kappa_1
    heated = np.repeat(np.eye(rod.sections), cells, axis=0) / cells  # (4)
    heated /= rod.width * rod.height * dz
    B = np.column_stack([heated, np.full(n, rod.kappa_2)]) / rod.kappa_1
    middles = dz * (np.arange(n) + 0.5)
    hats = [np.interp(rod.sensors, middles, cell) for cell in each]
    return labelled(rod, A, B, np.transpose(hats))


def labelled(rod: Rod, A, B, C) -> control.StateSpace:
    """Return a model with the signal names of a rod."""
    return control.ss(A, B, C, 0, inputs=rod.inputs, outputs=rod.outputs, name="rod")


def exact_response(rod: Rod, s) -> np.ndarray:
    """Compute the transfer function of the rod's equations (1)-(4), without approximation.

    With gamma(s)^2 = (kappa_1 s + kappa_2) / lambda the temperature obeys
    theta'' = gamma^2 theta - (mu + kappa_2 theta_a) / lambda with theta'(0) = theta'(l) = 0. If the
    rod is heated from 0 to y by a heat flow per volume mu = 1, lambda gamma^2 theta(z) is

        cosh(gamma (l - z)) sinh(gamma y) / sinh(gamma l),            y <= z,
        1 - cosh(gamma z) sinh(gamma (l - y)) / sinh(gamma l),        y > z.

    A heated section gives the value for y at its higher edge, less the value for y at its lower
    edge.

    Parameters
    ----------
    rod : Rod
    s : array_like, shape (n,)
        Complex frequencies, 1/s; ``1j * omega`` for a frequency response.

    Returns
    -------
    ndarray, shape (n, outputs, inputs), complex
        Inputs and outputs are in the order of :func:`midr`.

    See Also
    --------
    sampled_response : the response between a hold and a sampler
    midr : a model of finite order

    Examples
    --------
    >>> from ilctools import frequency_response
    >>> from rodlib import Rod, exact_response, midr
    >>> exact = exact_response(Rod(), 0.01j)
    >>> model = frequency_response(midr(Rod()), 0.01)[0]
    >>> bool(abs(model - exact).max() < 0.02 * abs(exact).max())
    True
    """
    arguments.instance("rod", rod, Rod)
    s = arguments.row("s", s, complex)
    pole = -rod.kappa_2 / rod.kappa_1
    if np.any(np.abs(s - pole) <= -1e-12 * pole):
        raise ValueError(f"s contains {pole:.6g}, where the transfer function has a pole")
    decay = (rod.kappa_1 * s + rod.kappa_2)[:, None, None]  # lambda gamma^2
    gamma = np.sqrt(decay / rod.conductivity)
    z, y, length = np.array(rod.sensors)[:, None], rod.edges, rod.length
    below = y <= z
    from_end, heated = np.where(below, length - z, z), np.where(below, y, length - y)
    # cosh(gamma from_end) sinh(gamma heated) / sinh(gamma l) without overflow
    exponentials = (1 + np.exp(-2 * gamma * from_end)) * np.expm1(-2 * gamma * heated)
    exponentials /= 2 * np.expm1(-2 * gamma * length)
    shares = np.where(below, 1, -1) * np.exp(gamma * (from_end + heated - length)) * exponentials
    shares = np.diff(shares) - np.diff(below.astype(float))  # exactly 1 or 0: whether z is inside
    density = rod.sections / (rod.width * rod.height * length)  # mu of a heat flow of 1 W, (4)
    # the air, which warms all of the rod alike, is the last input
    return np.insert(density * shares, rod.sections, rod.kappa_2, axis=2) / decay
