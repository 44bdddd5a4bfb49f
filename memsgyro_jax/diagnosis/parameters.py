"""The numbers of a model that a fit may move, in the order of its vector."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import PyTree

from memsgyro_jax.base.transforms import Free, Identity, fixed, mark
from memsgyro_jax.effects import free_numbers
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import Readings


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


MOBILITY, _OFFSET = "1/m", "offset"
_SPRING, _PUSHED = 0, 2  # places of k/m and 1/m of a device of one axis


def parameters(model: Model) -> tuple[Parameter, ...]:
    """The parameters in the order of the vector."""
    pairs = ("",) if model.axes == 1 else ("xx", "yy", "xy")
    low = [-np.inf if pair == "xy" else 0.0 for pair in pairs]  # nothing but a coupling is negative
    base = [Parameter(f"k{pair}/m", "rad²/s²", low=least) for pair, least in zip(pairs, low, strict=True)]
    base += [Parameter(f"d{pair}/m", "1/s", low=least) for pair, least in zip(pairs, low, strict=True)]
    base += [Parameter(MOBILITY, "1/kg", low=-np.inf if model.axes == 1 else 0.0)]  # a channel may be turned round
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


def untold(parameters: Sequence[Parameter], fitted: Sequence[Readings]) -> frozenset[int]:
    """Place of 1/m where no known force drives what is fitted: forces then scale with what is declared; and of the
    constant voltage of each channel where none is read.
    """
    driven, constant = (any(getattr(r.experiment, of) for r in fitted) for of in ("driven", "reads_constants"))
    idle = [(p.name == MOBILITY and not driven) or (p.is_offset and not constant) for p in parameters]
    return frozenset(np.flatnonzero(idle).tolist())


def with_gain(vectors: np.ndarray, gain: float | None) -> np.ndarray:
    """Parameters, or directions among them, (..., p) of a device of one axis with 1/m where its displacement per force
    at rest puts that beside k/m; the same where none is held.
    """
    if gain is None:
        return vectors
    out = np.array(vectors, float)
    out[..., _PUSHED] = gain * out[..., _SPRING]
    return out


def all_free(model: Model) -> PyTree:
    """What of a model is free: device, offsets, every strength and every declared number."""
    spec = fixed(model)
    identity = Free(Identity())
    spec = mark(spec, lambda m: (m.device.stiffness, m.device.damping, m.device.mobility, m.offset), identity)
    if not model.effects:
        return spec
    places = [(i, number.field) for i, effect in enumerate(model.effects) for number in free_numbers(effect)]
    return mark(spec, lambda m: tuple(getattr(m.effects[i], field) for i, field in places), identity)
