"""The current-trial feedback loop: what holds the rod on its reference within one trial.

Section III, (12)-(32): a minimal realisation of the plant, its exact discretisation, a state
feedback, and an observer that also estimates the equivalent input disturbance. The loop is what
iterative learning control then acts on from trial to trial. What a model gets wrong is seen with
the same controller around another plant.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import control
import numpy as np
from scipy.linalg import LinAlgError, LinAlgWarning, block_diag, null_space, solve_discrete_are

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
    units : dict
        Unit of each input and output of the plant, by name; "" if it is not known.
    """

    plant: control.StateSpace
    Ks: np.ndarray
    KL: np.ndarray
    N: np.ndarray
    units: dict[str, str]

    @property
    def Ts(self) -> float:
        """Sampling period, s."""
        return self.plant.dt

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
    def P(self) -> control.StateSpace:
        """The transfer function from w to y, P of (31), as C (zI - A + B K_s)^-1 B N.

        The signal w does not excite the estimation error, so the observer's states are left out.
        """
        B = self.plant.B[:, : self.plant.noutputs]
        return control.ss(
            self.plant.A - B @ self.Ks, B @ self.N, self.plant.C, 0, self.Ts,
            inputs=_learned(self), outputs=self.outputs,
        )  # fmt: skip

    @cached_property
    def closed(self) -> control.StateSpace:
        """The loop (19): inputs w1, w2, ..., then d; outputs y; states x, x-hat, epsilon-hat."""
        return _close(self, self.plant)

    def around(self, plant: control.StateSpace | control.TransferFunction) -> control.StateSpace:
        """Close the loop (19) of the same controller around another plant.

        Parameters
        ----------
        plant : control.StateSpace or control.TransferFunction
            Of any order. Its signals are matched by name: it must have the loop's controls and
            outputs, and a disturbance that it lacks has no effect. Others than the loop's are left
            out. Feedthrough is allowed.

        Returns
        -------
        control.StateSpace
            As `closed`, but the first states are those of `plant`.

        Raises
        ------
        ValueError
            If the plant is not finite, is in continuous time or has another sampling period, lacks
            a control or an output, or if the loop around it is not stable.
        """
        plant = _sampled(plant)
        arguments.one_period(loop=self.Ts, plant=plant.dt)
        signals = [*plant.input_labels, *plant.output_labels]
        missing = [name for name in [*self.controls, *self.outputs] if name not in signals]
        if missing:
            raise ValueError(f"plant has the signals {signals}, but lacks {missing} of the loop")
        names = self.plant.input_labels
        picked = np.array([[theirs == ours for ours in names] for theirs in plant.input_labels])
        rows = [plant.output_labels.index(name) for name in self.outputs]
        closed = _close(
            self,
            control.ss(plant.A, plant.B @ picked, plant.C[rows], plant.D[rows] @ picked, plant.dt),
        )
        poles = closed.poles()
        worst = poles[np.abs(poles).argmax()]
        if abs(worst) > 1 - 1e-12:  # one, up to rounding
            raise ValueError(
                f"plant makes the loop unstable: a pole at z = {worst:.6g}, of modulus "
                f"{abs(worst):.6g}. If the plant is right, make the controller weaker, by a larger "
                "Rs or Ro"
            )
        return closed

    def frequency_response(self, omega, plant=None) -> np.ndarray:
        """P of (31), of the loop as designed or of the same controller around another plant.

        Around another plant the observer does not drop out: w excites the estimation error.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Angular frequencies, rad/s.
        plant : control.StateSpace, control.TransferFunction or array_like, optional
            A model as in :meth:`around`, or samples of shape (n, m, m) of a sampled plant's
            response on `omega`, from the controls to y in the loop's order: those of
            :func:`rodlib.sampled_response`, or measured. Samples do not tell whether the loop is
            stable; that is then for the caller to know. Default: the plant of the design.

        Returns
        -------
        ndarray, shape (n, m, m), complex

        Raises
        ------
        ValueError
            As in :meth:`around`; if the samples have another shape or are not finite, or a
            frequency is that of a pole.
        """
        if plant is None:
            return frequency_response(self.P, omega)
        m = self.plant.noutputs
        if isinstance(plant, control.StateSpace | control.TransferFunction):
            return frequency_response(self.around(plant)[:, :m], omega)
        omega = arguments.row("omega", omega)
        G = arguments.array("plant", plant, (len(omega), m, m), complex)
        A, B, K = _controller(self)
        # The controller's states and y at once, since its integrators have no response at z = 1.
        points = np.exp(1j * omega * self.Ts)[:, None, None]
        left = np.block(
            [
                [points * np.eye(len(A)) - A, np.broadcast_to(-self.KL, (len(G), *self.KL.shape))],
                [G @ K, np.broadcast_to(np.eye(m), G.shape)],
            ]
        )
        right = np.concatenate([np.broadcast_to(B, (len(G), *B.shape)), G @ self.N], axis=1)
        return _solve(left, right)[:, len(A) :]


def _learned(loop):
    return [f"w{i + 1}" for i in range(loop.plant.noutputs)]


def _controller(loop):
    """Observer (16) and feedback (18): c(p+1) = A c + B w + K_L y, u = N w - K c."""
    plant, m = loop.plant, loop.plant.noutputs
    B = plant.B[:, :m]
    C = np.hstack([plant.C, np.zeros((m, m))])
    A = block_diag(plant.A - B @ loop.Ks, np.eye(m)) - loop.KL @ C
    return A, np.vstack([B @ loop.N, np.zeros((m, m))]), np.hstack([loop.Ks, np.eye(m)])


def _close(loop, plant):
    """The controller of a loop around a plant with the same inputs and outputs."""
    m = loop.plant.noutputs
    A, B, K = _controller(loop)
    Bu, E, Du, F = plant.B[:, :m], plant.B[:, m:], plant.D[:, :m], plant.D[:, m:]
    return control.ss(
        np.block([[plant.A, -Bu @ K], [loop.KL @ plant.C, A - loop.KL @ Du @ K]]),
        np.block([[Bu @ loop.N, E], [B + loop.KL @ Du @ loop.N, loop.KL @ F]]),
        np.hstack([plant.C, -Du @ K]),
        np.hstack([Du @ loop.N, F]),
        loop.Ts,
        inputs=_learned(loop) + loop.disturbances,
        outputs=loop.outputs,
        name="current-trial loop",
    )


def reply(loop: CurrentTrialLoop) -> control.StateSpace:
    """What the controls u of the loop (19) answer to w and to an error in the measured outputs.

    With it the same controller around another plant can be computed from the loop as designed,
    which is stable, and not from the controller alone, which integrates.

    Parameters
    ----------
    loop : CurrentTrialLoop

    Returns
    -------
    control.StateSpace
        2m inputs: w, then what is added to y before the observer (16) sees it. m outputs: u.
    """
    closed, m = loop.closed, loop.plant.noutputs
    enters = np.zeros((closed.nstates, m))
    enters[-len(loop.KL) :] = loop.KL
    _, _, K = _controller(loop)
    shown = np.hstack([np.zeros((m, closed.nstates - len(loop.KL))), -K])  # (18)
    D = np.hstack([loop.N, np.zeros((m, m))])
    return control.ss(closed.A, np.hstack([closed.B[:, :m], enters]), shown, D, loop.Ts)


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
    return system.C @ _solve(resolvent, system.B.astype(complex)) + system.D


def _solve(left, right):
    try:
        return np.linalg.solve(left, right)
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
    plant = _controls_first(plant, controls)
    A, B, C = plant.A, plant.B, plant.C
    T = reachable_basis(A, B[:, : len(controls)])
    T = T @ reachable_basis((T.T @ A @ T).T, (C @ T).T)
    if not T.size:
        raise ValueError(f"controls = {controls!r} reach no state that the outputs show")
    return control.ss(
        T.T @ A @ T, T.T @ B, C @ T, plant.D, plant.dt,
        inputs=plant.input_labels, outputs=plant.output_labels, name=plant.name,
    )  # fmt: skip


def _controls_first(plant, controls):
    """The plant with its inputs in the order controls, disturbances."""
    names = plant.input_labels
    given = [str(name) for name in controls] if isinstance(controls, Sequence) else []
    if not given or sorted(given) != sorted(set(given) & set(names)):
        raise ValueError(
            f"controls = {controls!r} must list different inputs of the plant, {names}"
        )
    ordered = given + [name for name in names if name not in given]
    columns = [names.index(name) for name in ordered]
    return control.ss(
        plant.A, plant.B[:, columns], plant.C, plant.D[:, columns], plant.dt,
        inputs=ordered, outputs=plant.output_labels, name=plant.name,
    )  # fmt: skip


def current_trial_loop(
    plant: control.StateSpace | control.TransferFunction,
    controls: Sequence[str] | None = None,
    sizes: dict[str, float] | None = None,
    units: dict[str, str] | None = None,
    *,
    Qs=None,
    Rs=None,
    Qo=None,
    Ro=None,
) -> CurrentTrialLoop:
    """Close the loop (16)-(19) around a discrete-time plant.

    Parameters
    ----------
    plant : control.StateSpace or control.TransferFunction
        The model (12) with m outputs, without direct feedthrough from its controls. A transfer
        function is realised with as few states as it needs.
    controls : sequence of str, optional
        Names of the m inputs that are controls u; any others are disturbances d, which the
        controller does not know. Default: all inputs, if there are as many as outputs.
    sizes : dict, optional
        What counts as large for an output or a control, in its unit, by name; one for those that
        are not named. With them the default weights, and so the loop, depend neither on the units
        nor on the coordinates of the state. Without them the default weights are the paper's, in
        the units and coordinates of `plant`.
    units : dict, optional
        Units of inputs and outputs, by name, for those who read the results.
    Qs, Rs : array_like, shapes (n, n), (m, m), optional
        Weights of states and controls in (24). Default: C' S_y^-2 C and 0.05 S_u^-2, where S_y and
        S_u hold the sizes on their diagonals; the paper's are all one.
    Qo, Ro : array_like, shapes (n + m, n + m), (m, m), optional
        Weights of the estimation errors of states and outputs in (27). Default:
        diag(B S_u^2 B', 2 S_u^2) and S_y^2; without `sizes`, diag(I, 2I) and I as in the paper.

    Returns
    -------
    CurrentTrialLoop

    Raises
    ------
    ValueError
        If the plant is not in discrete time, is not finite, has feedthrough from a control, has
        fewer inputs than outputs, or more and `controls` does not say which are meant, has an
        unstable mode that no control reaches or no output shows, or has no control authority at
        frequency zero; if a transfer function has more zeros than poles; if a name, size or unit is
        none of the plant's; if a weight has the wrong shape or is indefinite, or if the loop with
        these weights is not stable.

    Notes
    -----
    The disturbance model (14) is integral action, A_d = C_d = I. The paper prints (28) and (29)
    with A and C; the dimensions need A_a and C_a of (15).
    """
    plant = _sampled(plant)
    m, names = plant.noutputs, plant.input_labels
    if controls is None and len(names) > m:
        raise ValueError(
            f"plant has {len(names)} inputs for {m} outputs: name the controls among {names}, such "
            f"as controls={names[:m]}; the others are disturbances"
        )
    plant = _controls_first(plant, names if controls is None else controls)
    count = len(names if controls is None else controls)
    if count != m:
        raise ValueError(
            f"controls = {plant.input_labels[:count]} are {count} inputs, but each of the {m} "
            f"outputs {plant.output_labels} needs a control of its own"
        )
    if not plant.nstates:
        raise ValueError("plant has no states: (12) needs at least one")
    if np.any(plant.D[:, :m]):
        raise ValueError(
            f"plant.D must be zero for the controls {plant.input_labels[:m]}: (12) has no direct "
            "feedthrough. Delay them by a sample"
        )
    names = [*plant.output_labels, *plant.input_labels]
    units = dict.fromkeys(names, "") | arguments.by_name("units", units, names)
    for name, unit in units.items():
        arguments.instance(f"units[{name!r}]", unit, str)
    large = dict.fromkeys(names[: 2 * m], 1.0)
    large |= arguments.by_name("sizes", sizes, names[: 2 * m])
    large = [arguments.positive(f"sizes[{name!r}]", size) for name, size in large.items()]
    Sy, Su = np.diag(large[:m]), np.diag(large[m:])

    n, A, B, C = plant.nstates, plant.A, plant.B[:, :m], plant.C
    I, O = np.eye(m), np.zeros  # noqa: E741
    Aa = np.block([[A, B], [O((m, n)), I]])  # (15) with A_d = C_d = I
    Ca = np.hstack([C, O((m, m))])
    spread = np.eye(n) if sizes is None else B @ Su**2 @ B.T
    Qs = _weight("Qs", C.T @ np.linalg.inv(Sy**2) @ C if Qs is None else Qs, n)
    Rs = _weight("Rs", 0.05 * np.linalg.inv(Su**2) if Rs is None else Rs, m, definite=True)
    Qo = _weight("Qo", block_diag(spread, 2 * Su**2) if Qo is None else Qo, n + m)
    Ro = _weight("Ro", Sy**2 if Ro is None else Ro, m, definite=True)
    _require(A, B, "no control reaches")
    _require(Aa.T, Ca.T, "no output, or none apart from an input disturbance, shows")

    Ps = _riccati(A, B, Qs, Rs, "Qs and Rs")  # (25)
    Ks = np.linalg.solve(B.T @ Ps @ B + Rs, B.T @ Ps @ A)  # (26)
    Po = _riccati(Aa.T, Ca.T, Qo, Ro, "Qo and Ro")  # (28)
    KL = np.linalg.solve(Ca @ Po @ Ca.T + Ro, Ca @ Po @ Aa.T).T  # (29)
    _require_stable(A - B @ Ks, "Qs and Rs")
    _require_stable(Aa - KL @ Ca, "Qo and Ro")
    N = np.linalg.inv(C @ np.linalg.solve(np.eye(n) - A + B @ Ks, B))
    return CurrentTrialLoop(plant, Ks, KL, N, units)


def _sampled(plant):
    """A plant as a state-space model, if it is finite and in discrete time."""
    if not isinstance(plant, control.TransferFunction):
        arguments.state_space("plant", plant)
    if not (plant.isdtime(strict=True) and plant.dt is not True):
        raise ValueError(
            f"plant.dt = {plant.dt!r} must be a sampling period in seconds: sample the plant first"
        )
    names = [*plant.output_labels, *plant.input_labels]
    if len(set(names)) < plant.noutputs + plant.ninputs:
        raise ValueError(f"plant has the signals {names}: each needs a name of its own")
    return _realised(plant) if isinstance(plant, control.TransferFunction) else plant


def _realised(plant):
    """Realise each entry of a transfer function, then keep the states that all of them need."""
    shape = (plant.noutputs, plant.ninputs)
    entries = {}
    for i, j in np.ndindex(shape):
        numerator, denominator = (
            np.trim_zeros(arguments.row(f"plant.{name}", polynomials[i][j]), "f")
            for name, polynomials in (("num", plant.num), ("den", plant.den))
        )
        if len(numerator) > len(denominator):
            raise ValueError(
                f"plant has more zeros than poles from {plant.input_labels[j]} to "
                f"{plant.output_labels[i]}: it would have to look ahead. Delay it"
            )
        entries[i, j] = control.ss(control.tf(plant.num[i][j], plant.den[i][j], plant.dt))
    rows = np.repeat(np.eye(shape[0]), shape[1], axis=0)
    columns = np.tile(np.eye(shape[1]), (shape[0], 1))
    B, C, D = (block_diag(*(getattr(e, x) for e in entries.values())) for x in "BCD")
    model = control.ss(
        block_diag(*(entry.A for entry in entries.values())), B @ columns, rows.T @ C,
        rows.T @ D @ columns, plant.dt,
        inputs=plant.input_labels, outputs=plant.output_labels, name=plant.name,
    )  # fmt: skip
    return minimal_realisation(model, model.input_labels)


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
        Controls Q1 and Q3 (W), disturbances theta_a (K), Q2 and Q4 (W); outputs y1 and y2 (K).

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
    units = {name: "W" if name.startswith("Q") else "K" for name in rod.inputs + rod.outputs}
    return current_trial_loop(
        control.sample_system(model, Ts, method="zoh"), controls=["Q1", "Q3"], units=units
    )


def _weight(name, value, size, definite=False):
    value = arguments.array(name, value, (size, size))
    smallest = np.linalg.eigvalsh((value + value.T) / 2).min()
    largest = np.abs(value).max()  # rounding counts against it, whatever the units
    skew = np.abs(value - value.T).max() > 1e-6 * largest
    if skew or smallest < -1e-12 * largest or (definite and smallest <= 0):
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
