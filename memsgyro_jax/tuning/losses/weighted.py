"""Several losses at once."""

from typing import Any

import jax.numpy as jnp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar

from .base import AbstractLoss


class Weighted(AbstractLoss[Any]):
    """Σ weight · loss, for example `Weighted((SquaredRateError(0.05), 1.0), (Consistency(0.05), 0.1))`.

    Every part must be averaged over the dies; wrap the sum in `WorstDies`, not one of its parts.
    """

    losses: tuple[AbstractLoss, ...]
    weights: tuple[Scalar, ...]

    def __init__(self, *parts: tuple[AbstractLoss, Scalar]):
        if not parts:
            raise InputError("A weighted sum must have at least one (loss, weight), but none was given.")
        for loss, _ in parts:
            if type(loss).combine is not AbstractLoss.combine:
                raise InputError(
                    f"A part of a weighted sum must be averaged over the dies, but {type(loss).__name__} is not; "
                    "wrap the sum in it."
                )
        self.losses = tuple(loss for loss, _ in parts)
        self.weights = tuple(jnp.asarray(weight, float) for _, weight in parts)

    @property
    def sees_truth(self) -> bool:  # type: ignore[override]  # depends on the parts
        return any(loss.sees_truth for loss in self.losses)

    @property
    def believes_claims(self) -> bool:  # type: ignore[override]  # depends on the parts: one that sees more corrects it
        return all(loss.believes_claims for loss in self.losses)

    def init(self):
        return tuple(loss.init() for loss in self.losses)

    def sample(self, memory, sample):
        return tuple(loss.sample(own, sample) for loss, own in zip(self.losses, memory, strict=True))

    def value(self, memory):
        pairs = zip(self.losses, self.weights, memory, strict=True)
        return sum(weight * loss.value(own) for loss, weight, own in pairs)

    def of_loop(self, loop):
        return sum(weight * loss.of_loop(loop) for loss, weight in zip(self.losses, self.weights, strict=True))

    def begins(self):
        return max(float(loss.begins()) for loss in self.losses)
