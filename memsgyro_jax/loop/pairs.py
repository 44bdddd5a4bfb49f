"""Fields that hold one number for each axis."""

from collections.abc import Callable
from typing import Any

import equinox as eqx

from memsgyro_jax.base.arguments import in_unit
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Pair


def pair_field(unit: str = "", **options: Any) -> Pair:
    """A field for one number per axis; a single number serves both. With a `unit` also text such as "2 pF"."""
    return eqx.field(converter=pair_in(unit), **options)


def pair_in(unit: str) -> Callable[[object], Pair]:
    """The converter of such a field."""
    convert = in_unit(unit)

    def as_pair(value: object) -> Pair:
        if not isinstance(value, tuple | list):
            return (convert(value),) * 2
        if len(value) != 2:
            raise InputError(
                f"A pair of numbers for the axes x and y must have 2 entries, but {len(value)} were given."
            )
        return tuple(map(convert, value))

    return as_pair
