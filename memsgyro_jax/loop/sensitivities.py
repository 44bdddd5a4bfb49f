"""What the read-out would have shown, had anything unknown been a little different: sensitivities along a run.

The motion of the run without noise is differentiated exactly by everything that is unknown (start of the motion,
read-out offsets, coefficients), sample by sample with the plant's own step, while the commands are held: an observer
knows what it commanded. The information bound weighs these sensitivities with the noise; observability asks which
combination of the unknown has none.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from memsgyro_jax.base.concrete import at_hand, is_concrete, settled
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import (
    UX,
    UY,
    VX,
    VY,
    Coefficient,
    Dynamics,
    Inertial,
    MotionModel,
    Pair,
    Scalar,
    X,
    Y,
    mode_frequencies,
)
from memsgyro_jax.device.propagate import State4, applied

from .engine import healthy, over_dies
from .loop import ClosedLoop, LoopState
from .observers.base import MOTION, OFFSETS, Clock
from .observers.settings import Prior
from .scenario import Conditions, Scenario
from .whitening import Shaken


class Unknowns(eqx.Module):
    """What is to be found: names, units, the scale each column is computed in, and the prior's standard deviation."""

    scale: Float[Array, " quantities"]
    prior_std: Float[Array, " quantities"]
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    model: MotionModel = eqx.field(static=True)

    def tangent(self, name: str) -> Array:
        """How entry `name` moves by a unit step of each (scaled) quantity: a scaled unit vector, or zero if known."""
        unit = [float(name == own) for own in self.names]
        return self.scale * np.asarray(unit)


class Dimensions(NamedTuple):
    """Typical length of the motion in m, mean of the modes in rad/s, mean gain of a force in 1/kg."""

    length: Scalar
    frequency: Scalar
    gain: Scalar


def dimensions_of(loop: ClosedLoop) -> Dimensions:
    """Units in which a loop's numbers are about one."""
    device, start = at_hand(settled((loop.device, loop.start)))
    xp = np if is_concrete(device, start) else jnp
    frequency = 2.0 * np.pi * xp.mean(mode_frequencies(device))
    length = xp.maximum(1e-9, xp.hypot(*(xp.max(xp.abs(xp.asarray(q))) for q in start[:2])))
    gain = xp.mean(xp.stack([xp.mean(xp.asarray(g)) for g in device.dynamics(Inertial()).gain]))
    return Dimensions(length, frequency, gain)


def units_of(model: MotionModel) -> tuple[str, ...]:
    """The unit of each coefficient of the equations of motion."""
    by_signal = {**dict.fromkeys((X, Y), "1/s²"), **dict.fromkeys((VX, VY), "1/s"), **dict.fromkeys((UX, UY), "1/kg")}
    return tuple(
        "s"
        if c.delays is not None
        else "1"
        if c.scales is not None
        else "rad/s"
        if c.is_rate
        else by_signal[c.terms[0].signal]
        for c in model.coefficients
    )


def unknowns_of(
    loop: ClosedLoop, prior: Prior | None, known: tuple[str, ...], also: tuple[Coefficient, ...]
) -> Unknowns:
    """Everything about a loop that its own read-out has to tell, but what is `known`; coefficients `also`, too.

    Raises `InputError` for an unknown name.
    """
    model = MotionModel(loop.device.model.coefficients + also)
    length, frequency, gain = dimensions_of(loop)
    by_unit = {"1/s²": frequency**2, "1/s": frequency, "1/kg": gain, "rad/s": 1.0, "s": 1.0 / frequency, "1": 1.0}
    table = dict.fromkeys(MOTION[:2], (length, "m")) | dict.fromkeys(MOTION[2:], (length * frequency, "m/s"))
    table |= dict.fromkeys(OFFSETS, (1e-3, "V"))
    table |= {name: (by_unit[unit], unit) for name, unit in zip(model.names, units_of(model), strict=True)}
    strange = set(known) - set(table)
    if strange:
        raise InputError(f"Argument `known` must name some of {', '.join(table)}, but holds `{sorted(strange)[0]}`.")
    std = dict.fromkeys(table, np.inf)
    if prior is not None:
        std |= dict(zip(table, (*prior.motion_std, *prior.offset_std, *prior.theta_std), strict=False))
    exact = {name for name, value in at_hand(settled(std)).items() if is_concrete(value) and value == 0.0}
    names = tuple(name for name in table if name not in exact.union(known))
    scale, units = zip(*(table[name] for name in names), strict=True)
    return Unknowns(jnp.asarray(scale), jnp.asarray(at_hand([std[name] for name in names])), names, units, model)


def lanes_of(loop: ClosedLoop, design: ClosedLoop, scenario: Scenario) -> tuple[int, ...]:
    """The batch: axes that leaves of the loop have beyond those of the design, or that the scenario's values have."""
    leaves = zip(jax.tree.leaves(loop), jax.tree.leaves(design), strict=True)
    extra = [jnp.shape(leaf)[jnp.ndim(like) :] for leaf, like in leaves]
    return jnp.broadcast_shapes(*extra, *map(jnp.shape, jax.tree.leaves(scenario.at(0.0))))


class Sensitive(NamedTuple):
    """State of the loop, the motion's derivative by each quantity, whether the die was never lost, and, where a force
    shakes the mass, what is known of its part in the rows.
    """

    loop: LoopState
    tangents: tuple[Float[Array, "quantities *lanes"], ...]
    alive: Bool[Array, "*lanes"]
    shaken: Shaken | None = None


def begin(
    loop: ClosedLoop, design: ClosedLoop, unknown: Unknowns, lanes: tuple[int, ...], warm: bool = False
) -> Sensitive:
    """The start of a run; a `warm` one makes rows independent of each other under the device's Brownian force."""
    state = jax.tree.map(
        lambda value, like: over_dies(value, jnp.ndim(like), lanes), loop.init(), jax.eval_shape(design.init)
    )
    tangents = fresh(unknown, lanes)
    return Sensitive(state, tangents, jnp.ones(lanes, bool), Shaken.still(tangents[0]) if warm else None)


def fresh(unknown: Unknowns, lanes: tuple[int, ...]) -> tuple[Array, ...]:
    """Derivatives of the motion where it is itself what is unknown."""
    return tuple(over_dies(unknown.tangent(name), 1, lanes) for name in MOTION)


def sampling(
    loop: ClosedLoop, scenario: Scenario, unknown: Unknowns, unit: Pair, period: float, lanes: tuple[int, ...]
):
    """A function that advances a block of samples without noise: from a `Sensitive` state and the numbers of the
    samples to the next state and the rows (*lanes, 2 samples, quantities), in `unit` volts of the two channels.
    """
    silent = eqx.tree_at(lambda made: made.readout.noise_density, loop, (jnp.zeros(()), jnp.zeros(())))

    def sample(carry: Sensitive, xs):
        index, conditions = xs
        clock = Clock(index * period, index, period)
        state, taken = silent.step(carry.loop, conditions, (0.0, 0.0), clock)
        tangents = _propagated(silent, carry, conditions, taken.force, clock, unknown)
        rows, shaken = _voltage_rows(silent, state.motion, tangents, unit, unknown, lanes), carry.shaken
        if shaken is not None:
            dynamics = silent.device.dynamics(conditions.inertial)
            step = silent.discretisation.transition(dynamics.stiffness, dynamics.velocity, period)
            shaken, rows = _independent(
                silent, shaken.carried(step.full, silent.shaking(conditions, period)), rows, unit
            )
        return Sensitive(state, tangents, carry.alive & healthy(silent, state), shaken), rows

    def block(carry: Sensitive, index: Array) -> tuple[Sensitive, Array]:
        carry, rows = jax.lax.scan(sample, carry, (index, jax.vmap(scenario.at)((index + 0.5) * period)))
        rows = rows.reshape(2 * index.size, len(unknown.names), *lanes)
        return carry, jnp.moveaxis(rows, (0, 1), (-2, -1))

    return block


def _propagated(
    loop: ClosedLoop, carry: Sensitive, conditions: Conditions, force: Pair, clock: Clock, unknown: Unknowns
) -> tuple[Array, ...]:
    """The derivative of the motion, one sample later: a jvp of the plant's own step per quantity."""
    true, model = loop.device.dynamics(conditions.inertial), unknown.model

    def plant(motion: State4, change: tuple[Scalar, ...]) -> State4:
        changed = _plus(true, model.assemble(change))
        push = applied(changed, force)
        return loop.discretisation.advance(motion, push, changed.stiffness, changed.velocity, clock.period)

    at = (carry.loop.motion, tuple(jnp.zeros(()) for _ in model.names))
    moves = tuple(unknown.tangent(name) for name in model.names)
    return jax.vmap(lambda *tangents: jax.jvp(plant, at, tangents)[1])(carry.tangents, moves)


def _plus(true: Dynamics, change: Dynamics) -> Dynamics:
    return Dynamics(
        stiffness=true.stiffness + change.stiffness,
        damping=true.damping + change.damping,
        coriolis=true.coriolis + change.coriolis,
        gain=true.gain + change.gain,
        bias=true.bias,
    )


def _independent(loop: ClosedLoop, shaken: Shaken, rows: Array, unit: Pair) -> tuple[Shaken, Array]:
    """Rows without what the Brownian force makes them share, one channel after the other."""
    left = []
    for row, signal, scale, volts in zip(rows, loop.readout.signals, loop.readout.scale, unit, strict=True):
        shaken, missed = shaken.whitened(row, signal, scale / volts)
        left.append(missed)
    return shaken, jnp.stack(left)


def _voltage_rows(
    loop: ClosedLoop, motion: State4, tangents: tuple[Array, ...], unit: Pair, unknown: Unknowns, lanes: tuple[int, ...]
) -> Float[Array, "2 quantities *lanes"]:
    """Derivative of both voltages by each quantity, in `unit` volts."""
    readout, rows = loop.readout, []
    for axis, (signal, scale, volts) in enumerate(zip(readout.signals, readout.scale, unit, strict=True)):
        row = scale * tangents[signal] + over_dies(unknown.tangent(OFFSETS[axis]), 1, lanes)
        for coefficient in unknown.model.coefficients:
            if coefficient.scales == axis:
                row = row + scale * motion[signal] * over_dies(unknown.tangent(coefficient.name), 1, lanes)
        rows.append(row / volts)
    return jnp.stack(rows)
