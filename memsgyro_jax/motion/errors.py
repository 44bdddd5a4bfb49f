"""What the maker of a design admits not to know of the device, beside what the observer finds by itself."""

import math

import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.device.gyro import AbstractGyro, Inertial, Scalar, check_not_negative, number


class ModelErrors(Displayed):
    """Standard deviations of what is known a priori only: the observer's model leaves it out.

    - `cross_damping`: by which dxy and dyx differ, relative to dxy (for a device without, to the geometric mean of dxx
      and dyy). It is the same force as a rate of (dyx - dxy)/(4 mass): no motion tells the two apart.
    - `force_gain`: of the force on each axis by itself, relative.
    - `delay`: of each channel of the read-out by itself [s].

    Zero means known exactly. Raises `InputError` for a negative one.
    """

    cross_damping: Scalar = number(default=0.1)
    force_gain: Scalar = number(default=0.01)
    delay: Scalar = number(default=0.1e-6)

    def __check_init__(self):
        for name in ("cross_damping", "force_gain", "delay"):
            check_not_negative(name, getattr(self, name))

    @classmethod
    def none(cls) -> "ModelErrors":
        """A model that is right: the nominal case."""
        return cls(0.0, 0.0, 0.0)

    def std(self, gyro: AbstractGyro) -> Float[np.ndarray, "5"]:
        """Of (dyx - dxy)/mass [1/s], both force gains [1] and both delays [s]."""
        (xx, xy), (yx, yy) = gyro.dynamics(Inertial()).damping
        cross = max(abs(float(xy)), abs(float(yx))) or math.sqrt(float(xx) * float(yy))
        gain, delay = float(self.force_gain), float(self.delay)
        return np.array([float(self.cross_damping) * cross, gain, gain, delay, delay])

    def __str__(self) -> str:
        parts = [
            f"{name} ± {scale * float(value):.3g} {unit}"
            for name, value, scale, unit in (
                ("cross damping", self.cross_damping, 100.0, "%"),
                ("force gain", self.force_gain, 100.0, "%"),
                ("delay", self.delay, 1e6, "µs"),
            )
            if float(value) > 0.0
        ]
        return ", ".join(parts) or "none"
