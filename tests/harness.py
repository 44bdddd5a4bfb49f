"""What the tests of the simulation core share: records to feed to observers, and one compiled program per structure."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.loop import noise
from memsgyro_jax.loop.engine import AbstractRecorder, run
from memsgyro_jax.loop.loop import Sample
from memsgyro_jax.loop.observers import Clock


PERCENTILES = {"rms", "p50", "p95", "p95_low", "p95_high"}  # what summary.json holds of an error


class Keep(AbstractRecorder):
    """Keeps what `pick` takes from the last sample of each block."""

    pick: object = eqx.field(static=True)
    like: object

    def init(self):
        return self.like

    def sample(self, memory, sample: Sample):
        return jax.tree.map(lambda old, new: jnp.broadcast_to(new, jnp.shape(old)), memory, self.pick(sample))

    def block(self, memory):
        return memory, memory


def everything(sample: Sample):
    """Truth (4), volts (2), force (2), estimated motion (4), coefficients, offsets, rate variance and NIS."""
    estimate = sample.estimate
    parts = (*sample.motion, *sample.volts, *sample.force, *estimate.motion, *estimate.theta, *estimate.offset)
    return (*parts, *(part for part in (estimate.rate_variance, estimate.nis) if part is not None))


@eqx.filter_jit
def run_kept(loop, scenario, words, rate, blocks, block, keep, design):
    """`engine.run` with everything that is a number traced, so that only a new structure compiles again."""
    return run(loop, scenario, words, 1.0 / rate, blocks, block, keep, design)


def record(loop, scenario, *, rate=100e3, blocks=50, block=1, seed=0, dies=0, design=None):
    """Run and `everything` per block, as (blocks, quantity, *dies); `dies` is a number or an array of numbers."""
    estimate = (design or loop).observer.estimate((design or loop).observer.init())
    count = 14 + len(estimate.theta) + (estimate.rate_variance is not None) + (estimate.nis is not None)
    words = noise.die_words(jax.random.key(seed), jnp.asarray(dies))
    keep = Keep(everything, tuple(jnp.zeros(()) for _ in range(count)))
    done = run_kept(loop, scenario, words, jnp.asarray(rate), blocks, block, keep, design)
    return done, np.stack([np.asarray(part) for part in done.outputs], axis=1)


@eqx.filter_jit
def observe(observer, measured, force, period):
    """States of an observer after each row of a record: `measured` in V, `force` held since the row before in N."""

    def step(state, row):
        number, z, u = row
        clock = Clock((number + 1) * period, number + 1, period)
        state = observer.update(state, (z[0], z[1]), (u[0], u[1]), clock)
        return state, state

    rows = jnp.arange(len(measured)), jnp.asarray(measured), jnp.asarray(force)
    return jax.lax.scan(step, observer.init(), rows)[1]
