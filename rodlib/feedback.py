"""The current-trial feedback loop: what holds the rod on its reference within one trial.

Section III, (12)-(32): a minimal realisation of the plant, its exact discretisation, a state
feedback, and an observer that also estimates the equivalent input disturbance. The loop is what
iterative learning control then acts on from trial to trial.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import control
import numpy as np
from scipy.linalg import LinAlgError, LinAlgWarning, null_space, solve_discrete_are

from rodlib import arguments
from rodlib.rod import Rod, midr


@dataclass(frozen=True)
class CurrentTrialLoop:
    """The feedback loop (19) and what it is made of. Arrays are in the order of `plant`.

    Attributes
    ----------
    plant : control.StateSpace
        The plant (12): inputs u (m of them), then d; outputs y (m).
    Ks, KL, N : ndarray, shapes (m, n), (n + m, m), (m, m)
        State feedback (26), observer gain (29), static feedforward.
    closed : control.StateSpace
        The loop (19): inputs w1, w2, ..., then d; outputs y; states x, x-hat, epsilon-hat.
    units : dict
        Unit of each input and output of the plant, by name; "" if it is not known.
    """

    plant: control.StateSpace
    Ks: np.ndarray
    KL: np.ndarray
    N: np.ndarray
    closed: control.StateSpace
    units: dict[str, str] = field(default_factory=dict)

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs y."""
        return self.plant.output_labels

    @property
    def controls(self) -> list[str]:
        """Names of the controls u."""
        return self.plant.input_labels[: self.plant.noutputs]

    @property
    def disturbances(self) -> list[str]:
        """Names of the disturbances d, which the controller does not know."""
        return self.plant.input_labels[self.plant.noutputs :]

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.plant.dt

    @property
    def P(self) -> control.StateSpace:
        """The transfer function from w to y, P of (31), as C (zI - A + B K_s)^-1 B N.

        The signal w does not excite the estimation error, so the observer's states are left out.
        """
        m, names = self.plant.noutputs, self.closed.input_labels
        B = self.plant.B[:, :m]
        return control.ss(
            self.plant.A - B @ self.Ks, B @ self.N, self.plant.C, 0, self.Ts,
            inputs=names[:m], outputs=self.plant.output_labels,
        )  # fmt: skip

    def frequency_response(self, omega) -> np.ndarray:
        """P of (31) at the angular frequencies `omega` (rad/s), shape (n, m, m), complex."""
        return frequency_response(self.P, omega)


def frequency_response(system: control.StateSpace, omega) -> np.ndarray:
    """Frequency response of a state-space model, frequency first.

    Parameters
    ----------
    system : control.StateSpace
        In continuous or discrete time.
    omega : array_like, shape (n,)
        Angular frequencies, rad/s.

    Returns
    -------
    ndarray, shape (n, outputs, inputs), complex

    Raises
    ------
    ValueError
        If the system is not finite or has no sampling period, or `omega` does not hold numbers in
        a row, or one of them is the frequency of a pole.
    """
    arguments.state_space("system", system)
    omega = arguments.row("omega", omega)
    if system.dt is None or system.dt is True:
        raise ValueError(f"system.dt = {system.dt} must be 0, or a sampling period in seconds")
    points = np.exp(1j * omega * system.dt) if system.dt else 1j * omega
    resolvent = points[:, None, None] * np.eye(system.nstates) - system.A
    try:
        return system.C @ np.linalg.solve(resolvent, system.B.astype(complex)) + system.D
    except LinAlgError:
        raise ValueError(
            "omega has the frequency of a pole: the system has no response there"
        ) from None


def unreachable_modes(A, B, tolerance: float = 1e-9) -> tuple[np.ndarray, np.ndarray]:
    """Modes that no input can excite, by Hautus's test.

    Parameters
    ----------
    A, B : array_like, shapes (n, n), (n, m)
        Of a model in continuous or discrete time. For unobservable modes pass A', C'.
    tolerance : float
        A mode counts as unreachable if the smallest singular value of [lambda I - A, B], with
        both blocks scaled to norm one, is below it.

    Returns
    -------
    eigenvalues : ndarray, shape (r,)
    directions : ndarray, shape (n, r)
        Left eigenvectors; their common null space contains all that can be reached.
    """
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    scale_A, scale_B = (np.linalg.norm(X, 2) or 1.0 for X in (A, B))
    values, vectors = [], []
    for eigenvalue in np.linalg.eigvals(A):
        if any(np.isclose(eigenvalue, seen, rtol=1e-6, atol=1e-9 * scale_A) for seen in values):
            continue
        pencil = np.hstack([(eigenvalue * np.eye(len(A)) - A) / scale_A, B / scale_B])
        left, singular_values, _ = np.linalg.svd(pencil)
        silent = left[:, singular_values < tolerance]
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

    Raises
    ------
    ValueError
        If the plant is not finite, if the controls are not different inputs of it, or if they
        reach nothing that its outputs show.
    """
    arguments.state_space("plant", plant)
    given = [str(name) for name in controls] if isinstance(controls, Sequence) else []
    if not given or sorted(given) != sorted(set(given) & set(plant.input_labels)):
        raise ValueError(
            f"controls = {controls!r} must list different inputs out of {plant.input_labels}"
        )
    disturbances = [name for name in plant.input_labels if name not in controls]
    u = [plant.input_labels.index(name) for name in controls]
    d = [plant.input_labels.index(name) for name in disturbances]

    A, B, C = plant.A, plant.B, plant.C
    T = reachable_basis(A, B[:, u])
    T = T @ reachable_basis((T.T @ A @ T).T, (C @ T).T)
    if not T.size:
        raise ValueError(f"controls = {controls!r} reach no state that the outputs show")
    return control.ss(
        T.T @ A @ T,
        T.T @ B[:, u + d],
        C @ T,
        plant.D[:, u + d],
        plant.dt,
        inputs=[*controls, *disturbances],
        outputs=plant.output_labels,
        name=plant.name,
    )


def current_trial_loop(
    plant: control.StateSpace, *, Qs=None, Rs=None, Qo=None, Ro=None
) -> CurrentTrialLoop:
    """Close the loop (16)-(19) around a discrete-time plant.

    Parameters
    ----------
    plant : control.StateSpace
        The model (12) with m outputs; its first m inputs are the controls u, the others are
        disturbances d that the controller does not know. No direct feedthrough.
    Qs, Rs : array_like, shapes (n, n), (m, m), optional
        Weights of states and controls in (24). Default: C'C and 0.05 I, as in the paper.
    Qo, Ro : array_like, shapes (n + m, n + m), (m, m), optional
        Weights of the estimation errors of states and outputs in (27). Default: diag(I, 2I) and
        I, as in the paper.

    Returns
    -------
    CurrentTrialLoop

    Raises
    ------
    ValueError
        If the plant is not in discrete time, is not finite, has feedthrough, has fewer inputs than
        outputs, has an unstable mode that no control reaches or no output shows, or has no
        control authority at frequency zero; if a weight has the wrong shape or is indefinite, or
        if the loop with these weights is not stable.

    Notes
    -----
    The disturbance model (14) is integral action, A_d = C_d = I. The paper prints (28) and (29)
    with A and C; the dimensions need A_a and C_a of (15).
    """
    arguments.state_space("plant", plant)
    n, m = plant.nstates, plant.noutputs
    if not (plant.isdtime(strict=True) and plant.dt is not True):
        raise ValueError(
            f"plant.dt = {plant.dt!r} must be a sampling period in seconds: sample the plant first"
        )
    if not n:
        raise ValueError("plant has no states: (12) needs at least one")
    if plant.ninputs < m:
        raise ValueError(
            f"plant has {plant.ninputs} inputs, but each of its {m} outputs needs a control"
        )
    if np.any(plant.D):
        raise ValueError("plant.D must be zero: (12) has no direct feedthrough")
    A, B, E, C = plant.A, plant.B[:, :m], plant.B[:, m:], plant.C
    I, O = np.eye(m), np.zeros  # noqa: E741

    Aa = np.block([[A, B], [O((m, n)), I]])  # (15) with A_d = C_d = I
    Ca = np.hstack([C, O((m, m))])
    Qs = _weight("Qs", C.T @ C if Qs is None else Qs, n)
    Rs = _weight("Rs", 0.05 * I if Rs is None else Rs, m, definite=True)
    Qo = _weight("Qo", np.diag([1.0] * n + [2.0] * m) if Qo is None else Qo, n + m)
    Ro = _weight("Ro", I if Ro is None else Ro, m, definite=True)
    _require(A, B, "no control reaches")
    _require(Aa.T, Ca.T, "no output, or none apart from an input disturbance, shows")

    Ps = _riccati(A, B, Qs, Rs, "Qs and Rs")  # (25)
    Ks = np.linalg.solve(B.T @ Ps @ B + Rs, B.T @ Ps @ A)  # (26)
    Po = _riccati(Aa.T, Ca.T, Qo, Ro, "Qo and Ro")  # (28)
    KL = np.linalg.solve(Ca @ Po @ Ca.T + Ro, Ca @ Po @ Aa.T).T  # (29)
    _require_stable(A - B @ Ks, "Qs and Rs")
    _require_stable(Aa - KL @ Ca, "Qo and Ro")
    N = np.linalg.inv(C @ np.linalg.solve(np.eye(n) - A + B @ Ks, B))

    KL1, KL2 = KL[:n], KL[n:]
    Acl = np.block(
        [
            [A, -B @ Ks, -B],
            [KL1 @ C, A - B @ Ks - KL1 @ C, O((n, m))],
            [KL2 @ C, -KL2 @ C, I],
        ]
    )
    d = E.shape[1]
    Bcl = np.block([[B @ N, E], [B @ N, O((n, d))], [O((m, m)), O((m, d))]])
    Ccl = np.hstack([C, O((m, n + m))])
    closed = control.ss(
        Acl,
        Bcl,
        Ccl,
        0,
        plant.dt,
        inputs=[f"w{i + 1}" for i in range(m)] + plant.input_labels[m:],
        outputs=plant.output_labels,
        name="current-trial loop",
    )
    return CurrentTrialLoop(plant, Ks, KL, N, closed)


def paper_loop(rod: Rod | None = None, degree: int = 3, Ts: float = 1.0) -> CurrentTrialLoop:
    """Build the paper's current-trial loop, Section IV.

    Parameters
    ----------
    rod : Rod, optional
        Default: the paper's rig.
    degree : int, default 3
        Degree M of the polynomials in :func:`rodlib.midr`.
    Ts : float, default 1.0
        Sampling period, s.

    Returns
    -------
    CurrentTrialLoop
        Controls Q1 and Q3 (W), disturbances theta_a (K), Q2 and Q4 (W).

    Raises
    ------
    ValueError
        If the rod has not the paper's four sections and two sensors, or `Ts` is not between 1e-6
        and 1e4 s, where the states of a rod can be told apart.
    """
    rod = arguments.instance("rod", Rod() if rod is None else rod, Rod)
    Ts = arguments.number("Ts", Ts, "a sampling period between 1e-6 and 1e4 s", 1e-6, 1e4)
    if (rod.sections, len(rod.sensors)) != (4, 2):
        raise ValueError(
            f"rod has {rod.sections} sections and {len(rod.sensors)} sensors, but the paper's loop "
            "has Q1 to Q4 and two sensors: for another rod see minimal_realisation and "
            "current_trial_loop"
        )
    model = minimal_realisation(midr(rod, degree), ["Q1", "Q3"])
    model = model[:, ["Q1", "Q3", "theta_a", "Q2", "Q4"]]  # d in the order of (10)
    loop = current_trial_loop(control.sample_system(model, Ts, method="zoh"))
    units = {"y1": "K", "y2": "K", "Q1": "W", "Q3": "W", "theta_a": "K", "Q2": "W", "Q4": "W"}
    return replace(loop, units=units)


def _weight(name, value, size, definite=False):
    value = arguments.array(name, value, (size, size))
    smallest = np.linalg.eigvalsh((value + value.T) / 2).min()
    if not np.allclose(value, value.T) or smallest < -1e-12 or (definite and smallest <= 0):
        kind = "positive definite" if definite else "positive semidefinite"
        raise ValueError(f"{name} must be symmetric and {kind}, but is {value.tolist()}")
    return (value + value.T) / 2  # symmetric to the last digit, as the Riccati equation wants it


def _riccati(A, B, Q, R, weights):
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("error", LinAlgWarning)
            return solve_discrete_are(A, B, Q, R)
    except (LinAlgError, LinAlgWarning):
        raise ValueError(
            f"{weights} leave the Riccati equation of this plant without a solution: a weight is "
            "zero or too far from the other"
        ) from None


def _require_stable(A, weights):
    radius = np.abs(np.linalg.eigvals(A)).max()
    if radius > 1 - 1e-12:  # one, up to rounding
        raise ValueError(
            f"{weights} give a loop with a pole of modulus {radius:.6g}, which does not settle: a "
            "weight is zero or too far from the other"
        )


def _require(A, B, what):
    poles, _ = unreachable_modes(A, B)
    unstable = poles[np.abs(poles) >= 1]
    if unstable.size:
        raise ValueError(f"plant has a mode at z = {unstable[0]:.6g} that {what}: no gain holds it")
