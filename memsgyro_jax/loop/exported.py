"""One sample of a loop as a program that runs without this package: StableHLO, by `jax.export`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import export
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError

from .loop import ClosedLoop, as_loop
from .observers.base import Clock
from .scenario import Constant, Scenario


_EVER = 1e12  # s


class ExportedLoop(NamedTuple):
    """A loop sampled every `period` [s].

    `program.call(state, number, rate, noise)` gives the state after sample `number` (from 0) and what came out: rate
    [rad/s], commanded force x, y [N] and voltage x, y [V]. `rate` is the true one in rad/s, `noise` two standard
    normal numbers of the read-out. `start` is the first state. `program.mlir_module()` is its text, and
    `program.serialize()` (with `flatbuffers` installed) what `jax.export.deserialize` reads anywhere.
    """

    program: export.Exported
    start: np.ndarray
    period: float


def export_loop(loop: ClosedLoop, *, sample_rate: float | str, duration: float | str | None = None) -> ExportedLoop:
    """A sample of `loop`, undisturbed but for its rate, compiled for the processor at hand.

    `duration` is that of the run of `simulate` to be met to rounding: the longer a filter runs, the more exact `Exact`
    takes its derivative. Left out, it runs for ever.

    **Raises:** `InputError` for a loop whose numbers are traced, and as `simulate` does.
    """
    runtime.require_float64("export_loop")
    rate = quantity("sample_rate", sample_rate, "Hz")
    until = _EVER if duration is None else quantity("duration", duration, "s")
    ready = as_loop(loop).sampled_at(rate, duration=until).present
    if not is_concrete(ready):
        raise InputError("Argument `loop` must be of numbers to be exported, but is traced; call this outside of jit.")
    start, shaped = ravel_pytree(jax.tree.map(jnp.asarray, ready.init()))

    def sample(state: Array, number: Array, turning: Array, noise: Float[Array, "2"]) -> tuple[Array, Array]:
        clock = Clock(number / rate, number, 1.0 / rate)
        entering = Scenario(Constant(turning)).at(clock.time)
        new, taken = ready.step(shaped(state), entering, (noise[0], noise[1]), clock)
        out = jnp.stack([jnp.asarray(v, float) for v in (taken.rate, *taken.force, *taken.volts)])
        return ravel_pytree(jax.tree.map(jnp.asarray, new))[0].astype(start.dtype), out

    shapes = [jax.ShapeDtypeStruct(shape, kind) for shape, kind in
              ((start.shape, start.dtype), ((), jnp.int64), ((), float), ((2,), float))]  # fmt: skip
    return ExportedLoop(export.export(jax.jit(sample))(*shapes), np.asarray(start), 1.0 / rate)
