"""Actuators that end: forces beyond their limit are not made."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Pair, check_positive

from ..observers.base import Clock, Estimate
from ..observers.settings import arrays
from .base import AbstractController


class Saturated(AbstractController[Any]):
    """`inner` with the force of each axis cut at ±`limit` (x, y) [N], which the observer is told of.

    A law that adapts 1/mass by its own force, `SlidingMode` with an unknown mass, takes what it asked for. No such loop
    can be advanced by blocks. A `Trace` says in what share of its samples a force was at its limit.
    """

    inner: AbstractController[Any]
    limit: Pair = arrays("N", metadata={"unit": "N"})

    def __check_init__(self):
        if len(self.limit) != 2:
            raise InputError(f"Argument `limit` must be a pair (x, y) in N, but has {len(self.limit)} entries.")
        for value in self.limit:
            check_positive("limit", value)

    @property
    def usually_tuned(self) -> tuple[str, ...]:  # type: ignore[override]
        """What is tuned of the inner law."""
        return tuple(f"inner.{name}" for name in self.inner.usually_tuned)

    @property
    def sets_bandwidth(self) -> Mapping[str, tuple[str, ...]]:  # type: ignore[override]
        """That of the inner law."""
        return {w: tuple(f"inner.{path}" for path in paths) for w, paths in self.inner.sets_bandwidth.items()}

    def reached(self, force: Float[np.ndarray, "samples 2"]) -> float:
        """Share of samples with a force at its limit."""
        return float(np.mean(np.any(np.abs(force) >= np.asarray(self.limit), axis=-1)))

    def init(self) -> Any:
        """That of the inner law."""
        return self.inner.init()

    def command(self, state: Any, estimate: Estimate, clock: Clock) -> tuple[Pair, Any]:
        """The inner law's force, as far as it can be made."""
        force, state = self.inner.command(state, estimate, clock)
        return tuple(jnp.clip(f, -end, end) for f, end in zip(force, self.limit, strict=True)), state

    def measured(self, state: Any, volts: Pair, clock: Clock) -> Any:
        """What the inner law makes of them."""
        return self.inner.measured(state, volts, clock)

    def output(self, state: Any, estimate: Estimate) -> Estimate:
        """What the inner law gives out."""
        return self.inner.output(state, estimate)
