"""The search for tones: many starts, descent by gradient, limits that hold by construction."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from .aim import Aim, aimed
from .information import Tones, held, rate_variance, sensitivities
from .plant import Plant


_LOST = 50.0  # logarithm of the error of a design that says nothing
_SHARPNESS = 16  # of the smooth maximum by which the limit on the force acts


class Problem(eqx.Module):
    """What a design is judged by. `dies` and `aims` have one die per entry of the leading axis, `design` is the one it
    is made for; each die moves in the design aimed at it.

    `own` (unknowns, 0 where known) and `std` (of the model's errors) as in `rate_variance`; `used` (tones, 2) which
    tone may move which axis; `displacement` [m] and `force` [N] (infinite: none) limit each axis, `band` [Hz] the
    frequencies.
    """

    dies: Plant
    aims: Aim
    design: Plant
    own: Float[Array, " own"]
    std: Float[Array, " errors"]
    used: Bool[Array, "tones 2"]
    displacement: Float[Array, ""]
    force: Float[Array, ""]
    band: Float[Array, "2"]
    period: Float[Array, ""]
    samples: int = eqx.field(static=True)
    signals: tuple[int, int] = eqx.field(static=True)
    rate: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Length of the vector that `tones` reads."""
        return 5 * len(self.used) + 2


def tones(vector: Float[Array, " n"], problem: Problem) -> Tones:
    """The design that stands for any numbers: frequencies within the band, amplitudes within both limits.

    The amplitudes of an axis are shares of its displacement, and a slack takes the rest; the axes are then lowered
    together where the force asks for it.
    """
    count, (low, high) = len(problem.used), problem.band
    frequency = low + (high - low) * jax.nn.sigmoid(_scale(problem) * vector[:count])
    real, imaginary = vector[count : 3 * count], vector[3 * count : 5 * count]
    raw = (real + 1j * imaginary).reshape(count, 2) * problem.used
    size = jnp.sqrt(raw.real**2 + raw.imag**2 + 1e-24)
    whole = jnp.sqrt(jnp.sum(size, axis=0) ** 2 + vector[5 * count :] ** 2)
    made = Tones(2.0 * jnp.pi * frequency, problem.displacement * raw / whole)
    needed = jnp.sum(jnp.abs(held(problem.design, made, problem.period).force + 1e-30), axis=0) / problem.force
    return made._replace(amplitude=made.amplitude * (1.0 + jnp.sum(needed**_SHARPNESS)) ** (-1.0 / _SHARPNESS))


def _scale(problem: Problem) -> Array:
    """What makes a frequency coordinate count in 1/duration, as finely as the record resolves it."""
    return 4.0 / ((problem.band[1] - problem.band[0]) * problem.samples * problem.period)


def variances(made: Tones, problem: Problem) -> Float[Array, " dies"]:
    """Bound of the rate's variance for each die that moves in its design, (rad/s)²."""

    def of(die: Plant, how: Aim) -> Array:
        moved = aimed(made, how, problem.displacement)
        rows = sensitivities(die, moved, problem.period, problem.samples, problem.signals)
        return rate_variance(rows, problem.own, problem.rate, problem.std)

    return jax.vmap(of)(problem.dies, problem.aims)


def loss(vector: Float[Array, " n"], problem: Problem) -> Float[Array, ""]:
    """Mean over dies of the logarithm of the bound."""
    found = 0.5 * jnp.mean(jnp.log(variances(tones(vector, problem), problem)))
    return jnp.where(jnp.isfinite(found), found, _LOST)


class BestTones(NamedTuple):
    """Tones at the end of each start, best first, and the logarithm of their bound before they met a limit."""

    tones: Tones
    losses: Float[np.ndarray, " starts"]


def search(
    problem: Problem, modes: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]], starts: int, steps: int, seed: int
) -> BestTones:
    """Descend from the best `starts` of many random designs, each with at most `steps` steps of BFGS.

    `modes` are the frequencies [Hz] and shapes about which most of the designs are drawn.
    """
    pool = _pool(problem, modes, 128 * starts, np.random.default_rng(seed))
    chosen = pool[np.argsort(np.asarray(_losses(pool, problem)))[:starts]]
    vectors = np.asarray(_descents(chosen, problem, steps))
    # A slack that is not needed comes near zero but stays; without it the limit is met exactly.
    exact = np.where(np.arange(problem.size) < problem.size - 2, vectors, 0.0)
    both = np.stack([vectors, exact])
    padded = np.resize(both.reshape(-1, problem.size), pool.shape)  # the pool's program serves again
    losses = np.asarray(_losses(padded, problem))[: 2 * starts].reshape(2, starts)
    best = np.argmin(losses, axis=0), np.arange(len(vectors))
    order = np.argsort(losses[best])
    return BestTones(_to_the_limit(both[best][order], problem), losses[best][order])


def _pool(problem: Problem, modes: tuple, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count n"]:
    """Random designs: of the tones, two of three lie about a mode (within what 0.1 s tells apart a few times over), and
    two of three move in the shape of one.
    """
    number, (frequencies, shapes) = len(problem.used), modes
    low, high = np.asarray(problem.band)
    at_mode = rng.choice(frequencies, (count, number)) + rng.normal(0.0, 30.0, (count, number))
    anywhere = rng.uniform(low, high, (count, number))
    frequency = np.where(rng.random((count, number)) < 2.0 / 3.0, at_mode, anywhere)
    share = np.clip((frequency - low) / (high - low), 0.01, 0.99)
    turned, free = (rng.normal(size=(2, count, number, n)) for n in (1, 2))
    shaped = turned * shapes.T[rng.integers(0, 2, (count, number))]
    amplitude = np.where(rng.random((count, number, 1)) < 2.0 / 3.0, shaped, free)
    slack = rng.normal(0.0, 0.1, (count, 2))
    place = np.log(share / (1.0 - share)) / float(_scale(problem))
    return np.concatenate([place, *(part.reshape(count, -1) for part in amplitude), slack], axis=1)


@eqx.filter_jit
def _to_the_limit(vectors: Float[Array, "n size"], problem: Problem) -> Tones:
    """Larger until a limit is met: the smooth maximum keeps 4 % away from the force where both axes need it, and larger
    amplitudes tell more of everything.
    """

    def one(vector: Array) -> Tones:
        made = tones(vector, problem)
        force = jnp.sum(jnp.abs(held(problem.design, made, problem.period).force), axis=0)
        moved = jnp.sum(jnp.abs(made.amplitude), axis=0)
        used = jnp.concatenate([force / problem.force, moved / problem.displacement])
        return made._replace(amplitude=made.amplitude / jnp.max(used))

    return jax.vmap(one)(vectors)


@eqx.filter_jit
def _losses(vectors: Float[Array, "count n"], problem: Problem) -> Float[Array, " count"]:
    return jax.vmap(lambda v: loss(v, problem))(vectors)


@eqx.filter_jit
def _descents(vectors: Float[Array, "starts n"], problem: Problem, steps: int) -> Float[Array, "starts n"]:
    solver: optx.BFGS = optx.BFGS(rtol=1e-7, atol=1e-7)

    def one(vector: Array) -> Array:
        return optx.minimise(loss, solver, vector, problem, max_steps=steps, throw=False).value

    return jax.vmap(one)(vectors)
