"""The maps of a block: how truth and estimate cross M = 2^p samples, and what the read-out shows of them meanwhile.

Within a block the filter is left alone, and the command is L w with w = (estimated motion m, sines and cosines of the
tones). Of a sample, at coefficients θ with transition F and the push G of a force,

    m(θ)' = F(θ) m + G(θ) L w = E(θ) w,       w' = A w   with E at the linearisation and the turning of the tones,

and the true motion z, with its own F and G, the same force and a constant b: u = (z, w, 1), u' = B u. A true
coefficient that differs from the linearisation by δθ moves the motion by T w δθ, T' = F T + (∂E/∂θ) A^n. What the
statistics see of a motion C A^n w are sums S of b_n ⊗ C A^n. Everything doubles:

    A_2m = A_m A_m,    T_2m = F_m T_m + T_m A_m,    S_2m = S_m + R_m S_m A_m,    N_2m = N_m + R_m (O_m T_m + N_m A_m)

where O are the sums of C F^n and N those of C T_n. Where a coefficient moves others, by D in a second, what the second
half begins with is θ (1 + D m): its T_m A_m and N_m A_m are taken through that. Q_2m = Q_m + F_m Q_m F_mᵀ is the
covariance that a random walk of the motion gathers. At the end the sums are whitened (`basis`). ∂E/∂θ is the filter's
own, by a rule of Gauss.
"""

import math
from collections.abc import Callable
from functools import partial, reduce
from operator import add
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.fields import Scalar
from memsgyro_jax.device.gyro import Dynamics

from ..loop import ClosedLoop
from ..observers.base import AbstractBlockObserver
from . import basis
from .algebra import matrix_over_lanes, multiplied, over_lanes
from .basis import Sums, Turn
from .law import Groups, Lanes, law_of, pulsations, rows_of_readout


Moved = Callable[[Array, Array], Array]


class Maps(NamedTuple):
    """Over a block, p estimated coefficients, w = 4 + 2·tones, u = w + 5; statistics are white.

    `theta` is the linearisation, at which nothing moves a coefficient; `angles` [rad per sample] those of the basis,
    `whiten` its W and `ones` what a constant of 1 V shows in it. `estimated` A, `free` F, `turned` T and `walked` Q
    lead to the end of the block, `true` to the true motion there; `seen_free` O and `seen_turned` N are what the
    read-out shows, `unexpected` what it shows of truth less estimate; `ramp` is None where the true rate stands still.
    """

    theta: Float[Array, "p lanes"]
    angles: Float[Array, "frequencies lanes"]
    whiten: Float[Array, "k k lanes"]
    ones: Float[Array, "k lanes"]
    estimated: Float[Array, "w w lanes"]
    free: Float[Array, "4 4 lanes"]
    turned: Float[Array, "4 p w lanes"]
    walked: Float[Array, "4 4 lanes"]
    true: Float[Array, "4 u lanes"]
    seen_free: Float[Array, "k 2 4 lanes"]
    seen_turned: Float[Array, "k 2 p w lanes"]
    unexpected: Float[Array, "k 2 u lanes"]
    ramp: "RateRamp | None" = None


class RateRamp(NamedTuple):
    """What a unit slope of the true rate about the middle of the block [rad/s²] adds to `true`, and to `unexpected`."""

    true: Float[Array, "4 u lanes"]
    unexpected: Float[Array, "k 2 u lanes"]


_APART = 0.1  # rad over a whole block, by which neighbours differ: a ramp to a twentieth, told from rounding


def maps_of(
    loop: ClosedLoop, dynamics: Dynamics, theta: tuple[Scalar, ...], groups: Groups, period: Scalar,
    doublings: tuple[Array, int], lanes: Lanes, backwards: bool = False,
) -> Maps:  # fmt: skip
    """The maps over 2^p samples at linearisation `theta`, of a device with `dynamics`; `doublings`: p and its top.
    `backwards` is a run whose derivative goes so.
    """
    observer: Any = loop.observer
    law = law_of(loop.controller, observer, theta, groups, period, lanes)
    apart = _APART / (2 ** doublings[1] * period) if loop.blocks and loop.blocks.ramps else None
    pulsation, tonal = pulsations(loop.controller, observer.model.assemble(theta), groups, lanes, apart)
    angles = pulsation * period
    free, step, turned = sample_of(observer, theta, law, period, lanes)
    turned, moved = _moving(observer, turned, period, lanes)
    estimated = jnp.concatenate([step, turning(tonal * period, lanes)])
    own, driven, pushed = true_sample(loop, dynamics, law, period, lanes)
    expects = over_lanes(
        [
            [s if i == signal else 0.0 for i in range(4)]
            for signal, s in zip(observer.signals, observer.scale, strict=True)
        ],
        lanes,
    )
    shows = rows_of_readout(loop.readout, lanes)
    walk = jnp.eye(4)[..., None] * over_lanes(observer.walk()[:4], lanes) * period
    turn, one = Turn(jnp.cos(angles), jnp.sin(angles)), basis.at(angles)
    seen = partial(Sums.first, turn)
    double = partial(_doubled, moved)
    start = _Doubling(
        turn,
        one[:, None] * one[None],
        _Ends(free, estimated, turned, walk, own, driven, pushed),
        _Seen(
            seen(multiplied(expects, free)),
            seen(multiplied(expects, turned)),
            seen(multiplied(shows, own)),
            seen(multiplied(shows, driven) - multiplied(expects, step)),
            seen(multiplied(shows, pushed)),
        ),
    )

    _, gram, to, sums = (_level_by_level if backwards else levels_at_once)(double, start, doublings)
    whiten = basis.whitening(gram)
    white = partial(multiplied, whiten)
    unexpected = jnp.concatenate([white(part.joined) for part in (sums.own, sums.driven, sums.pushed)], axis=2)
    chosen = over_lanes([theta[i] for i in observer.estimated], lanes)
    chosen = jnp.concatenate([chosen, jnp.zeros((turned.shape[1] - len(chosen), *lanes))])
    return Maps(
        chosen, angles, whiten, multiplied(whiten, gram[:, 0]), to.estimated, to.free, to.turned, to.walked,
        jnp.concatenate([to.own, to.driven, to.pushed], axis=1),
        white(sums.free.joined), white(sums.turned.joined), unexpected,
    )  # fmt: skip


class _Ends(NamedTuple):
    """What leads to the end of m samples: F, A, T and Q, and of the true motion its own F, what w and what 1 push."""

    free: Array
    estimated: Array
    turned: Array
    walked: Array
    own: Array
    driven: Array
    pushed: Array


class _Seen(NamedTuple):
    """What the read-out shows over m samples: O and N; and of truth less estimate by z, w and 1."""

    free: Sums
    turned: Sums
    own: Sums
    driven: Sums
    pushed: Sums


class _Doubling(NamedTuple):
    """b_m, G_m and the rest of m samples."""

    turn: Turn
    gram: Array
    to: _Ends
    seen: _Seen


def levels_at_once(double: Callable, start: Any, doublings: tuple[Array, int]) -> Any:
    """Of a whole block, from what is `start` of a sample; `double` is told how often it was doubled before."""

    def level(half: Any, passed: Array) -> tuple[Any, None]:
        return jax.lax.cond(passed < doublings[0], double, lambda whole, _: whole, half, passed), None

    return jax.lax.scan(level, start, jnp.arange(doublings[1]))[0]


def _level_by_level(double: Callable, start: _Doubling, doublings: tuple[Array, int]) -> _Doubling:
    """The same. What has a derivative goes from level to level as one array, which is all that is kept of the way: XLA
    on CPU writes a row of one array in place, but copies several anew at every level.
    """
    leaves, tree = jax.tree.flatten(start[2:])
    sizes = [math.prod(leaf.shape[:-1]) for leaf in leaves]

    def flat(half: _Doubling) -> tuple[Turn, Array, Array]:
        parts = [leaf.reshape(-1, leaf.shape[-1]) for leaf in jax.tree.leaves(half[2:])]
        return half.turn, half.gram, jnp.concatenate(parts)

    def apart(turn: Turn, gram: Array, whole: Array) -> _Doubling:
        parts = zip(jax.lax.split(whole, sizes), leaves, strict=True)
        return _Doubling(turn, gram, *jax.tree.unflatten(tree, [part.reshape(leaf.shape) for part, leaf in parts]))

    @jax.checkpoint
    def level(half: tuple, passed: Array) -> tuple[tuple, None]:
        doubled = lambda *half: flat(double(apart(*half), passed))  # noqa: E731
        return jax.lax.cond(passed < doublings[0], doubled, lambda *whole: whole, *half), None

    return apart(*jax.lax.scan(level, flat(start), jnp.arange(doublings[1]))[0])


def _doubled(moved: Moved, half: _Doubling, passed: Array) -> _Doubling:
    """Over 2m samples from over m = 2^passed; `moved` takes what hangs on coefficients to those of a later start."""
    turn, gram, to, seen = half
    later = partial(moved, passed)
    ends = _Ends(
        free=multiplied(to.free, to.free),
        estimated=multiplied(to.estimated, to.estimated),
        turned=multiplied(to.free, to.turned) + later(multiplied(to.turned, to.estimated)),
        walked=to.walked + multiplied(multiplied(to.free, to.walked), jnp.swapaxes(to.free, 0, 1)),
        own=multiplied(to.own, to.own),
        driven=multiplied(to.own, to.driven) + multiplied(to.driven, to.estimated),
        pushed=multiplied(to.own, to.pushed) + to.pushed,
    )

    added = _Seen(
        free=seen_later(turn, seen.free, seen_through(seen.free, to.free)),
        turned=seen_later(
            turn,
            seen.turned,
            seen_through(seen.free, to.turned),
            Sums(*map(later, seen_through(seen.turned, to.estimated))),
        ),
        own=seen_later(turn, seen.own, seen_through(seen.own, to.own)),
        driven=seen_later(
            turn, seen.driven, seen_through(seen.own, to.driven), seen_through(seen.driven, to.estimated)
        ),
        pushed=seen_later(turn, seen.pushed, seen_through(seen.own, to.pushed), seen.pushed),
    )
    return _Doubling(turn.twice, basis.gram_twice(gram, turn), ends, added)


def seen_through(sums: Sums, onto: Array) -> Sums:
    """What is seen once all went through a map."""
    return Sums(*(multiplied(part, onto) for part in sums))


def seen_later(turn: Turn, first: Sums, *second: Sums) -> Sums:
    """Sums over both halves, where what adds up over the second is given as if it were the first."""
    rest = Sums(*(reduce(add, parts) for parts in zip(*second, strict=True))).turned(turn)
    return Sums(*(a + b for a, b in zip(first, rest, strict=True)))


def sample_of(
    observer: AbstractBlockObserver, theta: tuple[Scalar, ...], law: Array, period: Scalar, lanes: Lanes
) -> tuple[Array, Array, Array]:
    """F, E and ∂E/∂θ of a sample: a coefficient accelerates by its signals, at the nodes that the filter takes too."""
    dynamics = observer.model.assemble(theta)
    sample = observer.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
    pushed = over_lanes(dynamics.gain, lanes)[:, None] * law
    free = over_lanes(sample.full, lanes)
    step = multiplied(over_lanes(sample.push, lanes), pushed).at[:, :4].add(free)
    terms = [observer.model.coefficients[index].terms for index in observer.estimated]
    return free, step, turned_in_a_sample(sample.nodes, terms, pushed, law, lanes)


def _moving(
    observer: AbstractBlockObserver, turned: Float[Array, "4 p w lanes"], period: Scalar, lanes: Lanes
) -> tuple[Array, Moved]:
    """∂E/∂θ with columns for what moves coefficients, and how they move."""
    moves = observer.moves()
    if moves is None:
        return turned, lambda passed, later: later
    begin = 2 if observer.with_offsets else 0
    by = matrix_over_lanes(moves, lanes)[begin:, begin:]
    more = jnp.zeros((4, len(by) - turned.shape[1], *turned.shape[2:]))
    moved = as_moved_by(by, period)
    return moved(jnp.zeros(()), jnp.concatenate([turned, more], axis=1)), moved


def as_moved_by(by: Float[Array, "p p lanes"], period: Scalar) -> Moved:
    """How what hangs on coefficients after 2^passed samples (..., p, w) hangs on those before, where a unit of one
    moves another, `by` in a second, before each sample.
    """

    def moved(passed: Array, later: Array) -> Array:
        columns = multiplied(jnp.swapaxes(by, 0, 1), jnp.moveaxis(later, -3, 0))
        return later + 2.0**passed * period * jnp.moveaxis(columns, 0, -3)

    return moved


def turned_in_a_sample(nodes: Any, terms: list, pushed: Array, law: Array, lanes: Lanes) -> Float[Array, "4 p w lanes"]:
    """∂E/∂θ of coefficients with these `terms`: where what acts accelerates by `pushed` w and is commanded by `law` w,
    of which the motion is the first four.
    """
    slopes = jnp.zeros((4, len(terms), *pushed.shape[1:]))
    for node in nodes:
        reached = multiplied(over_lanes(node.push, lanes), pushed).at[:, :4].add(over_lanes(node.reach, lanes))
        kick, signals = over_lanes(node.kick, lanes), jnp.concatenate([reached, law])
        each = [sum(f * kick[:, None, axis] * signals[None, signal] for axis, signal, f in term) for term in terms]
        slopes = slopes + jnp.stack(each, axis=1) if each else slopes
    return slopes


def true_sample(
    loop: ClosedLoop, dynamics: Dynamics, law: Array, period: Scalar, lanes: Lanes
) -> tuple[Array, Array, Array]:
    """Of the true motion after a sample: what comes from itself, from w, and from nothing."""
    sample = loop.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
    push = over_lanes(sample.push, lanes)
    driven = multiplied(push, over_lanes(dynamics.gain, lanes)[:, None] * law)
    return over_lanes(sample.full, lanes), driven, multiplied(push, over_lanes(dynamics.bias, lanes)[:, None])


def turning(angles: Float[Array, "tones lanes"], lanes: Lanes) -> Float[Array, "2·tones w lanes"]:
    """How the sine and cosine of each tone turn in a sample."""
    size, rows = 4 + 2 * len(angles), []
    for place, angle in enumerate(angles):
        c, s = jnp.cos(angle), jnp.sin(angle)
        for pair in ((c, s), (-s, c)):
            row = [jnp.zeros(lanes)] * size
            row[4 + 2 * place : 6 + 2 * place] = pair
            rows.append(jnp.stack(row))
    return jnp.stack(rows) if rows else jnp.zeros((0, size, *lanes))
