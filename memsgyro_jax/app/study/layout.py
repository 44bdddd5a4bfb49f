"""A device and a read-out by their layout, and section `[process]`, which makes both."""

from typing import Annotated, Literal

from pydantic import Field

from memsgyro_jax.base.quantity import FileSection, In, KelvinDifference, Metre, Pure, Radian
from memsgyro_jax.device.geometry import LayoutGyro, PlateLayout, Process
from memsgyro_jax.loop.layout_readout import LayoutReadout

from .masses import Warm
from .pickoffs import Charge


_Length = Annotated[float, Field(gt=0.0), In("m")]
_Positive = Annotated[float, Field(gt=0.0), In("1")]


class ProcessSection(FileSection):
    """Section `[process]`: what the process does to device and read-out of `kind = "layout"`; zeros, or what is left
    out, are the drawing. Vary it by `"process.over_etch"` in `[spread]`.
    """

    over_etch: Metre = 0.0
    thickness: Metre = 0.0
    sidewall: Radian = 0.0
    misalignment: Radian = 0.0
    stress: Annotated[float, In("Pa")] = 0.0
    gap: Metre = 0.0
    pressure: Pure = 0.0
    temperature: KelvinDifference = 0.0

    def build(self) -> Process:
        """The process."""
        return Process(**self.numbers())


class LayoutDevice(Warm):
    """`kind = "layout"`: a square plate on guided legs above a substrate (`PlateLayout`), made by `[process]`."""

    kind: Literal["layout"]
    side: _Length
    thickness: _Length
    length_x: _Length
    length_y: _Length
    width: _Length
    gap: _Length
    pressure: Annotated[float, Field(gt=0.0), In("Pa")]
    legs: _Positive = 4.0
    young: Annotated[float, Field(gt=0.0), In("Pa")] = 169e9
    density: Annotated[float, Field(gt=0.0), In("kg/m^3")] = 2330.0
    softening: Annotated[float, In("1/K")] = -6e-5
    loss: Annotated[float, Field(ge=0.0), In("1")] = 0.0

    def build(self, process: Process) -> LayoutGyro:
        """The device; raises `InputError` where the process leaves nothing of a part."""
        given = self.numbers()
        temperature = given.pop("temperature")
        return LayoutGyro(PlateLayout(**given), process, temperature=temperature)


class DrawnComb(Charge):
    """`kind = "layout"`: the comb pick-off and charge amplifier as they are drawn, entries as of
    `kind = "charge_amplifier"`; `[process]` makes the comb (`LayoutReadout`).
    """

    kind: Literal["layout"]  # type: ignore[assignment]  # another kind, the same entries

    def made(self, process: Process) -> LayoutReadout:
        """The read-out; raises `InputError` where the process leaves nothing of it."""
        return LayoutReadout(self.build(), process)
