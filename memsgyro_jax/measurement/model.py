"""The model of a device as it stands on the bench: base device, read-out, and the effects it has beyond the base model.

This is what measurements are compared with. Everything here is for one instant, one condition, one device.
"""

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.affine import is_affine
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.linalg import inverse, product
from memsgyro_jax.device.carried import check_effect
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.effects.base import Effect, Moment, ReadoutEffect
from memsgyro_jax.effects.evaluation import Acting, carried, moment
from memsgyro_jax.effects.readout_delay import LateEffect, behind


class Model(Displayed):
    """Base device, read-out and effects.

    Args:
        device: a `SingleMassGyro`, a `Resonator`, or either per mass; effects that it carries become the model's. One
            axis may have a negative mobility, where drive or pick-off are turned round: its mass is positive.
        scale: volts per displacement of each channel [V/m], or one number for all.
        offset: constant voltage of each channel [V]; lock-in records do not see it.
        order: of the derivative that channels show and `scale` is per: 0 displacement, 1 velocity, 2 acceleration.
        holds_gain: whether a fit of records that no known force drives holds the displacement per force at rest, of a
            device of one axis, and not its mass.
        effects: further ones, beside those that the device carries.
        reference_temperature: at which the base parameters hold [K]; None takes the device's.
        reference_bias: electrode bias at which the base stiffness holds [V]; None takes the device's.
    """

    device: NormalisedDevice
    scale: Float[Array, " axes"]
    offset: Float[Array, " axes"]
    effects: tuple[Effect, ...]
    reference_temperature: Array
    reference_bias: Array
    order: int = eqx.field(static=True)
    holds_gain: bool = eqx.field(static=True)

    def __init__(
        self,
        device: SingleMassGyro | Resonator | NormalisedDevice,
        *,
        scale: float | Array = 1.0,
        offset: float | Array = 0.0,
        effects: tuple[Effect, ...] = (),
        reference_temperature: float | None = None,
        reference_bias: float | None = None,
        order: int = 0,
        holds_gain: bool = False,
    ):
        self.device = NormalisedDevice.of(device)
        axes = self.device.axes
        self.scale, self.offset = (jnp.broadcast_to(jnp.asarray(v, float), (axes,)) for v in (scale, offset))
        at = (reference_temperature, reference_bias)
        held = (getattr(device, "reference_temperature", 298.15), getattr(device, "reference_bias", 0.0))
        self.reference_temperature, self.reference_bias = (
            jnp.asarray(own if given is None else given, float) for given, own in zip(at, held, strict=True)
        )
        self.order, self.holds_gain = order, holds_gain
        self.effects = (*carried(device), *effects)
        for effect in self.effects:
            check_effect(effect, axes)

    def physical(self, **more: Any) -> SingleMassGyro | Resonator:
        """The device with its mass and its effects, as the loop runs it, and `more` of its fields; scale and offset are
        the read-out's, and terms of an instrument stay with its records.
        """
        references = {"reference_temperature": self.reference_temperature, "reference_bias": self.reference_bias}
        own = tuple(effect for effect in self.effects if not effect.of_instrument)
        return self.device.physical(effects=own, **{name: float(v) for name, v in references.items()}, **more)

    @property
    def axes(self) -> int:
        """Number of axes, which is the number of channels."""
        return self.device.axes

    @property
    def size(self) -> int:
        """Length of the state: displacements, velocities, the effects' own states."""
        return 2 * self.axes + self._acting.own_size

    @property
    def _acting(self) -> Acting:
        return Acting.of(self.effects)

    def with_effect(self, *effects: Effect) -> "Model":
        """The same model with further effects."""
        for effect in effects:
            check_effect(effect, self.axes)
        return self.with_only((*self.effects, *effects))

    def with_only(self, effects: Iterable[Effect]) -> "Model":
        """The same model with these effects and no others."""
        return eqx.tree_at(lambda m: m.effects, self, tuple(effects), is_leaf=lambda x: isinstance(x, tuple))

    @property
    def present(self) -> "Model":
        """The same model without the effects of strength zero, which are absent."""
        return self.with_only(effect for effect in self.effects if np.any(np.asarray(effect.strength) != 0))

    def state_of(self, motion: Float[Array, " m"], conditions: Conditions) -> Float[Array, " n"]:
        """The state of displacements and velocities, with the effects' own states as they begin there."""
        cold = jnp.concatenate([motion, jnp.zeros(self._acting.own_size)])
        now = self.at_moment(cold, jnp.zeros(self.axes), conditions)
        return jnp.concatenate([motion, *(effect.own_start(now) for effect in self._acting.forces)])

    # Compiled programs hold these many times over: under `jit` what every effect does is traced once for all of them.

    @eqx.filter_jit
    def derivative(
        self, state: Float[Array, " n"], command: Float[Array, " axes"], conditions: Conditions
    ) -> Float[Array, " n"]:
        """Time derivative of the state under a commanded force [N]."""
        now = self.at_moment(state, command, conditions)
        q, v = now.displacement, now.velocity
        pushed, own = self.pushed(now, state[2 * self.axes :])
        held = product(self.device.stiffness_matrix, q) + product(self.device.damping_matrix, v)
        acceleration = pushed - held
        if self.axes == 2:
            acceleration = acceleration + 2.0 * conditions.rate * jnp.stack([v[1], -v[0]])
        return jnp.concatenate([v, acceleration, own])

    def pushed(self, now: Moment, own: Float[Array, " own"]) -> tuple[Float[Array, " axes"], Float[Array, " own"]]:
        """What the forces at a moment accelerate the mass by, and the time derivative of the effects' own states."""
        extra, rates = self._acting.force(now, own)
        mobility = self.device.mobility
        return mobility * (now.force + jnp.sign(mobility) * extra), rates  # what is turned round is the drive

    @eqx.filter_jit
    def observe(
        self,
        state: Float[Array, " n"],
        command: Float[Array, " axes"],
        command_rate: Float[Array, " axes"],
        conditions: Conditions,
        leaking: Float[Array, " axes"] | None = None,
    ) -> Float[Array, " axes"]:
        """Voltage of each channel, without noise; `command_rate` [N/s] matters where a read-out effect looks back.

        `leaking` is the command that couples into the read-out [N], where the motion is seen as it was at another time.
        """
        now = self.at_reading(state, command, command_rate, conditions)
        now = now if leaking is None else eqx.tree_at(lambda m: m.command, now, leaking)
        return self._acting.signal(self.scale * now.seen + self.offset, now)

    def behind(self, omega: Array, conditions: Conditions, state: Array | None = None) -> Array:
        """exp(−iω·delay), by which a phasor is seen late; `state` (n,) is the mean one, by default rest."""
        late = [effect for effect in self.effects if isinstance(effect, LateEffect)]
        if not late:
            return jnp.ones(())
        rest = jnp.zeros(self.size) if state is None else state
        now = self.at_moment(rest, jnp.zeros(self.axes), conditions)
        return behind(sum(effect.late(now) for effect in late), omega)

    @property
    def prompt(self) -> "Model":
        """The same model with a read-out that is not late."""
        effects = (
            eqx.tree_at(lambda e: e.strength, effect, jnp.zeros_like(effect.strength))
            if isinstance(effect, LateEffect)
            else effect
            for effect in self.effects
        )
        return self.with_only(effects)

    def motion(self, phasors: Array, omega: Array) -> Array:
        """Displacement phasors that phasors (n, axes) of the channels stand for at `omega` (n,) [rad/s]."""
        return phasors / (self.scale * (1j * omega[..., None]) ** self.order)

    def moved(self, shown: Complex[Array, "n axes"], conditions: Conditions) -> Complex[Array, "n axes"]:
        """Displacement phasors (n, axes) [m] that look like those `shown` where the read-out has its scale alone: what
        read-out effects make of a small motion, in the surroundings of each row, is taken off.
        """
        if not self._acting.readouts:
            return shown
        found = jax.vmap(lambda at, row: inverse(self.gain(at)) @ row)(conditions.rows(len(shown)), shown)
        return jnp.where(jnp.isfinite(found), found, shown)

    def shown(self, moved: Complex[Array, "n axes"], conditions: Conditions) -> Complex[Array, "n axes"]:
        """The inverse of `moved`."""
        if not self._acting.readouts:
            return moved
        return jax.vmap(lambda at, row: self.gain(at) @ row)(conditions.rows(len(moved)), moved)

    def gain(self, conditions: Conditions) -> Float[Array, "axes axes"]:
        """What the read-out shows of a small motion along each axis, over its scale."""
        still = jnp.zeros(self.axes)

        def volts(seen: Array) -> Array:
            moving = [seen if order == self.order else still for order in range(4)]
            state = jnp.concatenate([*moving[:2], jnp.zeros(self.size - 2 * self.axes)])
            now = eqx.tree_at(
                lambda m: (m.acceleration, m.jerk),
                self.at_moment(state, still, conditions),
                tuple(moving[2:]),
                is_leaf=lambda leaf: leaf is None,
            )
            return self._acting.signal(self.scale * seen, now)

        return jax.jacfwd(volts)(still) / self.scale[:, None]

    @eqx.filter_jit
    def linear(self, conditions: Conditions) -> tuple[Float[Array, "n n"], Float[Array, "n axes"]]:
        """The derivative by state and command at rest: the part that is propagated exactly."""
        rest, still = jnp.zeros(self.size), jnp.zeros(self.axes)
        return jax.jacfwd(self.derivative, argnums=(0, 1))(rest, still, conditions)

    @property
    def is_linear(self) -> bool:
        """Whether the derivative is affine in state and command, whatever the conditions are."""
        rest, still = jnp.zeros(self.size), jnp.zeros(self.axes)
        return is_affine(lambda s, u: self.derivative(s, u, Conditions()), rest, still)

    @property
    def is_bare(self) -> bool:
        """Whether no effect acts on the motion, which a step of any length then tells exactly under held forces and a
        constant rate.
        """
        return not self._acting.forces

    @property
    def is_read_linearly(self) -> bool:
        """Whether the voltages are affine in state and command, whatever the conditions are."""
        rest, still = jnp.zeros(self.size), jnp.zeros(self.axes)
        return is_affine(lambda s, u, du, now: self.observe(s, u, du, Conditions(), now), rest, still, still, still)

    @property
    def is_sharp(self) -> bool:
        """Whether the recorded waveform has corners."""
        return any(isinstance(effect, ReadoutEffect) and effect.sharp for effect in self.effects)

    @property
    def nonlinear_rows(self) -> tuple[int, ...]:
        """Rows of the derivative that may be nonlinear: accelerations, and own states not declared linear."""
        rows, place = list(range(self.axes, 2 * self.axes)), 2 * self.axes
        for effect in self._acting.forces:
            rows += [] if effect.own_is_linear else range(place, place + effect.own_size)
            place += effect.own_size
        return tuple(rows)

    def at_reading(self, state: Array, command: Array, command_rate: Array, conditions: Conditions) -> Moment:
        """What read-out effects see: with acceleration and jerk."""
        slope, onward = jax.linearize(lambda s, u: self.derivative(s, u, conditions), state, command)
        curvature, a = onward(slope, command_rate), self.axes
        return eqx.tree_at(
            lambda m: (m.acceleration, m.jerk),
            self.at_moment(state, command, conditions),
            (slope[a : 2 * a], curvature[a : 2 * a]),
            is_leaf=lambda leaf: leaf is None,
        )

    def at_moment(self, state: Array, command: Array, conditions: Conditions) -> Moment:
        """What effects that act on the mass see."""
        a = self.axes
        now = moment(
            state[:a],
            state[a : 2 * a],
            command,
            conditions,
            device=eqx.tree_at(lambda device: device.mobility, self.device, jnp.abs(self.device.mobility)),
            scale=self.scale,
            reference_temperature=self.reference_temperature,
            reference_bias=self.reference_bias,
            order=self.order,
        )
        return self._acting.driven(self._acting.around(now, state[2 * a :]))
