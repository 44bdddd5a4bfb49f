"""Fields that hold one number for each axis."""

from typing import Any

import equinox as eqx

from memsgyro_jax.base.arguments import number_in
from memsgyro_jax.base.converter import FieldConverter
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Pair


def pair_field(unit: str = "", **options: Any) -> Pair:
    """A field for one number per axis; a single number serves both. With a `unit` also text such as "2 pF"."""
    return eqx.field(converter=FieldConverter(lambda field, given: pair_in(field.what, given, unit)), **options)


def pair_in(what: str, given: Any, unit: str) -> Pair:
    """`given`, one number for both axes or a pair, as such a field holds it; `what` is its name in a message."""
    if not isinstance(given, tuple | list):
        return (number_in(what, given, unit),) * 2
    if len(given) != 2:
        raise InputError(
            f"{what} must be one number, or a pair of numbers for the axes x and y, but {len(given)} were given."
        )
    return tuple(number_in(what, entry, unit) for entry in given)
