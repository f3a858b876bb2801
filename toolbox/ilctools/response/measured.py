"""A frequency response as it was measured: what is known of it, where, and how it is drawn."""

import control
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.interpolate import make_interp_spline

from ilctools import arguments
from ilctools.singular_values import largest_singular_values

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

        Two rows for each output; shaded gray where P is not identified. Of an excited rig also the
        standard deviations of P by noise and by what is not linear.

        Returns
        -------
        matplotlib.figure.Figure
        """
        (inputs, outputs), (n, p, m) = self.names, self.response.shape
        figure = Figure(figsize=(3.2 * m, 4 * p), layout="constrained")
        axes = figure.subplots(2 * p, m, squeeze=False)
        radius = self.radius(CONFIDENCE, jointly=True)
        known = getattr(self, "known", np.ones(n, bool))
        sizes = np.abs(self.response)
        floors = np.maximum(sizes, 1e-5 * (sizes.max() or 1)) / 10  # zero is on no logarithmic axis
        for i, j in np.ndindex(p, m):
            gain, phase = axes[2 * i : 2 * i + 2, j]
            self._draw(gain, phase, self.response[:, i, j], radius, floors[:, i, j].min())
            gain.set(title=f"{inputs[j]} to {outputs[i]}", ylabel="gain")
            phase.set(xlabel="frequency (rad/s)", ylabel="phase (deg)")
            for ax in (gain, phase):
                across = ax.get_xaxis_transform()
                ax.fill_between(self.omega, 0, 1, ~known, color="0.9", transform=across)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return figure

    def _draw(self, gain, phase, P, radius, floor):
        """Gain and phase of one entry, (n,)."""
        size, turned = np.maximum(np.abs(P), floor), np.unwrap(np.angle(P))
        off = np.where(radius < size, np.arcsin(np.minimum(radius / size, 1)), np.pi)
        gain.loglog(self.omega, size)
        gain.fill_between(self.omega, np.maximum(size - radius, floor), size + radius, alpha=0.3)
        for name, style in (("noise", "0.5"), ("distortion", "0.7")):
            if hasattr(self, name):
                gain.loglog(self.omega, getattr(self, name), color=style, label=name)
                floor = None
        gain.yaxis.set_minor_formatter(NullFormatter())
        gain.set_ylim(floor)
        phase.semilogx(self.omega, np.degrees(turned))
        phase.fill_between(self.omega, *np.degrees([turned - off, turned + off]), alpha=0.3)

    def __repr__(self):
        return "\n".join(self.basis(self.omega))


def radius_of(uncertainty, P) -> np.ndarray:
    """The radius at each frequency of P, (n, m, m); one number is in units of sigma_max(P)."""
    if np.ndim(uncertainty) == 0:
        what = "a radius at each frequency, or one number below 1, relative to sigma_max(P)"
        uncertainty = arguments.number("uncertainty", uncertainty, what, high=1, least=0)
        uncertainty = uncertainty * largest_singular_values(P)
    radius = arguments.array("uncertainty", uncertainty, (len(P),))
    if radius.min() < 0:
        raise ValueError(f"uncertainty reaches {radius.min():.6g}, but must not be negative")
    return radius


def with_phase(name: str, P) -> np.ndarray:
    """A table P, (n, m, m), refused if it is real and not constant, as no causal plant is."""
    if not P.imag.any() and np.ptp(P.real, axis=0).any():
        raise ValueError(
            f"{name} is real at each frequency, but not constant, as no plant is: a gain without "
            "its phase, or in dB? Pass complex values, gain * np.exp(1j * phase), phase in rad"
        )
    return P


def probability(confidence) -> float:
    """A confidence, that of a region."""
    return arguments.number("confidence", confidence, "between 0 and 1", 0, 1)


def interpolated(knots, P, at) -> tuple[np.ndarray, np.ndarray]:
    """A cubic spline through P, (n, m, m), and by how much it differs from straight lines."""
    spline, straight = (make_interp_spline(knots, P, k)(at) for k in (3, 1))
    return spline, np.linalg.norm(spline - straight, 2, axis=(1, 2))
