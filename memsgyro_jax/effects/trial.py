"""Whether an effect keeps the port's promises: right shapes, exactly absent at strength zero, differentiable there."""

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from memsgyro_jax.base.own_code import amiss_in_arguments, traced
from memsgyro_jax.base.plainly import plainly
from memsgyro_jax.device.normalised import NormalisedDevice

from .base import (
    DriveEffect,
    Effect,
    ForceEffect,
    LockInEffect,
    LockInRow,
    Moment,
    ReadoutEffect,
    SurroundingsEffect,
    SweepEffect,
    UntilNow,
)


def at_strength(effect: Effect, strength: Array) -> Effect:
    """The same effect with another strength."""
    return eqx.tree_at(lambda e: e.strength, effect, strength)


def moments(effect: Effect, axes: int, count: int = 5) -> Moment:
    """Some unremarkable instants of a gyro of 20 kHz, stacked; the first one is at rest."""
    rng = np.random.default_rng(0)
    size = (count, axes)
    moving = np.arange(count) > 0

    def vector(scale: float, width: int = axes) -> Array:
        return jnp.asarray(scale * rng.standard_normal((count, width)) * moving[:, None])

    def scalar(scale: float) -> Array:
        return jnp.asarray(scale * rng.standard_normal(count) * moving)

    stiffness, damping = ([1.5e10, 1.6e10, 1e8], [20.0, 25.0, 1.0]) if axes == 2 else ([1.5e10], [20.0])
    device = NormalisedDevice(jnp.asarray(stiffness), jnp.asarray(damping), 5e6)
    push = vector(1e-8)
    return Moment(
        displacement=vector(1e-6),
        velocity=vector(0.1),
        command=push,
        force=push,
        own=vector(1e-6, effect.own_size),
        rate=scalar(1.0),
        angular_acceleration=scalar(10.0),
        rate_trusted=jnp.zeros(count),
        warming=scalar(10.0),
        bias_voltage=scalar(5.0),
        reference_bias=jnp.ones(count),
        time=jnp.linspace(0.0, 1.0, count),
        progress=jnp.linspace(0.0, 1.0, count),
        record=jnp.zeros(count),
        sweep=jnp.zeros(count),
        device=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *leaf.shape)), device),
        scale=jnp.full(size, 5e5),
        acceleration=vector(1e4),
        jerk=vector(1e9),
    )


class PortMethod(NamedTuple):
    """One method of a port: its value, an array of the shape it must have, and whether that array is also the value at
    strength zero.
    """

    method: str
    value: Callable[[Any, Moment], Array]
    like: Callable[[Moment], Array]
    exact: bool = True


def _read(now: Moment) -> tuple[Array, LockInRow]:
    """Phasors that a lock-in might make of a moment, and what it knows of the row."""
    values, force = now.scale * now.displacement * (1 + 0.5j), now.force + 0j
    decay = (0.5 + 1j) * jnp.eye(values.size)
    return values, LockInRow(
        jnp.asarray(1.0), force, 0.9j * values, now.record, now.sweep, now.time,
        dwell=jnp.asarray(1.0), decay=decay, left=jnp.exp(-0.5 - 1j) * jnp.eye(values.size),
        until_now=UntilNow.settled_at(values),
    )  # fmt: skip


def _parts(values: Any) -> Any:
    """Real and imaginary parts; what is no array stays as it is."""
    if isinstance(values, list | tuple):
        return values
    return jnp.stack([values.real, values.imag], axis=-1)


PORT_METHODS: dict[type[Effect], tuple[PortMethod, ...]] = {
    ForceEffect: (
        PortMethod("force", lambda e, now: e.force(now), lambda now: jnp.zeros_like(now.displacement)),
        PortMethod("own_rate", lambda e, now: e.own_rate(now), lambda now: now.own, exact=False),
    ),
    DriveEffect: (PortMethod("applied", lambda e, now: e.applied(now.force, now), lambda now: now.force),),
    ReadoutEffect: (
        PortMethod(
            "signal", lambda e, now: e.signal(now.scale * now.displacement, now), lambda n: n.scale * n.displacement
        ),
    ),
    SurroundingsEffect: (
        PortMethod("warmer", lambda e, now: e.warmer(now), lambda now: jnp.zeros_like(now.warming), exact=False),
        PortMethod("more_volts", lambda e, now: e.more_volts(now), lambda now: jnp.zeros_like(now.warming)),
    ),
    LockInEffect: (
        PortMethod("phasors", lambda e, now: _parts(e.phasors(*_read(now))), lambda now: _parts(_read(now)[0])),
    ),
    SweepEffect: (PortMethod("speed", lambda e, now: e.speed(), lambda now: jnp.zeros(())),),
}


def methods_of(effect: Effect) -> tuple[PortMethod, ...]:
    """The methods an effect answers for; none if it belongs to no port."""
    return tuple(part for port, found in PORT_METHODS.items() if isinstance(effect, port) for part in found)


def feels_warmth(effect: Effect) -> bool:
    """Whether anything of an effect changes with the temperature of the surroundings."""
    now = moments(effect, 2)
    for part in methods_of(effect):

        def value(warming: Array, part: PortMethod = part) -> Array:
            warmed = eqx.tree_at(lambda n: n.warming, now, warming)
            return jax.vmap(lambda n: jnp.asarray(part.value(effect, n)))(warmed)

        if bool(jnp.any(jax.jvp(value, (now.warming,), (jnp.ones_like(now.warming),))[1] != 0.0)):
            return True
    return False


def complaint(effect: Effect, axes: int) -> str:
    """What is wrong with an effect, as the rest of a sentence about it; empty if nothing is."""
    absent, now = at_strength(effect, jnp.zeros_like(effect.strength)), moments(effect, axes)
    return misshapen(effect, axes) or next(
        filter(None, (_complaint(part, absent, now) for part in methods_of(effect))), ""
    )


def misshapen(effect: Effect, axes: int) -> str:
    """The same of what its methods take, return and read alone, for which nothing is computed. What they raise passes,
    as what JAX raises where it cannot follow them.
    """
    now = moments(effect, axes, 1)
    found = (_misshapen(part, effect, now) for part in methods_of(effect))
    return next(chain(amiss_in_arguments(effect), filter(None, found), [""]))


def _misshapen(part: PortMethod, effect: Effect, now: Moment) -> str:
    # Everything under tracing, as fits do: a branch on a number shows here and not in the middle of a fit.
    first = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), now)
    wanted, given = jax.eval_shape(part.like, first).shape, type(None)

    def value(moment: Moment) -> Array:
        nonlocal given
        found = part.value(effect, moment)
        given = type(found)
        return jnp.asarray(found)

    shapes, far = traced(value, first)
    shape = shapes.shape
    if issubclass(given, list | tuple):
        return (
            f"method `{part.method}` must return an array of shape {wanted}, but returns a {given.__name__}; "
            "`jax.numpy.stack` makes an array of one"
        )
    if shape != wanted:
        return f"method `{part.method}` must return an array of shape {wanted}, but returns one of {shape}"
    axes = now.displacement.shape[-1]
    return f"method `{part.method}` {far}, on a device of {axes} {'axes' if axes > 1 else 'axis'}" if far else ""


def _complaint(part: PortMethod, absent: Effect, now: Moment) -> str:
    def value(strength: Array) -> Array:
        return jax.vmap(lambda n: jnp.asarray(part.value(at_strength(absent, strength), n)))(now)

    def everything(strength: Array) -> tuple[Array, ...]:
        # In reverse mode a branch that is not taken still counts: zero times infinity is no number.
        reverse = jax.grad(lambda s: jnp.sum(value(s)))(strength)
        return value(strength), jax.jacfwd(value)(strength), reverse, jax.vmap(part.like)(now)

    given, forward, reverse, like = map(np.asarray, plainly(everything)(absent.strength))
    if not np.all(np.isfinite(given)):
        return f"method `{part.method}` must be finite at strength zero, but is not"
    if part.exact and not np.all(given == like):
        return f"method `{part.method}` must do exactly nothing at strength zero, but does something"
    if not all(np.all(np.isfinite(slope)) for slope in (forward, reverse)):
        return f"method `{part.method}` must have a finite derivative by the strength at zero, but has none"
    return ""
