"""Axes: on which one an effect acts, from which to which it leads, and which variants a device with so many has."""

import dataclasses
from itertools import product
from typing import Any, ClassVar, cast

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import AbstractVar

from .base import Effect, Moment, on_one_axis


def axis_number(axis: int | str) -> int:
    """0 for `x` or 0, 1 for `y` or 1.

    **Raises:** `InputError` for anything else.
    """
    if axis in ("x", "y"):
        return "xy".index(str(axis))
    if isinstance(axis, int) and axis in (0, 1):
        return int(axis)
    raise InputError(f'An axis must be "x", "y", 0 or 1, but is {axis!r}.')


def on_axis(default: int | str = 0) -> Any:
    """The field that holds an axis: structure, not a number that could be fitted."""
    return eqx.field(static=True, converter=axis_number, default=default)


class Planar(Effect):
    """An effect that exists on a device with two axes only."""

    @property
    def axes_needed(self) -> int:
        """Two."""
        return 2


class Coupling(Effect):
    """An effect that leads from the axis `source` to the axis `target`.

    `straight` says whether source and target may be the same.
    """

    straight: ClassVar[bool] = False

    source: AbstractVar[Any]
    target: AbstractVar[Any]

    def __check_init__(self):
        if self.source == self.target and not self.straight:
            raise InputError(
                f"Arguments `source` and `target` of `{self.name}` must be different axes, "
                f'but both are "{"xy"[self.source]}".'
            )

    @property
    def where(self) -> str:
        """E.g. `x_to_y`."""
        return f"{'xy'[self.source]}_to_{'xy'[self.target]}"

    def across(self, now: Moment, vector: Float[Array, " axes"]) -> Float[Array, " axes"]:
        """A vector with the source's entry of `vector` on the target axis and zero elsewhere."""
        return on_one_axis(now, self.target, vector[self.source])


def turned(vector: Float[Array, " axes"]) -> Float[Array, " axes"]:
    """(y, −x): the direction into which a rate turns a velocity. Zero on a single axis."""
    return jnp.stack([vector[1], -vector[0]]) if vector.shape[0] == 2 else jnp.zeros_like(vector)


def coriolis(now: Moment, rate: Float[Array, ""]) -> Float[Array, " axes"]:
    """Force [N] by which a further rate [rad/s] acts on the mass that moves along both axes: 2·m·rate·(y', −x')."""
    return 2.0 * rate * now.device.mass(1) * turned(now.velocity)


def needed_axes(effect: Effect) -> int:
    """How many axes a device must have for this effect."""
    return effect.axes_needed


def variants(kind: type[Effect], axes: int) -> tuple[Effect, ...]:
    """One instance of every variant of an effect on a device with so many axes, each with its default strength."""
    if issubclass(kind, Planar) and axes < 2:
        return ()
    numbers, make = range(axes), cast(Any, kind)  # fields differ from kind to kind
    if issubclass(kind, Coupling):
        pairs = product(numbers, numbers)
        return tuple(make(source=s, target=t) for s, t in pairs if s != t or kind.straight)
    if any(field.name == "axis" for field in dataclasses.fields(kind)):
        return tuple(make(axis=axis) for axis in numbers)
    return (make(),)
