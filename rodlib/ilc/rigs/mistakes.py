"""Mistakes in the wiring, as far as the first trial shows them.

The commands and the model give outputs. Where the measured ones are others, each of the common
mistakes gives outputs as well; the one that explains nearly all of the difference is named.
"""

from collections.abc import Iterator
from itertools import combinations

import control
import numpy as np

from rodlib.ilc import arguments
from rodlib.ilc.models import state_sequence

OTHER = 0.5  # of an output: what is less beside the model is no mistake
LEFT = 0.02  # of the power of the difference, that a mistake may leave unexplained
MOVES = 0.1  # of the largest reference: a sensor that stands still although as much was foretold


def mistake_in(
    model: control.StateSpace, u, known, y, reference, outputs, inputs
) -> str | None:
    """The mistake that explains a trial from rest, of signals (time, channel), in words.

    The inputs of the model are the commands u, then what is known beside them.
    """
    drifts = (
        np.abs(model.poles()).max(initial=0) > arguments.CIRCLE
    )  # with any disturbance
    if len(y) < 2 or drifts or not reference.any():
        return None
    largest = max(
        np.abs(each).max() for each in (u, y, known.ravel(), reference) if each.size
    )
    u, known, y, reference = (each / largest for each in (u, known, y, reference))
    answers, foretold = _answers(model, u, known)
    stuck = [
        name
        for name, own, model_own in zip(outputs, y.T, foretold.T, strict=True)
        if not np.ptp(own) and np.ptp(model_own) > MOVES * np.abs(reference).max()
    ]
    if stuck:
        return f"{', '.join(stuck)} never moves, although the commands would move it: a dead sensor"
    size = np.sqrt(
        np.maximum.reduce([np.mean(each**2, axis=0) for each in (y, foretold)])
    )
    size = np.maximum(size, np.sqrt(np.mean(reference**2, axis=0)))
    size = np.where(size > 0, size, 1.0)

    def power(other):
        return np.mean(((y - other) / size) ** 2, axis=0)

    beside = power(foretold)
    if beside.max() <= OTHER**2:
        return None
    others = _others(answers, foretold, y, outputs, inputs)
    found = ((power(other).sum(), text) for text, other in others)
    left, best = min(found, default=(np.inf, None))
    return best if left <= LEFT * beside.sum() else None


def _answers(model, u, known):
    """How the outputs answer to each command through each input, and to all as they should be."""
    m, zero = u.shape[1], np.zeros(model.nstates)

    def through(signals, columns):
        states = state_sequence(model.A, signals @ model.B[:, columns].T, zero)
        return states @ model.C.T + signals @ model.D[:, columns].T

    answers = np.array([[through(u[:, [i]], [j]) for j in range(m)] for i in range(m)])
    beside = through(known, list(range(m, model.ninputs)))
    return answers, np.einsum("iipq->pq", answers) + beside


def _others(answers, foretold, y, outputs, inputs) -> Iterator[tuple[str, np.ndarray]]:
    """Mistakes in words, and the outputs that they would lead to."""
    for j, name in enumerate(inputs):
        yield f"{name} acts in the wrong direction", foretold - 2 * answers[j, j]
    for i, j in combinations(range(len(inputs)), 2):
        exchanged = answers[i, j] + answers[j, i] - answers[i, i] - answers[j, j]
        yield f"{inputs[i]} and {inputs[j]} are exchanged", foretold + exchanged
    for i, j in combinations(range(len(outputs)), 2):
        order = np.arange(len(outputs))
        order[[i, j]] = j, i
        yield f"{outputs[i]} and {outputs[j]} are exchanged", foretold[:, order]
    for i, name in enumerate(outputs):
        own, other = foretold[:, i], foretold.copy()
        if own.any():
            factor = (y[:, i] @ own) / (own @ own)
            other[:, i] = factor * own
            yield (
                f"{name} is {factor:.3g} times what the commands explain: another unit or sign",
                other,
            )
        other = foretold.copy()
        other[:, i] += np.mean(y[:, i] - own)
        yield (
            f"{name} is off by the same amount all the time: counted from another zero",
            other,
        )
