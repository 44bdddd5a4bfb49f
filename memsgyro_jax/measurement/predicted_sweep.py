"""What a lock-in would record of a device in a stepped frequency sweep, without a measurement to lie beside.

Row after row the drive goes on from the motion that the row before has left, as on a bench: a bent resonance is climbed
to its end on the way up and fallen from, and the way down shows another branch.
"""

from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.concrete import check_positive, is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.labelled import Tabular, labelled
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.device.resonator import Resonator

from .envelope import HARMONICS, Driven
from .experiments.base import CartesianNoise
from .experiments.harmonic_sweep import HarmonicSweep
from .model import Conditions, Model
from .steady import FINENESS, Fineness, steady_state


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

_DWELL = 8.0  # decay times of the slower axis at each row: a three thousandth of a jump is left for the balance
# Steps of each dwell: with the first the bend of a resonance by 50 of its half widths turns by one radian in a step.
_STEPS = (400, 1600, 6400)
_NEAR = 0.05  # of the motion, within which the steady state must lie of what the dwell has left
_TWO_PI = 2.0 * np.pi


class PredictedSweep(Tabular, eqx.Module):
    """The rows of a stepped sweep in the order of the drive.

    `frequency` (n,) [Hz] and `drive` (n,) [N] are what was asked for, `axis` 0 or 1 the electrode. `readings` are the
    phasors of the channels, V(t) = Re[(I + iQ) e^{iωt}] for a drive F cos ωt, in V, or in m where no read-out was
    given. `settled` tells rows whose motion came to rest: one that is on its way from branch to branch did not.

    A pytree: `predict_sweep` can be differentiated and compiled; `jax.vmap` puts devices along a leading axis.
    """

    frequency: Float[Array, " n"]
    drive: Float[Array, " n"]
    readings: Complex[Array, "n axes"]
    settled: Bool[Array, " n"]
    axis: int = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    along: ClassVar[str] = "row"

    def __str__(self) -> str:
        low, high = np.min(self.frequency), np.max(self.frequency)
        size = np.abs(np.asarray(self.readings))
        lines = [f"Sweep of {'xy'[self.axis]} from {low:.6g} to {high:.6g} Hz, {size.shape[-2]} rows"]
        if size.ndim > 2:
            return f"{lines[0]} of each of {size.shape[0]} devices"
        for channel in range(size.shape[1]):
            top = int(np.argmax(size[:, channel]))
            at = f"{size[top, channel]:.6g} {self.unit} at {float(self.frequency[top]):.8g} Hz"
            lines.append(f"  {'xy'[channel]}: at most {at}")
        if moving := int(np.sum(~np.asarray(self.settled))):
            lines.append(f"  {moving} of {len(size)} rows did not come to rest")
        return "\n".join(lines)

    def to_xarray(self) -> "xr.Dataset":
        """I and Q of the channels over the rows."""
        rows = ("device", "row") if np.ndim(self.readings) > 2 else ("row",)
        channels = list("xy"[: self.readings.shape[-1]])
        variables = {
            "I": ((*rows, "channel"), np.real(self.readings), self.unit, "in phase with the drive"),
            "Q": ((*rows, "channel"), np.imag(self.readings), self.unit, "a quarter turn before the drive"),
            "settled": (rows, np.asarray(self.settled), None, "whether the motion came to rest"),
            "frequency": (rows, np.asarray(self.frequency), "Hz"),
            "drive": (rows, np.asarray(self.drive), "N"),
        }
        return labelled(self, variables, {"channel": channels}, {"driven": "xy"[self.axis]})

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Amplitude of each channel over frequency, rows in their order; returns the axes."""
        ax = axes(ax)
        hertz, size = np.asarray(self.frequency), np.abs(np.asarray(self.readings))
        for channel in range(size.shape[-1]):
            lines = ax.plot(hertz.T, size[..., channel].T, ".-", color=f"C{channel}")
            lines[0].set_label("xy"[channel])
        ax.set(xlabel="frequency [Hz]", ylabel=f"amplitude [{self.unit}]")
        if size.shape[-1] > 1:
            ax.legend(frameon=False)
        return ax


def predict_sweep(
    device: SingleMassGyro | Resonator | Model,
    frequency: Float[Array, " n"],
    drive: float | str | Float[Array, " n"],
    *,
    axis: str = "x",
    rate: float | str = 0.0,
    temperature: float | str | None = None,
    bias_voltage: float | str | None = None,
    harmonics: int = 7,
) -> PredictedSweep:
    """What a lock-in would record of `device`, with all its effects, in a sweep that steps through `frequency`.

    Every row begins in the motion that the row before has left, dwells there for eight decay times, and shows the
    steady state that this comes to: exact where the device is linear, by harmonic balance where it is not. Derivatives
    are those of the steady state.

    Args:
        device: a gyro or resonator, which is seen by its displacement in m, or a `Model`, which has a read-out.
        frequency: of the drive [Hz], in the order in which it is stepped: rising, falling, or there and back.
        drive: amplitude of the force [N], of a resonator in the unit of its gain; one number, or one for each row.
        axis: the electrode that is driven, "x" or "y".
        rate, temperature, bias_voltage: of the table [rad/s], of the device [K], of its electrodes [V]; None is where
            the device's numbers hold.
        harmonics: of the balance: 3 do for a smooth law, 7 or 15 for one with a kink.

    **Raises:** `InputError` for float32, another axis, no rows, a frequency that is not positive, or more harmonics.
    """
    require_float64("`predict_sweep`")
    model = device if isinstance(device, Model) else Model(device)
    fineness = next((fine for fine in FINENESS if fine.harmonics >= harmonics), None)
    if axis not in ("x", "y")[: model.axes]:
        raise InputError(f"Argument `axis` must be one of {', '.join('xy'[: model.axes])}, but `{axis}` was given.")
    if fineness is None or harmonics < 1:
        most = FINENESS[-1].harmonics
        raise InputError(f"Argument `harmonics` must be between 1 and {most}, but {harmonics} was given.")
    frequency, driven = jnp.atleast_1d(jnp.asarray(frequency, float)), "xy".index(axis)
    if frequency.ndim != 1 or not frequency.size:
        raise InputError(f"Argument `frequency` must be a row of numbers, but has the shape {frequency.shape}.")
    check_positive("frequency", frequency)
    force = jnp.broadcast_to(quantity("drive", drive, "N"), frequency.shape)
    around = Conditions(
        rate=quantity("rate", rate, "rad/s"),
        temperature=model.reference_temperature if temperature is None else quantity("temperature", temperature, "K"),
        bias_voltage=model.reference_bias if bias_voltage is None else quantity("bias_voltage", bias_voltage, "V"),
    )
    for steps in _STEPS:
        readings, settled, finite = _swept(model, frequency, force, around, driven, fineness, jnp.asarray(steps))
        if not is_concrete(finite) or bool(finite):
            break
    return PredictedSweep(frequency, force, readings, settled, driven, "V" if model is device else "m")


@eqx.filter_jit
def _swept(
    model: Model, frequency: Array, drive: Array, around: Conditions, axis: int, fineness: Fineness, steps: Array
) -> tuple[Complex[Array, "n axes"], Bool[Array, " n"], Bool[Array, ""]]:
    """Readings, which rows came to rest, and whether the steps were small enough for all to have a motion."""
    omega = _TWO_PI * frequency
    force = drive[:, None] * np.eye(model.axes)[axis] + 0j
    held, at, pushed, there = jax.lax.stop_gradient((model, omega, force, around))
    left = _followed(held, at, pushed, there, fineness.samples, steps)
    rows = around.rows(len(frequency))
    steady = jax.vmap(lambda w, f, c, near: steady_state(model, w, f, c, near, fineness)[1, : model.axes])
    moved = steady(*jax.lax.stop_gradient((omega, force, rows, left)))
    near = jnp.linalg.norm(moved - left, axis=1) <= _NEAR * jnp.linalg.norm(left, axis=1)
    sweep = HarmonicSweep(
        name="predicted", frequency=omega, force=force, measured=jnp.zeros_like(force), noise=CartesianNoise(1.0),
        surroundings=rows, near=model.shown(left, rows) * model.behind(omega[:, None], around), fineness=fineness,
        direction=jnp.where(jnp.diff(omega, prepend=2.0 * omega[:1] - omega[1:2]) < 0.0, -1.0, 1.0),
    )  # fmt: skip
    return sweep.predict(model), near, jnp.isfinite(left).all()


def _followed(
    model: Model,
    omega: Float[Array, " n"],
    force: Complex[Array, "n axes"],
    around: Conditions,
    samples: int,
    steps: Int[Array, ""],
) -> Complex[Array, "n axes"]:
    """Phasors of the displacement at the end of each row's dwell, in time from row to row."""
    step = _DWELL / steps * 2.0 / jnp.min(jnp.diag(model.device.damping_matrix))

    def row(state: Array, at: tuple[Array, Array]) -> tuple[Array, Array]:
        driven = Driven.of(model, *at, around, samples)
        propagate, load, now = driven.propagator(step), driven.load, driven.around(around)

        def advance(_: int, state: Array) -> Array:
            return propagate.advance(state, load, lambda s: driven.rest(s, now))[0]

        state = jax.lax.fori_loop(0, steps, advance, state)
        return state, state[1, : model.axes]

    return jax.lax.scan(row, jnp.zeros((HARMONICS + 1, model.size), complex), (omega, force))[1]
