"""The numbers of a model that a fit may move, in the order of its vector."""

from dataclasses import dataclass

import numpy as np

from memsgyro_jax.effects import free_numbers
from memsgyro_jax.measurement.model import Model


@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    Args:
        name, unit: for people, and in SI.
        effect: place of the effect it is a number of; `None` for the base.
        field: of the effect, `strength` or a number that it declares.
        index: `[k]` where that field has several entries.
        low, high: bounds that no fit leaves.
    """

    name: str
    unit: str
    effect: int | None = None
    field: str = ""
    index: str = ""
    low: float = -np.inf
    high: float = np.inf

    @property
    def is_offset(self) -> bool:
        """Whether it is the constant voltage of a channel."""
        return self.effect is None and self.name.startswith(_OFFSET)


_OFFSET = "offset"


def parameters(model: Model) -> tuple[Parameter, ...]:
    """The parameters in the order of the vector."""
    pairs = ("",) if model.axes == 1 else ("xx", "yy", "xy")
    low = [-np.inf if pair == "xy" else 0.0 for pair in pairs]  # nothing but a coupling is negative
    base = [Parameter(f"k{pair}/m", "rad²/s²", low=least) for pair, least in zip(pairs, low, strict=True)]
    base += [Parameter(f"d{pair}/m", "1/s", low=least) for pair, least in zip(pairs, low, strict=True)]
    base += [Parameter("1/m", "1/kg", low=-np.inf if model.axes == 1 else 0.0)]  # a channel may be turned round
    base += [Parameter(f"{_OFFSET} {a}", "V") for a in ("x", "y")[: model.axes]]
    others = []
    for place, effect in enumerate(model.effects):
        for number in free_numbers(effect):
            size = getattr(effect, number.field).size
            label = effect.label if number.field == "strength" else f"{effect.label} {number.field}"
            parts = getattr(effect, "parts", ())
            for k, index in enumerate([""] if size == 1 else [f"[{k}]" for k in range(size)]):
                more = place, number.field, index, number.low, number.high
                name = f"{label} {parts[k]}" if len(parts) == size else label + index
                others.append(Parameter(name, number.unit, *more))
    return (*base, *others)
