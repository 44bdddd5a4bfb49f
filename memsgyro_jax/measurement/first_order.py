"""What effects that a model lacks would do to a prediction, to first order, without carrying them through it.

A prediction tells the moments at which it asks its model: those at which forces act and those that are read. There the
derivative of an absent effect by its strength is an acceleration or a voltage, the force of the effect alone; what it
does to the prediction is then the linear response of the *present* model to those. Exact at strength zero.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import (
    DriveEffect,
    Effect,
    ForceEffect,
    LockInEffect,
    ReadoutEffect,
    SurroundingsEffect,
    SweepEffect,
)
from memsgyro_jax.effects.evaluation import Acting

from .model import Model
from .steady import drive_waveform, waveform


class Asked(eqx.Module):
    """Moments at which a prediction asks its model, `r` rows of `m` each.

    Args:
        state, command, turn: (r, m, n), (r, m, axes), (r, m, axes): of the device, the command [N] and its rate [N/s].
        conditions: with a row each.
        harmonics: of the Fourier series that stands for the m samples; `None` where one sample stands for itself.
    """

    state: Array
    command: Array
    turn: Array
    conditions: Conditions
    harmonics: int | None = eqx.field(static=True, default=None)

    @classmethod
    def over_periods(
        cls, states: Array, force: Array, frequency: Array, conditions: Conditions, samples: int, harmonics: int
    ) -> "Asked":
        """So many samples of a period of vibrations (r, h, n) under drives (r, axes) [N], each at its frequency; force
        and frequency may hold for all rows.
        """
        rows = states.shape[0]
        force, frequency = jnp.broadcast_to(force, (rows, force.shape[-1])), jnp.broadcast_to(frequency, (rows,))
        command, turn = jax.vmap(lambda one: drive_waveform(one, samples))(force)
        waves = jax.vmap(lambda one: waveform(one, samples))(states)
        return cls(waves, command, frequency[:, None, None] * turn, conditions, harmonics)


class Inquiry(eqx.Module):
    """All that a prediction asks of its model.

    Args:
        forced: where forces act, group by group.
        seen: where channels are read.
        base: conditions at which its linear part is propagated; `None` where it is not propagated.
    """

    forced: tuple[Asked, ...]
    seen: Asked
    base: Conditions | None


class Contribution(eqx.Module):
    """What is added to a prediction on its way.

    Args:
        forced: per group of its inquiry accelerations (r, axes), or their Fourier coefficients (r, h + 1, axes).
        seen: voltages (r, axes), or their phasors.
        linear: to the matrix (n, n) and gain (n, axes) that are propagated.
        speed: of a sweep [rad/s²].
    """

    forced: tuple[Array, ...]
    seen: Array
    linear: tuple[Array, Array]
    speed: Array

    def beside(self, linear: tuple[Array, Array]) -> tuple[Array, Array]:
        """The linear part of a model with what is added to it."""
        return linear[0] + self.linear[0], linear[1] + self.linear[1]


class Absent(eqx.Module):
    """Effects of strength zero beside a model, each with the number of the model's own effects that stand before it."""

    effects: tuple[Effect, ...]
    places: tuple[int, ...] = eqx.field(static=True)

    @property
    def sizes(self) -> tuple[int, ...]:
        """How many numbers each strength has."""
        return tuple(int(np.size(effect.strength)) for effect in self.effects)


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


def _accelerations(model: Model, absent: Absent, state: Array, command: Array, now: Conditions) -> Array:
    """(K, axes) what all strengths add to the acceleration per unit."""
    axes = model.axes
    moment = model.at_moment(state, command, now)
    parts = []
    for effect, place in zip(absent.effects, absent.places, strict=True):
        if isinstance(effect, ForceEffect):

            def added(strength: Array, effect=effect) -> Array:
                return model.device.mobility * eqx.tree_at(lambda e: e.strength, effect, strength).force(moment)

        elif isinstance(effect, DriveEffect):

            def added(strength: Array, effect=effect, place=place) -> Array:
                return _with(model, effect, place, strength).derivative(state, command, now)[axes : 2 * axes]

        else:
            parts.append(jnp.zeros((int(effect.strength.size), axes)))
            continue
        parts.append(_each(added, effect.strength))
    return jnp.concatenate(parts)


def _voltages(model: Model, absent: Absent, state: Array, command: Array, turn: Array, now: Conditions) -> Array:
    """(K, axes) what all strengths add to the voltages per unit, the state being what it is."""
    moment = model.at_reading(state, command, turn, now)
    volts = model.scale * moment.seen + model.offset
    looks_back = model.order == 2 or any(isinstance(effect, ReadoutEffect) for effect in model.effects)
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


@eqx.filter_jit
def _pushed(model: Model, absent: Absent, state: Array, command: Array, now: Conditions) -> Float[Array, "N K axes"]:
    return jax.vmap(lambda s, u, c: _accelerations(model, absent, s, u, c))(state, command, now)


@eqx.filter_jit
def _read(model: Model, absent: Absent, state: Array, command: Array, turn: Array, now: Conditions) -> Array:
    return jax.vmap(lambda s, u, du, c: _voltages(model, absent, s, u, du, c))(state, command, turn, now)


@eqx.filter_jit
def _propagated(model: Model, absent: Absent, base: Conditions) -> tuple[Array, Array]:
    """(K, n, n) and (K, n, axes): what is added to the linear part."""
    axes, rest, still = model.axes, jnp.zeros(model.size), jnp.zeros(model.axes)
    parts = jax.jacfwd(lambda s, u: _accelerations(model, absent, s, u, base), argnums=(0, 1))(rest, still)
    around = (0, 0), (axes, model.size - 2 * axes), (0, 0)
    return jnp.pad(parts[0], around), jnp.pad(parts[1], around)


@eqx.filter_jit
def _speeds(absent: Absent) -> Array:
    """(K,) what all strengths add to the rate of a sweep per unit."""
    parts = []
    for effect in absent.effects:
        speed = jax.jacfwd(lambda s, e=effect: eqx.tree_at(lambda e: e.strength, e, s).speed()) if isinstance(
            effect, SweepEffect) else jnp.zeros_like  # fmt: skip
        parts.append(jnp.ravel(speed(jnp.zeros_like(effect.strength))))
    return jnp.concatenate(parts)


CHUNK = 6144  # moments at a time: whole rows of 12, 32 and 128, and small enough to stay near the processor


def contributions(model: Model, absent: Absent, inquiry: Inquiry) -> Contribution:
    """What all strengths of absent effects add to a prediction per unit, side by side along a leading axis K."""
    matrix, gain = np.zeros((model.size, model.size)), np.zeros((model.size, model.axes))
    total = sum(absent.sizes)
    linear = tuple(np.zeros((total, *part.shape)) for part in (matrix, gain))
    if inquiry.base is not None:
        linear = _propagated(model, absent, inquiry.base)
    forced = tuple(
        _summed(group, lambda s, u, _, c: _pushed(model, absent, s, u, c)) for group in inquiry.forced
    )  # fmt: skip
    seen = _summed(inquiry.seen, lambda *moments: _read(model, absent, *moments))
    if inquiry.seen.harmonics is not None:
        seen = seen[:, :, 1]
    return Contribution(forced, seen, linear, _speeds(absent))


def _summed(asked: Asked, function) -> np.ndarray:
    """(K, r, axes) or (K, r, h + 1, axes): what a function of moments is in each row, chunk by chunk."""
    rows, samples = asked.state.shape[:2]
    size = max(1, CHUNK // samples)
    parts = []
    for begin in range(0, rows, size):
        chosen = np.minimum(np.arange(begin, begin + size), rows - 1)
        flat = lambda leaf: np.asarray(leaf)[chosen].reshape(size * samples, -1)  # noqa: E731, B023
        now = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[chosen], samples), asked.conditions)  # noqa: B023
        values = np.asarray(function(flat(asked.state), flat(asked.command), flat(asked.turn), now))
        values = values.reshape(size, samples, *values.shape[1:])[: rows - begin]
        parts.append(values[:, 0] if asked.harmonics is None else _series(values, asked.harmonics))
    return np.moveaxis(np.concatenate(parts), -2, 0)


def _series(samples: np.ndarray, harmonics: int) -> np.ndarray:
    """(r, h + 1, K, axes) Fourier coefficients of samples (r, m, K, axes), as `steady.spectrum` gives them."""
    count, order = samples.shape[1], np.arange(harmonics + 1)
    weight = np.where(order == 0, 1.0, 2.0)[:, None] / count
    kernel = weight * np.exp(-2j * np.pi * np.outer(order, np.arange(count)) / count)
    return np.tensordot(kernel, samples, axes=(1, 1)).swapaxes(0, 1)
