"""Which force is missing, as data: what a model would need to move as the device was seen to move.

Every kind of measurement offers at most one view of it:

- each row of a **sweep**: one force phasor, in parts that act like a stiffness and like a damping (its
  describing function);
- a **waveform**: the force over time, by regularised deconvolution around the modes, against displacement and velocity;
- **phasors over time**: what is left, against rate and time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from scipy import special

from memsgyro_jax.device.conditions import Conditions

from ..model import Model
from .deviation import Deviation


BINS = 24
BLOCKS = 16  # of a record, whose scatter tells the uncertainty of what is averaged over it
LINES = 9  # of a spectrum, over which power is told from noise
TAPER = 0.2  # of a record at each end, over which it is faded in and out
SEEN = 0.25  # of full weight, from which the result is kept
FEWEST = 64  # rows of a waveform below which no spectrum is told from noise
REACH = (0.5, 2.5)  # times the lowest and the highest mode: where a force is looked for; it holds second harmonics


@dataclass(frozen=True, eq=False)
class MissingForce:
    """A view of the missing force in one record.

    Args:
        record: its name.
    """

    record: str


@dataclass(frozen=True, eq=False)
class SweepForce(MissingForce):
    """Missing force of each row of a sweep, as phasors Re[F e^{iωt}].

    Args:
        axis: driven, 0 = x, 1 = y.
        frequency, drive, temperature, bias_voltage: of each row (n,), SI.
        motion: displacement phasor of the driven axis as it was seen (n,) [m].
        force: missing force on each axis (n, axes) [N].
        std: of each of its parts, from the noise of the record (n, axes) [N].
    """

    axis: int
    frequency: np.ndarray
    drive: np.ndarray
    temperature: np.ndarray
    bias_voltage: np.ndarray
    motion: np.ndarray
    force: np.ndarray
    std: np.ndarray

    @property
    def amplitude(self) -> np.ndarray:
        """Displacement amplitude of the driven axis (n,) [m]."""
        return np.abs(self.motion)

    @property
    def stiffness(self) -> np.ndarray:
        """Missing stiffness k of F = −k·q − d·q' per axis of the force, q the driven axis (n, axes) [N/m]."""
        return -(self.force / self.motion[:, None]).real

    @property
    def stiffness_std(self) -> np.ndarray:
        """Its standard deviation (n, axes) [N/m]."""
        return self.std / self.amplitude[:, None]

    @property
    def damping(self) -> np.ndarray:
        """Missing damping d (n, axes) [N s/m]."""
        return -(self.force / self.motion[:, None]).imag / self.frequency[:, None]

    @property
    def damping_std(self) -> np.ndarray:
        """Its standard deviation (n, axes) [N s/m]."""
        return self.stiffness_std / self.frequency[:, None]


@dataclass(frozen=True, eq=False)
class Binned:
    """Means over bins of a variable: `centre` (k,), `mean` and its standard error `error`, both (k, ...)."""

    centre: np.ndarray
    mean: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class TimeForce(MissingForce):
    """Missing force over the time of a raw capture or ring-down.

    Only what lies in the band `REACH` around the modes and stands above the noise is seen; all is zero where noise
    explains the record. The constant part of a force is not.

    Args:
        time: (n,) [s].
        force: on each axis (n, axes) [N].
        motion, speed: displacement and velocity of the model in all rows that were compared (r, axes) [m], [m/s].
        window: of these rows (r, 1); those above `SEEN` are the n.
        weights: of their spectral lines (f, axes): the share that is seen.
    """

    time: np.ndarray
    force: np.ndarray
    motion: np.ndarray
    speed: np.ndarray
    window: np.ndarray
    weights: np.ndarray

    @property
    def kept(self) -> np.ndarray:
        """Which of the rows that were compared are shown (r,)."""
        return np.asarray(self.window[:, 0] > SEEN)

    @property
    def displacement(self) -> np.ndarray:
        """Of the model (n, axes) [m]."""
        return np.asarray(self.motion[self.kept])

    @property
    def velocity(self) -> np.ndarray:
        """Of the model (n, axes) [m/s]."""
        return np.asarray(self.speed[self.kept])

    def as_seen(self, force: np.ndarray) -> np.ndarray:
        """Of a force known in all rows (r, axes) what would be seen of it (n, axes): through the same window and
        spectral lines.
        """
        lines = np.fft.rfft(force * self.window, axis=0) * self.weights
        return np.asarray(np.fft.irfft(lines, len(force), axis=0)[self.kept] / self.window[self.kept])

    def against_displacement(self, axis: int, bins: int = BINS) -> Binned:
        """Mean force on an axis over its own displacement: what is like a spring."""
        return in_bins(self.force[:, axis], self.displacement[:, axis], bins, blocks=BLOCKS)

    def against_velocity(self, axis: int, bins: int = BINS) -> Binned:
        """Mean force on an axis over its own velocity: what is like a damper."""
        return in_bins(self.force[:, axis], self.velocity[:, axis], bins, blocks=BLOCKS)

    def against_time(self, bins: int = 4 * BINS) -> Binned:
        """Root mean square of the force on each axis over time; `error` is zero."""
        place = np.arange(len(self.time)) * bins // len(self.time)
        rms = np.stack([np.sqrt(np.mean(self.force[place == k] ** 2, axis=0)) for k in range(bins)])
        centre = np.array([self.time[place == k].mean() for k in range(bins)])
        return Binned(centre, rms, np.zeros_like(rms))


@dataclass(frozen=True, eq=False)
class RateResidual(MissingForce):
    """What is left of a rate table, as voltages in phase with displacement and velocity of the driven axis.

    Args:
        rate: against the rate [rad/s], `None` where it does not vary; mean (k, channels, 2) [V].
        time: against the time [s].
    """

    rate: Binned | None
    time: Binned


def force_over_time(record: str, deviation: Deviation, time: np.ndarray, noise_std: np.ndarray) -> TimeForce | None:
    """The equation of motion of a waveform's residual, solved for the force, in the lines of the spectrum that carry
    it; `None` where too few rows are compared.

    Args:
        record: its name.
        deviation: from the model.
        time: (n,) uniform [s].
        noise_std: (channels,) of each reading.
    """
    seen = deviation.seen
    if seen.sum() <= FEWEST:
        return None
    model, around = deviation.model, deviation.declared.environment
    scale = np.asarray(model.scale)
    noise = noise_std / np.abs(scale)
    error = deviation.white[seen, :, 0] * noise_std / scale
    period = float(time[-1] - time[0]) / (len(time) - 1)
    motion = deviation.motion(period)[seen]
    count, modes = len(error), model.device.resonances()
    place = Conditions(temperature=around.temperature, bias_voltage=around.bias_voltage)
    omega = 2 * np.pi * np.fft.rfftfreq(count, period)
    near = (omega > REACH[0] * modes[0]) & (omega < REACH[1] * modes[-1])
    window, slope, bend = _window(count, period)
    lines = np.fft.rfft(error * window, axis=0)
    weights = np.zeros(lines.shape)
    weights[near] = weight_above_noise(lines[near] / noise, float(np.sum(window**2)))
    lines = np.where(near[:, None], weights * lines, 0.0)
    lines[near] /= (1j * omega[near, None]) ** model.order
    force = np.zeros_like(lines)
    stiffness, matrix = _dynamic_stiffness(model, place, jnp.asarray(omega[near]))
    force[near] = np.einsum("fij,fj->fi", stiffness, lines[near])
    # Z·(w·δ) is w·F and what the window itself would take to move: that is known, and taken off.
    clean, moving, whole = (np.fft.irfft(part, count, axis=0) for part in (lines, 1j * omega[:, None] * lines, force))
    kept = window[:, 0] > SEEN
    w, dw, ddw = window[kept], slope[kept], bend[kept]
    delta = clean[kept] / w
    speed = (moving[kept] - dw * delta) / w
    friction = np.asarray(matrix)[model.axes : 2 * model.axes, model.axes : 2 * model.axes]
    spurious = (2 * dw * speed + ddw * delta - dw * delta @ friction.T) / abs(float(model.device.mobility))
    turning = np.fft.irfft(1j * omega[:, None] * np.fft.rfft(motion * window, axis=0), count, axis=0)[kept]
    speeds = np.gradient(motion, period, axis=0)
    speeds[kept] = (turning - dw * motion[kept]) / w
    return TimeForce(
        record,
        time[seen][kept],
        (whole[kept] - spurious) / w,
        motion,
        speeds,
        window,
        weights,
    )


def _window(count: int, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A window (n, 1) that rises and falls like sin², and its first and second derivative by time."""
    rise = np.pi / (2 * TAPER * count * period)
    end = np.minimum(np.arange(count) + 0.5, count - np.arange(count) - 0.5) * period
    phase = np.minimum(rise * end, 0.5 * np.pi)
    sign = np.where(np.arange(count) < count / 2, 1.0, -1.0)
    flat = phase >= 0.5 * np.pi
    parts = np.sin(phase) ** 2, sign * rise * np.sin(2 * phase), np.where(flat, 0.0, 2 * rise**2 * np.cos(2 * phase))
    return parts[0][:, None], parts[1][:, None], parts[2][:, None]


@eqx.filter_jit
def _dynamic_stiffness(model: Model, conditions: Conditions, omega: Float[Array, " f"]) -> tuple[Array, Array]:
    matrix, _ = model.linear(conditions)
    return jax.vmap(lambda w: jnp.linalg.inv(receptance(model, matrix, w)))(omega), matrix


def weight_above_noise(lines: np.ndarray, power: float) -> np.ndarray:
    """Wiener's filter: for spectral lines (f, a) of a whitened record the share of their power, smoothed over
    neighbours, that is not noise; noise alone has E|line|² = `power`, and leaves nothing with a probability of 99 %.
    """
    smoothed = np.stack(
        [np.convolve(p, np.ones(LINES) / LINES, mode="same") for p in (np.abs(lines) ** 2 / power).T], 1
    )
    noise = float(special.chdtri(2 * LINES, 0.01 / lines.size)) / (2 * LINES)
    return np.asarray(np.maximum(1.0 - noise / np.maximum(smoothed, noise), 0.0))


def receptance(model: Model, matrix: Array, omega: Array) -> Complex[Array, "a a"]:
    """Displacement per force [m/N] of the linear part."""
    a = model.axes
    response = jnp.linalg.inv(1j * omega * jnp.eye(model.size) - matrix)
    return response[:a, a : 2 * a] * jnp.abs(model.device.mobility)


def residual_over_rate(
    record: str, deviation: Deviation, axis: int, rate: np.ndarray, time: np.ndarray, noise_std: np.ndarray
) -> RateResidual:
    """What is left of phasors over time, by the phase of the driven axis, against rate [rad/s] and time [s], (n,)."""
    seen = deviation.seen
    driven, white = deviation.predicted[seen, axis], deviation.white[seen]
    error = (white[..., 0] + 1j * white[..., 1]) * noise_std * (driven.conj() / np.abs(driven))[:, None]
    parts = np.stack([error.real, error.imag], axis=-1)
    varied = in_bins(parts, rate[seen], BINS) if np.ptp(rate) > 0 else None
    return RateResidual(record, varied, in_bins(parts, time[seen], 2 * BINS))


def in_bins(values: np.ndarray, variable: np.ndarray, bins: int = BINS, *, blocks: int = 0) -> Binned:
    """Means of `values` (n, ...) over equal bins of a variable (n,); bins with few rows are left out.

    The standard error comes from the scatter within the bin, as if rows were independent, or with `blocks` from that of
    the means of so many stretches of the record, which need not be.
    """
    low, high = float(variable.min()), float(variable.max())
    place = np.minimum(((variable - low) / ((high - low) or 1.0) * bins).astype(int), bins - 1)
    stretch = np.arange(len(variable)) * blocks // len(variable)
    centre, mean, error = [], [], []
    for k in range(bins):
        rows = place == k
        if rows.sum() < 4:
            continue
        parts: Sequence[np.ndarray] = [values[rows]]
        if blocks:
            means = [values[rows & (stretch == b)].mean(axis=0) for b in range(blocks) if np.any(rows & (stretch == b))]
            parts = [np.array(means)]
        if len(parts[0]) < 3:
            continue
        centre.append(variable[rows].mean())
        mean.append(values[rows].mean(axis=0))
        error.append(parts[0].std(axis=0, ddof=1) / np.sqrt(len(parts[0])))
    return Binned(np.array(centre), np.array(mean), np.array(error))
