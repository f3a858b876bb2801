"""The design of the current-trial loop, which keeps a plant near its reference within one trial.

The design follows Section III of the paper, (12)-(29); all equation numbers are those of the paper.
It consists of a state feedback, and of an observer that also estimates the equivalent input
disturbance. Iterative learning control then acts on this loop from trial to trial.
"""

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.linalg import LinAlgWarning, block_diag, schur, solve_discrete_are

from ilctools import arguments
from ilctools.loop.closed import CurrentTrialLoop, with_disturbance
from ilctools.models import Model, controls_first, sampled_plant

INDEFINITE = 1e-12  # relative size of a negative eigenvalue of a weight that counts as rounding


def current_trial_loop(
    plant: Model,
    controls: Sequence[str] | None = None,
    sizes: dict[str, float] | None = None,
    units: dict[str, str] | None = None,
    *,
    Qs=None,
    Rs=None,
    Qo=None,
    Ro=None,
) -> CurrentTrialLoop:
    """Design a loop around a plant: state feedback, observer, and estimate of the disturbance.

    The gains solve two linear-quadratic problems, (16)-(29) of the paper. The disturbance is
    estimated as the input that has the same effect on the plant, and is subtracted from the
    controls. Source: J.-H. She, M. Fang, Y. Ohyama, H. Hashimoto and M. Wu, Improving
    disturbance-rejection performance based on an equivalent-input-disturbance approach, IEEE
    Transactions on Industrial Electronics 55 (2008) 380-389.

    Parameters
    ----------
    plant : control.StateSpace or control.TransferFunction
        The model (12) with m outputs, in discrete time. The controls must have no direct
        feedthrough. Every unstable mode must be reachable by a control and visible in an output. A
        transfer function is realised, with a shift register for the delay of each input.
    controls : sequence of str, optional
        Names of the m inputs that are controls u; any others are disturbances d, which the
        controller does not know. Default: all inputs, if there are as many as outputs.
    sizes : dict, optional
        A value that counts as large for an output or a control, in the unit of this signal, by
        name. A signal that is not named has the size one. With `sizes`, the default weights and the
        loop do not depend on the units or on the coordinates of the state. Without `sizes`, the
        default weights are the paper's, in the units and coordinates of `plant`.
    units : dict, optional
        Units of inputs and outputs, by name. They only label the results.
    Qs, Rs : array_like, shapes (n, n), (m, m), optional
        Weights of states and controls in (24). Only their symmetric parts count. Default:
        C' S_y^-2 C and 0.05 S_u^-2, where S_y and S_u hold the sizes on their diagonals. The
        paper's sizes are all one.
    Qo, Ro : array_like, shapes (n + m, n + m), (m, m), optional
        Weights of the estimation errors of states and outputs in (27). Default:
        diag(B S_u^2 B', 2 S_u^2) and S_y^2; without `sizes`, diag(I, 2I) and I as in the paper.

    See Also
    --------
    ClosedLoop : a loop that another controller closes
    synthesise : designs a learning filter for the loop

    Notes
    -----
    The disturbance model (14) is integral action, A_d = C_d = I. The paper prints (28) and (29)
    with A and C, but the dimensions require A_a and C_a of (15).

    Examples
    --------
    >>> import control
    >>> from ilctools import current_trial_loop
    >>> oven = control.ss(0.9, 0.1, 1.0, 0.0, 1.0, inputs=["heater"], outputs=["T"])
    >>> loop = current_trial_loop(oven, units={"T": "K", "heater": "W"})
    >>> loop.controls, float(loop.P(1.0).real.round(6))  # at rest y follows w
    (['heater'], 1.0)
    """
    plant = _checked(plant, controls)
    m = plant.noutputs
    weights = _weights(plant, sizes, Qs, Rs, Qo, Ro)
    A, B, C = plant.A, plant.B[:, :m], plant.C
    Ks, KL, N = _gains(A, B, C, *weights)
    return CurrentTrialLoop(plant, Ks, KL, N, units)


def _checked(plant, controls):
    """Check that the plant has the form (12), and return the plant as a model.

    In this model, the controls are the first inputs.
    """
    plant = sampled_plant(plant)
    m, names = plant.noutputs, plant.input_labels
    controls = names if controls is None else controls
    plant = controls_first(plant, controls)
    if len(controls) != m:
        raise ValueError(
            f"controls = {[*controls]} are {len(controls)} inputs, but the plant has {m} "
            f"outputs: name one of the inputs {names} for each of the outputs "
            f"{plant.output_labels}; the other inputs are disturbances. With more outputs than "
            "controls, close the loop on some outputs, and learn from all by a ClosedLoop"
        )
    if not plant.nstates:
        raise ValueError(
            "plant has no states, but (12) needs at least one: add a delay of one sample"
        )
    if np.any(plant.D[:, :m]):
        raise ValueError(
            f"plant.D must be zero for the controls {plant.input_labels[:m]}, because (12) has "
            "no direct feedthrough: delay the controls by a sample"
        )
    return plant


def _weights(plant, sizes, Qs, Rs, Qo, Ro):
    """Check and return the weights of (24) and (27), or their defaults."""
    n, m = plant.nstates, plant.noutputs
    Sy, Su = _sizes(sizes, plant.output_labels, plant.input_labels[:m])
    B, C = plant.B[:, :m], plant.C
    spread = np.eye(n) if sizes is None else B @ Su**2 @ B.T
    weights = {
        "Qs": (Qs, C.T @ np.linalg.inv(Sy**2) @ C),  # (24)
        "Rs": (Rs, 0.05 * np.linalg.inv(Su**2)),
        "Qo": (Qo, block_diag(spread, 2 * Su**2)),  # (27)
        "Ro": (Ro, Sy**2),
    }
    return [_weight(name, *values) for name, values in weights.items()]


def _sizes(sizes, outputs, controls):
    """Return S_y and S_u, which hold the sizes of the outputs and of the controls.

    If a size is not given, it is one.
    """
    names = [*outputs, *controls]
    large = dict.fromkeys(names, 1.0) | arguments.by_name("sizes", sizes, names)
    large = [arguments.positive(f"sizes[{name!r}]", size) for name, size in large.items()]
    return np.diag(large[: len(outputs)]), np.diag(large[len(outputs) :])


def _weight(name, asked, usual):
    """Check a weight, and return its symmetric part; the default is `usual`."""
    weight = usual if asked is None else arguments.array(name, asked, usual.shape)
    weight = (weight + weight.T) / 2
    if np.linalg.eigvalsh(weight).min() < -INDEFINITE * np.abs(weight).max():
        raise ValueError(f"{name} must be positive semidefinite")
    return weight


def _gains(A, B, C, Qs, Rs, Qo, Ro):
    """Compute K_s of (26), K_L of (29) and N, in coordinates in which A is triangular."""
    # Rounding depends on the coordinates of the state. If a transfer function has lags that are
    # slow compared with Ts, the Riccati equations have no solution in its own coordinates.
    m = B.shape[1]
    T, Z = schur(A, output="real")
    Za = block_diag(Z, np.eye(m))
    B, C, Qs, Qo = Z.T @ B, C @ Z, Z.T @ Qs @ Z, Za.T @ Qo @ Za
    Ta, Ca = with_disturbance(T, B, C)  # (15)
    Ks = _gain(T, B, Qs, Rs, "Qs and Rs")  # (26)
    KL = _gain(Ta.T, Ca.T, Qo, Ro, "Qo and Ro").T  # (29)
    N = np.linalg.inv(C @ np.linalg.solve(np.eye(len(T)) - T + B @ Ks, B))
    return Ks @ Z.T, Za @ KL, N


def _gain(A, B, Q, R, weights):
    """Compute K from a Riccati equation.

    If the equation has a mode on the unit circle, it is refused.
    """
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("error", LinAlgWarning)
            P = solve_discrete_are(A, B, Q, R)  # (25), (28)
        K = np.linalg.solve(B.T @ P @ B + R, B.T @ P @ A)  # (26), (29)
        arguments.stable("A - B K", np.linalg.eigvals(A - B @ K))
        return K
    # LinAlgError is a ValueError, and not the only one
    except (ValueError, LinAlgWarning):
        raise ValueError(
            f"{weights} leave the Riccati equation of this plant without a stabilising "
            "solution. Either the controls cannot reach an unstable mode, or the outputs do "
            "not show it; or the plant has a zero at z = 1, so that a constant input has no "
            "effect on the outputs; or a weight is zero, or too different from the other one. "
            "For the last case, pass `sizes`, the amounts that count as large"
        ) from None
