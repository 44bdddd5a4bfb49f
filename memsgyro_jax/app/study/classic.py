"""Sections of classic control: a phase-locked drive, the sense axis open or rebalanced, and no observer."""

from typing import Annotated, Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import FileSection, Hertz, In, Newton, PerSecond, Pure, Radian, Rate, Share, field_unit
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.loop.controllers import AbstractController, ClassicControl, ProductDemodulator
from memsgyro_jax.loop.observers import AbstractObserver, NoObserver
from memsgyro_jax.loop.readout import AbstractReadout


_Length = Annotated[float, Field(gt=0.0), In("m")]
_Integral = Annotated[float, Field(ge=0.0), In("1/s^2")]
_ForceGain = Annotated[float, Field(ge=0.0), In("N/m")]
_ForceIntegral = Annotated[float, Field(ge=0.0), In("N/(m*s)")]

_PLACES = {  # entry of the section: path of the number in the controller
    "amplitude": "drive.amplitude",
    "drive_bandwidth": "drive.demodulator.bandwidth",
    "phase_gain": "drive.phase_gain",
    "phase_integral": "drive.phase_integral",
    "force_gain": "drive.force_gain",
    "force_integral": "drive.force_integral",
    "limit": "drive.limit",
    "sense_bandwidth": "sense.demodulator.bandwidth",
    "gain": "sense.gain",
    "integral": "sense.integral",
    "quadrature_gain": "sense.quadrature_gain",
    "quadrature_integral": "sense.quadrature_integral",
    "turn": "sense.turn",
    "rate_offset": "rate_offset",
    "rate_scale": "rate_scale",
}


class Unobserved(FileSection):
    """`kind = "none"`: no observer, for a controller that measures by itself."""

    kind: Literal["none"]

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """None."""
        return NoObserver.for_device(gyro, readout)


class Classic(FileSection):
    """`kind = "classic"`: phase-locked loop and gain control on the drive axis, the sense axis open or rebalanced.
    Gains that are left out follow the device (`ClassicControl`).
    """

    kind: Literal["classic"]
    sense: Literal["open", "rebalanced"] = "open"
    """Whether the motion of the sense axis is measured (open loop) or held at zero by forces (force-to-rebalance)."""
    demodulator: Literal["tracking", "product"] = "tracking"
    """Of both axes: "tracking" follows the oscillation without ripple, "product" multiplies and smooths (thesis
    (5.3))."""
    amplitude: _Length | None = None
    """Amplitude of the drive axis that the gain control holds; left out, 2 % of the travel."""
    bandwidth: Hertz | None = None
    """Where the rebalance loops cross; left out, what the device bears. Not of an open loop."""
    drive_bandwidth: Hertz | None = None
    """Bandwidth (-3 dB) of the drive axis' demodulator, which sets the gains of both drive loops; left out, a twentieth
    of the drive frequency, rebalanced up to a fifth."""
    sense_bandwidth: Hertz | None = None
    """Bandwidth (-3 dB) of the sense axis' demodulator, and so of an open loop; left out, a tenth of the drive
    frequency, rebalanced a twentieth, or what the split of the axes asks for. From five splits on, rebalance loops
    close around both axes."""
    phase_gain: PerSecond | None = None
    """Proportional gain of the phase-locked loop: angular frequency per sine of the phase error."""
    phase_integral: _Integral | None = None
    """Integral gain of the phase-locked loop."""
    force_gain: _ForceGain | None = None
    """Proportional gain of the amplitude control: force per missing amplitude."""
    force_integral: _ForceIntegral | None = None
    """Integral gain of the amplitude control."""
    limit: Newton | None = None
    """Largest drive force; left out, 20 times the one that holds the amplitude."""
    gain: Share | None = None
    """Proportional gain of the rebalance loop."""
    integral: PerSecond | None = None
    """Integral gain of the rebalance loop."""
    quadrature_gain: Share | None = None
    """Proportional gain of the quadrature loop; zero, with its integral, leaves the quadrature alone."""
    quadrature_integral: PerSecond | None = None
    """Integral gain of the quadrature loop."""
    turn: Radian | None = None
    """Angle by which what is left of rate and quadrature is turned before it is balanced: zero is the phase of the
    displacement, nearly a right angle that of the velocity; left out, what the demodulator's bandwidth asks for."""
    rate_offset: Rate = 0.0
    """Trim of the bias: what is taken off the rate that the design's scale factor gives."""
    rate_scale: Pure = 1.0
    """Trim of the scale factor: what the rate, less `rate_offset`, is multiplied by."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller; raises `InputError` for gains of a loop that there is not."""
        widths: dict[str, Any] = {"drive_bandwidth": self.drive_bandwidth}
        make: Any = ClassicControl.open_loop
        if self.sense == "open":
            widths["bandwidth"] = self.sense_bandwidth
            if self.bandwidth is not None:
                raise InputError(
                    "bandwidth is that of a rebalanced sense axis; give `sense_bandwidth`, that of the open loop's "
                    'demodulator, or `sense = "rebalanced"`'
                )
        else:
            make = ClassicControl.force_rebalance
            widths |= {"bandwidth": self.bandwidth, "demodulator_bandwidth": self.sense_bandwidth}
        made = make(gyro, readout, amplitude=self.amplitude, **widths)
        given = {name: getattr(self, name) for name in _PLACES}
        changed = {name: jnp.asarray(value, float) for name, value in given.items() if value is not None}
        unknown = [name for name in changed if _at(made, _PLACES[name]) is None]
        if unknown:
            raise InputError(f'{unknown[0]} is a gain of a rebalanced sense axis; give `sense = "rebalanced"`')
        made = eqx.tree_at(lambda m: [_at(m, _PLACES[name]) for name in changed], made, list(changed.values()))
        if self.demodulator == "product":
            where = lambda m: (m.drive.demodulator, m.sense.demodulator)  # noqa: E731
            made = eqx.tree_at(where, made, tuple(ProductDemodulator(d.bandwidth) for d in where(made)))
        return made


def entries_of_classic(controller: ClassicControl) -> dict[str, float | str]:
    """What the section must be given so that it has the controller's numbers: all of them, since some follow others."""
    found = {name: _at(controller, path) for name, path in _PLACES.items()}
    return {
        f"controller.{name}": In(unit_of_classic(f"controller.{_PLACES[name]}") or "1").write(float(np.asarray(value)))
        for name, value in found.items()
        if value is not None
    }


def unit_of_classic(path: str) -> str | None:
    """Unit of the number at `path` of a loop with this controller; None for one that the section does not hold."""
    names = [name for name, place in _PLACES.items() if path == f"controller.{place}"]
    return field_unit(Classic, names[0]) if names else None


def _at(controller: Any, path: str) -> Any:
    for part in path.split("."):
        controller = getattr(controller, part, None)
    return controller
