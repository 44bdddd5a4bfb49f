"""The drive axis of a classic gyro: a phase-locked loop and an automatic gain control."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.device.gyro import Pair, Scalar, check_not_negative, check_positive, number

from .demodulator import AbstractDemodulator


class DriveState(NamedTuple):
    """Phase φ [rad] and its speed [rad/s], the integrals of both loops [rad/s, N], the size of the force [N], and the
    demodulator's state.
    """

    phase: Scalar
    speed: Scalar
    tuned: Scalar
    pushed: Scalar
    force: Scalar
    held: Any


class PhaseLockedDrive(Displayed):
    """Holds the drive axis at `amplitude` [m] on its resonance: `x = A cos φ`, `force = -F sin φ`.

    Phase-locked loop: φ turns with `frequency` [Hz] corrected by `phase_gain` [1/s] times the sine of the phase by
    which x leads, plus `phase_integral` [1/s²] times its integral, by at most the share `pull` of it. Beside the
    resonance, where the swing is small and that sine large, the integral runs faster by `amplitude` over the swing, at
    most `haste` times (1: never). Gain control: F is `force_gain` [N/m] times the missing amplitude plus
    `force_integral` [N/(m·s)] times its integral, between zero and `limit` [N]. Zero gains hold the frequency, and
    leave the mass undriven. From rest it starts by itself.
    """

    amplitude: Scalar = number()
    frequency: Scalar = number()
    demodulator: AbstractDemodulator
    phase_gain: Scalar = number()
    phase_integral: Scalar = number()
    force_gain: Scalar = number()
    force_integral: Scalar = number()
    limit: Scalar = number()
    pull: Scalar = number(default=0.3)
    haste: Scalar = number(default=16.0)

    def __check_init__(self):
        for name in ("amplitude", "frequency", "limit"):
            check_positive(name, getattr(self, name))
        check_positive("haste", self.haste)
        for name in ("phase_gain", "phase_integral", "force_gain", "force_integral", "pull"):
            check_not_negative(name, getattr(self, name))

    def init(self) -> DriveState:
        """At rest, turning with the design's frequency."""
        zero, speed = jnp.zeros(()), 2.0 * jnp.pi * self.frequency
        return DriveState(zero, speed, speed, zero, zero, self.demodulator.init())

    def displacement(self, state: DriveState, per_volt: Pair) -> Pair:
        """In-phase and quadrature part of x [m]; `per_volt` is the phasor of x per volt."""
        return phasor_product(self.demodulator.phasor(state.held), per_volt)

    def step(self, state: DriveState, volts: Scalar, turn: Pair, per_volt: Pair, period: Scalar) -> DriveState:
        """Both loops after one more sample of `volts`, whose phase has the `turn` (cos φ, sin φ)."""
        held = self.demodulator.step(state.held, volts, turn, period)
        i, q = phasor_product(self.demodulator.phasor(held), per_volt)
        size = jnp.sqrt(i**2 + q**2 + (_SILENCE * self.amplitude) ** 2)
        lead, missing = q / size, self.amplitude - size
        nominal = 2.0 * jnp.pi * self.frequency
        faster = 1.0 + lead**2 * (jnp.clip(self.amplitude / size, 1.0, self.haste) - 1.0)
        most = self.pull * nominal
        tuned = nominal + jnp.clip(state.tuned - nominal + self.phase_integral * faster * lead * period, -most, most)
        pushed = jnp.clip(state.pushed + self.force_integral * missing * period, 0.0, self.limit)
        return DriveState(
            phase=state.phase,
            speed=tuned + self.phase_gain * lead,
            tuned=tuned,
            pushed=pushed,
            force=jnp.clip(pushed + self.force_gain * missing, 0.0, self.limit),
            held=held,
        )

    def advanced(self, state: DriveState, period: Scalar) -> DriveState:
        """One sample later, the phase kept within ±π."""
        phase = state.phase + state.speed * period
        return state._replace(phase=jnp.where(phase > jnp.pi, phase - 2.0 * jnp.pi, phase))


_SILENCE = 1e-6  # of the amplitude: below, there is no phase to follow


def phasor_product(phasor: Pair, by: Pair) -> Pair:
    """The product of two phasors."""
    (a, b), (c, d) = phasor, by
    return a * c - b * d, a * d + b * c
