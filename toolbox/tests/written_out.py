"""The current-trial loop written out sample by sample, and plants that are not its model."""

import control
import numpy as np


def simulated(loop, plant, w, d, noise=None, x=None):
    """Readings, u and delta: the plant, (16) and (18); signals in the loop's order."""
    n, m = loop.plant.nstates, loop.plant.noutputs
    A, B, C = loop.plant.A, loop.plant.B[:, :m], loop.plant.C
    KL1, KL2 = loop.KL[:n], loop.KL[n:]
    noise, x = (
        np.zeros(w.shape) if noise is None else noise,
        np.zeros(plant.nstates) if x is None else x,
    )
    x_hat, delta = np.zeros(n), np.zeros(m)
    y, us, deltas = np.empty((3, *w.shape))
    for p in range(len(w)):
        u = loop.N @ w[p] - loop.Ks @ x_hat - delta
        inputs = np.concatenate([u, d[p]])
        us[p], deltas[p] = u, delta
        y[p] = plant.C @ x + plant.D @ inputs + noise[p]
        innovation = y[p] - C @ x_hat
        x = plant.A @ x + plant.B @ inputs
        x_hat, delta = (A @ x_hat + B @ (u + delta) + KL1 @ innovation, delta + KL2 @ innovation)
    return y, us, deltas


def another(design, rng):
    """A plant of another order than a design of order 4, with feedthrough."""
    return control.ss(
        np.block([[0.99 * design.A, np.zeros((4, 1))], [np.ones((1, 4)), 0.3]]),
        np.vstack([design.B, np.ones((1, 3))]), np.hstack([design.C, 0.01 * np.ones((2, 1))]),
        0.01 * rng.standard_normal(design.D.shape), design.dt,
        inputs=design.input_labels, outputs=design.output_labels,
    )  # fmt: skip


def mixed(plant, rng):
    """The same plant with its inputs and outputs in another order, and with some more of them."""
    B = np.hstack([rng.standard_normal((plant.nstates, 1)), plant.B[:, ::-1]])
    C = np.vstack([np.ones((1, plant.nstates)), plant.C[::-1]])
    D = np.zeros((len(C), B.shape[1]))
    D[1:, 1:] = plant.D[::-1, ::-1]
    inputs = ["draught", *plant.input_labels[::-1]]
    outputs = ["spare", *plant.output_labels[::-1]]
    return control.ss(plant.A, B, C, D, plant.dt, inputs=inputs, outputs=outputs)
