"""A one-axis resonator: test structures, electronic oscillators, and a gyro of which only one axis was measured."""

from typing import ClassVar

import jax.numpy as jnp

from .carried import CarriesEffects
from .gyro import Scalar, check_positive, number


class Resonator(CarriesEffects):
    """One mode: x'' = −ω0²·x − (ω0/Q)·x' + g·ω0²·u.

    `resonance` ω0 in rad/s, `quality_factor` Q, `static_gain` g: displacement per drive at rest, in any unit, for
    example m/N or V/V. With g in m/N the moving mass is 1/(g·ω0²).
    """

    resonance: Scalar = number()
    quality_factor: Scalar = number()
    static_gain: Scalar = number(default=1.0)
    axes: ClassVar[int] = 1

    def __check_init__(self):
        check_positive("resonance", self.resonance)
        check_positive("quality_factor", self.quality_factor)
        check_positive("static_gain", jnp.abs(self.static_gain))
