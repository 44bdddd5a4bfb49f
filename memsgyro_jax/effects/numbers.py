"""The numbers of an effect that a fit may move: its strength, and others that it declares, with bounds and signs."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from memsgyro_jax.base.arguments import in_unit

from .base import Effect


class EffectNumber(NamedTuple):
    """A field of an effect that a fit may move: its SI unit and the bounds it stays within."""

    field: str
    unit: str
    low: float
    high: float


def parameter(*, start: float, low: float = -np.inf, high: float = np.inf, unit: str = "1") -> Any:
    """The field of a further number of an effect, such as a gap, a threshold or an exponent, that is fitted.

    At strength zero nothing depends on it: a fit starts it at `start` (or what the effect was made with) once the
    strength has left zero, and keeps it strictly between `low` and `high`. `unit` is its SI unit. A plain array field
    is a setting, which no fit moves.
    """
    return eqx.field(converter=in_unit(unit, float), default=start, metadata={"number": (unit, low, high)})


def setting(default: float, unit: str) -> Any:
    """The field of a number in `unit` that is only set, as the power that a device takes: no fit moves it."""
    return eqx.field(converter=in_unit(unit, float), default=default, metadata={"unit": unit})


def free_numbers(effect: Effect) -> tuple[EffectNumber, ...]:
    """The strength and the declared numbers, in the order of the fields."""
    out = []
    for field in dataclasses.fields(effect):
        if field.name == "strength":
            out.append(EffectNumber("strength", effect.unit, *field.metadata.get("range", (-np.inf, np.inf))))
        elif "number" in field.metadata:
            out.append(EffectNumber(field.name, *field.metadata["number"]))
    return tuple(out)
