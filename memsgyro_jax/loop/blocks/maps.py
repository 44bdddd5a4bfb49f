"""The maps of a block: how truth and estimate cross M = 2^p samples, and what the read-out shows of them meanwhile.

Within a block the filter is left alone, and the command is L w with w = (estimated motion m, sines and cosines of the
tones). Of a sample, at coefficients θ with transition F and the push G of a force,

    m(θ)' = F(θ) m + G(θ) L w = E(θ) w,       w' = A w   with E at the linearisation and the turning of the tones,

and the true motion z, with its own F and G, the same force and a constant b: u = (z, w, 1), u' = B u. A true
coefficient that differs from the linearisation by δθ moves the motion by T w δθ, T' = F T + (∂E/∂θ) A^n. What the
statistics see of a motion C A^n w are sums S of b_n ⊗ C A^n. Everything doubles:

    A_2m = A_m A_m,    T_2m = F_m T_m + T_m A_m,    S_2m = S_m + R_m S_m A_m,    N_2m = N_m + R_m (O_m T_m + N_m A_m)

where O are the sums of C F^n and N those of C T_n; Q_2m = Q_m + F_m Q_m F_mᵀ is the covariance that a random walk of
the motion gathers. At the end the sums are whitened (`basis`). ∂E/∂θ is the filter's own, by a rule of Gauss.
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
from memsgyro_jax.device.gyro import Dynamics, MotionModel

from ..loop import ClosedLoop
from ..observers.base import AbstractBlockObserver
from . import basis
from .algebra import multiplied, over_lanes
from .basis import Sums, Turn
from .law import Groups, Lanes, law_of, pulsations, rows_of_readout


class Maps(NamedTuple):
    """Over a block, p estimated coefficients, w = 4 + 2·tones, u = w + 5; statistics are white.

    `theta` is the linearisation; `angles` [rad per sample] those of the basis, `whiten` its W and `ones` what a
    constant of 1 V shows in it. `estimated` A, `free` F, `turned` T and `walked` Q lead to the end of the block, `true`
    to the true motion there; `seen_free` O and `seen_turned` N are what the read-out shows, `unexpected` what it shows
    of truth less estimate.
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
    free, step, turned = _sample(observer, theta, law, period, lanes)
    estimated = jnp.concatenate([step, _turning(tonal * period, lanes)])
    own, driven, pushed = _true_sample(loop, dynamics, law, period, lanes)
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

    _, gram, to, sums = _level_by_level(start, doublings) if backwards else _at_once(_doubled, start, doublings)
    whiten = basis.whitening(gram)
    white = partial(multiplied, whiten)
    unexpected = jnp.concatenate([white(part.joined) for part in (sums.own, sums.driven, sums.pushed)], axis=2)
    chosen = over_lanes([theta[i] for i in observer.estimated], lanes)
    return Maps(
        chosen, angles, whiten, multiplied(whiten, gram[:, 0]), to.estimated, to.free, to.turned, to.walked,
        jnp.concatenate([to.own, to.driven, to.pushed], axis=1),
        white(sums.free.joined), white(sums.turned.joined), unexpected,
    )  # fmt: skip


class TrueMaps(NamedTuple):
    """Of the truth alone, over a block and with all its p coefficients: how a change of its start goes on by `free` and
    one of a coefficient by `turned`, and what the read-out shows of both, white; `ones` as of `Maps`.
    """

    ones: Float[Array, "k lanes"]
    free: Float[Array, "4 4 lanes"]
    turned: Float[Array, "4 p u lanes"]
    seen_free: Float[Array, "k 2 4 lanes"]
    seen_turned: Float[Array, "k 2 p u lanes"]


def true_maps_of(
    loop: ClosedLoop, model: MotionModel, dynamics: Dynamics, theta: tuple[Scalar, ...], period: Scalar,
    doublings: tuple[Array, int], lanes: Lanes,
) -> TrueMaps:  # fmt: skip
    """How what is true of a device with `dynamics` could be otherwise by the coefficients of `model`, while the command
    stays that of a filter which believes `theta`. By the same doubling, with u for w.
    """
    observer: Any = loop.observer
    groups: Any = loop.blocks and loop.blocks.alike
    law = law_of(loop.controller, observer, theta, groups, period, lanes)
    pulsation, tonal = pulsations(loop.controller, dynamics, groups, lanes, None)
    angles = pulsation * period
    estimated = jnp.concatenate([_sample(observer, theta, law, period, lanes)[1], _turning(tonal * period, lanes)])
    own, driven, pushed = _true_sample(loop, dynamics, law, period, lanes)
    size = len(estimated)
    nothing = lambda rows, columns: jnp.zeros((rows, columns, *lanes))  # noqa: E731
    whole = jnp.concatenate([
        jnp.concatenate([own, driven, pushed], axis=1),
        jnp.concatenate([nothing(size, 4), estimated, nothing(size, 1)], axis=1),
        nothing(1, size + 5).at[0, -1].set(1.0),
    ])  # fmt: skip
    sample = loop.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
    commanded = jnp.concatenate([nothing(2, 4), law, nothing(2, 1)], axis=1)
    acting = over_lanes(dynamics.gain, lanes)[:, None] * commanded
    acting = acting.at[:, -1].set(over_lanes(dynamics.bias, lanes))
    terms = [coefficient.terms for coefficient in model.coefficients]
    turned = _turned_in_a_sample(sample.nodes, terms, acting, commanded, lanes)
    shows, turn, one = rows_of_readout(loop.readout, lanes), Turn(jnp.cos(angles), jnp.sin(angles)), basis.at(angles)
    start = _TrueDoubling(
        turn, one[:, None] * one[None], own, whole, turned,
        Sums.first(turn, multiplied(shows, own)), Sums.first(turn, multiplied(shows, turned)),
    )  # fmt: skip
    done = _at_once(_truly_doubled, start, doublings)
    whiten = basis.whitening(done.gram)
    seen = (multiplied(whiten, part.joined) for part in (done.seen_free, done.seen_turned))
    return TrueMaps(multiplied(whiten, done.gram[:, 0]), done.free, done.turned, *seen)


class _TrueDoubling(NamedTuple):
    """b_m, G_m, F, B and T of m samples, O and N."""

    turn: Turn
    gram: Array
    free: Array
    whole: Array
    turned: Array
    seen_free: Sums
    seen_turned: Sums


def _truly_doubled(half: _TrueDoubling) -> _TrueDoubling:
    """Over 2m samples from over m."""
    turn, gram, free, whole, turned, seen, seen_turned = half
    return _TrueDoubling(
        turn.twice,
        basis.gram_twice(gram, turn),
        multiplied(free, free),
        multiplied(whole, whole),
        multiplied(free, turned) + multiplied(turned, whole),
        _later(turn, seen, _through(seen, free)),
        _later(turn, seen_turned, _through(seen, turned), _through(seen_turned, whole)),
    )


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


def _at_once(double: Callable, start: Any, doublings: tuple[Array, int]) -> Any:
    """Of a whole block, from what is `start` of a sample."""

    def level(half: Any, passed: Array) -> tuple[Any, None]:
        return jax.lax.cond(passed < doublings[0], double, lambda whole: whole, half), None

    return jax.lax.scan(level, start, jnp.arange(doublings[1]))[0]


def _level_by_level(start: _Doubling, doublings: tuple[Array, int]) -> _Doubling:
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
        doubled = lambda *half: flat(_doubled(apart(*half)))  # noqa: E731
        return jax.lax.cond(passed < doublings[0], doubled, lambda *whole: whole, *half), None

    return apart(*jax.lax.scan(level, flat(start), jnp.arange(doublings[1]))[0])


def _doubled(half: _Doubling) -> _Doubling:
    """Over 2m samples from over m."""
    turn, gram, to, seen = half
    ends = _Ends(
        free=multiplied(to.free, to.free),
        estimated=multiplied(to.estimated, to.estimated),
        turned=multiplied(to.free, to.turned) + multiplied(to.turned, to.estimated),
        walked=to.walked + multiplied(multiplied(to.free, to.walked), jnp.swapaxes(to.free, 0, 1)),
        own=multiplied(to.own, to.own),
        driven=multiplied(to.own, to.driven) + multiplied(to.driven, to.estimated),
        pushed=multiplied(to.own, to.pushed) + to.pushed,
    )

    added = _Seen(
        free=_later(turn, seen.free, _through(seen.free, to.free)),
        turned=_later(turn, seen.turned, _through(seen.free, to.turned), _through(seen.turned, to.estimated)),
        own=_later(turn, seen.own, _through(seen.own, to.own)),
        driven=_later(turn, seen.driven, _through(seen.own, to.driven), _through(seen.driven, to.estimated)),
        pushed=_later(turn, seen.pushed, _through(seen.own, to.pushed), seen.pushed),
    )
    return _Doubling(turn.twice, basis.gram_twice(gram, turn), ends, added)


def _through(sums: Sums, onto: Array) -> Sums:
    """What is seen once all went through a map."""
    return Sums(*(multiplied(part, onto) for part in sums))


def _later(turn: Turn, first: Sums, *second: Sums) -> Sums:
    """Sums over both halves, where what adds up over the second is given as if it were the first."""
    rest = Sums(*(reduce(add, parts) for parts in zip(*second, strict=True))).turned(turn)
    return Sums(*(a + b for a, b in zip(first, rest, strict=True)))


def _sample(
    observer: AbstractBlockObserver, theta: tuple[Scalar, ...], law: Array, period: Scalar, lanes: Lanes
) -> tuple[Array, Array, Array]:
    """F, E and ∂E/∂θ of a sample: a coefficient accelerates by its signals, at the nodes that the filter takes too."""
    dynamics = observer.model.assemble(theta)
    sample = observer.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
    pushed = over_lanes(dynamics.gain, lanes)[:, None] * law
    free = over_lanes(sample.full, lanes)
    step = multiplied(over_lanes(sample.push, lanes), pushed).at[:, :4].add(free)
    terms = [observer.model.coefficients[index].terms for index in observer.estimated]
    return free, step, _turned_in_a_sample(sample.nodes, terms, pushed, law, lanes)


def _turned_in_a_sample(
    nodes: Any, terms: list, pushed: Array, law: Array, lanes: Lanes
) -> Float[Array, "4 p w lanes"]:
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


def _true_sample(
    loop: ClosedLoop, dynamics: Dynamics, law: Array, period: Scalar, lanes: Lanes
) -> tuple[Array, Array, Array]:
    """Of the true motion after a sample: what comes from itself, from w, and from nothing."""
    sample = loop.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
    push = over_lanes(sample.push, lanes)
    driven = multiplied(push, over_lanes(dynamics.gain, lanes)[:, None] * law)
    return over_lanes(sample.full, lanes), driven, multiplied(push, over_lanes(dynamics.bias, lanes)[:, None])


def _turning(angles: Float[Array, "tones lanes"], lanes: Lanes) -> Float[Array, "2·tones w lanes"]:
    """How the sine and cosine of each tone turn in a sample."""
    size, rows = 4 + 2 * len(angles), []
    for place, angle in enumerate(angles):
        c, s = jnp.cos(angle), jnp.sin(angle)
        for pair in ((c, s), (-s, c)):
            row = [jnp.zeros(lanes)] * size
            row[4 + 2 * place : 6 + 2 * place] = pair
            rows.append(jnp.stack(row))
    return jnp.stack(rows) if rows else jnp.zeros((0, size, *lanes))
