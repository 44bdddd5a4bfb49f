"""The port of the physics that a device may have beyond the base model.

An effect is a formula and a strength. Strength zero is exactly "absent"; which effects a model has is structure, how
strong they are are numbers. One's own effect takes about ten lines:

    class Creep(mg.effects.ForceEffect):
        name, unit, law = "creep", "N·s³/m³", "F = −s·v³"
        axis: int = eqx.field(static=True, default=0)
        strength: mg.effects.Scalar = mg.effects.strength()

        def force(self, now: mg.effects.Moment) -> Array:
            return self.along(now, -self.strength * now.velocity[self.axis] ** 3)
"""

import abc
import math
from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.arguments import number_in
from memsgyro_jax.base.concrete import check_finite
from memsgyro_jax.base.converter import FieldConverter
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.base.fields import Scalar as Scalar
from memsgyro_jax.device.carried import AbstractEffect
from memsgyro_jax.device.normalised import NormalisedDevice


class Moment(Displayed):
    """Everything an effect may depend on, at one instant. Vectors have one entry per axis.

    | field | unit | holds |
    |---|---|---|
    | `displacement`, `velocity` | m, m/s | of the proof mass |
    | `command` | N | asked for |
    | `force` | N | applied by the electrodes, which drive effects make differ from the command |
    | `own` | any | the effect's own state, `own_size` numbers |
    | `rate`, `angular_acceleration` | rad/s, rad/s² | of the frame, as the record has it |
    | `rate_trusted` | 1 | 1 where the rate is known apart from the table's own reading, else 0 |
    | `warming` | K | temperature above the reference |
    | `bias_voltage`, `reference_bias` | V | of the electrodes; at which the base stiffness holds |
    | `time` | s | within the record |
    | `progress` | 1 | part of the record that has passed, 0 to 1 |
    | `record` | 1 | number of the record in its case, from 0 |
    | `sweep` | 1 | number of the single sweep in its record, from 0 |
    | `device` | | the base device |
    | `scale` | V/m | of the read-out |
    | `acceleration`, `jerk` | m/s², m/s³ | of the proof mass; only read-out effects see them |
    | `order` | | 0, 1, 2: the read-out sees displacement, velocity, acceleration |
    """

    displacement: Array
    velocity: Array
    command: Array
    force: Array
    own: Array
    rate: Array
    angular_acceleration: Array
    rate_trusted: Array
    warming: Array
    bias_voltage: Array
    reference_bias: Array
    time: Array
    progress: Array
    record: Array
    sweep: Array
    device: NormalisedDevice
    scale: Array
    acceleration: Array | None = None
    jerk: Array | None = None
    order: int = eqx.field(static=True, default=0)

    @property
    def seen(self) -> Array:
        """What the read-out sees: displacement, velocity or acceleration."""
        return self.derivatives[0]

    @property
    def derivatives(self) -> tuple[Array, ...]:
        """What the read-out sees, and as many of its time derivatives as are known."""
        known = (self.displacement, self.velocity, self.acceleration, self.jerk)[self.order :]
        return tuple(part for part in known if part is not None)


def strength(default: float = 0.0, *, sign: int = 0, low: float = -math.inf, high: float = math.inf) -> Array:
    """The field that holds the strength of an effect; `sign` is +1 or −1 where physics allows but one, `low` and `high`
    are further ends of what it allows. No fit leaves them, and a strength that ends there is no finding. It is given as
    a number in the effect's `unit`, or as text with a unit of that kind.
    """
    low, high = max(low, 0.0) if sign > 0 else low, min(high, 0.0) if sign < 0 else high
    return eqx.field(
        converter=FieldConverter(lambda field, given: number_in(field.what, given, field.unit, float)),
        default=default,
        metadata={"range": (low, high)},
    )


def on_one_axis(now: Moment, axis: int, value: Array) -> Float[Array, " axes"]:
    """A vector with `value` on one axis and zero elsewhere; put together, as filling one in is slow for many dies."""
    value = jnp.asarray(value)
    parts, zero = range(now.displacement.shape[0]), jnp.zeros_like(value)
    if isinstance(axis, jax.Array):  # a number under `jit`, where the author of an effect did not make it structure
        return jnp.stack([jnp.where(axis == i, value, zero) for i in parts])
    return jnp.stack([value if i == axis else zero for i in parts])


class Effect(AbstractEffect):
    """A named physical effect: `name`, `unit` of its strength in SI, `law` as a formula, `reference`.

    **Raises:** `InputError` for a strength that is no number, or not finite; a traced one passes.
    """

    name: ClassVar[str] = ""
    unit: ClassVar[str] = "1"
    law: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    own_size: ClassVar[int] = 0
    own_is_linear: ClassVar[bool] = False
    of_instrument: ClassVar[bool] = False  # belongs to a record, not to the device

    if TYPE_CHECKING:  # a member's field may stand in the place of a property, not of a class variable

        @property
        def strength(self) -> Array: ...

    else:
        strength: AbstractVar[Array]

    def __check_init__(self):
        check_finite("strength", self.strength)

    @property
    def where(self) -> str:
        """Which of its variants this is: `x`, `y`, `x_to_y`, `stiffness`..., or empty."""
        axis = getattr(self, "axis", None)
        return "" if axis is None else "xy"[axis]

    @property
    def axes_needed(self) -> int:
        """How many axes a device must have for this effect."""
        return 1 + max(getattr(self, name, 0) for name in ("axis", "source", "target"))

    @property
    def label(self) -> str:
        """Name and variant, e.g. `cubic_stiffness x`."""
        return f"{self.name} {self.where}".rstrip()

    def along(self, now: Moment, value: Array) -> Float[Array, " axes"]:
        """A vector with `value` on the effect's own axis and zero elsewhere."""
        return on_one_axis(now, getattr(self, "axis", 0), value)


class ForceEffect(Effect):
    """Acts on the proof mass.

    **Raises:** `InputError` for an own state without `own_rate`, and for the reverse: neither would do anything.
    """

    def __check_init__(self):
        if missing := self.unmoved():
            raise InputError(f"Effect `{self.label}` must have {missing}.")

    @classmethod
    def unmoved(cls) -> str:
        """What an effect with a state of its own lacks, in words; empty for nothing."""
        moves = cls.own_rate is not ForceEffect.own_rate
        if cls.own_size and not moves:
            return (
                "the method `own_rate(self, now)`, the time derivative of its own state, as `own_size` of "
                f"{cls.__name__} is {cls.own_size}, but has not: the state would stay as it is"
            )
        if moves and not cls.own_size:
            return (
                f"an `own_size`, how many numbers its own state has, as {cls.__name__} has a method `own_rate`, but "
                "has not: it would never be asked"
            )
        return ""

    @abc.abstractmethod
    def force(self, now: Moment) -> Float[Array, " axes"]:
        """Force on the proof mass [N] along each axis."""

    def own_start(self, now: Moment) -> Float[Array, " own"]:
        """The effect's own state where the mass is at time zero; zero unless overridden."""
        return jnp.zeros(self.own_size)

    def own_rate(self, now: Moment) -> Float[Array, " own"]:
        """Time derivative of the effect's own state; override it together with `own_size`."""
        return jnp.zeros_like(now.own)


class SurroundingsEffect(ForceEffect):
    """Changes what all other effects see of the surroundings, and acts on the mass only through them. First all that
    warms is added up, then all that the bias voltage gains at that temperature.
    """

    def force(self, now: Moment) -> Float[Array, " axes"]:
        """None."""
        return jnp.zeros_like(now.displacement)

    def warmer(self, now: Moment) -> Array:
        """How much warmer than the surroundings the device is [K]."""
        return jnp.zeros_like(now.warming)

    def more_volts(self, now: Moment) -> Array:
        """How much higher than asked for the bias voltage is [V]."""
        return jnp.zeros_like(now.bias_voltage)


class DriveEffect(Effect):
    """Acts between the command and the electrodes, or, a `last` one, between them and the mass: `now.force` is then
    what all electrodes give.
    """

    last: ClassVar[bool] = False

    @abc.abstractmethod
    def applied(self, command: Float[Array, " axes"], now: Moment) -> Float[Array, " axes"]:
        """Force that the electrodes apply [N] when `command` [N] is asked for."""


class ReadoutEffect(Effect):
    """Acts between the displacement and the recorded voltage.

    `last` puts it behind all others; a `sharp` one has corners that a lock-in needs many samples to see; a `curve`
    shows nothing but the displacement of its own axis, now, by a smooth law that a filter may know.
    """

    last: ClassVar[bool] = False
    sharp: ClassVar[bool] = False
    curve: ClassVar[bool] = False

    @abc.abstractmethod
    def signal(self, volts: Float[Array, " axes"], now: Moment) -> Float[Array, " axes"]:
        """Voltage of each channel, given what it would be without this effect."""


class SweepEffect(Effect):
    """Acts on the way a frequency sweep is taken: `speed` at which the frequency moves."""

    @abc.abstractmethod
    def speed(self) -> Array:
        """Speed of the sweep [rad/s²]."""


class UntilNow(eqx.Module):
    """How a device moved in a row and in those before it, the last of them first: of each, V + e^{−B(t − t_k)}·Δ.

    Args:
        settled: phasors V that each settles to [V].
        ringing: how far from them each began, Δ [V]; zero where it settled at once.
        decay: matrix B [1/s] by which that dies away; `left` is e^{−B·dwell}.
        began, ended: how long ago [s]; infinite where nobody knows.
    """

    settled: Complex[Array, "k axes"]
    ringing: Complex[Array, "k axes"]
    decay: Complex[Array, "k axes axes"]
    left: Complex[Array, "k axes axes"]
    began: Float[Array, " k"]
    ended: Float[Array, " k"]

    @classmethod
    def settled_at(cls, values: Complex[Array, " axes"]) -> "UntilNow":
        """Of a device that has always moved as it does."""
        none, still = jnp.zeros((1, values.size), complex), jnp.zeros((1, values.size, values.size), complex)
        return cls(values[None] + 0j, none, still, still, jnp.full(1, jnp.inf), jnp.zeros(1))


class LockInRow(eqx.Module):
    """What a lock-in knows of one row.

    Args:
        frequency: of the drive [rad/s].
        force: complex amplitude of the command per axis [N].
        before: phasors that were read in the row before [V].
        record, sweep, time: as in a `Moment`.
        dwell: time since the row before [s], zero where none is known.
        decay: matrix B [1/s] by which what differs from the settled motion of the row dies away, e^{−Bt}.
        left: e^{−Bt} after the dwell; it and B are zero where no dwell is known.
        until_now: how the device moved in this row and in those before it, for effects that `remember` rows.
    """

    frequency: Array
    force: Complex[Array, " axes"]
    before: Complex[Array, " axes"]
    record: Array
    sweep: Array
    time: Array
    dwell: Array
    decay: Complex[Array, "axes axes"]
    left: Complex[Array, "axes axes"]
    until_now: UntilNow


class LockInEffect(Effect):
    """Acts on the phasors that a lock-in makes of the voltages of a sweep; a `last` one behind all others. One that
    `rings` asks what is left of the motion of the row before; one that `remembers` asks what rows further back showed;
    one `beside_any_motion` adds the same to whatever moves, and does so in a free decay, too.
    """

    last: ClassVar[bool] = False
    rings: ClassVar[bool] = False
    remembers: ClassVar[bool] = False
    beside_any_motion: ClassVar[bool] = False

    @abc.abstractmethod
    def phasors(self, values: Complex[Array, " axes"], row: LockInRow) -> Complex[Array, " axes"]:
        """Phasor of each channel [V], given what it would be without this effect."""
