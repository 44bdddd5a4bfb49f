"""Section `[readout]` with `kind = "carrier"`: what stands around the sensor, part by part."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from memsgyro_jax.base.quantity import Density, Farad, FileSection, Hertz, In, Pair, Radian, Volt, Whole
from memsgyro_jax.device.electronics import CarrierDetection, ChargeStage
from memsgyro_jax.loop.carrier_readout import CarrierReadout
from memsgyro_jax.loop.flicker import Flicker
from memsgyro_jax.loop.readout import AbstractReadout, Adc


class Converter(FileSection):
    """`adc = { limit = "1 V", bits = 16 }`: a converter that rounds and clips."""

    limit: Annotated[float, Field(gt=0.0), In("V")]
    """Half the span: the converter clips beyond ± this."""
    bits: Annotated[Whole, Field(ge=1, le=48)]
    """Word length: a step is the span over 2^bits."""

    def build(self) -> Adc:
        """The converter."""
        return Adc(self.limit, self.bits)


class Flickering(FileSection):
    """`flicker = { delay = ["0 s", "1 ns"], lowest, decades }`: a delay of x and y that wanders as 1/f."""

    delay: Pair[Annotated[float, Field(ge=0.0), In("s")]]
    """Flicker coefficient B (IEEE 952) of each channel's delay, of the one-sided density B²/(π f); zero is none."""
    lowest: Annotated[float, Field(gt=0.0), In("Hz")] = 0.1
    """Frequency below which that density is level."""
    decades: Annotated[Whole, Field(ge=1, le=12)] = 5
    """Number of decades above `lowest` over which it falls as 1/f; beyond them it falls as 1/f²."""

    def build(self) -> Flicker:
        """The flicker."""
        return Flicker(self.delay, self.lowest, self.decades)


_Stage = Annotated[float, Field(gt=0.0), In("F")]


class Carrier(FileSection):
    """`kind = "carrier"`: a carrier on both halves of the sensor, a charge amplifier, synchronous detection, low-pass,
    converter, as their equivalent in the base band.
    """

    kind: Literal["carrier"]
    gradient: Pair[Annotated[float, Field(gt=0.0), In("F/m")]]
    """Change of each half's capacitance per displacement, dC/dx."""
    capacitance: Pair[_Stage]
    """Capacitance of each half at rest."""
    capacitance_mismatch: Pair[Farad] = (0.0, 0.0)
    """Difference of the two halves at rest, which makes an offset."""
    carrier: Annotated[float, Field(gt=0.0), In("V")]
    """Amplitude of the carrier, of opposite sign on the two halves."""
    carrier_frequency: Hertz
    """Frequency of the carrier."""
    frequency: Hertz
    """Frequency of the motion at which scale, phase and noise of the read-out are taken, usually that of the drive."""
    bandwidth: Hertz
    """Bandwidth (-3 dB) of the Butterworth low-pass behind the multiplication."""
    order: Annotated[Whole, Field(ge=1, le=12)] = 2
    """Order of that low-pass."""
    phase: Radian = 0.0
    """Phase of the reference by which the carrier is multiplied."""
    feedback: Pair[_Stage]
    """Feedback capacitance Cf of the charge amplifier."""
    parasitic: Pair[Farad] = (0.0, 0.0)
    """Parasitic capacitance Cp from the amplifier's input to ground."""
    resistor: Annotated[float, Field(gt=0.0), In("ohm")] | None = None
    """Feedback resistor; left out, infinite."""
    gain_bandwidth: Hertz | None = None
    """Gain-bandwidth product of the op-amp; left out, infinite."""
    opamp_offset: Pair[Volt] = (0.0, 0.0)
    """Input offset voltage of the op-amp, which stays at the carrier's frequency, where the low-pass takes it."""
    opamp_noise: Density = 0.0
    """White input voltage noise of the op-amp, one-sided density; zero is none."""
    opamp_corner: Annotated[float, Field(ge=0.0), In("Hz")] = 0.0
    """Frequency below which its 1/f noise is more than that; zero is none."""
    temperature: Annotated[float, Field(ge=0.0), In("K")] = 0.0
    """Temperature of the feedback resistor, for its thermal noise; zero is none."""
    adc: Converter | None = None
    """Analogue-to-digital converter behind the output; left out, nothing is rounded or clipped."""
    flicker: Flickering | None = None
    """Flicker (1/f) of the phase, as a delay that wanders; left out, none."""

    @model_validator(mode="after")
    def _can_exist(self) -> "Carrier":
        self.build()
        return self

    def build(self) -> AbstractReadout:
        """The read-out; raises `InputError` where it cannot exist."""
        infinite: dict[str, Any] = {"resistor": self.resistor, "gain_bandwidth": self.gain_bandwidth}
        detections = tuple(
            CarrierDetection(
                ChargeStage(
                    feedback, 2.0 * rest, parasitic, offset=offset, noise=self.opamp_noise, corner=self.opamp_corner,
                    temperature=self.temperature, **{k: v for k, v in infinite.items() if v is not None},
                ),
                self.carrier, self.carrier_frequency, self.bandwidth, self.phase, self.order,
            )
            for feedback, rest, parasitic, offset in zip(
                self.feedback, self.capacitance, self.parasitic, self.opamp_offset, strict=True
            )
        )  # fmt: skip
        return CarrierReadout(
            detections,
            self.gradient,
            self.frequency,
            self.capacitance_mismatch,
            adc=self.adc and self.adc.build(),
            flicker=self.flicker and self.flicker.build(),
        )
