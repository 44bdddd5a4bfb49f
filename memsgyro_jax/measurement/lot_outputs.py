"""What the dies of a lot give out over time, as means over short windows."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from memsgyro_jax.device.gyro import Scalar
from memsgyro_jax.loop import engine, noise
from memsgyro_jax.loop.loop import ClosedLoop, Sample
from memsgyro_jax.loop.scenario import Scenario
from memsgyro_jax.montecarlo import batch as lot
from memsgyro_jax.montecarlo.spread import Spread


_LANES = 32  # dies side by side: one program, whatever their number


class Outputs(NamedTuple):
    """Of every die the mean rate given out over each window [rad/s], the mean quadrature (NaN where none is read), and
    whether it was never lost; `period` is that of the windows [s].
    """

    rate: Float[np.ndarray, "dies windows"]
    quadrature: Float[np.ndarray, "dies windows"]
    alive: Bool[np.ndarray, " dies"]
    period: float


class _Sums(NamedTuple):
    rate: Scalar
    quadrature: Scalar


class _Recorder(engine.AbstractRecorder[_Sums, _Sums]):
    """Sums over each window."""

    def init(self) -> _Sums:
        return _Sums(jnp.zeros(()), jnp.zeros(()))

    def sample(self, memory: _Sums, sample: Sample) -> _Sums:
        read = sample.estimate.readings
        return _Sums(memory.rate + sample.rate, memory.quadrature + (0.0 if read is None else read.quadrature))

    def block(self, memory: _Sums) -> tuple[_Sums, _Sums]:
        return jax.tree.map(jnp.zeros_like, memory), memory


def lot_outputs(
    loop: ClosedLoop, spread: Spread, scenario: Scenario, *, dies: int, seed: int, sample_rate: float, windows: int,
    window: int,
) -> Outputs:  # fmt: skip
    """Run `dies` dies of `spread` around `loop` for `windows` windows of `window` samples each; a die is that of a
    sweep with the same seed. `loop` must have been `sampled_at` the sample rate.
    """
    numbers = np.arange(dies)
    drawn, design = spread.draw(loop, scenario, seed, numbers), (loop, scenario)
    words = jax.tree.map(np.asarray, noise.die_words(jax.random.key(seed), jnp.asarray(spread.noise(numbers))))
    parts: list[tuple[Any, ...]] = []
    for first in range(0, dies, _LANES):
        places = np.minimum(first + np.arange(_LANES), dies - 1)
        one, conditions = lot.picked((drawn.loop, drawn.scenario), design, places)
        chosen = tuple(word[places] for word in words)
        found = _run(one, conditions, design, chosen, 1.0 / sample_rate, windows, window)
        parts.append(tuple(np.asarray(part)[..., : min(_LANES, dies - first)] for part in found))
    rate, quadrature, alive = (np.concatenate(part, axis=-1).T for part in zip(*parts, strict=True))
    known = jax.eval_shape(lambda: loop.estimate(loop.init())).readings is not None
    quadrature = quadrature / window if known else np.full_like(quadrature, np.nan)
    return Outputs(rate / window, quadrature, alive, window / sample_rate)


@eqx.filter_jit
def _run(
    loop: ClosedLoop, scenario: Scenario, design: tuple[ClosedLoop, Scenario], words: tuple[Array, Array],
    period: Scalar, windows: int, window: int,
) -> tuple[Array, Array, Array]:  # fmt: skip
    done = engine.run(loop, scenario, words, period, windows, window, _Recorder(), design[0])
    return done.outputs.rate, done.outputs.quadrature, done.alive
