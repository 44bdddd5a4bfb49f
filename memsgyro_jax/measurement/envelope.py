"""Motion in time by an exponential integrator: the linear part exactly, what it leaves out to second order in the step.

The state may carry harmonics of a drive, s(t) = S₀(t) + Re Σ S_h(t) e^{ihωt}, with slowly varying S_h: one step then
spans whole drive cycles and no waveform is sampled in time. Without a drive (harmonic 0 alone) it is the ordinary state
under held forces. The scheme is ETD2RK of Cox and Matthews, "Exponential time differencing for stiff systems", J.
Comput. Phys. 176 (2002), equation (22).
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.linalg import among, at_place, exponential_and_means, product

from .block_mean import BlockMean
from .model import Conditions, Model
from .steady import Remainder, nonlinear_spectrum


HARMONICS = 2  # a step in time carries no more: the third is a millionth of the first, and feeds back as its square
LONGEST = 2**20  # steps of a record, whose states a fit keeps for every direction (4 GB): no finer ones beyond
FINEST = 8  # parts at most that a step through a record is divided into, where what is left out needs it
SAMPLES = 12  # per cycle: exact for powers up to the third


class Propagator(eqx.Module):
    """e^{LΔ}, Δφ₁(LΔ), Δφ₂(LΔ) of one step Δ, one matrix per harmonic or a single real one."""

    exponential: Array
    first: Array
    second: Array

    @classmethod
    def of(cls, matrix: Array, step: Array, units: Float[Array, " n"]) -> "Propagator":
        """For s' = L·s + (what is left): L (..., n, n), the step [s] and typical sizes of the state's entries, which
        only keep the arithmetic well scaled.
        """
        balance = units / units[:, None]

        def single(m: Array) -> tuple[Array, Array, Array]:
            power, first, second = exponential_and_means(m * balance * step)
            return power / balance, step * first / balance, step * second / balance

        for _ in range(matrix.ndim - 2):
            single = jax.vmap(single)
        return cls(*single(matrix))

    def advance(self, state: Array, load: Array, rest, added=(0.0, 0.0)) -> tuple[Array, Array, Array]:
        """One step under a constant `load`: its end, and `rest(state)`, what the linear part leaves out, with what is
        `added` to it, at both ends.
        """
        here = rest(state) + added[0]
        predicted = product(self.exponential, state) + product(self.first, load + here)
        there = rest(predicted) + added[1]
        return predicted + product(self.second, there - here), here, there


def state_units(model: Model) -> Float[Array, " n"]:
    """Typical sizes of the state's entries next to each other: velocities are ω times displacements."""
    omega = jnp.sqrt(jax.lax.stop_gradient(jnp.max(model.device.stiffness)))
    return jnp.ones(model.size).at[model.axes : 2 * model.axes].set(omega)


class Course(eqx.Module):
    """Steps of a run, (t, h, n) each: the state at their start and end, and what the linear part leaves out there."""

    start: Array
    end: Array
    here: Array
    there: Array

    @classmethod
    def of(cls, start: Array, last: Array, passed: Complex[Array, "t 3 h n"]) -> "tuple[Array, Course]":
        """The last state and the course, of what every step from `start` gave."""
        end, here, there = jnp.moveaxis(passed, 1, 0)
        return last, cls(jnp.concatenate([start[None], end[:-1]]), end, here, there)


class Driven(eqx.Module):
    """The model under a drive Re[F e^{iωt}], its state as slowly varying harmonics (HARMONICS + 1, n).

    The linear part is taken at the conditions `base`; what later conditions change is part of what is left out, and so
    exact to second order in the step (a rate that changes: see `OnTable`). `samples` are those of a cycle.
    """

    model: Model
    omega: Array
    force: Array
    linear: tuple[Array, Array]
    samples: int = eqx.field(static=True, default=SAMPLES)

    @classmethod
    def of(cls, model: Model, omega: Array, force: Array, base: Conditions, samples: int = SAMPLES) -> "Driven":
        """At a drive frequency [rad/s] and complex force [N] per axis."""
        return cls(model, omega, force + 0j, model.linear(base), samples)

    @property
    def operator(self) -> Complex[Array, "h n n"]:
        """L_h = A − ihω."""
        turning = 1j * jnp.arange(HARMONICS + 1)[:, None, None] * self.omega
        return self.linear[0] - turning * jnp.eye(self.model.size)

    @property
    def load(self) -> Complex[Array, "h n"]:
        """The drive, in harmonic 1."""
        return at_place(self.linear[1] @ self.force, 1, HARMONICS + 1)

    def propagator(self, step: Array) -> Propagator:
        """Of one step [s]."""
        return Propagator.of(self.operator, step, state_units(self.model))

    def around(self, conditions: Conditions) -> Conditions | Remainder:
        """What `rest` asks for at some conditions, made once for all of its states where the model is affine."""
        if not self.model.is_linear:
            return conditions
        return Remainder.of(self.model, self.linear, conditions, self.force)

    def rest(self, state: Complex[Array, "h n"], now: Conditions | Remainder) -> Complex[Array, "h n"]:
        """What the linear part leaves out, `now` being what is `around`."""
        if isinstance(now, Remainder):
            return now.spectrum(state)
        left = nonlinear_spectrum(
            self.model, self.linear, state, self.force, now, samples=self.samples, harmonics=HARMONICS
        )
        return among(left, self.model.nonlinear_rows, self.model.size)

    def at_rest(self) -> Complex[Array, "h n"]:
        """No motion."""
        return jnp.zeros((HARMONICS + 1, self.model.size), complex)

    def run(
        self,
        start: Complex[Array, "h n"],
        step: Array,
        conditions: Conditions,
        added: Complex[Array, "t 2 h axes"] | None = None,
    ) -> "tuple[Array, Course]":
        """Through as many steps of `step` seconds as `conditions` has rows: the last state, and what happened on the
        way. `added` are accelerations that the model lacks, at both ends of each step.
        """
        passing = lambda start, *passed: jnp.stack(passed)  # noqa: E731
        # One result per step: with several, XLA's fusion copies all of the steps before at every step.
        return Course.of(start, *self._through(start, step, conditions, added, passing))

    def demodulated(
        self,
        start: Complex[Array, "h n"],
        step: Array,
        conditions: Conditions,
        added: Complex[Array, "t 2 h axes"] | None = None,
        boxcar: bool = True,
    ) -> tuple[Complex[Array, "t h n"], Complex[Array, "t h n"]]:
        """What a lock-in makes of each step of the same run (`BlockMean`), and, without derivatives, where it began.

        A block is demodulated on the way: the states of all, along each direction, would be written and read again.
        """
        mean = self.lock_in(step, boxcar)
        told = lambda start, end, *left: with_end(mean.over(start, end, *left), end)  # noqa: E731
        return means_and_begins(start, self._through(start, step, conditions, added, told)[1])

    def lock_in(self, step: Array, boxcar: bool) -> BlockMean:
        """Over each step [s]."""
        return BlockMean.of(self.operator, self.load, self.omega, step, boxcar)

    def _through(
        self, start: Array, step: Array, conditions: Conditions, added: Array | None, told: Callable[..., Any]
    ) -> tuple[Array, Any]:
        """The last state, and what is `told` of the start and end of each step and of what the linear part leaves out
        there.
        """
        propagate, load = self.propagator(step), self.load

        def advance(state: Array, inputs: tuple[Conditions | Remainder, Array | None]) -> tuple[Array, Any]:
            now, more = inputs
            extra = (0.0, 0.0) if more is None else among_velocities(more, self.model.size)
            end, here, there = propagate.advance(state, load, lambda s: self.rest(s, now), extra)
            return end, told(state, end, here, there)

        return jax.lax.scan(advance, start, (jax.vmap(self.around)(conditions), added))

    def visited(self, start: Complex[Array, "t h n"], step: Array, conditions: Conditions) -> Complex[Array, "t 2 h n"]:
        """The states at which steps from `start` ask what the linear part leaves out: there, and where each is
        predicted to end.
        """
        here = jax.vmap(lambda state, now: self.rest(state, self.around(now)))(start, conditions)
        return steps_from(self.propagator(step), start, self.load + here)

    def run_legs(
        self, start: Complex[Array, "h n"], legs: Sequence[tuple[Array, Array, int]], conditions: Conditions
    ) -> Complex[Array, "t h n"]:
        """The state at the end of every step through legs that follow each other, each a force per axis, a step [s] and
        how many of them, all under the same conditions.
        """
        forces, steps, counts = zip(*legs, strict=True)
        pushed = lambda force: eqx.tree_at(lambda driven: driven.force, self, force)  # noqa: E731
        pushes = jnp.stack(forces) + 0j
        of_legs = jax.vmap(self.propagator)(jnp.stack(steps)), pushes
        left = jax.vmap(lambda force: pushed(force).around(conditions))(pushes)

        def advance(state: Array, leg: Array) -> tuple[Array, Array]:
            propagate, force, now = jax.tree.map(lambda leaf: leaf[leg], (*of_legs, left))
            under = pushed(force)
            end, _, _ = propagate.advance(state, under.load, lambda s: under.rest(s, now))
            return end, end

        return jax.lax.scan(advance, start, np.repeat(np.arange(len(legs)), counts))[1]

    def instant(self, state: Complex[Array, "h n"], time: Array) -> Float[Array, " n"]:
        """The state itself at a time [s], phase zero at time zero."""
        turn = jnp.exp(1j * jnp.arange(HARMONICS + 1) * self.omega * time)
        return jnp.real(turn @ state)


def with_end(mean: Complex[Array, "h n"], end: Complex[Array, "h n"]) -> Complex[Array, "2 h n"]:
    """What a step tells of itself as one result: with several, XLA copies those of all steps before at every step."""
    return jnp.stack([mean, jax.lax.stop_gradient(end)])


def means_and_begins(start: Complex[Array, "h n"], told: Complex[Array, "t 2 h n"]) -> tuple[Array, Array]:
    """The means of all steps and, without derivatives, where each began, from what they told."""
    return told[:, 0], jax.lax.stop_gradient(jnp.concatenate([start[None], told[:-1, 1]]))


def steps_from(
    propagate: Propagator, start: Complex[Array, "t h n"], load: Complex[Array, "t h n"]
) -> Complex[Array, "t 2 h n"]:
    """The start of every step, and where it ends under a constant load, of propagators for all steps or for each."""
    end = product(propagate.exponential, start) + product(propagate.first, load)
    return jnp.stack([start, end], axis=1)


def among_velocities(accelerations: Array, size: int) -> Array:
    """Accelerations (..., axes) at their place in the derivative of a state of some `size`."""
    axes = accelerations.shape[-1]
    return jnp.pad(accelerations, [(0, 0)] * (accelerations.ndim - 1) + [(axes, size - 2 * axes)])


class Sampled(eqx.Module):
    """Steps of `step` seconds under forces that go linearly from one value to another within each.

    Args:
        model: whose state moves.
        linear: its part that is propagated exactly, as `Model.linear` gives it.
        step: [s].
    """

    model: Model
    linear: tuple[Array, Array]
    propagate: Propagator

    @classmethod
    def of(cls, model: Model, linear: tuple[Array, Array], step: Array) -> "Sampled":
        """With the propagator of that part."""
        return cls(model, linear, Propagator.of(linear[0], step, state_units(model)))

    def rest(self, state: Array, force: Array, now: Conditions) -> Array:
        """What the linear part leaves out."""
        matrix, gain = self.linear
        left = self.model.derivative(state, force, now) - product(matrix, state) - product(gain, force)
        return jnp.where(np.isin(np.arange(self.model.size), self.model.nonlinear_rows), left, 0.0)

    def predicted(self, state: Array, force: Array, increment: Array, here: Array) -> Array:
        """Where a step ends if what is left out stays as it is `here`."""
        gain, propagate = self.linear[1], self.propagate
        end = product(propagate.exponential, state) + product(propagate.first, product(gain, force) + here)
        return end + product(propagate.second, product(gain, increment))


def run_samples(
    model: Model,
    forces: Float[Array, "t axes"],
    increments: Float[Array, "t axes"],
    step: Array,
    conditions: Conditions,
    base: Conditions,
    *,
    start: Float[Array, " n"] | None = None,
    linear: tuple[Array, Array] | None = None,
    added: Float[Array, "t 2 axes"] | None = None,
) -> Float[Array, "t n"]:
    """State at the beginning of each step, from `start` (`None`: at rest), under forces that go linearly from `forces`
    to `forces + increments` within a step of `step` seconds: held ones with zero increments. `conditions` has a row per
    step.

    `linear` is what is propagated exactly, by default the model's own part at `base`; `added` are accelerations that
    the model lacks, at both ends of each step.
    """
    steps = Sampled.of(model, model.linear(base) if linear is None else linear, step)

    def advance(state: Array, inputs: tuple[Array, Array, Conditions, Array | None]) -> tuple[Array, Array]:
        force, increment, now, more = inputs
        extra = (0.0, 0.0) if more is None else among_velocities(more, model.size)
        here = steps.rest(state, force, now) + extra[0]
        predicted = steps.predicted(state, force, increment, here)
        there = steps.rest(predicted, force + increment, now) + extra[1]
        return predicted + product(steps.propagate.second, there - here), state

    begin = jnp.zeros(model.size) if start is None else start
    return jax.lax.scan(advance, begin, (forces, increments, conditions, added))[1]


def visited_samples(
    model: Model, states: Float[Array, "t n"], forces: Array, increments: Array, step: Array, conditions: Conditions,
    base: Conditions,
) -> Float[Array, "t 2 n"]:  # fmt: skip
    """The states at which `run_samples` asks what the linear part leaves out, from those that it gave."""
    steps = Sampled.of(model, model.linear(base), step)

    def one(state: Array, force: Array, increment: Array, now: Conditions) -> Array:
        here = steps.rest(state, force, now)
        return jnp.stack([state, steps.predicted(state, force, increment, here)])

    return jax.vmap(one)(states, forces, increments, conditions)
