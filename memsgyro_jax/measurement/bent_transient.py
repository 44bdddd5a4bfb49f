"""How the motion of a nonlinear device goes on from row to row of a sweep that is read before it has settled."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from memsgyro_jax.base.linalg import exponential_and_means, inverse, product
from memsgyro_jax.effects.base import LockInRow

from .model import Conditions, Model
from .steady import Fineness, linear_response, nonlinear_spectrum


_TURN = 0.3  # rad by which what is nonlinear may turn a motion within a step: 5e-5 of it is then off at most
_DECAY = 1.0  # decay times of a step at most
_OVER = 16.0  # decay times after which a row has settled: a ten millionth is left
_MOST = 128  # steps of a row


class SlowMotion(eqx.Module):
    """A device under the drive of one row, which moves as Re[q(t)·e^{iωt}] with a slow q:
    2iω·q' + D·q' = F + N(q) − (K − ω² + iωD)·q, with N(q) the fundamental of what is nonlinear. Other harmonics follow
    at once; states of effects keep the fundamental to which they settle.

    But for q'', as `ring_down_matrix` is; `Driven`, which has it and all harmonics in time, takes ten times as many
    steps. Nayfeh and Mook, "Nonlinear Oscillations" (1979), section 2.3: averaging.

    Args:
        model: the device.
        omega: of the drive [rad/s].
        force: its complex amplitude per axis [N].
        conditions: of the row.
        settled: (h, n) Fourier coefficients of the settled state, from which other harmonics begin.
        linear: matrix and gain of the linear part of the model.
        push: (h, n, k) response of each harmonic to what is nonlinear.
        mobile: (2iω + D)⁻¹ [s].
        samples: of a period.
    """

    model: Model
    omega: Float[Array, ""]
    force: Complex[Array, " axes"]
    conditions: Conditions
    settled: Complex[Array, "h n"]
    linear: tuple[Array, Array]
    push: Complex[Array, "h n k"]
    mobile: Complex[Array, "axes axes"]
    samples: int = eqx.field(static=True)

    @classmethod
    def of(
        cls, model: Model, omega: Array, force: Array, conditions: Conditions, settled: Array, fineness: Fineness
    ) -> "SlowMotion":
        """Beside a settled state of the row."""
        linear, axes = model.linear(conditions), model.axes
        push = linear_response(model, omega, force, linear, fineness.harmonics)[1]
        push = push[:, :, np.asarray(model.nonlinear_rows)]
        damping = -linear[0][axes : 2 * axes, axes : 2 * axes]
        mobile = inverse(2j * omega * jnp.eye(axes) + damping)
        return cls(model, omega, force, conditions, settled, linear, push, mobile, fineness.samples)

    def left_out(self, motion: Complex[Array, " axes"]) -> tuple[Array, Array]:
        """Of a motion q [m], the state of its fundamental, and the acceleration N(q) [m/s²]."""
        axes, harmonics = self.model.axes, len(self.settled) - 1
        first = jnp.concatenate([motion, 1j * self.omega * motion, self.settled[1, 2 * axes :]])
        given = self.force, self.conditions, self.samples, harmonics

        def left(state: Array) -> Array:
            return nonlinear_spectrum(self.model, self.linear, state, *given)

        others = product(self.push, left(self.settled.at[1].set(first)))
        return first, left(others.at[1].set(first))[1, :axes]

    @property
    def generator(self) -> Complex[Array, "axes axes"]:
        """G of q' = G·q + p(q): how the device moves on by itself where it is linear [1/s]."""
        (matrix, _), axes = self.linear, self.model.axes
        rows = matrix[axes : 2 * axes]
        by_motion = rows[:, :axes] + 1j * self.omega * rows[:, axes : 2 * axes] + self.omega**2 * jnp.eye(axes)
        return self.mobile @ by_motion

    def pushed(self, motion: Complex[Array, " axes"]) -> Complex[Array, " axes"]:
        """p(q) [m/s]: what the drive, states of effects and what is nonlinear make of a motion q [m]."""
        (matrix, gain), axes = self.linear, self.model.axes
        first, left = self.left_out(motion)
        own = product(matrix[axes : 2 * axes, 2 * axes :], first[2 * axes :])
        return product(self.mobile, product(gain[axes : 2 * axes], self.force) + own + left)

    def steps(self, motions: Complex[Array, "m axes"], dwell: Array, most: int) -> Int[Array, ""]:
        """How many a dwell takes [s], of what is nonlinear at some motions, and at most."""
        bend = jnp.linalg.norm(jax.vmap(lambda q: product(self.mobile, self.left_out(q)[1]))(motions), axis=1)
        size = jnp.linalg.norm(motions, axis=1)
        turning = jnp.max(bend / jnp.where(size > 0, size, 1.0))
        many = dwell * (turning / _TURN + self.decay / _DECAY)
        return jnp.where(jnp.isfinite(many), jnp.clip(jnp.ceil(many), 1, most), 1).astype(int)

    @property
    def decay(self) -> Array:
        """The slowest rate of decay of the device as it is where it is linear [1/s]."""
        return jnp.min(jnp.abs(jnp.diag(self.model.device.damping_matrix))) / 2.0

    def after(
        self, start: Complex[Array, " axes"], dwell: Float[Array, ""], most: int = _MOST
    ) -> Complex[Array, " axes"]:
        """Where a motion has come after a dwell [s]: exact where the device is linear, and where it has settled."""
        count = self.steps(jnp.stack([start, self.settled[1, : self.model.axes]]), dwell, most)
        count = jax.lax.stop_gradient(count)
        stages = Stages.of(self.generator, dwell / count)
        return jax.lax.fori_loop(0, count, lambda _, at: stages.step(at, self.pushed), start)


class Stages(NamedTuple):
    """Exponential integration of q' = G·q + p(q) by ETDRK4 of Cox and Matthews, "Exponential time differencing for
    stiff systems", Journal of Computational Physics 176 (2002): to places one after the other, of which the last is
    the end of a step, from its start (4, axes, axes) and by p at those before [s] (4, 4, axes, axes).
    """

    free: Complex[Array, "4 axes axes"]
    gained: Complex[Array, "4 4 axes axes"]

    @classmethod
    def of(cls, generator: Complex[Array, "axes axes"], step: Float[Array, ""]) -> "Stages":
        """Of a step [s]."""
        whole, first, second, third = exponential_and_means(generator * step, 3)
        half, begun, *_ = exponential_and_means(0.5 * generator * step, 1)
        begun, none = 0.5 * begun, jnp.zeros_like(begun)
        end = [first - 3 * second + 4 * third, *[2 * second - 4 * third] * 2, 4 * third - second]
        gained = [[begun, *[none] * 3], [none, begun, none, none], [half @ begun - begun, none, 2 * begun, none], end]
        return cls(jnp.stack([half, half, whole, whole]), step * jnp.stack([jnp.stack(row) for row in gained]))

    def step(self, start: Array, pushed: Callable[[Array], Array]) -> Complex[Array, " axes"]:
        """Where a motion is a step later. A loop over the places: `pushed` is compiled once."""

        def stage(carry: tuple[Array, Array], given: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], None]:
            (at, told), (number, free, gained) = carry, given
            told = told.at[number].set(pushed(at))
            return (product(free, start) + jnp.sum(product(gained, told), axis=0), told), None

        begin = start, jnp.zeros((len(self.free), *start.shape), start.dtype)
        (end, _), _ = jax.lax.scan(stage, begin, (jnp.arange(len(self.free)), *self))
        return end


class Bent(NamedTuple):
    """Settled states (n, h, size) of rows of a device that is not linear, and how finely they are resolved."""

    states: Complex[Array, "n h size"]
    fineness: Fineness


class BentRow(eqx.Module):
    """What a lock-in sees of the motion of a row.

    Args:
        motion: of the device.
        shown: what is read of a small motion along each axis [V/m], but for what `gain` makes of it.
        gain: (axes, axes) of effects of the read-out.
    """

    motion: SlowMotion
    shown: Complex[Array, " axes"]
    gain: Float[Array, "axes axes"]

    @classmethod
    def of(
        cls, model: Model, row: LockInRow, conditions: Conditions, state: Array, fineness: Fineness, turned: Array
    ) -> "BentRow":
        """Beside a settled state, where the instrument makes `turned` of a volt of each channel."""
        shown = model.scale * (1j * row.frequency) ** model.order * model.behind(row.frequency, conditions)
        motion = SlowMotion.of(model, row.frequency, row.force, conditions, state, fineness)
        return cls(motion, turned * shown, model.gain(conditions))

    def course(self, away: Complex[Array, " axes"], dwell: Array, parts: int = 1) -> Complex[Array, "parts axes"]:
        """How far from its settled reading a row is at the ends of so many equal parts of its dwell [s], which began
        so far `away` from it [V]; zero where the dwell is zero or so long that it settled, or the motion goes beyond
        all bounds.
        """
        motion, settled = self.motion, self.motion.settled[1, : len(away)]
        lasting = (dwell > 0) & (dwell * motion.decay < _OVER)
        start = settled + jnp.where(lasting, product(inverse(self.gain), away / self.shown), 0.0)
        step = jnp.where(lasting, dwell, 0.0) / parts

        def part(at: Array, _: None) -> tuple[Array, Array]:
            end = motion.after(at, step, -(-_MOST // parts))
            return end, end

        _, ends = jax.lax.scan(part, start, None, length=parts)
        return jnp.where(lasting & jnp.isfinite(ends), self.shown * product(self.gain, ends - settled), 0.0)
