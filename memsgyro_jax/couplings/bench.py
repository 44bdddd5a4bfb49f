"""The device as it stands in the laboratory: with its read-out, and with the artefacts a measurement may have."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex

from .modes import CoupledModes


class LockIn(eqx.Module):
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

    def channels(self, axis: int) -> Complex[Array, " 2"]:
        """Complex gain of both channels when electrode `axis` is driven."""
        common = self.gain * jnp.exp(1j * self.phase)
        drive = self.drive_ratio * jnp.exp(1j * self.drive_asymmetry) if axis else 1.0
        return common * drive * jnp.stack([jnp.ones_like(common), self.gain_ratio * jnp.exp(1j * self.phase_asymmetry)])


class ElectricalFeedthrough(eqx.Module):
    """The drive voltage leaks into the read-out: a phasor in proportion to the command, reported as
    `electrical_feedthrough`.

    `x_drive` and `y_drive` are (channel, (re, im)) in record units per drive, for the electrode driven. Zero or `None`:
    no leak.
    """

    x_drive: Array | None = None
    y_drive: Array | None = None

    def phasor(self, axis: int) -> Complex[Array, " 2"]:
        """Leak into both channels when electrode `axis` is driven."""
        leak = self.y_drive if axis else self.x_drive
        return jnp.zeros(2) + 0j if leak is None else leak[:, 0] + 1j * leak[:, 1]


class FiniteSweepRate(eqx.Module):
    """The frequency moves while the modes ring: `speed` in rad/s per second. Zero: every point is settled. Reported as
    `finite_sweep_rate`.
    """

    speed: Array = eqx.field(converter=jnp.asarray)


class Bench(eqx.Module):
    """Everything a prediction of an experiment depends on; an effect that is `None` is absent and costs nothing."""

    device: CoupledModes
    readout: LockIn = eqx.field(default_factory=LockIn)
    feedthrough: ElectricalFeedthrough | None = None
    sweep_rate: FiniteSweepRate | None = None
