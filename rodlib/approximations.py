"""Other ways from the rod's equation to a state-space model, beside :func:`rodlib.midr`. Section V.

Finite volumes and elements are ordinary differential equations of one form,

    kappa_1 M dx/dt = -(lambda K + kappa_2 M) x + F u,

with storage M, conduction K and supply F. They differ in what the states are. Modes are coupled by
nothing; what is balanced is a fine model cut down. All have the inputs and outputs of
:func:`rodlib.midr`.

See Also
--------
rodlib.midr : the paper's way

Examples
--------
>>> from rodlib import Rod, approximations
>>> approximations.finite_volumes(Rod(), cells=16).nstates
64
"""

from collections.abc import Sequence
from copy import deepcopy

import control
import numpy as np
from scipy.linalg import eigh, solve_continuous_lyapunov

from ilctools import arguments
from rodlib.rod import Rod, labelled, midr
from rodlib.rod import modes as modes_of


def finite_volumes(rod: Rod, cells: int) -> control.StateSpace:
    """Average temperatures of equal cells, and the heat that flows between neighbours.

    The flow follows from the difference of two averages by Fourier's law (2). Between the middles
    of two cells, sensors read the straight line, beyond the outer ones the average.

    Parameters
    ----------
    rod : Rod
    cells : int
        Number of cells in each section, 1000 or fewer.

    Returns
    -------
    control.StateSpace
        As :func:`rodlib.midr`, with ``sections * cells`` states (K). The error falls with the
        square of `cells`.
    """
    arguments.instance("rod", rod, Rod)
    cells = arguments.whole("cells", cells, 1, 1000)
    faces = np.linspace(0, rod.length, rod.sections * cells + 1)
    dz, middles, each = faces[1], (faces[:-1] + faces[1:]) / 2, np.eye(len(faces) - 1)
    heat = np.kron(np.eye(rod.sections), np.full((cells, 1), dz))
    step = np.diff(each, axis=0)  # from one cell to the next
    hats = [np.interp(rod.sensors, middles, hat) for hat in each]
    return _model(rod, dz * each, step.T @ step / dz, heat, np.column_stack(hats))


def finite_elements(rod: Rod, element, elements: int = 1) -> control.StateSpace:
    """Galerkin's method with elements of scikit-fem, of the extra ``rodlib[approximations]``.

    Parameters
    ----------
    rod : Rod
    element : skfem.Element
        For a line, such as ``skfem.ElementLineP1()`` or ``skfem.ElementLineHermite()``.
    elements : int, default 1
        Number of elements in each section, 1000 or fewer.

    Returns
    -------
    control.StateSpace
        As :func:`rodlib.midr`; the states are the coefficients of the elements' functions. With one
        element of degree M in each section, continuous and no more, the response is that of
        :func:`rodlib.midr`.
    """
    import skfem
    from skfem.models.poisson import laplace, mass, unit_load

    arguments.instance("rod", rod, Rod)
    elements = arguments.whole("elements", elements, 1, 1000)
    line = skfem.MeshLine.elem.refdom
    if getattr(element, "refdom", None) is not line or not element.nodal_dofs:
        raise ValueError(
            f"element = {element!r:.200} must be an element of scikit-fem for a line, with "
            "values at its ends"
        )
    mesh = skfem.MeshLine(np.linspace(0, rod.length, rod.sections * elements + 1))
    # ElementLinePp keeps its values by the number of points: a new one, with more than sensors.
    element, order = deepcopy(element), 2 * max(element.maxdeg, len(rod.sensors))
    basis = skfem.Basis(mesh, element, intorder=order)
    section = np.arange(mesh.nelements).reshape(rod.sections, elements)
    loads = [unit_load.assemble(basis.with_elements(part)) for part in section]
    M, K = (form.assemble(basis).toarray() for form in (mass, laplace))
    sensors = basis.probes(np.array([rod.sensors])).toarray()
    return _model(rod, M, K, np.column_stack(loads), sensors)


def modal_series(rod: Rod, modes: int) -> control.StateSpace:
    """The slowest modes cos(n pi z / l), n = 0, 1, ..., each of them exact; 10,000 or fewer.

    As :func:`rodlib.midr`; the states are the amplitudes of the modes (K). The error falls as
    slowly as the third power of `modes`, since the heat flow (4) jumps.
    """
    arguments.instance("rod", rod, Rod)
    n = np.arange(arguments.whole("modes", modes, 1, 10_000))
    s, B, C = modes_of(rod, n)
    return labelled(rod, np.diag(s), B, C)


def balanced_truncation(rod: Rod, states: int, inputs: Sequence[str]) -> control.StateSpace:
    """What counts most between inputs and outputs, cut out of a fine model (Moore, 1981).

    In balanced coordinates each state is as hard to excite as it is to see, by as much as its
    Hankel singular value says; those with the smallest are left out.

    Parameters
    ----------
    rod : Rod
    states : int
        How many to keep; some twenty, then Hankel singular values are rounding.
    inputs : sequence of str
        Those that count, as large as one watt and one kelvin; the model has the others as well.

    Notes
    -----
    At each frequency the error between `inputs` and outputs is at most twice the sum of the Hankel
    singular values left out, besides that of the fine model, :func:`rodlib.midr` of
    degree 12, which is below 1e-7 up to 0.1 rad/s.
    """
    fine = midr(rod, degree=12)
    states = arguments.whole("states", states, 1, fine.nstates)
    names = arguments.different("inputs", inputs)
    if not names or {*names} - {*rod.inputs}:
        raise ValueError(f"inputs = {inputs} must list some of {rod.inputs}")
    counted = fine[:, names].B
    R, S = _gramian_root(fine.A, counted), _gramian_root(fine.A.T, fine.C.T)
    U, hankel, Vh = np.linalg.svd(S.T @ R)
    scale = np.sqrt(hankel[:states])
    left, right = S @ U[:, :states] / scale, R @ Vh[:states].T / scale
    return labelled(rod, left.T @ fine.A @ right, left.T @ fine.B, fine.C @ right)


def _model(rod, M, K, heat, C):
    """The equations above: `heat` is what F is without the density of the flow, (4)."""
    density = rod.sections / (rod.width * rod.height * rod.length)
    F = np.column_stack([density * heat, rod.kappa_2 * heat.sum(axis=1)])
    A = -np.linalg.solve(M, rod.conductivity * K + rod.kappa_2 * M) / rod.kappa_1
    return labelled(rod, A, np.linalg.solve(M, F) / rod.kappa_1, C)


def _gramian_root(A, B):
    """R with A R R' + R R' A' + B B' = 0; negative eigenvalues of R R' are rounding."""
    values, vectors = eigh(solve_continuous_lyapunov(A, -B @ B.T))
    return vectors * np.sqrt(np.clip(values, 0, None))
