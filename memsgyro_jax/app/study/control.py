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


class Oscillation(FileSection):
    """What every tone says."""

    frequency: Hertz
    """Frequency of the sine."""
    amplitude: float
    phase: Radian = 0.0
    """Phase of the sine at time zero; 90 degrees start at its height."""
    axis: Axis = "both"
    """Axis along which it acts; "both" is the same tone on both."""


class Added(Oscillation):
    """`tones = [{ frequency, amplitude, phase, axis }]` that are accelerations: auxiliary signals."""

    amplitude: Acceleration
    """Amplitude (peak) of the acceleration."""


class Force(Oscillation):
    """`tones = [{ frequency, amplitude, phase, axis }]` that are forces: those of the drive."""

    amplitude: Newton
    """Amplitude (peak) of the force."""


class Swing(Oscillation):
    """`tones = [{ frequency, amplitude, phase, axis }]` that are displacements: parts of a motion."""

    amplitude: Metre
    """Amplitude (peak) of the displacement."""


def _tones(given: tuple[Added | Force | Swing, ...]) -> Tones:
    made = [(tone.axis, Tone(tone.frequency, tone.amplitude, tone.phase)) for tone in given]
    x, y = (tuple(tone for axis, tone in made if axis in (name, "both")) for name in "xy")
    return x, y


class Energy(FileSection):
    """`energy = { frequency, amplitude, gain }` of a control law: energy control beside it, thesis (4.21), (4.25)."""

    frequency: tuple[Hertz, Hertz]
    """Frequencies (x, y) at which the axes swing under the law, by which the energy is reckoned."""
    amplitude: tuple[Metre, Metre]
    """Displacement amplitudes (x, y) of which the energy is held."""
    gain: PerSecond
    """How fast a small error of the energy dies away: as exp(-gain·t). Zero leaves the law alone."""

    def beside(self, law: AbstractController) -> AbstractController:
        """The law with energy control."""
        return EnergyControl(law, self.frequency, self.amplitude, self.gain)


class Actuators(FileSection):
    """Section `[actuators]`: forces that end."""

    limit: Pair[Annotated[float, Field(gt=0.0), In("N")]]
    """Largest force of each axis: the command is cut at ± this, and the observer is told."""

    def around(self, law: AbstractController) -> AbstractController:
        """The law with these."""
        return Saturated(law, self.limit)


class Compensation(FileSection):
    """`kind = "damping_compensation"`: cancels the estimated damping, thesis (4.27), (4.28)."""

    kind: Literal["damping_compensation"]
    tones: tuple[Added, ...] = ()
    """Auxiliary accelerations, which make the coefficients observable."""
    energy: Energy | None = None
    """Energy control beside the law; left out, none."""
    ahead: bool = False
    """Whether the motion is fed back as it will be in the middle of the sample over which the force is held."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        plain = DampingCompensation(_tones(self.tones))
        law = Ahead(plain) if self.ahead else plain
        return law if self.energy is None else self.energy.beside(law)


class Reference(FileSection):
    """`kind = "reference_model"`: makes each axis an oscillator of its own frequency, thesis (4.17), (4.18)."""

    kind: Literal["reference_model"]
    frequency: tuple[Hertz, Hertz]
    """Frequencies (x, y) of the oscillators; they must differ for the coefficients to be observable."""
    tones: tuple[Added, ...] = ()
    """Auxiliary accelerations, which make the coefficients observable."""
    energy: Energy | None = None
    """Energy control beside the law; left out, none."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        law = ReferenceModel(self.frequency, _tones(self.tones))
        return law if self.energy is None else self.energy.beside(law)


class Rocking(FileSection):
    """`rocking = { frequency, amplitude, phase }`: the known angle by which a whole-angle law turns the vibration."""

    frequency: Hertz
    """Frequency of the rocking."""
    amplitude: Radian
    """Angle to either side; at 1.2024 rad the mean effect of wrong coefficients on the angle vanishes. Zero is none."""
    phase: Radian = 0.0
    """Phase of the sine at time zero."""


class FreeVibration(FileSection):
    """`kind = "whole_angle"`: lets the mass vibrate freely, so that the angle of the vibration is that of the frame,
    thesis (6.1), (6.2).
    """

    kind: Literal["whole_angle"]
    frequency: Hertz
    """Frequency that both axes are given."""
    tones: tuple[Added, ...] = ()
    """Auxiliary accelerations, which make the coefficients observable."""
    rocking: Rocking | None = None
    """Turning the vibration to and fro by a known angle, against what wrong damping does; left out, none."""
    energy: Energy | None = None
    """Energy control beside the law; left out, none."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        rocking = self.rocking and Tone(**self.rocking.numbers())
        law = WholeAngle(self.frequency, _tones(self.tones), rocking)
        return law if self.energy is None else self.energy.beside(law)


class Open(FileSection):
    """`kind = "open_loop"`: forces that ignore the estimate."""

    kind: Literal["open_loop"]
    tones: tuple[Force, ...] = ()
    """Drive forces; left out, the mass swings down freely."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        return OpenLoop(_tones(self.tones))


class Designed(FileSection):
    """`kind = "designed_motion"`: holds the mass on a sum of tones."""

    kind: Literal["designed_motion"]
    tones: tuple[Swing, ...]
    """Displacement that each axis is held on, a sum of sines."""
    settling: PerSecond = 1000.0
    """How fast any other motion dies away: as exp(-settling·t/2). Zero feeds nothing of the motion back."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractController:
        """The controller."""
        return DesignedMotion(_tones(self.tones), self.settling)


class Sliding(AdaptiveGains):
    """`kind = "sliding_mode"`: adaptive sliding-mode control, the baseline of thesis 5.4.1. It measures by itself."""

    kind: Literal["sliding_mode"]
    measures: ClassVar[bool] = True
    tones: tuple[Swing, ...]
    """Displacement that each axis is held on, a sum of sines."""
    layer: Positive = 0.1
    """Boundary layer of the sliding variable s: within it the switching is linear. A thin one holds the motion
    better."""
    gain: Positive = 1.0
    """Gain of the switching, gain·sat(s/layer)."""
    slope: Share = 1.0
    """λ of the sliding variable s = e' + λ·e, of the error e of the motion."""
    forgetting: Share = 0.25
    """How fast the integrated error of the displacement is forgotten, in units of `frequency`; zero never."""

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
