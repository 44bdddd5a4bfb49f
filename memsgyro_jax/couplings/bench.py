"""The device as it stands in the laboratory: with its read-out, and with the artefacts a measurement may have."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.effects import Effect, ElectricalFeedthrough, FiniteSweepRate, ReadoutDelay
from memsgyro_jax.effects.readout_delay import behind

from .modes import CoupledModes


class LockIn(Displayed):
    """Gains and phases between the force command and the recorded phasors. A sweep can tell only their products apart.

    | field | unit | zero means |
    |---|---|---|
    | `gain` | record unit · s²/m² per unit of drive | not allowed: displacement signal of x per acceleration |
    | `phase` | rad | drive and x channel add no phase |
    | `gain_ratio` | 1 | not allowed: sense channel over drive channel |
    | `phase_asymmetry` | rad | both channels have the same phase (ΔΨ of the paper) |
    | `drive_ratio` | 1 | not allowed: force per command of the y electrode over that of x |
    | `drive_asymmetry` | rad | both drives have the same phase |
    """

    gain: Array = eqx.field(converter=jnp.asarray, default=1.0)
    phase: Array = eqx.field(converter=jnp.asarray, default=0.0)
    gain_ratio: Array = eqx.field(converter=jnp.asarray, default=1.0)
    phase_asymmetry: Array = eqx.field(converter=jnp.asarray, default=0.0)
    drive_ratio: Array = eqx.field(converter=jnp.asarray, default=1.0)
    drive_asymmetry: Array = eqx.field(converter=jnp.asarray, default=0.0)

    @at_once
    def channels(self, axis: int) -> Complex[Array, " 2"]:
        """Complex gain of both channels when electrode `axis` is driven."""
        common = self.gain * jnp.exp(1j * self.phase)
        drive = self.drive_ratio * jnp.exp(1j * self.drive_asymmetry) if axis else 1.0
        return common * drive * jnp.stack([jnp.ones_like(common), self.gain_ratio * jnp.exp(1j * self.phase_asymmetry)])


class LeakPhasors(Displayed):
    """What the effect `electrical_feedthrough` makes of a lock-in's record: a phasor in proportion to the command.

    `x_drive` and `y_drive` are (channel, (re, im)) in record units per drive, for the electrode driven. Zero or `None`:
    no leak.
    """

    x_drive: Array | None = None
    y_drive: Array | None = None

    def phasor(self, axis: int) -> Complex[Array, " 2"]:
        """Leak into both channels when electrode `axis` is driven."""
        leak = self.y_drive if axis else self.x_drive
        return jnp.zeros(2) + 0j if leak is None else leak[:, 0] + 1j * leak[:, 1]


def offset_in(device: CoupledModes, offsets: Array | None, number: int) -> CoupledModes:
    """The device with the offset of its frequencies in a sweep; none in the first."""
    return device if offsets is None or number == 0 else device.offset(offsets[number - 1])


class Bench(Displayed):
    """A device as a frequency sweep sees it; what is `None` is absent and costs nothing.

    `offsets` (sweeps − 1,) are by what share of themselves its frequencies lie higher in the second sweep and those
    after it, as the effect `frequency_offset` has it.
    """

    device: CoupledModes
    readout: LockIn = eqx.field(default_factory=LockIn)
    feedthrough: LeakPhasors | None = None
    sweep_rate: FiniteSweepRate | None = None
    delay: ReadoutDelay | None = None
    offsets: Array | None = None

    @classmethod
    def of(cls, gyro: SingleMassGyro, scale: float | tuple[float, float] = 1.0) -> "Bench":
        """A gyro before a lock-in that reads `scale` [V/m], one number or one per channel, driven in N.

        The gyro may carry `force_misalignment`, `electrical_feedthrough`, `finite_sweep_rate` and `readout_delay`.

        **Raises:** `InputError` for any other effect, which is not of two linear modes.
        """
        volts = jnp.broadcast_to(jnp.asarray(scale, float), (2,))
        leaks = [effect for effect in gyro.effects if isinstance(effect, ElectricalFeedthrough)]
        rates = [effect for effect in gyro.effects if isinstance(effect, FiniteSweepRate)]
        delays = [effect for effect in gyro.effects if isinstance(effect, ReadoutDelay)]
        apart = ElectricalFeedthrough | FiniteSweepRate | ReadoutDelay
        rest = gyro.with_only(effect for effect in gyro.effects if not isinstance(effect, apart))
        drives = jnp.zeros((2, 2, 2))  # electrode, channel, part
        for leak in leaks:
            drives = drives.at[leak.source, leak.target, 0].add(leak.strength)
        return cls(
            CoupledModes.of(rest),
            LockIn(volts[0] / gyro.mass, gain_ratio=volts[1] / volts[0]),
            LeakPhasors(drives[0], drives[1]) if leaks else None,
            FiniteSweepRate(sum(rate.strength for rate in rates)) if rates else None,
            ReadoutDelay(sum(delay.strength for delay in delays)) if delays else None,
        )

    def during(self, number: int) -> CoupledModes:
        """The device as it was during a sweep, by its number from 0."""
        return offset_in(self.device, self.offsets, number)

    def behind(self, frequency: Array) -> Array:
        """By what factor phasors of the motion at `frequency` [rad/s] are seen late, as `Model.behind`."""
        return jnp.ones(()) if self.delay is None else behind(self.delay.strength, frequency)

    def gyro(self, mass: float) -> SingleMassGyro:
        """The device of this mass [kg] with its effects, inverse of `of`; of a leak the part in phase with the drive.

        What the lock-in adds (gains, phases), and what sweeps differ by, is no property of the device and stays behind.
        """
        effects: list[Effect] = []
        if self.feedthrough is not None:
            for electrode in (0, 1):
                phase = self.readout.channels(electrode)
                in_phase = jnp.real(self.feedthrough.phasor(electrode) * jnp.conj(phase / jnp.abs(phase)))
                per_force = in_phase / (self.readout.drive_ratio if electrode else 1.0)
                effects += [ElectricalFeedthrough(electrode, channel, per_force[channel]) for channel in (0, 1)]
        if self.sweep_rate is not None:
            effects.append(self.sweep_rate)
        if self.delay is not None:
            effects.append(self.delay)
        return self.device.gyro(mass).with_effect(*effects)
