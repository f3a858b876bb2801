"""State-space models: their response, and the states that inputs reach and outputs show.

Section III, before (12): what is left of a model when nothing is kept that no control reaches or no
output shows; and any plant, a transfer function as well, as such a model in discrete time.
"""

import reprlib
from collections.abc import Sequence
from functools import lru_cache
from os import PathLike

import control
import numpy as np
from scipy import signal
from scipy.linalg import LinAlgError, block_diag, null_space

from ilctools import arguments


def frequency_response(system: control.StateSpace, omega) -> np.ndarray:
    """Response of a model at `omega` (rad/s), shape (n, outputs, inputs), complex.

    See Also
    --------
    ClosedLoop.frequency_response : the response of a loop

    Examples
    --------
    >>> import control
    >>> from ilctools import frequency_response
    >>> model = control.ss(0.9, 0.1, 1.0, 0.0, 1.0)
    >>> frequency_response(model, [0.01, 0.1]).shape
    (2, 1, 1)
    """
    arguments.state_space("system", system)
    omega = arguments.row("omega", omega)
    if system.dt is None or system.dt is True:
        raise ValueError(f"system.dt = {system.dt} must be 0, or a sampling period in seconds")
    points = np.exp(1j * omega * system.dt) if system.dt else 1j * omega
    resolvent = np.repeat(-system.A[None].astype(complex), len(points), axis=0)
    np.einsum("nii->ni", resolvent)[:] += points[:, None]  # on the diagonals alone, in place
    return system.C @ solve_off_poles(resolvent, system.B.astype(complex)) + system.D


def solve_off_poles(left, right) -> np.ndarray:
    """Solve linear equations, one for each frequency; at a pole, a ValueError says so."""
    try:
        return np.linalg.solve(left, right)
    except LinAlgError:
        raise ValueError(
            "omega has the frequency of a pole: the system has no response there"
        ) from None


def by_substitution(T, B, C, D, z) -> np.ndarray:
    """C (zI - T)^-1 B + D of a triangular T, for all z at once, shape (n, outputs, inputs)."""
    n, m = B.shape
    X = np.empty((n, m * len(z)), dtype=complex)
    for i in reversed(range(n)):  # (zI - T) X = B, from the last row up
        row = (T[i, i + 1 :] @ X[i + 1 :]).reshape(m, -1) + B[i, :, None]
        X[i] = (row / (z - T[i, i])).ravel()
    G = (C @ X).reshape(-1, m, len(z)) + D[:, :, None]
    return np.moveaxis(G, -1, 0)


def state_sequence(A, forcing, initial) -> np.ndarray:
    """States x(0) ... x(time - 1) of x(p+1) = A x(p) + f(p), all at once, shape (time, n).

    See Also
    --------
    run_trials : trials of a loop

    Examples
    --------
    >>> import numpy as np
    >>> from ilctools import state_sequence
    >>> state_sequence(np.array([[0.5]]), np.ones((4, 1)), [0.0]).ravel()
    array([0.  , 1.  , 1.5 , 1.75])
    """
    # A loop over 2500 samples costs more than the arithmetic in it. The trial is cut into about 50
    # blocks that run side by side from zero; then their initial states are chained and added.
    samples, n = forcing.shape
    length = int(np.ceil(np.sqrt(samples)))
    blocks = -(-samples // length)
    padded = np.zeros((blocks * length, n))
    padded[:samples] = forcing
    padded = padded.reshape(blocks, length, n)

    powers = _powers(np.asarray(A, dtype=float).tobytes(), n, length)
    states = np.zeros((blocks, length + 1, n))
    for p in range(length):
        states[:, p + 1] = states[:, p] @ A.T + padded[:, p]
    starts = np.empty((blocks, n))
    starts[0] = initial
    for block in range(blocks - 1):
        starts[block + 1] = powers[length] @ starts[block] + states[block, length]
    states += np.tensordot(starts, powers, axes=(1, 2))
    return states[:, :length].reshape(-1, n)[:samples]


@lru_cache(maxsize=4)  # one trial after the other has the same
def _powers(A, n, length):
    """A^0 ... A^length of the matrix with these bytes."""
    A, powers = np.frombuffer(A).reshape(n, n), np.empty((length + 1, n, n))
    powers[0] = np.eye(n)
    for p in range(length):
        powers[p + 1] = A @ powers[p]
    powers.flags.writeable = False
    return powers


def unreachable_modes(A, B) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (r,) and left eigenvectors (n, r) of modes that no input can excite, by Hautus.

    A mode counts as one if the smallest singular value of [lambda I - A, B], both blocks scaled to
    norm one, is below 1e-9. For unobservable modes pass A', C'.

    See Also
    --------
    minimal_realisation : a model without them

    Examples
    --------
    >>> from ilctools import unreachable_modes
    >>> values, _ = unreachable_modes([[-1.0, 0.0], [0.0, -2.0]], [[1.0], [0.0]])
    >>> values.real.round(4)
    array([-2.])
    """
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    scale_A, scale_B = (np.linalg.norm(X, 2) or 1.0 for X in (A, B))
    values, vectors = [], []
    for eigenvalue in np.linalg.eigvals(A):
        if any(np.isclose(eigenvalue, seen, rtol=1e-6, atol=1e-9 * scale_A) for seen in values):
            continue
        pencil = np.hstack([(eigenvalue * np.eye(len(A)) - A) / scale_A, B / scale_B])
        left, singular_values, _ = np.linalg.svd(pencil)
        silent = left[:, singular_values < 1e-9]
        values.extend([eigenvalue] * silent.shape[1])
        vectors.append(silent)
    return np.array(values), np.hstack([np.empty((len(A), 0)), *vectors])


def reachable_basis(A, B) -> np.ndarray:
    """Orthonormal basis of the reachable subspace, shape (n, r)."""
    basis = np.eye(len(A))
    while basis.size:  # a second pass only for unreachable chains of generalised eigenvectors
        _, silent = unreachable_modes(basis.T @ A @ basis, basis.T @ B)
        if not silent.size:
            break
        basis = basis @ null_space(np.hstack([silent.real, silent.imag]).T, rcond=1e-9)
    return basis


def minimal_realisation(plant: control.StateSpace, controls: Sequence[str]) -> control.StateSpace:
    """Restrict a plant to the states that its controls reach and its outputs show.

    The state is expressed in an orthonormal basis of the reachable subspace, then of the
    observable part of it. The order matters: the observer's weight Q_o = diag(I, 2I) is not
    invariant, and this is the order that gives the gains which the paper prints.

    Parameters
    ----------
    plant : control.StateSpace
    controls : sequence of str
        Names of the inputs that are controls u. All others are disturbances d.

    Returns
    -------
    control.StateSpace
        The controls first, then the disturbances, as far as they act on the states kept.

    See Also
    --------
    unreachable_modes : what is left out
    current_trial_loop : what is made of the rest

    Examples
    --------
    >>> import control
    >>> from ilctools import minimal_realisation
    >>> A, B = [[0.5, 0.0], [0.0, 0.2]], [[1.0], [0.0]]  # u moves the first state only
    >>> plant = control.ss(A, B, [[1, 1]], 0, 1.0, inputs=["u"], outputs=["y"])
    >>> minimal_realisation(plant, ["u"]).nstates
    1
    """
    arguments.state_space("plant", plant)
    plant = controls_first(plant, controls)
    A, B, C = plant.A, plant.B, plant.C
    T = reachable_basis(A, B[:, : len(controls)])
    T = T @ reachable_basis((T.T @ A @ T).T, (C @ T).T)
    if not T.size:
        raise ValueError(f"controls = {controls!r} reach no state that the outputs show")
    return control.ss(
        T.T @ A @ T, T.T @ B, C @ T, plant.D, plant.dt,
        inputs=plant.input_labels, outputs=plant.output_labels, name=plant.name,
    )  # fmt: skip


def controls_first(plant: control.StateSpace, controls: Sequence[str]) -> control.StateSpace:
    """The plant with its inputs in the order controls, disturbances."""
    names = plant.input_labels
    ordered = arguments.different("controls", controls)
    if not ordered or not {*ordered} <= {*names}:
        raise ValueError(
            f"controls = {reprlib.repr(controls)} must list different inputs of the plant, {names}"
        )
    ordered = ordered + [name for name in names if name not in ordered]
    columns = [names.index(name) for name in ordered]
    return control.ss(
        plant.A, plant.B[:, columns], plant.C, plant.D[:, columns], plant.dt,
        inputs=ordered, outputs=plant.output_labels, name=plant.name,
    )  # fmt: skip


def refuse_foreign(name: str, value) -> None:
    """Refuse what stands for a model and is none of python-control's; the error says the remedy."""
    remedy, kind = None, type(value).__name__
    if isinstance(value, str | PathLike):
        kind, remedy = "path", "read the file, and pass what stands in it"
    elif isinstance(value, signal.lti | signal.dlti):
        remedy = f"of s = {name}.to_ss(), make control.ss(s.A, s.B, s.C, s.D, s.dt)"
    elif isinstance(value, control.NonlinearIOSystem) and not isinstance(value, control.LTI):
        remedy = f"linearise it, by control.linearize({name}, x, u)"
    models = control.StateSpace | control.TransferFunction
    if isinstance(value, models) and value.dt == 0:
        raise ValueError(
            f"{name}.dt = 0 is continuous time: pass control.sample_system({name}, Ts)"
        )
    if remedy:
        raise ValueError(f"{name} = {reprlib.repr(value)} is a {kind}, and no model: {remedy}")


def sampled_plant(
    plant: control.StateSpace | control.TransferFunction, name: str = "plant"
) -> control.StateSpace:
    """A plant in discrete time as a state-space model; realises a transfer function."""
    refuse_foreign(name, plant)
    if not isinstance(plant, control.TransferFunction):
        arguments.state_space(name, plant)
    if not (plant.isdtime(strict=True) and plant.dt is not True):
        raise ValueError(
            f"{name}.dt = {plant.dt!r} must be a sampling period in seconds: pass it, as dt"
        )
    names = [*plant.output_labels, *plant.input_labels]
    if len(set(names)) < plant.noutputs + plant.ninputs:
        raise ValueError(f"{name} has the signals {names}: each needs a name of its own")
    return _realised(plant, name) if isinstance(plant, control.TransferFunction) else plant


def impulse_response(model: control.StateSpace, samples: int) -> np.ndarray:
    """Markov parameters D, C B, C A B, ... of a model, shape (samples, outputs, inputs)."""
    h = np.empty((samples, model.noutputs, model.ninputs))
    h[0], X = model.D, model.B
    for p in range(1, samples):
        h[p], X = model.C @ X, model.A @ X
    return h


def _realised(plant, called):
    """Realise each entry of a transfer function, then keep the states that all of them need."""
    shape = (plant.noutputs, plant.ninputs)
    entries = []
    for i, j in np.ndindex(shape):
        numerator, denominator = (
            np.trim_zeros(arguments.row(f"{called}.{name}", polynomials[i][j]), "f")
            for name, polynomials in (("num", plant.num), ("den", plant.den))
        )
        if len(numerator) > len(denominator):
            raise ValueError(
                f"{called} has more zeros than poles from {plant.input_labels[j]} to "
                f"{plant.output_labels[i]}: it would have to look ahead. Delay it"
            )
        entries.append(control.ss(control.tf(plant.num[i][j], plant.den[i][j], plant.dt)))
    rows = np.repeat(np.eye(shape[0]), shape[1], axis=0)
    columns = np.tile(np.eye(shape[1]), (shape[0], 1))
    A, B, C, D = (block_diag(*(getattr(entry, x) for entry in entries)) for x in "ABCD")
    model = control.ss(
        A, B @ columns, rows.T @ C, rows.T @ D @ columns, plant.dt,
        inputs=plant.input_labels, outputs=plant.output_labels, name=plant.name,
    )  # fmt: skip
    return minimal_realisation(model, model.input_labels)
