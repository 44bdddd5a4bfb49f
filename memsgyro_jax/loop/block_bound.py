"""The information of a run whose loop goes in blocks: first samples one by one, then what a block's statistics tell.

Those are white, each with the variance of a sample's noise, and show of a change of motion and coefficients at the
block's start what `TrueMaps` say; how such a change goes on is theirs too.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .blocks.algebra import multiplied, over_lanes
from .blocks.maps import Maps
from .blocks.run import BlockCourse, Span, crossing
from .blocks.true_maps import TrueMaps
from .engine import healthy
from .loop import ClosedLoop, LoopState
from .observers.base import OFFSETS
from .scenario import Scenario
from .sensitivities import Unknowns, begin, sampling


def goes_by_blocks(unknown: Unknowns) -> bool:
    """Whether all that is unknown acts as a coefficient of forces."""
    return all(c.delays is None and c.scales is None for c in unknown.model.coefficients)


class _Carried(NamedTuple):
    """State of the loop, the motion's derivative by each quantity, whether the die was never lost, and the maps."""

    state: LoopState
    tangents: Float[Array, "4 quantities lanes"]
    alive: Bool[Array, " lanes"]
    maps: tuple[Maps, TrueMaps]


@eqx.filter_jit
def roots_in_blocks(
    loop: ClosedLoop, design: ClosedLoop, scenario: Scenario, unknown: Unknowns, period: float, start: int,
    sizes: tuple[int, ...], lanes: tuple[int, ...], only_last: bool,
) -> tuple[Float[Array, "moments *lanes quantities quantities"], None]:  # fmt: skip
    """Triangular root of the information behind the first `start` samples and at the end of each block of `sizes`; with
    `only_last` at the end of all, in one step for many blocks. The information itself, for derivatives, is not there.
    """
    wide, count, noise = lanes or (1,), len(unknown.names), loop.readout.noise_std(period)
    samples = sampling(loop, scenario, unknown, noise, period, wide)
    begun, rows = samples(begin(loop, design, unknown, wide), jnp.arange(start))
    known = jnp.broadcast_to(jnp.diag(unknown.scale / unknown.prior_std), (*wide, count, count))
    first = _root(known, rows)

    silent = eqx.tree_at(lambda made: made.readout.noise_density, loop, (jnp.zeros(()), jnp.zeros(())))
    course = BlockCourse(silent, scenario, (jnp.zeros(wide, jnp.uint32),) * 2, period, max(sizes))
    told = _Told(course, unknown, over_lanes(noise, wide))

    def block(carry: _Carried, entering: tuple[Span, Array]) -> tuple[_Carried, tuple[Array, Array]]:
        (state, tangents, alive, maps), (span, renewed) = carry, entering
        made = lambda: (course.maps(state, span), course.true_maps(state, unknown.model, span))  # noqa: E731
        maps = jax.lax.cond(renewed, made, lambda: maps)
        rows, tangents = told.later(maps[1], state, tangents, span)
        state = course.block(state, maps[0], span)[0]
        alive = alive & healthy(loop, state)
        return _Carried(state, tangents, alive, maps), (rows, alive)

    state = course.settled_in(begun.loop)
    shapes = jax.eval_shape(lambda: course.true_maps(state, unknown.model, Span(*(jnp.zeros((), int),) * 3)))
    nothing = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
    carry = _Carried(state, jnp.stack(begun.tangents), begun.alive, (course.no_maps(state), nothing))
    entering = jax.tree.map(jnp.asarray, crossing(design, scenario, start, np.asarray(sizes)))
    rows, alive = jax.lax.scan(block, carry, entering)[1]
    if only_last:
        rows = jnp.pad(rows, ((0, -len(rows) % _TOGETHER), *((0, 0),) * 3))
        parts = rows.reshape(-1, _TOGETHER, *rows.shape[1:])
        rows = jnp.moveaxis(parts, 1, -3).reshape(len(parts), *wide, -1, count)
    last, roots = jax.lax.scan(lambda root, rows: (_root(root, rows),) * 2, first, rows)
    roots = last[None] if only_last else jnp.concatenate([first[None], roots])
    alive = alive[-1:] if only_last else jnp.concatenate([begun.alive[None], alive])
    return jnp.where(alive[..., None, None], roots, jnp.nan).reshape(len(roots), *lanes, count, count), None


class _Told(NamedTuple):
    """What blocks tell of what is `unknown`, in units of the noise of a sample [V]."""

    course: BlockCourse
    unknown: Unknowns
    noise: Float[Array, "2 lanes"]

    def later(self, maps: TrueMaps, state: LoopState, tangents: Array, span: Span) -> tuple[Array, Array]:
        """The rows of a block, and the motion's derivatives at its end."""
        course, unknown, lanes = self.course, self.unknown, self.course.lanes
        believed = course.observer.believed(state.observer).mean[:4]
        tones = course.tones(span.before * course.period)
        u = jnp.concatenate([jnp.stack(state.motion), believed, tones, jnp.ones((1, *lanes))])
        along = lambda names: jnp.stack([unknown.tangent(name) for name in names])[..., None]  # noqa: E731
        moves, offsets = along(unknown.model.names), along(OFFSETS)
        seen = multiplied(maps.seen_free, tangents) + multiplied(multiplied(maps.seen_turned, u), moves)
        seen = (seen + maps.ones[:, None, None] * offsets) / self.noise[:, None]
        after = multiplied(maps.free, tangents) + multiplied(multiplied(maps.turned, u), moves)
        return jnp.moveaxis(seen.reshape(-1, *seen.shape[2:]), -1, 0), after


_TOGETHER = 16  # blocks in one orthogonal update


def _root(root: Array, rows: Array) -> Array:
    return jnp.linalg.qr(jnp.concatenate([root, rows], axis=-2), mode="r")
