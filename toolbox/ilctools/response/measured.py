"""A measured frequency response: its radius, its values at other frequencies, and its plot."""

import control
import numpy as np
from matplotlib.figure import Figure

from ilctools import arguments
from ilctools.errors import LogError
from ilctools.models import frequency_response
from ilctools.response.samples import Assumed, Samples
from ilctools.response.scale import scale_of
from ilctools.singular_values import largest_singular_values

CONFIDENCE = 0.99  # probability that the true P lies within the radius in a design
MODEL_ERROR = 0.01  # share of the largest gain: a model need not be nearer to the response,
MOST_MODEL_ERROR = 0.1  # and a model that is farther from the response than this is refused
ROWS = 200  # samples: number of rows of the Hankel matrix
STATES = 60  # most states of a model: an eigenvalue problem of this size takes milliseconds


class Measured:
    """A frequency response that was measured at some frequencies, and how accurate it is.

    The true response P differs from the measured one by Delta. The radius is a bound on ||Delta||.
    Each subclass has the `response` (n, p, m) at `omega` (n,), rad/s, and the `loop` that was
    measured. The attribute `findings` has the warnings about the measurement. The attribute
    `estimated` is False if a user passed a table. Each subclass implements ``_radius(confidence,
    jointly)``, ``_basis(omega, confidence)`` and ``_scaled(of_P)``. A subclass whose splines use
    other samples than `response` also implements ``_samples(confidence)``. A subclass without
    splines implements ``_anywhere(omega, confidence)`` instead.
    """

    findings = ()
    lines = None  # for a periodic excitation: P at the excited frequencies, noise and distortion
    estimated = True  # from a record, whose sampling period fixes the unit; P is known at rest

    def radius(self, confidence: float = 0.95, jointly: bool = False) -> np.ndarray:
        """Return a bound on ||Delta||, the largest singular value of the error of `response`.

        Parameters
        ----------
        confidence : float
            Probability, between 0 and 1, that the true response lies within the radius.
        jointly : bool
            Whether the probability is for all frequencies together. Default: for each frequency
            separately.

        Returns
        -------
        ndarray, shape (n,)
            The radius at `omega`.
        """
        return self._radius(probability(confidence), arguments.flag("jointly", jointly))

    def on(self, omega, confidence: float = 0.95, scale=None) -> tuple[np.ndarray, np.ndarray]:
        """Return the response and its radius at any frequencies, for the synthesis.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Frequencies, rad/s.
        confidence : float
            Probability that the true response lies within the radius at all measured frequencies.
        scale : dict or array_like, shape (m,), optional
            Sizes that count as one in each channel, as for :func:`ilctools.synthesise`. Response
            and radius are then in these units.

        Returns
        -------
        response : ndarray, shape (n, p, m), complex
        radius : ndarray, shape (n,)
            The radius at `omega`. :meth:`basis` states what is assumed between and outside the
            measured frequencies.
        """
        omega, own = np.abs(arguments.row("omega", omega)), self
        if scale is not None:
            inputs, outputs = self.names
            own = self._scaled(scale_of(scale, outputs, inputs).of_P)
        return own._anywhere(omega, probability(confidence))

    def _samples(self, confidence):
        return Samples(self.omega, self.response, self.radius(confidence, jointly=True))

    def _anywhere(self, omega, confidence):
        """Interpolate P by :mod:`.samples`.

        Above the last measured frequency, P may have any value that is not larger than at this
        frequency.
        """
        samples = self._samples(confidence)
        P, radius = samples.at(omega)
        above = samples.outside(omega) & (omega > samples.omega[-1])
        return P, radius + np.where(above, 2 * largest_singular_values(P), 0)

    def _between(self, omega, confidence):
        """Yield what is assumed about P at omega between and outside the measured frequencies."""
        yield Assumed(
            "between the lines, the error of the splines of P is not larger than at "
            "lines that are left out"
        )
        samples = self._samples(confidence)
        outside, below = samples.outside(omega), omega < samples.omega[0]
        if np.any(outside & below):
            yield samples.below_in_words
        if above := np.mean(outside & ~below):
            share = f"at {above:.0%} of omega"
            yield Assumed(f"above the last line, {share}, P is not larger than at this line")

    def basis(self, omega, confidence: float = 0.95) -> tuple[str, ...]:
        """Say in words what was measured, and what :meth:`on` assumes in addition at `omega`.

        The last lines are the findings, which are warnings about the measurement.
        """
        return tuple(
            map(str, self.statements(arguments.row("omega", omega), probability(confidence)))
        )

    def statements(self, omega, confidence) -> tuple[str | Assumed, ...]:
        """Return the statements of :meth:`basis`.

        Statements that are assumptions have the type `Assumed`.
        """
        return (*self._basis(omega, confidence), *self.findings)

    @property
    def names(self) -> tuple[list[str], list[str]]:
        """The names of inputs and of outputs."""
        if self.loop is None:
            p, m = self.response.shape[1:]
            return [f"w{i + 1}" for i in range(m)], [f"y{i + 1}" for i in range(p)]
        return self.loop.learned, self.loop.outputs

    def frd(self) -> control.FrequencyResponseData:
        """Return the response at `omega`, with names and sampling period, for python-control."""
        (inputs, outputs), dt = self.names, True if self.loop is None else self.loop.Ts
        P = np.moveaxis(self.response, 0, -1)
        return control.frd(P, self.omega, dt, inputs=inputs, outputs=outputs)

    def model(self) -> control.StateSpace:
        """Fit a stable model in discrete time to the response, with its names and few states.

        The states are found from the Hankel matrix of the impulse response (S. Kung, 12th Asilomar
        Conference (1978) 705-714). The impulse response is the inverse Fourier transform of P,
        which :meth:`on` returns at all frequencies. B and D are then fitted to the measured
        response by least squares. The model has the fewest states with which its distance from the
        response is small enough at all measured frequencies. The limit on the distance is the
        radius or a hundredth of the largest gain, whichever is larger.

        Returns
        -------
        control.StateSpace
            The model, for :class:`ilctools.ClosedLoop`, for simulated trials and for
            :class:`ilctools.NormOptimal`. If a law limits outputs, it also uses such a model, and
            adds the distance of the model from the response to the radius.

        Raises
        ------
        ValueError
            If the response is a table without a sampling period.
        LogError
            If the error of the best model exceeds a tenth of the largest gain.
        """
        if self.loop is None:
            raise ValueError(
                "the table states no sampling period, but a model needs one: pass "
                "control.frd(P, omega, Ts)"
            )
        Ts, (inputs, outputs) = self.loop.Ts, self.names
        grid, _ = self.on(np.linspace(0, np.pi / Ts, 8 * ROWS + 1))
        impulses = np.moveaxis(np.fft.irfft(grid, axis=0), 0, -1)[..., : 2 * ROWS + 1]
        full, _ = control.eigensys_realization(impulses, STATES, ROWS, ROWS)
        gain = largest_singular_values(self.response)
        near = np.maximum(self.radius(CONFIDENCE, jointly=True), MODEL_ERROR * gain.max())
        best, least = None, np.inf
        for n in range(STATES + 1):
            model = _nearest_with(full.A[:n, :n], full.C[:, :n], self, near)
            off = largest_singular_values(frequency_response(model, self.omega) - self.response)
            if np.abs(model.poles()).max(initial=0) < 1 and np.max(off / near) < least:
                best, least, distance = model, np.max(off / near), off.max() / gain.max()
            if least <= 1:
                break
        if best is None or distance > MOST_MODEL_ERROR:
            raise LogError(
                f"no model of up to {STATES} states is within a tenth of the largest gain of "
                "P: is the sampling period right, do the lines reach from low frequencies to "
                "the Nyquist frequency, and are they close enough to each other?"
            )
        best.update_names(inputs=inputs, outputs=outputs)
        return best

    def plot(self) -> Figure:
        """Draw gain and phase of P, with a band whose half width is the radius.

        The radius holds at all frequencies together with a probability of 99 %. Each entry of P has
        its own column. If the radius exceeds nine tenths of the gain at a frequency, P is hardly
        identified there. The lower edge of the band is then drawn at a tenth of the gain. If the
        rig was excited periodically, the plot also shows the standard deviations of P that come
        from noise and from nonlinearity.

        Returns
        -------
        matplotlib.figure.Figure
        """
        (inputs, outputs), omega, P = self.names, self.omega, self.response
        radius, pairs = self.radius(CONFIDENCE, jointly=True), [*np.ndindex(P.shape[1:])]
        figure = Figure(figsize=(3.2 * len(pairs), 4.5), layout="constrained")
        gains, phases = figure.subplots(2, len(pairs), sharex=True, squeeze=False)
        for (i, j), gain, phase in zip(pairs, gains, phases, strict=True):
            size = np.abs(P[:, i, j])
            band = np.maximum(size - radius, size / 10), size + radius
            gain.fill_between(omega, *band, alpha=0.3, label="radius, 99 %")
            gain.loglog(omega, size)
            self._draw_lines(gain, i, j)
            gain.set(title=f"{inputs[j]} to {outputs[i]}", ylabel="gain")
            phase.semilogx(omega, np.degrees(np.unwrap(np.angle(P[:, i, j]))))
            phase.set(xlabel="frequency (rad/s)", ylabel="phase (deg)")
        gain.legend(bbox_to_anchor=(1, 1))
        return figure

    def _draw_lines(self, axes, i, j):
        """Draw P at the excited frequencies, and its standard deviations, if they are known."""
        if self.lines is None:
            return
        omega = self.lines.omega
        axes.loglog(omega, np.abs(self.lines.response[:, i, j]), ".", label="lines")
        for name in ("noise", "distortion"):
            axes.loglog(omega, getattr(self.lines, name), label=name, nonpositive="mask")

    def __repr__(self):
        return "\n".join(self.basis(self.omega))


def _nearest_with(A, C, measured, near) -> control.StateSpace:
    """Fit B and D of a model with given A and C to `measured`.

    The errors of the fit are divided by `near`.
    """
    Ts, P = measured.loop.Ts, measured.response
    z, n = np.exp(1j * measured.omega * Ts), len(A)
    states = np.linalg.solve((z[:, None, None] * np.eye(n) - A).swapaxes(1, 2), C.T[None])
    rows = np.concatenate([states.swapaxes(1, 2), np.tile(np.eye(len(C)), (len(z), 1, 1))], axis=2)
    weighted, target = (part / near[:, None, None] for part in (rows, P))
    parts = (np.vstack([x.reshape(-1, x.shape[2]).real, x.reshape(-1, x.shape[2]).imag])
             for x in (weighted, target))  # fmt: skip
    B, D = np.split(np.linalg.lstsq(*parts, rcond=None)[0], [n])
    return control.ss(A, B, C, D, Ts)


def radius_of(uncertainty, P) -> np.ndarray:
    """Return the radius at each frequency of a response P.

    P has the shape (n, p, m). If `uncertainty` is a number, the radius is this share of
    sigma_max(P).
    """
    if np.ndim(uncertainty) == 0:
        what = "a radius at each frequency, or one number below 1, relative to sigma_max(P)"
        uncertainty = arguments.number("uncertainty", uncertainty, what, high=1, least=0)
        uncertainty = uncertainty * largest_singular_values(P)
    radius = arguments.array("uncertainty", uncertainty, (len(P),))
    if radius.min() < 0:
        raise ValueError(f"uncertainty has the value {radius.min():.6g}, but must not be negative")
    return radius


def with_phase(name: str, P) -> np.ndarray:
    """Return a table P (n, p, m); refuse a P that is real but not constant.

    No causal plant has such a response.
    """
    if not P.imag.any() and np.ptp(P.real, axis=0).any():
        raise ValueError(
            f"{name} is real at each frequency, but not constant, as no plant is: is it a gain "
            "without its phase, or in dB? Pass complex values, gain * np.exp(1j * phase), "
            "with the phase in rad"
        )
    return P


def probability(confidence) -> float:
    """Check a confidence, which must be between 0 and 1."""
    return arguments.number("confidence", confidence, "between 0 and 1", 0, 1)
