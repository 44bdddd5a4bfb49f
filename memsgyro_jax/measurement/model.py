"""The model of a device as it stands on the bench: base device, read-out, and the effects it has beyond the base model.

This is what measurements are compared with. Everything here is for one instant, one condition, one device.
"""

from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.effects.axes import needed_axes
from memsgyro_jax.effects.base import DriveEffect, Effect, ForceEffect, Moment, ReadoutEffect


class Conditions(eqx.Module):
    """What was set or known while a reading was taken; see `effects.Moment` for the fields. Scalars, or one per row."""

    rate: Array = eqx.field(converter=jnp.asarray, default=0.0)
    angular_acceleration: Array = eqx.field(converter=jnp.asarray, default=0.0)
    rate_trusted: Array = eqx.field(converter=jnp.asarray, default=0.0)
    temperature: Array = eqx.field(converter=jnp.asarray, default=298.15)
    bias_voltage: Array = eqx.field(converter=jnp.asarray, default=0.0)
    time: Array = eqx.field(converter=jnp.asarray, default=0.0)
    progress: Array = eqx.field(converter=jnp.asarray, default=0.0)
    record: Array = eqx.field(converter=jnp.asarray, default=0.0)

    def rows(self, count: int) -> "Conditions":
        """The same with every field of shape (count,)."""
        return jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.asarray(leaf, float), (count,)), self)


class Model(eqx.Module):
    """Base device, read-out and effects.

    Args:
        device: a `SingleMassGyro`, a `Resonator`, or either per mass.
        scale: volts per displacement of each channel [V/m], or one number for all.
        offset: constant voltage of each channel [V]; lock-in records do not see it.
        effects: what the device has beyond the base model.
        reference_temperature: at which the base parameters hold [K].
        reference_bias: electrode bias at which the base stiffness holds [V].
    """

    device: NormalisedDevice
    scale: Float[Array, " axes"]
    offset: Float[Array, " axes"]
    effects: tuple[Effect, ...]
    reference_temperature: Array
    reference_bias: Array

    def __init__(
        self,
        device: SingleMassGyro | Resonator | NormalisedDevice,
        *,
        scale: float | Array = 1.0,
        offset: float | Array = 0.0,
        effects: tuple[Effect, ...] = (),
        reference_temperature: float = 298.15,
        reference_bias: float = 0.0,
    ):
        self.device = NormalisedDevice.of(device)
        axes = self.device.axes
        self.scale, self.offset = (jnp.broadcast_to(jnp.asarray(v, float), (axes,)) for v in (scale, offset))
        self.reference_temperature = jnp.asarray(reference_temperature, float)
        self.reference_bias = jnp.asarray(reference_bias, float)
        for effect in effects:
            check_effect(effect, axes)
        self.effects = tuple(effects)

    @property
    def axes(self) -> int:
        """Number of axes, which is the number of channels."""
        return self.device.axes

    @property
    def size(self) -> int:
        """Length of the state: displacements, velocities, the effects' own states."""
        return 2 * self.axes + sum(effect.own_size for effect in self._forces)

    @property
    def _forces(self) -> tuple[ForceEffect, ...]:
        return tuple(effect for effect in self.effects if isinstance(effect, ForceEffect))

    def with_effect(self, *effects: Effect) -> "Model":
        """The same model with further effects."""
        for effect in effects:
            check_effect(effect, self.axes)
        return self.with_only((*self.effects, *effects))

    def with_only(self, effects: Iterable[Effect]) -> "Model":
        """The same model with these effects and no others."""
        return eqx.tree_at(lambda m: m.effects, self, tuple(effects), is_leaf=lambda x: isinstance(x, tuple))

    @property
    def present(self) -> "Model":
        """The same model without the effects of strength zero, which are absent."""
        return self.with_only(effect for effect in self.effects if np.any(np.asarray(effect.strength) != 0))

    def derivative(
        self, state: Float[Array, " n"], command: Float[Array, " axes"], conditions: Conditions
    ) -> Float[Array, " n"]:
        """Time derivative of the state under a commanded force [N]."""
        now = self._moment(state, command, conditions)
        q, v = now.displacement, now.velocity
        force, own, place = now.force, [], 2 * self.axes
        for effect in self._forces:
            seen = eqx.tree_at(lambda m: m.own, now, state[place : place + effect.own_size])
            force = force + effect.force(seen)
            own.append(effect.own_rate(seen))
            place += effect.own_size
        device = self.device
        acceleration = device.mobility * force - device.stiffness_matrix @ q - device.damping_matrix @ v
        if self.axes == 2:
            acceleration = acceleration + 2.0 * conditions.rate * jnp.stack([v[1], -v[0]])
        return jnp.concatenate([v, acceleration, *own])

    def observe(
        self,
        state: Float[Array, " n"],
        command: Float[Array, " axes"],
        command_rate: Float[Array, " axes"],
        conditions: Conditions,
    ) -> Float[Array, " axes"]:
        """Voltage of each channel, without noise; `command_rate` [N/s] matters where a read-out effect looks back."""
        slope, curvature = jax.jvp(
            lambda s, u: self.derivative(s, u, conditions),
            (state, command),
            (self.derivative(state, command, conditions), command_rate),
        )
        now = self._moment(state, command, conditions)
        a = self.axes
        now = eqx.tree_at(
            lambda m: (m.acceleration, m.jerk),
            now,
            (slope[a : 2 * a], curvature[a : 2 * a]),
            is_leaf=lambda leaf: leaf is None,
        )
        volts = self.scale * now.displacement + self.offset
        readouts = [effect for effect in self.effects if isinstance(effect, ReadoutEffect)]
        for effect in sorted(readouts, key=lambda e: e.last):
            volts = effect.signal(volts, now)
        return volts

    def linear(self, conditions: Conditions) -> tuple[Float[Array, "n n"], Float[Array, "n axes"]]:
        """The derivative by state and command at rest: the part that is propagated exactly."""
        rest, still = jnp.zeros(self.size), jnp.zeros(self.axes)
        return jax.jacfwd(self.derivative, argnums=(0, 1))(rest, still, conditions)

    @property
    def is_sharp(self) -> bool:
        """Whether the recorded waveform has corners."""
        return any(isinstance(effect, ReadoutEffect) and effect.sharp for effect in self.effects)

    @property
    def nonlinear_rows(self) -> tuple[int, ...]:
        """Rows of the derivative that may be nonlinear: accelerations, and own states not declared linear."""
        rows, place = list(range(self.axes, 2 * self.axes)), 2 * self.axes
        for effect in self._forces:
            rows += [] if effect.own_is_linear else range(place, place + effect.own_size)
            place += effect.own_size
        return tuple(rows)

    def _moment(self, state: Array, command: Array, conditions: Conditions) -> Moment:
        a = self.axes
        now = Moment(
            displacement=state[:a],
            velocity=state[a : 2 * a],
            command=command,
            force=command,
            own=jnp.zeros(0),
            rate=conditions.rate,
            angular_acceleration=conditions.angular_acceleration,
            rate_trusted=conditions.rate_trusted,
            warming=conditions.temperature - self.reference_temperature,
            bias_voltage=conditions.bias_voltage,
            reference_bias=self.reference_bias,
            time=conditions.time,
            progress=conditions.progress,
            record=conditions.record,
            device=self.device,
            scale=self.scale,
        )
        applied = command
        for effect in self.effects:
            if isinstance(effect, DriveEffect):
                applied = effect.applied(applied, now)
        return eqx.tree_at(lambda m: m.force, now, applied)


def check_effect(effect: Effect, axes: int) -> None:
    """Refuse what is no effect, and an effect on an axis that the device does not have."""
    if not isinstance(effect, Effect):
        raise InputError(f"An effect must be an instance of `effects.Effect`, but {effect!r} was given.")
    if needed_axes(effect) > axes:
        raise InputError(f"Effect `{effect.label}` needs {needed_axes(effect)} axes, but the device has {axes}.")
