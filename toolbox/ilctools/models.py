"""State-space models: their response, and their reachable and observable part.

Before equation (12), Section III of the paper reduces a model to the states that the controls reach
and the outputs show. This module also turns any plant, such as a transfer function, into a
state-space model in discrete time.
"""

import copyreg
import reprlib
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from itertools import pairwise
from typing import Any

import control
import numpy as np
from scipy import signal, sparse
from scipy.linalg import matrix_balance, null_space, schur
from scipy.linalg.blas import dgemv

from ilctools import arguments

# Relative tolerance: below this value, a mode counts as unreachable, and two responses as equal.
SILENT = 1e-9

# Any: for transfer functions, which entry points realise, and for the results of python-control
Model = control.StateSpace | Any


def _reduced(model):
    """Return how ``pickle`` restores a model, so that designs can be sent to other processes."""
    labels = {f"{kind}s": getattr(model, f"{kind}_labels") for kind in ("input", "output", "state")}
    make = partial(control.StateSpace, name=model.name, remove_useless_states=False, **labels)
    return make, (model.A, model.B, model.C, model.D, model.dt)


copyreg.pickle(control.StateSpace, _reduced)  # its attributes include lambdas, which pickle refuses


def frequency_response(system: Model, omega) -> np.ndarray:
    """Compute the response of a state-space model at `omega` (rad/s).

    The response is complex and has the shape (n, outputs, inputs).

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
    return _response(system, np.exp(1j * omega * system.dt) if system.dt else 1j * omega)


def _response(system, points):
    """Compute C (sI - A)^-1 B + D at points s of the complex plane."""
    T, B, C, D = schur_form(system)
    distance = np.abs(points[:, None] - np.diag(T)).min(initial=np.inf)
    if distance <= len(T) * np.finfo(float).eps * np.linalg.norm(T):  # within its rounding
        raise ValueError(
            "omega contains the frequency of a pole, where the system has no "
            "response: leave this frequency out"
        )
    return by_substitution(T, B, C, D, points)


def schur_form(system: Model):
    """Return T, B, C, D of a model in the basis Z in which T = Z* A Z is triangular."""
    A, B, C = balanced(system)
    T, Z = schur(A, output="complex")
    return T, Z.conj().T @ B, C @ Z, system.D


def by_substitution(T, B, C, D, z) -> np.ndarray:
    """Compute C (zI - T)^-1 B + D for a triangular matrix T and n numbers z.

    The result has the shape (n, outputs, inputs).
    """
    n, m = B.shape
    X = np.empty((n, m * len(z)), dtype=complex)
    for i in reversed(range(n)):  # (zI - T) X = B, from the last row up
        right = T[i, i + 1 :]
        used = right != 0  # for a delay, one entry in each row
        row = (right[used] @ X[i + 1 :][used]).reshape(m, -1) + B[i, :, None]
        X[i] = (row / (z - T[i, i])).ravel()
    G = (C @ X).reshape(-1, m, len(z)) + D[:, :, None]
    return np.moveaxis(G, -1, 0)


def state_sequence(A, forcing, initial) -> np.ndarray:
    """Compute the states x(0) ... x(time - 1) of x(p+1) = A x(p) + f(p).

    The result has the shape (time, n).

    See Also
    --------
    run_trials : simulates trials of a loop

    Examples
    --------
    >>> import numpy as np
    >>> from ilctools import state_sequence
    >>> state_sequence(np.array([[0.5]]), np.ones((4, 1)), [0.0]).ravel()
    array([0.  , 1.  , 1.5 , 1.75])
    """
    x = arguments.array("initial", initial, ("n",))
    A = arguments.array("A", A, (len(x), len(x)))
    forcing = arguments.array("forcing", forcing, ("time", len(x)))
    # Sample by sample: powers of A would need fewer steps, but their rounding grows with the size
    # of A, and a companion matrix is large. Powers gave errors of thousands for a stage at 2 kHz.
    x, A = np.vstack([x, forcing[:-1]]), np.asfortranarray(A)
    for before, now in pairwise(x):
        # now += A @ before, in place and without numpy's overhead: 1, the offsets and strides of
        # both, no transpose, overwrite
        dgemv(1.0, A, before, 1.0, now, 0, 1, 0, 1, 0, 1)
    return x


def from_rest(model: control.StateSpace, w) -> np.ndarray:
    """Compute the outputs of a model in a trial that begins at rest.

    The inputs have the shape (time, m), and the outputs have the shape (time, p).
    """
    direct = w @ model.D.T
    if not model.nstates:
        return direct
    x = state_sequence(model.A, w @ model.B.T, np.zeros(model.nstates))
    return x @ model.C.T + direct


def on_trial(samples: int, of_x, of_d, delay: int = 0) -> sparse.csc_array:
    """Make the matrix that maps the states x and the inputs d of a trial to a signal.

    The signal is of_x x(p - delay) + of_d d(p - delay) in the samples p = 0, ..., samples - 1. The
    columns of the matrix belong to the states x in all samples, and then to the inputs d.
    """
    time = sparse.eye_array(samples, k=-delay)
    return sparse.hstack([sparse.kron(time, part, "csc") for part in (of_x, of_d)], "csc")


def dynamics_on_trial(samples: int, A, B) -> sparse.csc_array:
    """Make the matrix that computes x(p) - A x(p - 1) - B d(p - 1).

    The states and inputs of a trial make this difference zero.
    """
    return on_trial(samples, np.eye(len(A)), np.zeros_like(B)) - on_trial(samples, A, B, delay=1)


def unreachable_modes(A, B) -> np.ndarray:
    """Compute the left eigenvectors of modes that no input can excite.

    The eigenvectors have the shape (n, r). The modes are found by the Hautus test. For this test,
    both blocks of [lambda I - A, B] are scaled to norm one. A mode is unreachable if the smallest
    singular value of this matrix is below SILENT. For unobservable modes pass A', C'.
    """
    scale_A, scale_B = (np.linalg.norm(X, 2) or 1.0 for X in (A, B))
    values, vectors = [], []
    for eigenvalue in np.linalg.eigvals(A):
        if any(np.isclose(eigenvalue, seen, rtol=1e-6, atol=1e-9 * scale_A) for seen in values):
            continue
        pencil = np.hstack([(eigenvalue * np.eye(len(A)) - A) / scale_A, B / scale_B])
        left, singular_values, _ = np.linalg.svd(pencil)
        silent = left[:, singular_values < SILENT]
        values += [eigenvalue] * silent.shape[1]
        vectors.append(silent)
    return np.hstack([np.empty((len(A), 0)), *vectors])


def reachable_basis(A, B) -> np.ndarray:
    """Compute an orthonormal basis of the reachable subspace; it has the shape (n, r)."""
    basis = np.eye(len(A))
    while basis.size:  # a second pass only for unreachable chains of generalised eigenvectors
        silent = unreachable_modes(basis.T @ A @ basis, basis.T @ B)
        if not silent.size:
            break
        basis = basis @ null_space(np.hstack([silent.real, silent.imag]).T, rcond=SILENT)
    return basis


def minimal_realisation(plant: Model, controls: Sequence[str]) -> control.StateSpace:
    """Restrict a plant to the states that its controls reach and its outputs show.

    The state is expressed in an orthonormal basis of the reachable subspace, and then of the
    observable part of this subspace. The order of these two steps matters, because the weight Q_o =
    diag(I, 2I) of the paper's observer is not invariant under a change of basis. With the order
    used here, the gains are the gains that the paper prints.

    Parameters
    ----------
    plant : control.StateSpace
        The plant.
    controls : sequence of str
        Names of the inputs that are controls u. All other inputs are disturbances d.

    Returns
    -------
    control.StateSpace
        The model. The controls are its first inputs. The disturbances follow, as far as they act on
        the remaining states.

    Raises
    ------
    ValueError
        If the controls reach no state that the outputs show. If rounding decides which states the
        controls reach. In this case, the frequency responses of the model and of the plant differ.

    See Also
    --------
    current_trial_loop : designs a loop for the remaining model

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
        raise ValueError(f"controls = {controls!r} act on no state that the outputs show")
    minimal = control.ss(
        T.T @ A @ T, T.T @ B, C @ T, plant.D, plant.dt,
        inputs=plant.input_labels, outputs=plant.output_labels,
    )  # fmt: skip
    half = np.linspace(0.02, 1.5, 64)  # half an angle, away from integrators; j omega by tan
    points = np.exp(2j * half) if plant.dt else 1j * np.linalg.norm(A) * np.tan(half)
    P, same = (_response(x[:, [*controls]], points) for x in (plant, minimal))
    if np.abs(same - P).max() > SILENT * np.abs(P).max():
        raise ValueError(
            f"plant: rounding decides which of its {len(A)} states the controls reach and the "
            "outputs show, as happens if entries share delays. Keep all states; loops and "
            "designs accept them"
        )
    return minimal


def controls_first(plant: control.StateSpace, controls: Sequence[str]) -> control.StateSpace:
    """Sort the inputs of a plant: first the controls, then the disturbances."""
    names = plant.input_labels
    ordered = arguments.different("controls", controls)
    if not ordered or not {*ordered} <= {*names}:
        raise ValueError(
            f"controls = {reprlib.repr(controls)} must list different inputs of the plant, {names}"
        )
    return plant[:, ordered + [name for name in names if name not in ordered]]


def model_and_response(name: str, plant, omega, Ts: float):
    """Return the state-space model of a plant, and the response of the plant at `omega`.

    If the plant is a measured response, the model is None. If the plant is an array, the array is
    returned as the response.
    """
    refuse_foreign(name, plant)
    if not isinstance(plant, control.LTI):
        return None, plant
    measured = isinstance(plant, control.FrequencyResponseData)
    unsaid = measured and plant.dt in (None, True, 0)  # samples need not state a period
    if not unsaid and (plant.dt is True or plant.dt != Ts):  # True, some period, equals 1 s
        raise ValueError(
            f"{name}.dt = {plant.dt!r} must be Ts = {Ts!r}: state it, by control.ss(..., Ts), "
            "or sample the model at Ts, by control.sample_system"
        )
    if measured:
        return None, _samples_on(name, plant, omega, np.pi / Ts)
    arguments.stable(name, control.poles(plant))
    model = sampled_plant(plant, name)
    return model, _response(model, np.exp(1j * omega * Ts))


def _samples_on(name, P, omega, nyquist):
    """Return the samples of python-control's response data.

    If the data have other frequencies than omega, they are refused.
    """
    own = np.minimum(P.omega, nyquist)  # rounding may take the last one above Nyquist's
    if len(own) != len(omega) or not np.allclose(own, omega, rtol=1e-9, atol=0):
        raise ValueError(
            f"{name} is known at {len(P.omega)} frequencies, which are not the frequencies "
            f"omega: pass omega = {name}.omega, or {name} = measured_response({name}), which "
            "interpolates between them"
        )
    return np.moveaxis(P.frdata, -1, 0)


def refuse_foreign(name: str, value) -> None:
    """Refuse a model that is not a linear model of python-control.

    The error names the remedy.
    """
    remedy, models = None, control.StateSpace | control.TransferFunction
    if isinstance(value, signal.lti | signal.dlti):
        remedy = f"for s = {name}.to_ss(), pass control.ss(s.A, s.B, s.C, s.D, s.dt)"
    elif hasattr(value, "cutoff"):
        remedy = "the plant comes first, as in synthesise(P, Q)"
    elif isinstance(value, control.NonlinearIOSystem) and not isinstance(value, control.LTI):
        remedy = f"linearise it, by control.linearize({name}, x, u)"
    elif isinstance(value, models) and value.dt == 0:
        raise ValueError(
            f"{name}.dt = 0 is continuous time: pass control.sample_system({name}, Ts)"
        )
    if remedy:
        raise ValueError(
            f"{name} = {reprlib.repr(value)} is not a linear model of python-control: {remedy}"
        )


def sampled_plant(plant: Model, name: str = "plant") -> control.StateSpace:
    """Return a plant in discrete time as a state-space model.

    A transfer function is realised.
    """
    refuse_foreign(name, plant)
    if isinstance(plant, control.FrequencyResponseData):
        raise ValueError(
            f"{name} is a table of a frequency response, which cannot be simulated: "
            "measured_response(table).model() gives a model near it. ClosedLoop(Ts=..., "
            "outputs=[...]) needs no P, and synthesise takes the table"
        )
    if not isinstance(plant, control.TransferFunction):
        arguments.state_space(name, plant)
    if not (plant.isdtime(strict=True) and plant.dt is not True):
        raise ValueError(
            f"{name}.dt = {plant.dt!r} must be a sampling period in seconds: pass it as dt"
        )
    names = [*plant.output_labels, *plant.input_labels]
    if len(set(names)) < plant.noutputs + plant.ninputs:
        raise ValueError(
            f"{name} has the signals {names}, but each signal needs its own name: rename them"
        )
    return _realised(plant, name) if isinstance(plant, control.TransferFunction) else plant


def stable_plant(plant: Model, name: str = "plant") -> control.StateSpace:
    """Check that a plant is stable, and return it as a state-space model in discrete time."""
    model = sampled_plant(plant, name)
    arguments.stable(name, model.poles())
    return model


def impulse_response(model: control.StateSpace, samples: int) -> np.ndarray:
    """Compute the Markov parameters D, C B, C A B, ... of a model.

    The result has the shape (samples, outputs, inputs).
    """
    h = np.empty((samples, model.noutputs, model.ninputs))
    h[0], X = model.D, model.B
    for p in range(1, samples):
        h[p], X = model.C @ X, model.A @ X
    return h


def balanced(model, *further):
    """Return A, B and C of a model whose states are scaled to similar size.

    If `further` rows are passed, they are appended to C. After the scaling, no entry of A is large
    merely because of the unit of a state.
    """
    # The errors of a Schur form and of sparse factors are relative to the largest entry of A. If
    # one state is counted in units of 1e-8, the others lose eight digits.
    A, B, C = model.A, model.B, np.vstack([model.C, *further])
    # all inputs count as one more column, and all outputs as one more row
    inputs = np.abs(B).max(axis=1, keepdims=True)
    outputs = np.abs(C).max(axis=0, keepdims=True)
    size = np.block([[np.abs(A), inputs], [outputs, 0]])
    np.fill_diagonal(size, 0)  # no unit changes the diagonal
    with np.errstate(invalid="ignore"):  # a cast to whole numbers that are not used
        _, (scale, _) = matrix_balance(size, permute=False, separate=True)
    scale = scale[:-1] / scale[-1]
    return A * scale / scale[:, None], B / scale[:, None], C * scale


def _realised(plant, name):
    """Realise a transfer function as P = H R, with shift registers R and a minimal model H.

    A shift register delays each input. For each entry of the transfer function, H reads the
    register at the delay of this entry. If the delays were states of H instead, several entries
    would share them, and rounding would decide which of these states are redundant.
    """
    m, p = plant.shape
    parts = {place: _without_delay(name, plant, *place) for place in np.ndindex(m, p)}
    taps = sorted({(j, delay) for (_, j), (delay, _) in parts.items()})
    rows, columns = np.array([(i, taps.index((j, d))) for (i, j), (d, _) in parts.items()]).T
    entries = control.append(*(entry for _, entry in parts.values()))
    H = np.eye(m)[:, rows] * entries * np.eye(len(taps))[columns]
    with suppress(ValueError):  # no states, or none that can be left out
        H = minimal_realisation(H, H.input_labels)
    R = [shift_register([d for k, d in taps if k == j], plant.dt) for j in range(p)]
    model = H * control.append(*R)
    model.update_names(inputs=plant.input_labels, outputs=plant.output_labels)
    return model


def _without_delay(name, plant, i, j):
    """Split an entry of a transfer function into its delay in samples and a model without delay."""
    num = arguments.array(f"{name}.num[{i}][{j}]", plant.num[i][j], (...,))
    den = arguments.array(f"{name}.den[{i}][{j}]", plant.den[i][j], (...,))
    num = np.append(np.trim_zeros(num[:-1], "f"), num[-1])
    delay = max(0, len(den) - max(len(num), len(np.trim_zeros(den, "b"))))
    size = 2.0 ** np.frexp(np.abs(num).max())[1]  # scipy takes a first number below 1e-14 for zero
    try:
        rest = control.ss(control.tf(num / size, den[: len(den) - delay], plant.dt))
        return delay, control.ss(rest.A, rest.B, size * rest.C, size * rest.D, rest.dt)
    except ValueError as error:
        raise ValueError(
            f"{name} has more zeros than poles, so that it would have to look ahead, or it has "
            f"coefficients that are not finite ({error}): delay it"
        ) from None


def shift_register(delays: Sequence[int], dt: float | bool) -> control.StateSpace:
    """Make a shift register with one input, and one output for each delay, in samples."""
    taps, length = np.eye(1 + max(delays))[delays], max(delays)
    A, B = np.eye(length, k=-1), np.eye(length, 1)
    return control.ss(A, B, taps[:, 1:], taps[:, :1], dt)
