"""Section `[readout]` with `kind = "carrier"`: what stands around the sensor, part by part."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from memsgyro_jax.base.quantity import Density, Farad, FileSection, Hertz, In, Pair, Radian, Volt, Whole
from memsgyro_jax.device.electronics import CarrierDetection, ChargeStage
from memsgyro_jax.loop.carrier_readout import CarrierReadout
from memsgyro_jax.loop.flicker import Flicker
from memsgyro_jax.loop.readout import AbstractReadout, Adc


class Converter(FileSection):
    """`adc = { limit = "1 V", bits = 16 }`: half the span and the word length."""

    limit: Annotated[float, Field(gt=0.0), In("V")]
    bits: Annotated[Whole, Field(ge=1, le=48)]

    def build(self) -> Adc:
        """The converter."""
        return Adc(self.limit, self.bits)


class Flickering(FileSection):
    """`flicker = { delay = ["0 s", "1 ns"], lowest, decades }`: a delay of x and y that wanders as 1/f."""

    delay: Pair[Annotated[float, Field(ge=0.0), In("s")]]
    lowest: Annotated[float, Field(gt=0.0), In("Hz")] = 0.1
    decades: Annotated[Whole, Field(ge=1, le=12)] = 5

    def build(self) -> Flicker:
        """The flicker."""
        return Flicker(self.delay, self.lowest, self.decades)


_Stage = Annotated[float, Field(gt=0.0), In("F")]


class Carrier(FileSection):
    """`kind = "carrier"`: a carrier on both halves of the sensor, a charge amplifier, synchronous detection, low-pass,
    converter, as their equivalent in the base band at the `frequency` of the motion.

    `gradient` and `capacitance` are those of one half. `resistor` and `gain_bandwidth` left out are infinite, noises
    absent.
    """

    kind: Literal["carrier"]
    gradient: Pair[Annotated[float, Field(gt=0.0), In("F/m")]]
    capacitance: Pair[_Stage]
    capacitance_mismatch: Pair[Farad] = (0.0, 0.0)
    carrier: Annotated[float, Field(gt=0.0), In("V")]
    carrier_frequency: Hertz
    frequency: Hertz
    bandwidth: Hertz
    order: Annotated[Whole, Field(ge=1, le=12)] = 2
    phase: Radian = 0.0
    feedback: Pair[_Stage]
    parasitic: Pair[Farad] = (0.0, 0.0)
    resistor: Annotated[float, Field(gt=0.0), In("ohm")] | None = None
    gain_bandwidth: Hertz | None = None
    opamp_offset: Pair[Volt] = (0.0, 0.0)
    opamp_noise: Density = 0.0
    opamp_corner: Annotated[float, Field(ge=0.0), In("Hz")] = 0.0
    temperature: Annotated[float, Field(ge=0.0), In("K")] = 0.0
    adc: Converter | None = None
    flicker: Flickering | None = None

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
