"""Effects at work at one moment of one die: what they make of a command, a motion and a voltage, in loop and bench."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.gyro import is_concrete
from memsgyro_jax.device.normalised import NormalisedDevice

from .base import DriveEffect, Effect, ForceEffect, Moment, ReadoutEffect, SurroundingsEffect
from .cross_damping_asymmetry import CrossDampingAsymmetry


class Acting(NamedTuple):
    """The effects of a device by what they act on, read-out effects in the order of the signal."""

    forces: tuple[ForceEffect, ...]
    drives: tuple[DriveEffect, ...]
    readouts: tuple[ReadoutEffect, ...]

    @classmethod
    def of(cls, effects: Iterable[Effect]) -> "Acting":
        """Sorted; effects on the way a sweep is taken are left out."""
        every = tuple(effects)
        forces, drives, readouts = (
            tuple(effect for effect in every if isinstance(effect, kind))
            for kind in (ForceEffect, DriveEffect, ReadoutEffect)
        )
        return cls(forces, drives, tuple(sorted(readouts, key=lambda effect: effect.last)))

    @property
    def own_size(self) -> int:
        """How many numbers of own state the effects have together."""
        return sum(effect.own_size for effect in self.forces)

    def around(self, now: Moment, own: Float[Array, " own"]) -> Moment:
        """The same moment with surroundings as effects on them make them."""
        for method, field in (("warmer", "warming"), ("more_volts", "bias_voltage")):
            place, total = 0, getattr(now, field)
            for effect in self.forces:
                if isinstance(effect, SurroundingsEffect):
                    mine = own[place : place + effect.own_size]
                    total = total + getattr(effect, method)(eqx.tree_at(lambda m: m.own, now, mine))
                place += effect.own_size
            now = now if total is getattr(now, field) else eqx.tree_at(lambda m: getattr(m, field), now, total)  # noqa: B023
        return now

    def driven(self, now: Moment) -> Moment:
        """The same moment with the force that the electrodes apply at its command."""
        applied = now.command
        for last in (False, True):
            electrodes = eqx.tree_at(lambda m: m.force, now, applied)
            for effect in self.drives:
                if effect.last == last:
                    applied = _whole(effect, "applied", effect.applied(applied, electrodes), now)
        return eqx.tree_at(lambda m: m.force, now, applied)

    def force(self, now: Moment, own: Float[Array, " own"]) -> tuple[Float[Array, " axes"], Float[Array, " own"]]:
        """Force on the mass [N] beside that of the electrodes, and the time derivative of the own states."""
        force, rates, place = jnp.zeros_like(now.displacement), [], 0
        for effect in self.forces:
            if not effect.own_size:
                force = force + _whole(effect, "force", effect.force(now), now)
                continue
            seen = eqx.tree_at(lambda m: m.own, now, own[place : place + effect.own_size])
            force = force + _whole(effect, "force", effect.force(seen), now)
            rates.append(effect.own_rate(seen))
            place += effect.own_size
        return force, jnp.concatenate(rates) if rates else own

    def signal(self, volts: Float[Array, " axes"], now: Moment) -> Float[Array, " axes"]:
        """What the read-out effects make of the voltages [V]."""
        for effect in self.readouts:
            volts = _whole(effect, "signal", effect.signal(volts, now), now)
        return volts


def _whole(effect: Effect, method: str, value: Array, now: Moment) -> Array:
    """What a method returned, a number for each axis: one number for all would act on all of them, unseen."""
    if isinstance(value, list | tuple):
        raise InputError(
            f"Method `{method}` of {type(effect).__name__} must return an array, but returns a {type(value).__name__}; "
            "`jax.numpy.stack` makes an array of one."
        )
    if jnp.shape(value) != now.displacement.shape:
        raise InputError(
            f"Method `{method}` of {type(effect).__name__} must return an array of shape {now.displacement.shape}, but "
            f"returns one of {jnp.shape(value)}; `self.along(now, value)` makes it of a number along the effect's axis."
        )
    return value


def moment(
    displacement: Array, velocity: Array, command: Array, conditions: Conditions, *, device: NormalisedDevice,
    scale: Array, reference_temperature: Array | float, reference_bias: Array | float, order: int = 0,
) -> Moment:  # fmt: skip
    """What effects see of a motion and a command [N] under `conditions`; the force is still the command."""
    at = conditions
    zero = jnp.zeros(())
    number = lambda value: zero if value is None else value  # noqa: E731
    return Moment(
        displacement=displacement,
        velocity=velocity,
        command=command,
        force=command,
        own=jnp.zeros(0),
        rate=at.rate,
        angular_acceleration=at.angular_acceleration,
        rate_trusted=number(at.rate_trusted),
        warming=zero if at.temperature is None else at.temperature - reference_temperature,
        bias_voltage=jnp.asarray(reference_bias) if at.bias_voltage is None else at.bias_voltage,
        reference_bias=jnp.asarray(reference_bias),
        time=number(at.time),
        progress=number(at.progress),
        record=number(at.record),
        sweep=number(at.sweep),
        device=device,
        scale=scale,
        order=order,
    )


def pickoff_volts(
    effects: Iterable[Effect], scale: Float[Array, " axes"], displacement: Float[Array, " axes"]
) -> Float[Array, " axes"]:
    """Voltage of each channel, without offset, of a pick-off that has effects which are a `curve`."""
    still = jnp.zeros_like(displacement)
    device = NormalisedDevice(jnp.ones(3), jnp.ones(3), jnp.ones(()))  # which no curve looks at
    now = moment(
        displacement, still, still, Conditions(), device=device, scale=scale, reference_temperature=0.0,
        reference_bias=0.0,
    )  # fmt: skip
    return Acting.of(effects).signal(scale * displacement, now)


def carried(device: Any) -> tuple[Effect, ...]:
    """What a device has beyond a symmetric oscillator: its effects, and unequal cross damping as an effect too."""
    effects = tuple(getattr(device, "effects", ()))
    difference = getattr(device, "cross_damping_asymmetry", 0.0)  # dyx - dxy, where the effect says d_xy - d_yx
    if is_concrete(difference) and not np.any(np.asarray(difference)):
        return effects
    return (*effects, CrossDampingAsymmetry(-difference))
