"""The device in operation, effects included: what one sample makes of its motion, and what the read-out shows of it.

The base device is propagated as without effects; they act as kicks at both ends of a sample, of half a sample each. A
force that swings with the resonance is then summed by the trapezoidal rule, whose error for what accumulates over
cycles is none: what is left is of second order in the period and does not grow. Own states that are linear are
propagated by the series of their exponential, along the cubic through the motion at both ends, however fast they are.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed
from memsgyro_jax.device.carried import Effects, each_die
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.device.gyro import AbstractGyro, Dynamics, Inertial, Pair, Scalar, SingleMassGyro
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.device.propagate import AbstractAddition, AbstractDiscretisation, Exact, State4, applied
from memsgyro_jax.effects.base import Moment, SweepEffect
from memsgyro_jax.effects.evaluation import Acting, moment

from .observers.base import Clock
from .own_states import Own, check_speed, propagated, stacked


class SampleEffects(AbstractAddition):
    """What the effects of a device add to it during one sample: `command` is asked for, `held` is what the electrodes
    apply at its start.
    """

    effects: Effects
    rest: Dynamics
    dynamics: Dynamics
    conditions: Conditions
    command: Pair
    scale: Pair
    period: Scalar
    held: Pair
    one_mass: bool = eqx.field(static=True)
    reference_temperature: float = eqx.field(static=True)
    reference_bias: float = eqx.field(static=True)

    @classmethod
    def of(
        cls, device: AbstractGyro, dynamics: Dynamics, conditions: Conditions, command: Pair, scale: Pair, clock: Clock
    ) -> "SampleEffects":
        """At the sample that begins at `clock`."""
        middle = eqx.tree_at(
            lambda c: c.time, conditions, clock.time + 0.5 * clock.period, is_leaf=lambda leaf: leaf is None
        )
        return cls(
            effects=Effects.of(device.effects),
            rest=device.dynamics(Inertial()),
            dynamics=dynamics,
            conditions=middle,
            command=command,
            scale=scale,
            period=clock.period,
            held=command,
            one_mass=isinstance(device, SingleMassGyro),
            reference_temperature=device.reference_temperature,
            reference_bias=device.reference_bias,
        )

    def driven(self, motion: State4, own: Own) -> "SampleEffects":
        """The same with what the electrodes apply at the command, the mass being at `motion`."""
        return eqx.tree_at(lambda sample: sample.held, self, each_die(_applied, self, motion, own))

    def rates(self, motion: State4, own: Own) -> tuple[Pair, Own]:
        """Acceleration beside the base device's [m/s²], and the own states' derivative by time."""
        return each_die(_rates, self, motion, own)

    def carried(self, own: Own, rates: Own, start: State4, end: State4) -> Own:
        """Own states one period later: exactly where they are linear, else by Euler's step."""
        return each_die(_carried, self, own, rates, start, end)

    def corrected(self, own: Own, rates: Own, later: Own) -> Own:
        """`carried` own states with the slope's change, for those that are not linear."""
        half, fixed = 0.5 * self.period, iter(_linear(self.effects))
        return tuple(o if next(fixed) else o + half * (b - a) for o, a, b in zip(own, rates, later, strict=True))

    @property
    def shows(self) -> bool:
        """Whether any of the effects acts on the read-out."""
        return bool(Acting.of(self.effects).readouts)

    def shown_at(self, motion: State4, own: Own) -> "tuple[OnReadout, OnReadout]":
        """What read-out effects make of volts before the noise, and behind it, at the end of the sample."""
        return OnReadout(self, motion, own, False), OnReadout(self, motion, own, True)


class OnReadout(eqx.Module):
    """What read-out effects make of volts at one moment: those behind the noise (`last`), or the others."""

    sample: SampleEffects
    motion: State4
    own: Own
    last: bool = eqx.field(static=True)

    def __call__(self, volts: Pair) -> Pair:
        """The volts [V] as the effects change them."""
        readouts = [effect for effect in Acting.of(self.sample.effects).readouts if effect.last == self.last]
        return each_die(_signal, self, volts) if readouts else volts


def own_start(device: AbstractGyro, motion: State4) -> Own:
    """The own states of a device's effects at time zero."""
    if not Acting.of(device.effects).own_size:
        return ()
    return each_die(_began, _at_rest(device), motion)


def _at_rest(device: AbstractGyro) -> SampleEffects:
    zero = (0.0, 0.0)
    return SampleEffects.of(device, device.dynamics(Inertial()), Conditions(), zero, zero, Clock(0.0, 0, 0.0))


def check_effects(device: AbstractGyro, signals: tuple[int, int]) -> None:
    """Refuse what has no meaning in a loop.

    **Raises:** `InputError` for an effect on the way a sweep is taken, and for a read-out effect on a velocity.
    """
    for effect in device.effects:
        if isinstance(effect, SweepEffect):
            raise InputError(
                f"A loop takes no frequency sweep, so its device must be without the effect `{effect.label}`; leave it "
                "out with `gyro.with_only(...)`."
            )
    if (shown := Acting.of(device.effects).readouts) and signals != (0, 1):
        named = listed((effect.label for effect in shown), "`")
        raise InputError(
            "A read-out whose effects are followed must show displacement, but it shows another signal beside a device "
            f"with {named}; leave that out with `gyro.with_only(...)`, or take a read-out of displacement "
            "(`DirectReadout`)."
        )


def check_own_states(device: AbstractGyro, discretisation: AbstractDiscretisation, sample_rate: float) -> None:
    """Refuse linear own states that turn faster than half the sample rate, where their series has to follow them.

    **Raises:** `InputError`; traced values pass.
    """
    turning = [e for e in Acting.of(device.effects).forces if e.own_is_linear and e.own_size]
    if turning and isinstance(discretisation, Exact):
        still = _moment(_at_rest(device), (0.0,) * 4, (0.0, 0.0))
        for effect in turning:
            check_speed(effect, still, sample_rate)


def _linear(effects: Effects) -> tuple[bool, ...]:
    """Of each own state, whether it is linear."""
    return tuple(effect.own_is_linear for effect in Acting.of(effects).forces for _ in range(effect.own_size))


def _moment(sample: SampleEffects, motion: State4, command: Pair) -> Moment:
    """What effects see, for one die."""
    (kxx, kxy), (kyx, kyy) = sample.rest.stiffness
    (dxx, dxy), (dyx, dyy) = sample.rest.damping
    if sample.one_mass:
        d = 0.5 * (dxy + dyx)
        device = NormalisedDevice(jnp.stack([kxx, kyy, kxy]), jnp.stack([dxx, dyy, d]), sample.rest.gain[0])
    else:
        device = NormalisedDevice(*map(stacked, ((kxx, kyy, kxy, kyx), (dxx, dyy, dxy, dyx), sample.rest.gain)))
    return moment(
        stacked(motion[:2]),
        stacked(motion[2:]),
        stacked(command),
        sample.conditions,
        device=device,
        scale=stacked(sample.scale),
        reference_temperature=sample.reference_temperature,
        reference_bias=sample.reference_bias,
    )


def _driven(sample: SampleEffects, motion: State4, own: Own) -> Moment:
    """The moment with its surroundings, and the force of the electrodes."""
    acting = Acting.of(sample.effects)
    return acting.driven(acting.around(_moment(sample, motion, sample.command), stacked(own)))


def _applied(sample: SampleEffects, motion: State4, own: Own) -> Pair:
    return tuple(_driven(sample, motion, own).force)


def _rates(sample: SampleEffects, motion: State4, own: Own) -> tuple[Pair, Own]:
    acting = Acting.of(sample.effects)
    now = _driven(sample, motion, own)
    force, rates = acting.force(now, stacked(own))
    beside = tuple(force)
    if acting.drives:  # electrodes whose force depends on the place change it within the sample
        beside = tuple(f + (a - h) for f, a, h in zip(force, now.force, sample.held, strict=True))
    return tuple(g * f for g, f in zip(sample.dynamics.gain, beside, strict=True)), tuple(rates)


def _began(sample: SampleEffects, motion: State4) -> Own:
    now = _moment(sample, motion, sample.command)
    return tuple(number for effect in Acting.of(sample.effects).forces for number in effect.own_start(now))


def _carried(sample: SampleEffects, own: Own, rates: Own, start: State4, end: State4) -> Own:
    made: list[Scalar] = []
    place, h, still = 0, sample.period, _moment(sample, (0.0,) * 4, (0.0, 0.0))
    for effect in Acting.of(sample.effects).forces:
        mine = slice(place, place + effect.own_size)
        place += effect.own_size
        if effect.own_is_linear and effect.own_size:
            made += propagated(effect, still, own[mine], sample.held, start, end, h)
        else:
            made += [o + h * r for o, r in zip(own[mine], rates[mine], strict=True)]
    return tuple(made)


def _signal(shown: OnReadout, volts: Pair) -> Pair:
    acting = Acting.of(shown.sample.effects)
    mine = acting._replace(readouts=tuple(effect for effect in acting.readouts if effect.last == shown.last))
    return tuple(mine.signal(jnp.stack(volts), _seen(shown.sample, shown.motion, shown.own)))


def _seen(sample: SampleEffects, motion: State4, own: Own) -> Moment:
    """What read-out effects see, with acceleration and jerk under the force still held."""
    true = sample.dynamics
    stiffness, velocity = (jnp.stack([stacked(row) for row in rows]) for rows in (true.stiffness, true.velocity))
    push = stacked(applied(true, sample.held))

    def slopes(q, v, own):
        beside, rates = _rates(sample, (*q, *v), tuple(own))
        return stacked(beside) + push - stiffness @ q - velocity @ v, stacked(rates)

    q, v, inner = stacked(motion[:2]), stacked(motion[2:]), stacked(own)
    (acceleration, rates) = slopes(q, v, inner)
    jerk = jax.jvp(slopes, (q, v, inner), (v, acceleration, rates))[1][0]
    now = _driven(sample, motion, own)
    return eqx.tree_at(lambda m: (m.acceleration, m.jerk), now, (acceleration, jerk), is_leaf=lambda leaf: leaf is None)
