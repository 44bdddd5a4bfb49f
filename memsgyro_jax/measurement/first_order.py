"""What effects that a model lacks would do to a prediction, to first order, without carrying them through it.

A prediction tells the moments at which it asks its model: those at which forces act and those that are read. There the
derivative of an absent effect by its strength is an acceleration or a voltage, the force of the effect alone; what it
does to the prediction is then the linear response of the *present* model to those. Exact at strength zero.
"""

import abc
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import SweepEffect

from .absent import Absent, added_to_linear, forced, seen
from .model import Model
from .steady import drive_waveform, phases, waveform


CHUNK = 6144  # moments at a time: whole rows of 12, 32 and 128, and small enough to stay near the processor


class AskedRows(eqx.Module):
    """Moments at which a prediction asks its model, row by row."""

    conditions: eqx.AbstractVar[Conditions]
    samples: eqx.AbstractVar[int]

    @abc.abstractmethod
    def of(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """State (r, m, n), command (r, m, axes) [N] and its rate (r, m, axes) [N/s] of some rows, `samples` of each."""

    @abc.abstractmethod
    def summed(self, values: np.ndarray) -> np.ndarray:
        """What stands for samples (r, m, K, axes) in a prediction."""

    def reader(self, model: Model) -> Model:
        """The model whose read-out is asked; by default the whole."""
        return model


class Instants(AskedRows):
    """One moment per row: state (r, n), command and its rate (r, axes)."""

    state: Array
    command: Array
    turn: Array
    conditions: Conditions
    samples: int = eqx.field(static=True, default=1)

    def of(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        state, command, turn = (np.asarray(part)[rows][:, None] for part in (self.state, self.command, self.turn))
        return state, command, turn

    def summed(self, values: np.ndarray) -> np.ndarray:
        return values[:, 0]


class Periods(AskedRows):
    """Vibrations (r, h, n), as they are seen, under drives (r, axes) [N] at their frequencies (r,), drive and frequency
    one for each row or one for all; `samples` of a period, which `harmonics` stand for in the prediction.
    """

    state: Array
    force: Array
    frequency: Array
    conditions: Conditions
    samples: int = eqx.field(static=True)
    harmonics: int = eqx.field(static=True)

    def of(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        state = waveform(np.asarray(self.state)[rows], self.samples)
        force, frequency = (
            np.broadcast_to(part, (len(self.state), *part.shape[1:]))[rows]
            for part in (np.asarray(self.force), np.asarray(self.frequency))
        )
        command, turn = drive_waveform(force[:, None], self.samples)
        return state, command, frequency[:, None, None] * turn

    def summed(self, values: np.ndarray) -> np.ndarray:
        order = np.arange(self.harmonics + 1)
        weight = np.where(order == 0, 1.0, 2.0)[:, None] / self.samples
        kernel = weight * np.exp(-1j * np.outer(order, phases(self.samples)))
        return np.tensordot(kernel, values, axes=(1, 1)).swapaxes(0, 1)

    def reader(self, model: Model) -> Model:
        return model.prompt


class Inquiry(eqx.Module):
    """All that a prediction asks of its model.

    Args:
        forced: where forces act, group by group.
        read: where channels are read.
        base: conditions at which its linear part is propagated, one or several; `None` where it is not propagated.
        swept: whether the rate of a sweep acts.
    """

    forced: tuple[AskedRows, ...]
    read: AskedRows
    base: Conditions | None
    swept: bool = eqx.field(static=True, default=False)


class Contribution(eqx.Module):
    """What is added to a prediction on its way.

    Args:
        forced: accelerations (r, axes) of each group of its inquiry, or their Fourier coefficients (r, h + 1, axes).
        seen: voltages (r, axes), or their phasors.
        linear: to the matrix (n, n) and gain (n, axes) that are propagated, at one condition or at each of several.
        speed: of a sweep [rad/s²].
    """

    forced: tuple[Array, ...]
    seen: Array
    linear: tuple[Array, Array]
    speed: Array

    @classmethod
    def none(
        cls, model: Model, forced: Sequence[tuple[int, ...]], seen: tuple[int, ...], kind: type,
        several: tuple[int, ...] = (),
    ) -> "Contribution":  # fmt: skip
        """Zeros of these shapes, real or complex, with a linear part at one condition or at `several`, (r,)."""
        linear = (*several, model.size, model.size), (*several, model.size, model.axes)
        parts = np.zeros(linear[0]), np.zeros(linear[1])
        return cls(tuple(np.zeros(shape, kind) for shape in forced), np.zeros(seen, kind), parts, np.zeros(()))

    def beside(self, linear: tuple[Array, Array]) -> tuple[Array, Array]:
        """The linear part of a model with what is added to it."""
        return linear[0] + self.linear[0], linear[1] + self.linear[1]


def _speeds(absent: Absent) -> np.ndarray:
    """(K,) what all strengths add to the rate of a sweep per unit."""
    parts = []
    for effect in absent.effects:
        still = np.zeros(np.shape(effect.strength))
        if isinstance(effect, SweepEffect):
            still = jax.jacfwd(lambda s, e=effect: eqx.tree_at(lambda e: e.strength, e, s).speed())(jnp.asarray(still))
        parts.append(np.ravel(still))
    return np.concatenate(parts)


def contributions(model: Model, absent: Absent, inquiry: Inquiry) -> Contribution:
    """What all strengths of absent effects add to a prediction per unit, side by side along a leading axis K."""
    total, size = sum(absent.sizes), model.size
    linear = np.zeros((total, size, size)), np.zeros((total, size, model.axes))
    if inquiry.base is not None:
        linear = added_to_linear(model, absent, inquiry.base)
    pushes = tuple(_told(group, lambda s, u, _, c: forced(model, absent, s, u, c)) for group in inquiry.forced)
    reader = inquiry.read.reader(model)
    shown = _told(inquiry.read, lambda *moments: seen(reader, absent, *moments))
    speeds = _speeds(absent) if inquiry.swept else np.zeros(total)
    return Contribution(pushes, shown if shown.ndim < 4 else shown[:, :, 1], linear, speeds)


def _told(moments: AskedRows, function) -> np.ndarray:
    """(K, r, ...) what a function of moments makes of each row, chunk by chunk."""
    rows, samples = moments.conditions.rate.shape[0], moments.samples
    size, parts = max(1, CHUNK // samples), []
    around = jax.tree.map(np.asarray, moments.conditions)
    for begin in range(0, rows, size):
        chosen = np.minimum(np.arange(begin, begin + size), rows - 1)
        flat = (part.reshape(size * samples, -1) for part in moments.of(chosen))
        now = jax.tree.map(lambda leaf: np.repeat(leaf[chosen], samples), around)  # noqa: B023
        values = np.asarray(function(*flat, now))
        parts.append(moments.summed(values.reshape(size, samples, *values.shape[1:])[: rows - begin]))
    return np.moveaxis(np.concatenate(parts), -2, 0)
