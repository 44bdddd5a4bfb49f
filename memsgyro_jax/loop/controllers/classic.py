"""Classic control: a phase-locked drive axis and a sense axis that is demodulated or rebalanced."""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.device.gyro import VX, AbstractGyro, Inertial, Pair, Scalar, X, check_positive, number

from ..observers.base import Clock, Estimate, LockReadings
from ..observers.settings import arrays
from ..readout import AbstractReadout
from .base import AbstractController
from .demodulator import TrackingDemodulator
from .phase_locked_drive import DriveState, PhaseLockedDrive
from .rebalance_design import DRIVE_SHARE, dynamic_stiffness, rebalance_design
from .sense import AbstractSense, ForceRebalance, OpenSense


class ClassicState(NamedTuple):
    """Of drive axis and sense axis."""

    drive: DriveState
    sense: Any


class ClassicControl(AbstractController[ClassicState]):
    """Drives x by phase-locked loop and gain control and reads the rate off y, from the read-out's volts alone.

    `drive` holds x = A cos φ, `sense` measures y in open loop or rebalances it. `scale` [V per unit] and `offset` [V]
    are those of the read-out's design, `signals` what it measures. The rate given out is `rate_scale` times (what the
    design's scale factor makes of y, less `rate_offset` [rad/s]): the trim of a die, 1 and 0 for none. It belongs to
    `NoObserver`. Make one with `open_loop` or `force_rebalance`.
    """

    drive: PhaseLockedDrive
    sense: AbstractSense
    scale: Pair = arrays()
    offset: Pair = arrays()
    rate_offset: Scalar = number("rad/s", default=0.0, metadata={"unit": "rad/s"})
    rate_scale: Scalar = number(default=1.0)
    signals: tuple[int, int] = eqx.field(static=True, default=(X, X + 1))
    usually_tuned: ClassVar[tuple[str, ...]] = (
        "drive.phase_gain", "drive.phase_integral", "drive.force_gain", "drive.force_integral",
    )  # fmt: skip

    @property
    def sets_bandwidth(self) -> Mapping[str, tuple[str, ...]]:  # type: ignore[override]
        """Of the sense axis."""
        return {words: tuple(f"sense.{path}" for path in paths) for words, paths in self.sense.sets_bandwidth.items()}

    @classmethod
    def open_loop(
        cls, gyro: AbstractGyro, readout: AbstractReadout, *, amplitude: Scalar, bandwidth: Scalar | None = None,
        drive_bandwidth: Scalar | None = None,
    ) -> "ClassicControl":  # fmt: skip
        """For the design `gyro`, swinging at `amplitude` [m, or text]: y is free, and its displacement is the rate.

        `bandwidth` [Hz] of the sense axis' demodulator is a tenth of the drive's frequency, `drive_bandwidth` of the
        drive's, which sets the gains of both drive loops, a twentieth, unless given. Raises `InputError` for numbers
        that are not positive.
        """
        amplitude, bandwidth, drive_bandwidth = _in_si(amplitude, bandwidth=bandwidth, drive_bandwidth=drive_bandwidth)
        omega = locked_frequency(gyro, nulled=False)
        drive = _drive(gyro, readout, amplitude, omega, drive_bandwidth)
        sense = OpenSense(
            TrackingDemodulator(omega / (20.0 * jnp.pi) if bandwidth is None else bandwidth),
            _conversion(gyro, omega, amplitude),
        )
        return cls(drive, sense, readout.scale, readout.offset, signals=readout.signals)

    @classmethod
    def force_rebalance(
        cls, gyro: AbstractGyro, readout: AbstractReadout, *, amplitude: Scalar, bandwidth: Scalar | None = None,
        demodulator_bandwidth: Scalar | None = None, drive_bandwidth: Scalar | None = None,
    ) -> "ClassicControl":  # fmt: skip
        """For the design `gyro`, swinging at `amplitude` [m, or text]: forces hold y still and are the rate and the
        quadrature.

        Stiffness that couples the axes moves the drive's resonance as y is let go or held: drive loops slower than that
        shift are unstable. `drive_bandwidth`, left out, is six times the shift, within a twentieth and a fifth of the
        drive's frequency.

        `bandwidth` [Hz] is where the loops cross. Where `demodulator_bandwidth` is five times as wide as the axes are
        apart, or wider, they close around both, and cross at a quarter of it when left out; else it is a good third of
        what the sense resonance, seen at the split, bears (`rebalance_design`). `demodulator_bandwidth`, left out, is a
        twentieth of the drive's frequency, or where the axes are farther apart than that closes around, as narrow as
        filters the resonance. Raises `InputError` for numbers that are not
        positive, and for a `bandwidth` at which the sense axis of the design is not stable.
        """
        amplitude, bandwidth, demodulator_bandwidth, drive_bandwidth = _in_si(
            amplitude, bandwidth=bandwidth, demodulator_bandwidth=demodulator_bandwidth, drive_bandwidth=drive_bandwidth
        )
        omega = locked_frequency(gyro, nulled=True)
        follow = _FOLLOW * _shift_of_nulling(gyro)
        if drive_bandwidth is None:
            drive_bandwidth = jnp.clip(follow, omega / DRIVE_SHARE, omega / _FASTEST_SHARE) / (2.0 * jnp.pi)
        drive = _drive(gyro, readout, amplitude, omega, drive_bandwidth)
        dynamics = gyro.dynamics(Inertial())
        if bandwidth is not None:
            check_positive("bandwidth", bandwidth)
        made = rebalance_design(dynamics, omega, bandwidth, demodulator_bandwidth, follow)
        conversion = _conversion(gyro, omega, amplitude)
        per_rate = _coriolis(gyro) * omega * amplitude / dynamics.gain[1]
        gains = (made.gain, made.integral)
        sense = ForceRebalance(TrackingDemodulator(made.width), conversion, per_rate, *gains, *gains, made.turn)
        return cls(drive, sense, readout.scale, readout.offset, signals=readout.signals)

    def init(self) -> ClassicState:
        """At rest."""
        return ClassicState(self.drive.init(), self.sense.init())

    def command(self, state: ClassicState, estimate: Estimate, clock: Clock) -> tuple[Pair, ClassicState]:
        """Forces whose fundamental has the phase φ: taken in the middle of the sample, and raised by the
        (ωh/2)/sin(ωh/2) that holding takes away.
        """
        drive, half = state.drive, 0.5 * state.drive.speed * clock.period
        held, (cos, sin) = half / jnp.sin(half), _turn(drive.phase + half)
        i, q = self.sense.force(state.sense)
        return (-held * drive.force * sin, held * (i * cos - q * sin)), state

    def measured(self, state: ClassicState, volts: Pair, clock: Clock) -> ClassicState:
        """Both axes after the sample that ends at `clock`."""
        drive = self.drive.advanced(state.drive, clock.period)
        turn = _turn(drive.phase)
        shown = tuple(v - o for v, o in zip(volts, self.offset, strict=True))
        first, second = (self._per_volt(axis, drive.speed) for axis in (0, 1))
        sense = self.sense.step(state.sense, shown[1], turn, second, clock.period)
        return ClassicState(self.drive.step(drive, shown[0], turn, first, clock.period), sense)

    def output(self, state: ClassicState, estimate: Estimate) -> Estimate:
        """The rate, trimmed, and what else the electronics read."""
        rate, minus_quadrature = self.sense.rate(state.sense)
        i, q = self.drive.displacement(state.drive, self._per_volt(0, state.drive.speed))
        readings = LockReadings(
            quadrature=-minus_quadrature,
            frequency=state.drive.speed / (2.0 * jnp.pi),
            amplitude=jnp.sqrt(i**2 + q**2 + (_TINY * self.drive.amplitude) ** 2),
            force=state.drive.force,
        )
        return estimate.read(self.rate_scale * (rate - self.rate_offset), readings)

    def _per_volt(self, axis: int, speed: Scalar) -> Pair:
        """The phasor of displacement per volt at ω = `speed`; a velocity is jω times a displacement."""
        per_unit = 1.0 / self.scale[axis]
        zero = 0.0 * per_unit
        return (zero, -per_unit / speed) if self.signals[axis] >= VX else (per_unit, zero)


_TINY = 1e-9  # of the amplitude: a size has a derivative at rest too
_STEPS = 8  # of Newton's way to the locked frequency, which doubles its digits
_FASTEST_SHARE = 5.0  # the same where the loops must follow a resonance that moves
_FOLLOW = 6.0  # times the shift of the resonance
_LIMIT = 20.0  # times the force that holds the amplitude: how fast a start may be


def _in_si(amplitude: Any, **widths: Any) -> tuple[Any, ...]:
    """An amplitude in m and bandwidths in Hz from numbers or text; None, where one is left out, passes."""
    read = (None if given is None else quantity(name, given, "Hz") for name, given in widths.items())
    return quantity("amplitude", amplitude, "m"), *read


def _turn(phase: Scalar) -> Pair:
    return jnp.cos(phase), jnp.sin(phase)


def _coriolis(gyro: AbstractGyro) -> Scalar:
    """Acceleration of y per rate and velocity of x: 2."""
    return gyro.dynamics(Inertial(rate=jnp.ones(()))).coriolis[1][0] - gyro.dynamics(Inertial()).coriolis[1][0]


def _conversion(gyro: AbstractGyro, omega: Scalar, amplitude: Scalar) -> Pair:
    """`j Δ / (2 ω A)`, 2 being the Coriolis factor."""
    found = 1j * dynamic_stiffness(gyro.dynamics(Inertial()), omega) / (_coriolis(gyro) * omega * amplitude)
    return jnp.real(found), jnp.imag(found)


def _shift_of_nulling(gyro: AbstractGyro) -> Scalar:
    """By how much [rad/s] the stiffness between the axes keeps the free mode from the drive axis' own frequency."""
    (kxx, kxy), (kyx, kyy) = gyro.dynamics(Inertial()).stiffness
    half = 0.5 * (kyy - kxx)
    apart = jnp.sqrt(half**2 + kxy * kyx + (_TINY * kxx) ** 2)  # a root has a slope where the axes match, too
    return jnp.abs(apart - jnp.abs(half)) / (2.0 * jnp.sqrt(kxx))


@at_once
def locked_frequency(gyro: AbstractGyro, *, nulled: bool) -> Scalar:
    """The ω [rad/s] at which a force along x in phase with its velocity swings it, with y free, or `nulled` by a force
    on y: there a phase-locked loop locks.

    Free axes that couple have two such frequencies, at their modes; this is that of the mode which moves along x most.
    """
    dynamics = gyro.dynamics(Inertial())
    (kxx, kxy), (kyx, kyy) = dynamics.stiffness
    if nulled:
        return jnp.sqrt(kxx)
    (_, dxy), (dyx, _) = dynamics.damping

    def out_of_phase(omega: Scalar) -> Scalar:
        across = (kxy + 1j * omega * dxy) * (kyx + 1j * omega * dyx)
        return kxx - omega**2 - jnp.real(across / dynamic_stiffness(dynamics, omega))

    mean, half = 0.5 * (kxx + kyy), jnp.sqrt(0.25 * (kxx - kyy) ** 2 + kxy * kyx)
    omega = jnp.sqrt(jnp.where(kxx > kyy, mean + half, mean - half))
    for _ in range(_STEPS):
        value, slope = jax.jvp(out_of_phase, (omega,), (jnp.ones_like(omega),))
        omega = omega - value / slope
    return omega


def _drive(
    gyro: AbstractGyro, readout: AbstractReadout, amplitude: Scalar, omega: Scalar, bandwidth: Scalar | None
) -> PhaseLockedDrive:
    """Gains at which both loops, with the demodulator's pole b, have a double pole at b/2 beside a slow integral."""
    check_positive("amplitude", amplitude)
    if readout.signals[0] not in (X, VX):
        raise InputError("A read-out for a phase-locked drive must measure x first, its displacement or its velocity.")
    width = omega / (2.0 * jnp.pi * DRIVE_SHARE) if bandwidth is None else jnp.asarray(bandwidth)
    dynamics = gyro.dynamics(Inertial())
    pole, decay, gain = 2.0 * jnp.pi * width, 0.5 * dynamics.damping[0][0], dynamics.gain[0]
    per_force = gain / (2.0 * omega)  # growth of the amplitude
    phase_gain, force_gain = 0.25 * pole, 0.25 * pole / per_force
    return PhaseLockedDrive(
        amplitude=amplitude,
        frequency=omega / (2.0 * jnp.pi),
        demodulator=TrackingDemodulator(width),
        phase_gain=phase_gain,
        phase_integral=phase_gain * 0.1 * pole,
        force_gain=force_gain,
        force_integral=force_gain * (decay + 0.02 * pole),
        limit=_LIMIT * 2.0 * decay * omega * amplitude / gain,
    )
