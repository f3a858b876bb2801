"""A frequency response as it was measured: what is known of it, where, and how it is drawn."""

import control
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.interpolate import make_interp_spline

from ilctools import arguments

CONFIDENCE = 0.99  # in a measured response


class Measured:
    """A response as known at some frequencies, and the region in which the truth lies.

    A kind has `response` (n, m, m) at `omega` (n,), rad/s, the `loop` whose response it is, and
    `findings`, which speak against it. It says what the doors here ask by ``_radius(confidence,
    jointly)``, ``_on(omega, confidence)``, ``_basis(omega, confidence)`` and ``_scaled(scale)``.
    """

    findings = ()

    def radius(self, confidence: float = 0.95, jointly: bool = False) -> np.ndarray:
        """Radius of ||Delta||, the largest singular value, that covers the truth.

        Parameters
        ----------
        confidence : float
            Probability, between 0 and 1, that the truth lies within.
        jointly : bool
            Whether within all radii at once, rather than within each.

        Returns
        -------
        ndarray, shape (n,)
            At `omega`.
        """
        return self._radius(probability(confidence), arguments.flag("jointly", jointly))

    def on(self, omega, confidence: float = 0.95, scale=None) -> tuple[np.ndarray, np.ndarray]:
        """Response and radius on other frequencies, for the synthesis.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Frequencies, rad/s.
        confidence : float
            Probability that the truth lies within the radius at all frequencies that are known.
        scale : array_like, shape (m,), optional
            Units of the channels, of both response and radius; see :func:`ilctools.synthesise`.

        Returns
        -------
        response : ndarray, shape (n, m, m), complex
        radius : ndarray, shape (n,)
            What is assumed between and beyond the frequencies measured, :meth:`basis` says.
        """
        omega, own = np.abs(arguments.row("omega", omega)), self
        if scale is not None:
            own = self._scaled(arguments.array("scale", scale, (self.response.shape[1],)))
        return own._on(omega, probability(confidence))

    def basis(self, omega, confidence: float = 0.95) -> tuple[str, ...]:
        """What is known, and what :meth:`on` assumes beside it on `omega`; the findings last."""
        lines = self._basis(arguments.row("omega", omega), probability(confidence))
        return (*lines, *self.findings)

    @property
    def names(self) -> tuple[list[str], list[str]]:
        """Of inputs and outputs."""
        if self.loop is None:
            return tuple([f"{x}{i + 1}" for i in range(self.response.shape[1])] for x in "wy")
        return self.loop.references, self.loop.outputs

    def frd(self) -> control.FrequencyResponseData:
        """The response at `omega`, with names and sampling period, for python-control."""
        (inputs, outputs), dt = self.names, True if self.loop is None else self.loop.Ts
        P = np.moveaxis(self.response, 0, -1)
        return control.frd(
            P, self.omega, dt, smooth=False, name="P", inputs=inputs, outputs=outputs
        )

    def plot(self) -> Figure:
        """Draw gain and phase of each entry of P, and their joint region of 99 %.

        Two rows for each output; shaded gray where P is not identified.

        Returns
        -------
        matplotlib.figure.Figure
        """
        (inputs, outputs), (n, p, m) = self.names, self.response.shape
        figure = Figure(figsize=(3.2 * m, 4 * p), layout="constrained")
        axes = figure.subplots(2 * p, m, squeeze=False)
        radius = self.radius(CONFIDENCE, jointly=True)
        sizes, known = np.abs(self.response), getattr(self, "known", np.ones(n, bool))
        for (i, j), size in zip(np.ndindex(p, m), sizes.reshape(n, -1).T, strict=True):
            gain, phase = axes[2 * i : 2 * i + 2, j]
            floor, turned = size.min() / 10, np.unwrap(np.angle(self.response[:, i, j]))
            if floor == 0:  # which no logarithmic axis shows
                floor = 1e-6 * (sizes.max() or 1.0)
                size = np.maximum(size, floor)
            off = np.where(radius < size, np.arcsin(np.minimum(radius / size, 1)), np.pi)
            band = np.maximum(size - radius, floor), size + radius
            gain.loglog(self.omega, size)
            gain.yaxis.set_minor_formatter(NullFormatter())
            gain.set(title=f"{inputs[j]} to {outputs[i]}", ylabel="gain", ylim=(floor, None))
            phase.semilogx(self.omega, np.degrees(turned))
            phase.set(xlabel="frequency (rad/s)", ylabel="phase (deg)")
            lower, upper = np.degrees([turned - off, turned + off])
            for ax, low, high in ((gain, *band), (phase, lower, upper)):
                ax.fill_between(self.omega, low, high, alpha=0.3)
                across = ax.get_xaxis_transform()
                ax.fill_between(self.omega, 0, 1, ~known, color="0.9", transform=across)
        return figure

    def __repr__(self):
        return "\n".join(self.basis(self.omega))


def probability(confidence) -> float:
    """A confidence, that of a region."""
    return arguments.number("confidence", confidence, "between 0 and 1", 0, 1)


def interpolated(knots, P, at) -> tuple[np.ndarray, np.ndarray]:
    """A cubic spline through P, (n, m, m), and by how much it differs from straight lines."""
    spline, straight = (make_interp_spline(knots, P, k)(at) for k in (3, 1))
    return spline, np.linalg.norm(spline - straight, 2, axis=(1, 2))
