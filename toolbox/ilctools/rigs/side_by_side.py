"""Trials of simulated rigs side by side, whose arrays have a row for each: one step for all.

What there is to say of the trials, :func:`ilctools.record` says of a rig that is :class:`Recorded`.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ilctools.law.law import Law
from ilctools.loop.closed import CurrentTrialLoop
from ilctools.rigs.controlled import Controller

Signals = tuple[np.ndarray, np.ndarray]  # y and u


def run(rigs, loop: CurrentTrialLoop, w) -> Signals:
    """Run a trial with the loop's controller: y and u, of the shape of w, (rig, time, m)."""
    w = np.moveaxis(w, 1, 0)
    controller, (y, u) = Controller(loop), np.zeros((2, *w.shape))
    positions = np.array([rigs.inputs.index(name) for name in loop.controls])
    inputs = np.zeros((w.shape[1], len(rigs.inputs)))
    for p in range(len(w)):
        y[p] = rigs.read()
        u[p] = inputs[:, positions] = controller.command(w[p])
        controller.observe(y[p], u[p])
        rigs.apply(inputs)
    return np.moveaxis(y, 0, 1), np.moveaxis(u, 0, 1)


def learn(
    rigs, loop: CurrentTrialLoop, laws: Sequence[Law], reference, trials: int
) -> Iterator[Signals]:
    """y and u of trials that begin anew, each rig under its law; reference (rig, time, m)."""
    v = np.zeros_like(reference)
    for trial in range(1, trials + 1):
        rigs.begin(trial)
        y, u = run(rigs, loop, reference + v)
        yield y, u
        for law in {*laws}:
            its = [each is law for each in laws]
            v[its] = law.next(v[its], (reference - y)[its])


class Recorded:
    """A rig whose trials, y and u of each, have been run: for `record` and `shake` to note."""

    def __init__(self, trials: Iterable[Signals], inputs, limits=None):
        self._trials, self.inputs, self.limits = iter(trials), inputs, limits

    def run(self, w) -> Signals:
        """The signals of the next trial."""
        return next(self._trials)
