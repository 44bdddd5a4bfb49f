"""How the truth could be otherwise: the maps of a block of the true motion by all that it hangs on, for the bound, and
by a rate that moves within it.

By the same doubling as `maps`, with u = (z, w, 1) for w.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.fields import Scalar
from memsgyro_jax.device.gyro import Dynamics, MotionModel

from ..loop import ClosedLoop
from . import basis
from .algebra import multiplied, over_lanes
from .basis import Sums, Turn
from .law import Lanes, law_of, pulsations, rows_of_readout
from .maps import (
    Maps,
    RateRamp,
    as_moved_by,
    levels_at_once,
    sample_of,
    seen_later,
    seen_through,
    true_sample,
    turned_in_a_sample,
    turning,
)


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
    pulsation, _ = pulsations(loop.controller, dynamics, _groups(loop), lanes, None)
    terms = [coefficient.terms for coefficient in model.coefficients]
    start = _of_a_sample(loop, dynamics, theta, terms, pulsation * period, period, lanes)
    done = levels_at_once(lambda half, _: _doubled(half), start, doublings)
    whiten = basis.whitening(done.gram)
    seen = (multiplied(whiten, part.joined) for part in (done.seen_free, done.seen_turned))
    return TrueMaps(multiplied(whiten, done.gram[:, 0]), done.free, done.turned, *seen)


def ramp_of(
    loop: ClosedLoop, dynamics: Dynamics, theta: tuple[Scalar, ...], maps: Maps, period: Scalar,
    doublings: tuple[Array, int], lanes: Lanes,
) -> RateRamp:  # fmt: skip
    """What a slope of the true rate within a block adds to its `maps`: to first order, a second coefficient that moves
    the rate, about its value in the middle, at which `dynamics` are taken.
    """
    shares = zip(loop.device.coefficients(1.0), loop.device.model.coefficients, strict=True)
    rate = [(axis, signal, f * share) for share, c in shares if c.is_rate for axis, signal, f in c.terms]
    by = over_lanes([[0.0, 1.0], [0.0, 0.0]], lanes)
    start = _of_a_sample(loop, dynamics, theta, [rate], maps.angles, period, lanes)
    moved = as_moved_by(by, period)

    def with_ramp(turned: Array) -> Array:  # of a sample, before which the rate has moved
        return moved(jnp.zeros(()), jnp.concatenate([turned, jnp.zeros_like(turned)], axis=-3))

    start = start._replace(turned=with_ramp(start.turned), seen_turned=_each(with_ramp, start.seen_turned))
    done = levels_at_once(lambda half, passed: _doubled(half, partial(moved, passed)), start, doublings)
    middle = 0.5 * (2.0 ** doublings[0] + 1.0) * period
    about = lambda turned: turned[..., 1, :, :] - middle * turned[..., 0, :, :]  # noqa: E731
    return RateRamp(about(done.turned), about(multiplied(maps.whiten, done.seen_turned.joined)))


def _groups(loop: ClosedLoop) -> Any:
    return loop.blocks and loop.blocks.alike


def _of_a_sample(
    loop: ClosedLoop, dynamics: Dynamics, theta: tuple[Scalar, ...], terms: list, angles: Array, period: Scalar,
    lanes: Lanes,
) -> "_TrueDoubling":  # fmt: skip
    """What is to be doubled, of what has these `terms`."""
    observer: Any = loop.observer
    law = law_of(loop.controller, observer, theta, _groups(loop), period, lanes)
    tonal = pulsations(loop.controller, dynamics, _groups(loop), lanes, None)[1]
    estimated = jnp.concatenate([sample_of(observer, theta, law, period, lanes)[1], turning(tonal * period, lanes)])
    own, driven, pushed = true_sample(loop, dynamics, law, period, lanes)
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
    turned = turned_in_a_sample(sample.nodes, terms, acting, commanded, lanes)
    shows, turn, one = rows_of_readout(loop.readout, lanes), Turn(jnp.cos(angles), jnp.sin(angles)), basis.at(angles)
    return _TrueDoubling(
        turn, one[:, None] * one[None], own, whole, turned,
        Sums.first(turn, multiplied(shows, own)), Sums.first(turn, multiplied(shows, turned)),
    )  # fmt: skip


class _TrueDoubling(NamedTuple):
    """b_m, G_m, F, B and T of m samples, O and N."""

    turn: Turn
    gram: Array
    free: Array
    whole: Array
    turned: Array
    seen_free: Sums
    seen_turned: Sums


def _doubled(half: _TrueDoubling, moved: Callable[[Array], Array] = lambda later: later) -> _TrueDoubling:
    """Over 2m samples from over m; `moved` takes what hangs on coefficients to those of an earlier start."""
    turn, gram, free, whole, turned, seen, seen_turned = half
    return _TrueDoubling(
        turn.twice,
        basis.gram_twice(gram, turn),
        multiplied(free, free),
        multiplied(whole, whole),
        multiplied(free, turned) + moved(multiplied(turned, whole)),
        seen_later(turn, seen, seen_through(seen, free)),
        seen_later(turn, seen_turned, seen_through(seen, turned), _each(moved, seen_through(seen_turned, whole))),
    )


def _each(made: Callable[[Array], Array], sums: Sums) -> Sums:
    return Sums(*map(made, sums))
