"""The controller of a current-trial loop, sample by sample."""

import numpy as np

from ilctools import arguments
from ilctools.loop.closed import CurrentTrialLoop, controller


class Controller:
    """Observer and state feedback of a loop, sample by sample, as on hardware.

    The command is u = N w - K_s x-hat - delta, (16) and (18) of the paper. Here x-hat is the
    estimate of the states, and delta is the estimate of the disturbance at the input. See
    :func:`current_trial_loop`.

    `command` and `observe` also take several loops side by side, with signals of shape (..., m).

    Parameters
    ----------
    loop : CurrentTrialLoop
        The loop with the gains of observer and state feedback.
    decimals : int, optional
        Number of decimals to which commands are rounded. Default: commands are not rounded.

    See Also
    --------
    record : runs the controller on a rig
    current_trial_loop : designs the gains

    Examples
    --------
    >>> import control
    >>> A, B = [[1, 0.01], [0, 1]], [[0], [0.01]]  # a mass of 1 kg, F in N, x in m
    >>> stage = control.ss(A, B, [[1, 0]], 0, 0.01, inputs=["F"], outputs=["x"])
    >>> from ilctools import Controller, current_trial_loop
    >>> loop = current_trial_loop(stage, ["F"])
    >>> bool(Controller(loop).step(y=[0.0], w=[1.0]) == loop.N)
    True
    """

    def __init__(self, loop: CurrentTrialLoop, decimals: int | None = None):
        arguments.instance("loop", loop, CurrentTrialLoop)
        if decimals is not None:
            arguments.whole("decimals", decimals, 0, 300)
        self.loop, self.decimals = loop, decimals
        self._A, B, self._K = controller(loop)
        self._B = np.hstack([B, loop.KL])
        self._state, self._m = np.zeros(len(B)), len(loop.outputs)

    @property
    def delta(self) -> np.ndarray:
        """The estimate of the input disturbance."""
        return self._state[..., -self._m :]

    def step(self, y, w) -> np.ndarray:
        """Compute the controls u(p) from the measured y(p) and w(p); advance the observer."""
        y = arguments.array("y", y, (self._m,))
        w = arguments.array("w", w, (self._m,))
        u = self.command(w)
        self.observe(y, u)
        return u

    def command(self, w) -> np.ndarray:
        """Compute the controls u(p) from w(p) and the estimates."""
        u = w @ self.loop.N.T - self._state @ self._K.T  # (18)
        return rounded(u, self.decimals)

    def observe(self, y, applied) -> None:
        """Advance the observer by the measured y(p) and the controls that were applied."""
        inputs = np.concatenate([applied, y], axis=-1)
        self._state = self._state @ self._A.T + inputs @ self._B.T  # (16)


def rounded(values, decimals: int | None):
    """Round values to a number of decimals; if this number is None, return them unchanged."""
    if decimals is None:
        return values
    # numpy rounds up some decimals that are just below a half
    rounds = round if isinstance(values, float) else np.round
    return rounds(values, decimals)
