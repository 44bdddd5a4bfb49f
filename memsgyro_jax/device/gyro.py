"""Vibratory gyroscopes: parameters and equations of motion.

Both devices of the thesis are two-axis oscillators in a rotating frame. Everything here is written for one die; the
engine passes many dies as trailing axes, so leaves are scalars or arrays of one number per die.
"""

import abc
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.arguments import number as number
from memsgyro_jax.base.arguments import number_in, quantity
from memsgyro_jax.base.concrete import at_hand
from memsgyro_jax.base.concrete import check_not_negative as check_not_negative
from memsgyro_jax.base.concrete import check_positive as check_positive
from memsgyro_jax.base.concrete import check_positive_definite as check_positive_definite
from memsgyro_jax.base.concrete import is_concrete as is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import Scalar as Scalar

from .brownian import HasTemperature
from .carried import AbstractEffect, Effects
from .inertial import UNCHANGED as UNCHANGED
from .inertial import Change as Change
from .inertial import Inertial as Inertial
from .inertial import Pair as Pair
from .inertial import frame_stiffness as frame_stiffness
from .modes import angle_of_quadrature, coupled, in_turned_axes, rates_of
from .modes import natural_frequencies as natural_frequencies
from .motion_model import DUAL_MASS as DUAL_MASS
from .motion_model import SINGLE_MASS as SINGLE_MASS
from .motion_model import UX as UX
from .motion_model import UY as UY
from .motion_model import VX as VX
from .motion_model import VY as VY
from .motion_model import Coefficient as Coefficient
from .motion_model import Dynamics as Dynamics
from .motion_model import MotionModel as MotionModel
from .motion_model import Term as Term
from .motion_model import X as X
from .motion_model import Y as Y
from .natural import AbstractNatural, NaturalDualMass, NaturalSingleMass


class AbstractGyro(HasTemperature):
    """A two-axis gyro. A new kind of device gives its `model` table and the two methods; `dynamics` is that of the base
    device, which the loop extends by the `effects`. `couplings` names the fields that couple the axes, which no maker
    holds at zero, with the two main coefficients that each stands beside; `natural` are the names of a designer.
    """

    model: eqx.AbstractClassVar[MotionModel]
    couplings: ClassVar[Mapping[str, tuple[str, str]]] = {}
    natural: ClassVar[AbstractNatural | None] = None

    @abc.abstractmethod
    def dynamics(self, inertial: Inertial) -> Dynamics:
        """The true equations of motion under the given motion of the frame."""

    @abc.abstractmethod
    def coefficients(self, rate: Scalar, damping_change: Change = UNCHANGED) -> tuple[Scalar, ...]:
        """The values of `model.coefficients` nearest to this device at rate `rate` [rad/s] and under `damping_change`
        (as in `Inertial`): what an observer should find.
        """


class SingleMassGyro(AbstractGyro):
    """One proof mass that moves along x and y (thesis (3.1)).

    Mass in kg, stiffness in N/m, damping in N·s/m. `dyx` is the damping force on y per velocity along x; left out it
    equals `dxy`; a difference (`cross_damping_asymmetry`) is the same as a rate of (dyx - dxy)/(4·mass) (thesis 4.1.2).
    `rotating_frame=True` keeps the terms in Ω², dΩ/dt, cross rates and frame acceleration of (2.4); False drops them as
    (2.6) does.
    """

    mass: Scalar = number("kg")
    kxx: Scalar = number("N/m")
    kyy: Scalar = number("N/m")
    kxy: Scalar = number("N/m")
    dxx: Scalar = number("N*s/m")
    dyy: Scalar = number("N*s/m")
    dxy: Scalar = number("N*s/m")
    cross_damping_asymmetry: Scalar = number("N*s/m")
    rotating_frame: bool = eqx.field(static=True)
    model: ClassVar[MotionModel] = SINGLE_MASS
    couplings: ClassVar[Mapping[str, tuple[str, str]]] = {"kxy": ("kxx", "kyy"), "dxy": ("dxx", "dyy")}
    natural = NaturalSingleMass()

    def __init__(
        self, mass, kxx, kyy, kxy, dxx, dyy, dxy, *, dyx=None, rotating_frame: bool = False,
        effects: tuple[AbstractEffect, ...] = (), reference_temperature: float = 298.15, reference_bias: float = 0.0,
        temperature: Scalar | None = None, cross_damping_asymmetry: Scalar = 0.0,
    ):  # fmt: skip
        self.mass, self.kxx, self.kyy, self.kxy = mass, kxx, kyy, kxy
        self.dxx, self.dyy, self.dxy = dxx, dyy, dxy
        if dyx is not None:
            one, other = (number_in(f"Argument `{n}`", v, "N*s/m") for n, v in (("dyx", dyx), ("dxy", dxy)))
            cross_damping_asymmetry = one - other
        self.cross_damping_asymmetry = cross_damping_asymmetry
        self.rotating_frame = rotating_frame
        self.effects = Effects.of(effects)
        self.reference_temperature, self.reference_bias = reference_temperature, reference_bias
        self.temperature = temperature

    def __check_init__(self):
        check_positive("mass", self.mass)
        check_positive_definite("stiffness", self.kxx, self.kyy, self.kxy)
        coupling, asymmetry = at_hand((self.dxy, self.cross_damping_asymmetry))
        check_positive_definite("damping", self.dxx, self.dyy, coupling + 0.5 * asymmetry)

    @property
    def dyx(self) -> Scalar:
        """Damping force on y per velocity along x [N·s/m]."""
        return self.dxy + self.cross_damping_asymmetry

    @classmethod
    def chi2010(cls) -> "SingleMassGyro":
        """The device of thesis Table 5.1: modes at 2.893 and 3.758 kHz, Q 942 and 919."""
        return cls(mass=1.8e-7, kxx=63.96, kyy=95.92, kxy=12.78, dxx=3.6e-6, dyy=4.5e-6, dxy=3.6e-7)

    @classmethod
    def from_modes(
        cls, mass: Scalar, frequency: Pair, quality_factor: Scalar | Pair, *, angle: Scalar | None = None,
        quadrature: Scalar | None = None, cross_damping: Scalar = 0.0, rotating_frame: bool = False,
        temperature: Scalar | None = None,
    ) -> "SingleMassGyro":  # fmt: skip
        """The device of `mass` [kg] with modes at `frequency` [Hz], in either order, and of `quality_factor`, a number
        for both or one each.

        The first mode moves along x, or at `angle` [rad] from x to y. Instead of the angle, `quadrature` [rad/s] is the
        rate whose force at the first mode has the amplitude of that of kxy (3.1): kxy = 2·mass·ω·quadrature.
        `cross_damping`, between -1 and 1, couples the modes by that share of the root of both dampings. Zeros: none. A
        `temperature` [K] adds the damping's Brownian force. Raises `InputError` for numbers that no device has.
        """
        if angle is not None and quadrature is not None:
            raise InputError("A device must have either `angle` or `quadrature`, but both were given.")
        mass = quantity("mass", mass, "kg")
        check_positive("mass", mass)
        modes, damping = rates_of(frequency, quality_factor)
        if quadrature is not None:
            angle = angle_of_quadrature(quantity("quadrature", quadrature, "rad/s"), modes)
        angle = 0.0 if angle is None else quantity("angle", angle, "rad")
        kxx, kyy, kxy = in_turned_axes(modes[0] ** 2, modes[1] ** 2, 0.0, angle)
        cross_damping = quantity("cross_damping", cross_damping, "1")
        dxx, dyy, dxy = in_turned_axes(*damping, cross_damping * jnp.sqrt(damping[0] * damping[1]), angle)
        coefficients = (mass * value for value in (kxx, kyy, kxy, dxx, dyy, dxy))
        return cls(mass, *coefficients, rotating_frame=rotating_frame).at_temperature(temperature)

    def dynamics(self, inertial: Inertial) -> Dynamics:
        """Thesis (3.1), with the frame terms of (2.4) when `rotating_frame` is set."""
        per_mass, rate = 1.0 / self.mass, inertial.rate
        sxx, syy, sxy = (per_mass * (1.0 + change) for change in inertial.damping_change)
        kxy = self.kxy * per_mass
        stiffness = ((self.kxx * per_mass, kxy), (kxy, self.kyy * per_mass))
        damping = ((self.dxx * sxx, self.dxy * sxy), (self.dyx * sxy, self.dyy * syy))
        bias = (0.0, 0.0)
        if self.rotating_frame:
            stiffness = frame_stiffness(inertial, x_share=1.0) + stiffness
            bias = (-inertial.acceleration[0], -inertial.acceleration[1])
        return Dynamics(stiffness, damping, ((0.0, -2.0 * rate), (2.0 * rate, 0.0)), (per_mass, per_mass), bias)

    def coefficients(self, rate: Scalar, damping_change: Change = UNCHANGED) -> tuple[Scalar, ...]:
        """(rate, kxx, kyy, kxy, dxx, dyy, dxy)/m and 1/m; with unequal cross damping the symmetric part."""
        m = self.mass
        damping = (self.dxx, self.dyy, self.dxy + 0.5 * self.cross_damping_asymmetry)
        changed = tuple(d * (1.0 + change) / m for d, change in zip(damping, damping_change, strict=True))
        return (rate, self.kxx / m, self.kyy / m, self.kxy / m, *changed, 1.0 / m)


class DualMassGyro(AbstractGyro):
    """Decoupled two-mass gyro (thesis (3.3)): the frame mass moves along x only, the inner mass `mass_y` along x and y.

    `mass_x` is the whole mass m1 + m2 moving along x and `mass_y` is m1, both in kg (Table 5.2); stiffness in N/m,
    damping in N·s/m.
    """

    mass_x: Scalar = number("kg")
    mass_y: Scalar = number("kg")
    kxx: Scalar = number("N/m")
    kyy: Scalar = number("N/m")
    kxy: Scalar = number("N/m")
    kyx: Scalar = number("N/m")
    dxx: Scalar = number("N*s/m")
    dyy: Scalar = number("N*s/m")
    rotating_frame: bool = eqx.field(static=True, default=False)
    model: ClassVar[MotionModel] = DUAL_MASS
    couplings: ClassVar[Mapping[str, tuple[str, str]]] = {"kxy": ("kxx", "kyy"), "kyx": ("kxx", "kyy")}
    natural = NaturalDualMass()

    def __check_init__(self):
        check_positive("mass_y", self.mass_y)
        check_positive("mass_x - mass_y", jnp.asarray(self.mass_x) - jnp.asarray(self.mass_y))
        # An unsymmetric matrix is stable when its determinant is positive beside positive diagonal entries.
        check_positive("kxx", self.kxx)
        check_positive("kyy", self.kyy)
        check_positive("kxx*kyy - kxy*kyx", self.kxx * self.kyy - self.kxy * self.kyx)
        check_positive("dxx", self.dxx)
        check_positive("dyy", self.dyy)

    @classmethod
    def chi2010(cls) -> "DualMassGyro":
        """The device of thesis Table 5.2."""
        return cls(mass_x=2.6e-7, mass_y=1.6e-7, kxx=92.38, kyy=85.26, kxy=0.92, kyx=0.25, dxx=5.2e-6, dyy=4.8e-6)

    @classmethod
    def from_modes(
        cls, mass_x: Scalar, mass_y: Scalar, frequency: Pair, quality_factor: Scalar | Pair, *,
        quadrature: Scalar = 0.0, rotating_frame: bool = False, temperature: Scalar | None = None,
    ) -> "DualMassGyro":  # fmt: skip
        """The device with masses as in its fields, modes at `frequency` [Hz] along x and y, and of `quality_factor`, a
        number for both or one each.
        `quadrature` [rad/s] is the rate whose force on y at the first mode has the amplitude of that of kyx (3.3):
        kxy = kyx = 2·mass_y·ω·quadrature; zero means no coupling. With a `temperature` [K] the damping makes a Brownian
        force. Raises `InputError` for numbers that no device has.
        """
        mass_x, mass_y = quantity("mass_x", mass_x, "kg"), quantity("mass_y", mass_y, "kg")
        modes, damping = rates_of(frequency, quality_factor)
        coupling = 2.0 * modes[0] * quantity("quadrature", quadrature, "rad/s")  # per inner mass
        first, second = coupled(modes, coupling**2 * mass_y / mass_x)
        kxy = mass_y * coupling
        return cls(
            mass_x, mass_y, mass_x * first, mass_y * second, kxy, kxy, mass_x * damping[0], mass_y * damping[1],
            rotating_frame=rotating_frame,
        ).at_temperature(temperature)  # fmt: skip

    def dynamics(self, inertial: Inertial) -> Dynamics:
        """Thesis (3.3); the frame terms follow (2.4) with the inner mass alone carrying the y motion."""
        mx, my, rate = self.mass_x, self.mass_y, inertial.rate
        share = my / mx
        sxx, syy, _ = (1.0 + change for change in inertial.damping_change)
        stiffness = ((self.kxx / mx, self.kxy / mx), (self.kyx / my, self.kyy / my))
        damping = ((self.dxx * sxx / mx, 0.0), (0.0, self.dyy * syy / my))
        bias = (0.0, 0.0)
        if self.rotating_frame:
            stiffness = frame_stiffness(inertial, x_share=share) + stiffness
            bias = (-inertial.acceleration[0], -inertial.acceleration[1])
        return Dynamics(stiffness, damping, ((0.0, -2.0 * share * rate), (2.0 * rate, 0.0)), (1.0 / mx, 1.0 / my), bias)

    def coefficients(self, rate: Scalar, damping_change: Change = UNCHANGED) -> tuple[Scalar, ...]:
        """(rate_x, rate, kxx, kyy, kxy, kyx, dxx, dyy, sigma_x, sigma_y) of thesis (3.4)."""
        mx, my = self.mass_x, self.mass_y
        sxx, syy, _ = (1.0 + change for change in damping_change)
        stiffness = (self.kxx / mx, self.kyy / my, self.kxy / mx, self.kyx / my)
        return (rate * my / mx, rate, *stiffness, self.dxx * sxx / mx, self.dyy * syy / my, 1.0 / mx, 1.0 / my)


def mode_frequencies(gyro: AbstractGyro) -> Float[np.ndarray, "*dies two"]:
    """Undamped mode frequencies in Hz, ascending, of a gyro at rest; inside a transformation JAX arrays.

    Two equal modes have no derivative but that of their mean, which each of them is given.
    """
    return natural_frequencies(at_hand(gyro).dynamics(Inertial()).stiffness)
