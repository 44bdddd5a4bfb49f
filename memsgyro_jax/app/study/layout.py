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
    """What every edge loses: beams, fingers and plates are narrower by twice that, gaps wider."""
    thickness: Metre = 0.0
    """Error of the layer's thickness."""
    sidewall: Radian = 0.0
    """Angle by which both walls lean: beams are wider at their foot."""
    misalignment: Radian = 0.0
    """Angle by which the axes of the springs are turned against those of the read-out."""
    stress: Annotated[float, In("Pa")] = 0.0
    """Tensile stress in the springs."""
    gap: Metre = 0.0
    """Error of the gap to the substrate."""
    pressure: Pure = 0.0
    """Error of the gas pressure, relative to that of the layout."""
    temperature: KelvinDifference = 0.0
    """Temperature above 298.15 K: softer silicon, a more viscous gas."""

    def build(self) -> Process:
        """The process."""
        return Process(**self.numbers())


class LayoutDevice(Warm):
    """`kind = "layout"`: a square plate on guided legs above a substrate (`PlateLayout`), made by `[process]`."""

    kind: Literal["layout"]
    side: _Length
    """Side of the square plate."""
    thickness: _Length
    """Thickness of the layer."""
    length_x: _Length
    """Length of the legs that bend along x."""
    length_y: _Length
    """Length of the legs that bend along y."""
    width: _Length
    """Width of every leg."""
    gap: _Length
    """Gap between plate and substrate."""
    pressure: Annotated[float, Field(gt=0.0), In("Pa")]
    """Pressure of the gas."""
    legs: _Positive = 4.0
    """Number of legs that hold each axis."""
    young: Annotated[float, Field(gt=0.0), In("Pa")] = 169e9
    """Young's modulus of the layer at 298.15 K."""
    density: Annotated[float, Field(gt=0.0), In("kg/m^3")] = 2330.0
    """Density of the layer."""
    softening: Annotated[float, In("1/K")] = -6e-5
    """Temperature coefficient of Young's modulus."""
    loss: Annotated[float, Field(ge=0.0), In("1")] = 0.0
    """1/Q of what springs and anchors lose beside the gas; zero is nothing."""

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
