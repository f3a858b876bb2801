"""Directions in which a plant never passes anything, such as two sensors at one place.

If U' P V holds all of P, with orthonormal columns in U and V,

    P = U (U' P V) V',

then the error in the directions orthogonal to U remains, whatever v is. A v orthogonal to V moves
nothing. A filter L for U' P V therefore gives the filter V L U' for P, with the same M in the
directions that are left. M does not act on the side that has more channels, and no direction is
left out there.
"""

from dataclasses import dataclass

import control
import numpy as np

NOTHING = 1e-12  # relative to the largest singular value of all responses side by side: rounding
NAMED = 0.05  # share of a channel in a direction, above which the channel is named


@dataclass(frozen=True, eq=False)
class Directions:
    """The output directions that P moves and the input directions that move P, orthonormal."""

    U: np.ndarray  # (p, p or less)
    V: np.ndarray  # (m, m or less)

    @classmethod
    def passed_by(cls, responses) -> "Directions | None":
        """Find the directions from responses (plants, n, p, m); None if P passes all directions."""
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
        U, V = self.U, self.V
        return control.ss(P.A, P.B @ V, U.T @ P.C, U.T @ P.D @ V, P.dt)

    @property
    def back(self) -> "Directions":
        """The directions that lead back: they turn U' P V into P again."""
        return Directions(self.U.T, self.V.T)

    def in_words(self, outputs, inputs) -> str:
        """Describe what P does not pass, by the names of its channels."""
        texts = [
            *(
                f"no input moves the combination {text} of the outputs"
                for text in _beside(self.U, outputs)
            ),
            *(
                f"the combination {text} of the inputs moves no output"
                for text in _beside(self.V, inputs)
            ),
        ]
        return "; ".join(texts)


def _spanned(rows):
    """Orthonormal columns that span the column space of a matrix with few rows."""
    U, S, _ = np.linalg.svd(rows, full_matrices=False)
    least = NOTHING * S.max(initial=0)
    if least < S.min(initial=np.inf):
        return np.eye(len(rows))  # no direction is preferred
    return U[:, least < S]


def _beside(columns, names):
    """The directions that are orthogonal to the columns, in words."""
    rest = np.linalg.svd(columns)[0][:, columns.shape[1] :]
    for direction in rest.T:
        direction = direction * np.sign(direction[np.abs(direction).argmax()])
        named = zip(direction, names, strict=True)
        parts = [f"{x:+.2g} {name}" for x, name in named if abs(x) > NAMED]
        yield " ".join(parts).removeprefix("+")
