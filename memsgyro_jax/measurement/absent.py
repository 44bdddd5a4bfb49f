"""What effects that a model lacks add per unit of strength to its accelerations and voltages, moment by moment.

Forces on the mass ask for the moment alone, which the model makes: one program tells them for all models of a case.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.affine import is_constant
from memsgyro_jax.base.kept import kept
from memsgyro_jax.base.plainly import PLAINLY
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import (
    DriveEffect,
    Effect,
    ForceEffect,
    LockInEffect,
    Moment,
    ReadoutEffect,
    SurroundingsEffect,
    SweepEffect,
)
from memsgyro_jax.effects.evaluation import Acting

from .model import Model


_seldom = partial(kept, options=PLAINLY)
NODES = 16  # conditions of the linear part at a time


class Absent(eqx.Module):
    """Effects of strength zero beside a model, each with the number of the model's own effects that stand before it."""

    effects: tuple[Effect, ...]
    places: tuple[int, ...] = eqx.field(static=True)

    @property
    def sizes(self) -> tuple[int, ...]:
        """How many numbers each strength has."""
        return tuple(int(np.size(effect.strength)) for effect in self.effects)

    def of(self, kind: type[Effect]) -> "tuple[Absent, np.ndarray]":
        """Those of one kind, and which of all strengths are theirs."""
        mine = [isinstance(effect, kind) for effect in self.effects]
        pairs = [pair for pair, chosen in zip(zip(self.effects, self.places, strict=True), mine, strict=True) if chosen]
        effects, places = zip(*pairs, strict=True) if pairs else ((), ())
        return Absent(effects, places), np.flatnonzero(np.repeat(mine, self.sizes))


def of_first_order(model: Model, effect: Effect) -> bool:
    """Whether the response to an absent effect is that of the model to its force, voltage or sweep rate alone."""
    if isinstance(effect, SweepEffect):
        return True
    own = sum(getattr(one, "own_size", 0) for one in model.effects)
    if getattr(effect, "own_size", 0) or isinstance(effect, (SurroundingsEffect, LockInEffect)):
        return False
    if isinstance(effect, ReadoutEffect):
        return not effect.sharp
    return isinstance(effect, ForceEffect) or (isinstance(effect, DriveEffect) and not own)


def _with(model: Model, effect: Effect, place: int, strength: Array) -> Model:
    """The model with an effect of some strength at its place."""
    own = model.effects
    return model.with_only((*own[:place], eqx.tree_at(lambda e: e.strength, effect, strength), *own[place:]))


def _each(function, strength: Array) -> Array:
    """(k, axes) derivative by each number of a strength, at zero."""
    slopes = jax.jacfwd(function)(jnp.zeros_like(strength))
    return jnp.moveaxis(slopes.reshape(slopes.shape[0], -1), 0, 1)


# Several programs hold these: under `jit` what every effect does is traced once for all of them.


@eqx.filter_jit
def _accelerations(effects: tuple[ForceEffect, ...], now: Moment) -> Float[Array, "K axes"]:
    """What the strengths of all forces add per unit."""

    def added(strength: Array, effect: ForceEffect) -> Array:
        force = eqx.tree_at(lambda e: e.strength, effect, strength).force(now)
        return now.device.mobility * force

    return jnp.concatenate([_each(partial(added, effect=effect), effect.strength) for effect in effects])


@eqx.filter_jit
def _driven(model: Model, drives: Absent, state: Array, command: Array, now: Conditions) -> Float[Array, "K axes"]:
    """What the strengths of effects on the electrodes' force add per unit, through all that sees that force."""
    moment = model.at_moment(state, command, now)
    parts = []
    for effect, place in zip(drives.effects, drives.places, strict=True):

        def applied(strength: Array, effect=effect, place=place) -> Array:
            return Acting.of(_with(model, effect, place, strength).effects).driven(moment).force

        parts.append(_each(applied, effect.strength))

    def accelerated(force: Array) -> Array:
        return model.pushed(eqx.tree_at(lambda m: m.force, moment, force), state[2 * model.axes :])[0]

    return jax.vmap(lambda way: jax.jvp(accelerated, (moment.force,), (way,))[1])(jnp.concatenate(parts))


@eqx.filter_jit
def _voltages(model: Model, absent: Absent, state: Array, command: Array, turn: Array, now: Conditions) -> Array:
    """(K, axes) what all strengths add to the voltages per unit, the state being what it is."""
    moment = model.at_reading(state, command, turn, now)
    volts = model.scale * moment.seen + model.offset
    looks_back = model.order == 2 or _looks_back(model, volts, moment)
    parts = []
    for effect, place in zip(absent.effects, absent.places, strict=True):
        if isinstance(effect, ReadoutEffect):

            def added(strength: Array, effect=effect, place=place) -> Array:
                return Acting.of(_with(model, effect, place, strength).effects).signal(volts, moment)

        elif looks_back and isinstance(effect, (ForceEffect, DriveEffect)):

            def added(strength: Array, effect=effect, place=place) -> Array:
                return _with(model, effect, place, strength).observe(state, command, turn, now)

        else:
            parts.append(jnp.zeros((int(effect.strength.size), model.axes)))
            continue
        parts.append(_each(added, effect.strength))
    return jnp.concatenate(parts)


@_seldom
def _moments(model: Model, state: Array, command: Array, now: Conditions) -> Moment:
    return jax.vmap(model.at_moment)(state, command, now)


@_seldom
def _of_forces(effects: tuple[ForceEffect, ...], moments: Moment) -> Float[Array, "N K axes"]:
    return jax.vmap(lambda now: _accelerations(effects, now))(moments)


@_seldom
def _of_drives(model: Model, drives: Absent, state: Array, command: Array, now: Conditions) -> Array:
    return jax.vmap(lambda s, u, c: _driven(model, drives, s, u, c))(state, command, now)


@_seldom
def seen(model: Model, absent: Absent, state: Array, command: Array, turn: Array, now: Conditions) -> Array:
    """(N, K, axes) what all strengths add to the voltages per unit, at N moments."""
    return jax.vmap(lambda s, u, du, c: _voltages(model, absent, s, u, du, c))(state, command, turn, now)


def forced(
    model: Model, absent: Absent, state: Array, command: Array, now: Conditions
) -> Float[np.ndarray, "N K axes"]:
    """What all strengths add to the accelerations per unit, at N moments."""
    out = np.zeros((len(state), sum(absent.sizes), model.axes))
    (forces, of_forces), (drives, of_drives) = absent.of(ForceEffect), absent.of(DriveEffect)
    if of_forces.size:
        out[:, of_forces] = _of_forces(forces.effects, _moments(model, state, command, now))
    if of_drives.size:
        out[:, of_drives] = _of_drives(model, drives, state, command, now)
    return out


@_seldom
def _moments_about_rest(model: Model, base: Conditions) -> tuple[Moment, Moment]:
    """Moments at rest at each of several conditions (r, ...), and how they move with each entry of state and command
    (r, n + axes, ...).
    """
    rest = jnp.zeros(model.size + model.axes)

    def at(now: Conditions) -> tuple[Moment, Moment]:
        moment = lambda both: model.at_moment(both[: model.size], both[model.size :], now)  # noqa: E731
        along = jax.vmap(lambda way: jax.jvp(moment, (rest,), (way,)), out_axes=(None, 0))
        return along(jnp.eye(rest.size))

    return jax.vmap(at)(base)


@_seldom
def _forces_about_rest(effects: tuple[ForceEffect, ...], still: Moment, moving: Moment) -> Array:
    """(r, n + axes, K, axes)."""

    def at(still: Moment, moving: Moment) -> Array:
        return jax.vmap(lambda way: jax.jvp(partial(_accelerations, effects), (still,), (way,))[1])(moving)

    return jax.vmap(at)(still, moving)


@_seldom
def _drives_about_rest(model: Model, drives: Absent, base: Conditions) -> Array:
    """(r, n + axes, K, axes)."""

    def at(now: Conditions) -> Array:
        both = lambda x: _driven(model, drives, x[: model.size], x[model.size :], now)  # noqa: E731
        return jnp.moveaxis(jax.jacfwd(both)(jnp.zeros(model.size + model.axes)), -1, 0)

    return jax.vmap(at)(base)


def _about_rest(model: Model, absent: Absent, base: Conditions) -> Float[np.ndarray, "r m K axes"]:
    """How what all strengths add to the accelerations per unit moves with each entry of state and command."""
    out = np.zeros((len(base.rate), model.size + model.axes, sum(absent.sizes), model.axes))
    (forces, of_forces), (drives, of_drives) = absent.of(ForceEffect), absent.of(DriveEffect)
    if of_forces.size:
        out[:, :, of_forces] = _forces_about_rest(forces.effects, *_moments_about_rest(model, base))
    if of_drives.size:
        out[:, :, of_drives] = _drives_about_rest(model, drives, base)
    return out


def added_to_linear(model: Model, absent: Absent, base: Conditions) -> tuple[np.ndarray, np.ndarray]:
    """(K, n, n) and (K, n, axes), or (K, r, ...) at each of several conditions; `NODES` at a time, whatever r is, so
    that experiments share a program.
    """
    several = np.ndim(base.rate) > 0
    every = jax.tree.map(lambda leaf: np.asarray(leaf) if several else np.asarray(leaf)[None], base)
    count, parts = len(every.rate), []
    for begin in range(0, count, NODES):
        chosen = np.minimum(np.arange(begin, begin + NODES), count - 1)
        parts.append(_about_rest(model, absent, jax.tree.map(lambda leaf: leaf[chosen], every)))  # noqa: B023
    moved = np.moveaxis(np.concatenate(parts)[:count], (1, 2), (3, 0))  # (K, r, axes, n + axes)
    whole = np.zeros((*moved.shape[:2], model.size, moved.shape[3]))
    whole[:, :, model.axes : 2 * model.axes] = moved
    matrix, load = whole[..., : model.size], whole[..., model.size :]
    return (matrix, load) if several else (matrix[:, 0], load[:, 0])


def _looks_back(model: Model, volts: Array, moment: Moment) -> bool:
    """Whether the read-out shows more of the motion than what it sees of it: acceleration or jerk."""

    def signal(acceleration: Array, jerk: Array) -> Array:
        seen = eqx.tree_at(lambda m: (m.acceleration, m.jerk), moment, (acceleration, jerk))
        return Acting.of(model.effects).signal(volts, seen)

    return not is_constant(signal, moment.acceleration, moment.jerk)
