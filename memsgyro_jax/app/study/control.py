"""Section `[controller]` of a study file."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from memsgyro_jax.base.quantity import (
    Acceleration,
    FileSection,
    Hertz,
    In,
    Metre,
    Newton,
    Pair,
    PerSecond,
    Radian,
    Share,
)
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.loop.controllers import (
    AbstractController,
    Ahead,
    DampingCompensation,
    DesignedMotion,
    EnergyControl,
    OpenLoop,
    ReferenceModel,
    Saturated,
    SlidingMode,
    Tone,
    WholeAngle,
)
from memsgyro_jax.loop.controllers.base import Tones, swing
from memsgyro_jax.loop.readout import AbstractReadout

from .classic import Classic
from .laws import AdaptiveGains, Positive, scaled


Axis = Literal["x", "y", "both"]


class Added(FileSection):
    """An auxiliary acceleration `{ frequency, amplitude, phase, axis }`; `axis` is "x", "y" or "both"."""

    frequency: Hertz
    amplitude: Acceleration
    phase: Radian = 0.0
    axis: Axis = "both"


class Force(FileSection):
    """A drive force `{ frequency, amplitude, phase, axis }` in N."""

    frequency: Hertz
    amplitude: Newton
    phase: Radian = 0.0
    axis: Axis = "both"


class Swing(FileSection):
    """A part of a motion `{ frequency, amplitude, phase, axis }` in m; a phase of 90 degrees starts at its height."""

    frequency: Hertz
    amplitude: Metre
    phase: Radian = 0.0
    axis: Axis = "both"


def _tones(given: tuple[Added | Force | Swing, ...]) -> Tones:
    made = [(tone.axis, Tone(tone.frequency, tone.amplitude, tone.phase)) for tone in given]
    x, y = (tuple(tone for axis, tone in made if axis in (name, "both")) for name in "xy")
    return x, y


class Energy(FileSection):
    """`energy = { frequency, amplitude, gain }` of a control law: energy control beside it, thesis (4.21), (4.25)."""

    frequency: tuple[Hertz, Hertz]
    amplitude: tuple[Metre, Metre]
    gain: PerSecond

    def beside(self, law: AbstractController) -> AbstractController:
        """The law with energy control."""
        return EnergyControl(law, self.frequency, self.amplitude, self.gain)


class Actuators(FileSection):
    """Section `[actuators]`: no force goes beyond `limit`, one for both axes or a pair (x, y)."""

    limit: Pair[Annotated[float, Field(gt=0.0), In("N")]]

    def around(self, law: AbstractController) -> AbstractController:
        """The law with these."""
        return Saturated(law, self.limit)


class Compensation(FileSection):
    """`kind = "damping_compensation"`: thesis (4.27), (4.28); `ahead` feeds back half a sample early."""

    kind: Literal["damping_compensation"]
    tones: tuple[Added, ...] = ()
    energy: Energy | None = None
    ahead: bool = False

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        plain = DampingCompensation(_tones(self.tones))
        law = Ahead(plain) if self.ahead else plain
        return law if self.energy is None else self.energy.beside(law)


class Reference(FileSection):
    """`kind = "reference_model"`: thesis (4.17), (4.18); `frequency` of x and y, which must differ."""

    kind: Literal["reference_model"]
    frequency: tuple[Hertz, Hertz]
    tones: tuple[Added, ...] = ()
    energy: Energy | None = None

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        law = ReferenceModel(self.frequency, _tones(self.tones))
        return law if self.energy is None else self.energy.beside(law)


class Rocking(FileSection):
    """`rocking = { frequency, amplitude, phase }`: the known angle by which a whole-angle law turns the vibration."""

    frequency: Hertz
    amplitude: Radian
    phase: Radian = 0.0


class FreeVibration(FileSection):
    """`kind = "whole_angle"`: thesis (6.1), (6.2); one `frequency` for both axes."""

    kind: Literal["whole_angle"]
    frequency: Hertz
    tones: tuple[Added, ...] = ()
    rocking: Rocking | None = None
    energy: Energy | None = None

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        rocking = self.rocking and Tone(**self.rocking.numbers())
        law = WholeAngle(self.frequency, _tones(self.tones), rocking)
        return law if self.energy is None else self.energy.beside(law)


class Open(FileSection):
    """`kind = "open_loop"`: forces that ignore the estimate."""

    kind: Literal["open_loop"]
    tones: tuple[Force, ...] = ()

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        return OpenLoop(_tones(self.tones))


class Designed(FileSection):
    """`kind = "designed_motion"`: holds the mass on a sum of tones in m."""

    kind: Literal["designed_motion"]
    tones: tuple[Swing, ...]
    settling: PerSecond = 1000.0

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        return DesignedMotion(_tones(self.tones), self.settling)


class Sliding(AdaptiveGains):
    """`kind = "sliding_mode"`: adaptive sliding-mode control, the baseline of thesis 5.4.1. It measures by itself."""

    kind: Literal["sliding_mode"]
    measures: ClassVar[bool] = True
    tones: tuple[Swing, ...]
    layer: Positive = 0.1
    gain: Positive = 1.0
    slope: Share = 1.0
    forgetting: Share = 0.25

    @property
    def displacement(self) -> tuple[float, float]:
        """Where the motion begins."""
        x, y = swing(_tones(self.tones), 0.0)[0]
        return float(x), float(y)

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller; raises `InputError` for another read-out or a coefficient that the device does not have."""
        given: dict[str, Any] = self.numbers()
        adaptation, tones = given.pop("adaptation"), _tones(given.pop("tones"))
        return scaled(SlidingMode.for_device(gyro, readout, tones, **given), adaptation)


_Kinds = Compensation | Reference | Designed | FreeVibration | Sliding | Open | Classic
Controller = Annotated[_Kinds, Field(discriminator="kind")]

MEASURING = tuple(part.model_fields["kind"].annotation.__args__[0] for part in (Classic, Sliding))  # type: ignore[union-attr]
"""Kinds of controller that measure by themselves, and go with `NoObserver`."""
