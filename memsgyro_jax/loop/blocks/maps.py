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

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.fields import Scalar
from memsgyro_jax.device.gyro import Dynamics

from ..loop import ClosedLoop
from ..observers.base import AbstractBlockObserver
from . import basis
from .algebra import multiplied, over_lanes, weighted
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
    turned: Float[Array, "p 4 w lanes"]
    walked: Float[Array, "4 4 lanes"]
    true: Float[Array, "4 u lanes"]
    seen_free: Float[Array, "k 2 4 lanes"]
    seen_turned: Float[Array, "p k 2 w lanes"]
    unexpected: Float[Array, "k 2 u lanes"]


def maps_of(
    loop: ClosedLoop, dynamics: Dynamics, theta: tuple[Scalar, ...], groups: Groups, period: Scalar, length: int,
    lanes: Lanes,
) -> Maps:  # fmt: skip
    """The maps over `length` samples at linearisation `theta`, for a device with `dynamics`."""
    observer: Any = loop.observer
    law = law_of(loop.controller, observer, theta, groups, period, lanes)
    pulsation, tonal = pulsations(loop.controller, observer.model.assemble(theta), groups, lanes)
    angles = pulsation * period
    free, step, turned = _sample(observer, theta, law, period, lanes)
    estimated = jnp.concatenate([step, _turning(tonal * period, lanes)])
    true = _true_sample(loop, dynamics, law, estimated, period, lanes)
    expects = over_lanes(
        [
            [s if i == signal else 0.0 for i in range(4)]
            for signal, s in zip(observer.signals, observer.scale, strict=True)
        ],
        lanes,
    )
    shows = jnp.concatenate([rows_of_readout(loop.readout, lanes), -expects], axis=1)
    shows = jnp.concatenate([shows, jnp.zeros((2, true.shape[1] - 8, *lanes))], axis=1)
    walk = jnp.eye(4)[..., None] * over_lanes(observer.walk()[:4], lanes) * period
    one = basis.at(angles)
    seen = lambda volts: one.reshape(len(one), *(1,) * (volts.ndim - 1), *lanes) * volts  # noqa: E731
    start = (
        one,
        one[:, None] * one[None],
        _Sums(free, estimated, turned, walk, true),
        (
            seen(multiplied(expects, free)),
            jnp.moveaxis(seen(multiplied(expects, turned)), 0, 1),
            seen(multiplied(shows, true)),
        ),
    )
    _, gram, ends, sums = jax.lax.fori_loop(0, length.bit_length() - 1, lambda _, s: _doubled(*s), start)
    whiten = basis.whitening(gram)
    white = lambda parts: jnp.stack([weighted(row, parts) for row in whiten])  # noqa: E731
    seen_turned = jnp.moveaxis(white(jnp.moveaxis(sums[1], 0, 1)), 0, 1)
    chosen = over_lanes([theta[i] for i in observer.estimated], lanes)
    return Maps(
        chosen, angles, whiten, weighted_ones(whiten, gram), ends.estimated, ends.free, ends.turned, ends.walked,
        ends.true[:4], white(sums[0]), seen_turned, white(sums[2]),
    )  # fmt: skip


def weighted_ones(whiten: Float[Array, "k k lanes"], gram: Float[Array, "k k lanes"]) -> Float[Array, "k lanes"]:
    """W Σ b_n: the basis holds the constant, so that the sum is a column of G."""
    return jnp.stack([weighted(row, gram[:, 0]) for row in whiten])


class _Sums(NamedTuple):
    """What leads to the end of m samples; `true` is the whole of B."""

    free: Array
    estimated: Array
    turned: Array
    walked: Array
    true: Array


def _doubled(one: Array, gram: Array, to: _Sums, sums: tuple[Array, Array, Array]) -> tuple:
    """All of it over 2m samples from that over m."""
    seen_free, seen_turned, unexpected = sums
    turn = lambda parts: basis.rotated(parts, one)  # noqa: E731
    moved = multiplied(seen_free, to.turned[:, None]) + multiplied(seen_turned, to.estimated)
    ends = _Sums(
        free=multiplied(to.free, to.free),
        estimated=multiplied(to.estimated, to.estimated),
        turned=multiplied(to.free, to.turned) + multiplied(to.turned, to.estimated),
        walked=to.walked + multiplied(multiplied(to.free, to.walked), jnp.swapaxes(to.free, 0, 1)),
        true=multiplied(to.true, to.true),
    )
    added = (
        seen_free + turn(multiplied(seen_free, to.free)),
        seen_turned + jnp.moveaxis(turn(jnp.moveaxis(moved, 0, 1)), 0, 1),
        unexpected + turn(multiplied(unexpected, to.true)),
    )
    return basis.twice(one), basis.gram_twice(gram, one), ends, added


def _sample(
    observer: AbstractBlockObserver, theta: tuple[Scalar, ...], law: Array, period: Scalar, lanes: Lanes
) -> tuple[Array, Array, Array]:
    """F, E and ∂E/∂θ of a sample: a coefficient accelerates by its signals, at the nodes that the filter takes too."""
    dynamics = observer.model.assemble(theta)
    sample = observer.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
    pushed = over_lanes(dynamics.gain, lanes)[:, None] * law
    free = over_lanes(sample.full, lanes)
    step = multiplied(over_lanes(sample.push, lanes), pushed).at[:, :4].add(free)
    slopes = jnp.zeros((len(observer.estimated), *step.shape))
    for node in sample.nodes:
        reached = multiplied(over_lanes(node.push, lanes), pushed).at[:, :4].add(over_lanes(node.reach, lanes))
        kick, signals = over_lanes(node.kick, lanes), jnp.concatenate([reached, law])
        terms = [observer.model.coefficients[index].terms for index in observer.estimated]
        each = [sum(f * kick[:, None, axis] * signals[None, signal] for axis, signal, f in term) for term in terms]
        slopes = slopes + jnp.stack(each) if each else slopes
    return free, step, slopes


def _true_sample(
    loop: ClosedLoop, dynamics: Dynamics, law: Array, estimated: Array, period: Scalar, lanes: Lanes
) -> Array:
    """B of a sample."""
    sample = loop.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
    free, push = over_lanes(sample.full, lanes), over_lanes(sample.push, lanes)
    driven = multiplied(push, over_lanes(dynamics.gain, lanes)[:, None] * law)
    constant = multiplied(push, over_lanes(dynamics.bias, lanes)[:, None])
    size = len(estimated)
    below = jnp.concatenate([jnp.zeros((size, 4, *lanes)), estimated, jnp.zeros((size, 1, *lanes))], axis=1)
    last = jnp.concatenate([jnp.zeros((1, 4 + size, *lanes)), jnp.ones((1, 1, *lanes))], axis=1)
    return jnp.concatenate([jnp.concatenate([free, driven, constant], axis=1), below, last])


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
