"""What a filter knows of a curved pick-off: the volts it expects of a displacement, and their slope."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.carried import Effects
from memsgyro_jax.device.gyro import AbstractGyro, Pair, X, Y
from memsgyro_jax.effects.evaluation import pickoff_volts


def curves_of(gyro: AbstractGyro) -> tuple[Any, ...]:
    """The effects of a device that are a curve of its pick-off, which a filter can be told as `pickoff`."""
    return tuple(effect for effect in gyro.effects if getattr(effect, "curve", False))


def check_curves(effects: tuple[Any, ...], signals: tuple[int, int]) -> None:
    """Raise `InputError` for an effect that is no curve of a pick-off, and for one of a velocity read-out."""
    if effects and signals != (X, Y):
        raise InputError("A filter that knows curves of the pick-off must have a displacement read-out.")
    for effect in effects:
        if not getattr(effect, "curve", False):
            raise InputError(
                "Argument `pickoff` of the filter must hold curves of the pick-off, such as `pickoff_nonlinearity`, "
                f"but `{effect.label}` is none."
            )


def curved(pickoff: Effects, scale: Pair, displacement: Pair) -> tuple[Pair, Pair]:
    """Volts of both channels without offset, and their slopes by the displacement of their own axis; for one die."""
    place, volts = jnp.stack(displacement), partial(pickoff_volts, pickoff, jnp.stack(scale))
    return tuple(volts(place)), tuple(jnp.diagonal(jax.jacfwd(volts)(place)))
