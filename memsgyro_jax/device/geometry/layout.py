"""A gyro by its drawing and by what the process makes of it."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from memsgyro_jax.base.concrete import check_positive
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.fields import Scalar

from ..gyro import SINGLE_MASS, UNCHANGED, AbstractGyro, Change, Dynamics, Inertial, MotionModel, SingleMassGyro, number
from .films import AIR, couette_damping, effective_viscosity
from .springs import Beam


_DRAWN_AT = 298.15  # K, of the layout's modulus and viscosity


class Process(Displayed):
    """What a process does to every part of a die alike; zeros are the drawing.

    Args:
        over_etch: [m] that every edge loses: beams, fingers and plates are narrower by twice that, gaps wider.
        thickness: error of the layer [m].
        sidewall: angle [rad] by which both walls lean: a beam is wider at its foot, by 2·thickness·tan of it.
        misalignment: angle [rad] by which the springs' axes are turned against those of the read-out.
        stress: tension in the springs [Pa].
        gap: error of the gap to the substrate [m].
        pressure: of the gas, relative to the layout's, less one.
        temperature: above 298.15 K [K]: softer silicon, thicker gas.
    """

    over_etch: Scalar = number("m", default=0.0)
    thickness: Scalar = number("m", default=0.0)
    sidewall: Scalar = number("rad", default=0.0)
    misalignment: Scalar = number("rad", default=0.0)
    stress: Scalar = number("Pa", default=0.0)
    gap: Scalar = number("m", default=0.0)
    pressure: Scalar = number(default=0.0)
    temperature: Scalar = number(default=0.0)


class PlateLayout(Displayed):
    """A square plate on guided legs, `legs` for either axis, above a substrate.

    Args:
        side: of the plate [m].
        thickness: of the layer [m].
        length: of the legs that bend along x, and along y [m].
        width: of every leg [m].
        gap: to the substrate [m].
        pressure: of the gas [Pa].
        legs: that hold each axis.
        young, density: of the layer [Pa, kg/m³].
        softening: of the modulus, per K.
        loss: 1/Q of what springs and anchors lose beside the gas; zero: nothing.
    """

    side: Scalar = number("m")
    thickness: Scalar = number("m")
    length_x: Scalar = number("m")
    length_y: Scalar = number("m")
    width: Scalar = number("m")
    gap: Scalar = number("m")
    pressure: Scalar = number("Pa")
    legs: Scalar = number(default=4.0)
    young: Scalar = number("Pa", default=169e9)
    density: Scalar = number("kg/m^3", default=2330.0)
    softening: Scalar = number("1/K", default=-6e-5)
    loss: Scalar = number(default=0.0)

    def made(self, process: Process) -> SingleMassGyro:
        """The device that `process` makes of the drawing.

        Stiffness of guided legs, 12 E I/L³, with the area moment of the leaning section; the plate's mass alone; the
        Couette film below it, and the `loss` of the springs, √(k m)/Q. Raises `InputError` where nothing is left of a
        part.
        """
        return SingleMassGyro(*self.numbers(process))

    def numbers(self, process: Process) -> tuple[Scalar, ...]:
        """Mass, kxx, kyy, kxy, dxx, dyy, dxy of `made`."""
        thick = self.thickness + process.thickness
        mean = self.width - 2.0 * process.over_etch + thick * jnp.tan(process.sidewall)
        lean = thick * jnp.tan(process.sidewall)  # from the mean width to that at foot and top
        # ∫ a³ dz/12 over the height, a from mean − lean to mean + lean, is that of the mean width times this.
        shape = 1.0 + (lean / mean) ** 2
        young = self.young * (1.0 + self.softening * process.temperature)
        kx, ky = (
            self.legs * Beam(length, mean, thick, young * shape, process.stress).guided
            for length in (self.length_x, self.length_y)
        )
        side = self.side - 2.0 * process.over_etch
        mass = self.density * side**2 * thick
        cosine, sine = jnp.cos(process.misalignment), jnp.sin(process.misalignment)
        kxx, kyy = kx * cosine**2 + ky * sine**2, kx * sine**2 + ky * cosine**2
        gap = self.gap + process.gap
        gas = AIR * (1.0 + process.temperature / _DRAWN_AT) ** 0.7
        viscosity = effective_viscosity(gap, self.pressure * (1.0 + process.pressure), gas)
        dx, dy = (
            couette_damping(side**2, gap, viscosity) + self.loss * jnp.sqrt(stiffness * mass) for stiffness in (kx, ky)
        )
        dxx, dyy = dx * cosine**2 + dy * sine**2, dx * sine**2 + dy * cosine**2
        return mass, kxx, kyy, (kx - ky) * cosine * sine, dxx, dyy, (dx - dy) * cosine * sine


class LayoutGyro(AbstractGyro):
    """The gyro of a `layout` and a `process`, for any loop: with `Vary("device.process.over_etch", Normal(std=0.1e-6))`
    a lot varies in the process, and its two axes together.
    """

    layout: PlateLayout
    process: Process = eqx.field(default_factory=Process)
    model: ClassVar[MotionModel] = SINGLE_MASS

    def __check_init__(self):
        check_positive("layout.pressure", self.layout.pressure * (1.0 + self.process.pressure))
        check_positive("layout.gap", self.layout.gap + self.process.gap)
        check_positive("layout.side", self.layout.side - 2.0 * self.process.over_etch)
        self.made  # noqa: B018  # checks itself

    @property
    def made(self) -> SingleMassGyro:
        """The device that the process makes of the layout."""
        return self.layout.made(self.process)

    def dynamics(self, inertial: Inertial) -> Dynamics:
        """Of the device that is made."""
        return self.made.dynamics(inertial)

    def coefficients(self, rate: Scalar, damping_change: Change = UNCHANGED) -> tuple[Scalar, ...]:
        """Of the device that is made."""
        return self.made.coefficients(rate, damping_change)
