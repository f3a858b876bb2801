"""Directions of outputs or inputs in which a plant has no gain at any frequency.

An example is the difference between two sensors at the same place, which no input changes. Let U
and V have orthonormal columns, such that at all frequencies

    P = U (U' P V) V'.

The error in the directions orthogonal to U then remains for any v. A v orthogonal to V changes no
output. A filter L is therefore designed for U' P V, and V L U' is the filter for P. L and V L U'
have the same M in the directions of U and V. M acts on the outputs or on the inputs, whichever have
fewer channels. Directions are left out only among the channels on which M acts.
"""

from dataclasses import dataclass

import control
import numpy as np

NOTHING = 1e-12  # relative to the largest singular value of all responses: rounding
NAMED = 0.05  # a message names the channels with a larger share in a direction


@dataclass(frozen=True, eq=False)
class Directions:
    """The output directions that inputs can change, and the input directions that change outputs.

    The directions are the orthonormal columns of U and V.
    """

    U: np.ndarray  # (p, p or less)
    V: np.ndarray  # (m, m or less)

    @classmethod
    def passed_by(cls, responses) -> "Directions | None":
        """Find directions from responses, shape (plants, n, p, m).

        If P has a gain in all directions, the result is None.
        """
        p, m = responses.shape[2:]
        parts = np.concatenate([responses.real, responses.imag]).reshape(-1, p, m)
        U = _spanned(np.moveaxis(parts, 1, 0).reshape(p, -1)) if p <= m else np.eye(p)
        V = _spanned(np.moveaxis(parts, 2, 0).reshape(m, -1)) if m <= p else np.eye(m)
        full = (U.shape[1], V.shape[1]) == (p, m)
        return None if full or not U.size else cls(U, V)

    def of(self, P):
        """Return U' P V for responses P of shape (..., p, m)."""
        return self.U.T @ P @ self.V

    def of_model(self, P: control.StateSpace) -> control.StateSpace:
        """Return U' P V for a model."""
        return self.U.T * P * self.V

    @property
    def back(self) -> "Directions":
        """The directions with which `of` converts U' P V back into P."""
        return Directions(self.U.T, self.V.T)

    def in_words(self, outputs, inputs) -> str:
        """Describe the directions in which P has no gain, by the names of the channels."""
        unmoved = [
            f"no input moves the combination {text} of the outputs"
            for text in _beside(self.U, outputs)
        ]
        idle = [
            f"the combination {text} of the inputs moves no output"
            for text in _beside(self.V, inputs)
        ]
        return "; ".join(unmoved + idle)


def _spanned(rows):
    """Return orthonormal columns that span the column space of a matrix with few rows."""
    U, S, _ = np.linalg.svd(rows, full_matrices=False)
    least = NOTHING * S.max(initial=0)
    if least < S.min(initial=np.inf):
        return np.eye(len(rows))  # the channels themselves span the space
    return U[:, least < S]


def _beside(columns, names):
    """Yield the directions that are orthogonal to the columns, in words."""
    rest = np.linalg.svd(columns)[0][:, columns.shape[1] :]
    for direction in rest.T:
        direction = direction * np.sign(direction[np.abs(direction).argmax()])
        named = zip(direction, names, strict=True)
        parts = [f"{x:+.2g} {name}" for x, name in named if abs(x) > NAMED]
        yield " ".join(parts).removeprefix("+")
