"""Thermal noise of a device: the white force of its damping, and what a sample collects of it.

What takes energy out of a motion gives it back as a random force (fluctuation and dissipation; H. B. Callen and T. A.
Welton, Phys. Rev. 83, 1951): a damping matrix D [N·s/m] at T goes with forces of the two-sided density 2 k T D, so that
every mode holds k T/2 in displacement and as much in velocity. Cross damping makes the forces of the axes correlated.
"""

from typing import Self

import equinox as eqx
import jax.numpy as jnp

from memsgyro_jax.base.arguments import in_unit, number_in
from memsgyro_jax.base.concrete import check_not_negative

from .carried import CarriesEffects
from .small import Matrix, Scalar, Vector


BOLTZMANN = 1.380649e-23  # J/K


class HasTemperature(CarriesEffects):
    """A device that may know its `temperature` [K]: then its damping shakes it. None, or 0 K, is no Brownian force.

    Scenarios with a temperature of their own are followed.
    """

    temperature: Scalar | None = eqx.field(kw_only=True, default=None, converter=in_unit("K", optional=True))

    def __check_init__(self):
        if self.temperature is not None:
            check_not_negative("temperature", self.temperature)

    def at_temperature(self, temperature: Scalar | None) -> Self:
        """The same device at `temperature` [K]; None forgets it.

        **Raises:** `InputError` for a negative temperature.
        """
        temperature = None if temperature is None else number_in("Argument `temperature`", temperature, "K")
        made = eqx.tree_at(
            lambda d: d.temperature, self, temperature, is_leaf=lambda part: part is None
        )  # fmt: skip
        HasTemperature.__check_init__(made)
        return made


def thermal_acceleration(damping: Matrix, gain: Vector, temperature: Scalar) -> Matrix:
    """Two-sided density [m²/s³] of the white acceleration of both axes: 2 k T/m of the symmetric damping per mass.

    `damping` per mass in 1/s, `gain` 1/m in 1/kg. What is antisymmetric takes no energy, as Coriolis forces do not.
    """
    both = 2.0 * BOLTZMANN * temperature
    cross = 0.5 * both * (damping[0][1] * gain[1] + damping[1][0] * gain[0])
    return Matrix(((both * damping[0][0] * gain[0], cross), (cross, both * damping[1][1] * gain[1])))


def white_covariance(stiffness: Matrix, velocity: Matrix, density: Matrix, period: Scalar, order: int) -> Matrix:
    """Covariance (x, y, vx, vy) that a white acceleration of two-sided `density` leaves after `period`, from none.

    The Taylor series in the period of the Lyapunov equation Q' = A Q + Q Aᵀ + B S Bᵀ, `order` terms of it.
    """
    nothing = Matrix(((0.0, 0.0), (0.0, 0.0)))
    place, mixed, speed = nothing, nothing, Matrix(density)
    total = [period * part for part in (place, mixed, speed)]
    weight = period
    for power in range(2, order + 2):
        fall, turn = Matrix(stiffness) @ mixed, speed @ velocity.T
        place, mixed, speed = (
            mixed + mixed.T,
            speed - place @ stiffness.T - mixed @ velocity.T,
            -(fall + fall.T) - (turn + turn.T),
        )
        weight = weight * period / power
        total = [so_far + weight * part for so_far, part in zip(total, (place, mixed, speed), strict=True)]
    place, mixed, speed = total
    return place.beside(mixed).above(mixed.T.beside(speed))


def correlated(covariance: Matrix, normal: tuple[Scalar, ...]) -> Vector:
    """Numbers of that `covariance` from as many independent standard normal ones; zero covariance gives zeros.

    Its Cholesky root, from the last entry up: velocities gather most of a white force, displacements the rest of it.
    """
    size = len(covariance)
    rest = [list(row) for row in covariance]
    values: list[Scalar] = [0.0] * size
    for pivot in reversed(range(size)):
        there = rest[pivot][pivot] > 0.0
        root = jnp.sqrt(jnp.where(there, rest[pivot][pivot], 1.0))
        column = [jnp.where(there, rest[i][pivot] / root, 0.0) for i in range(pivot + 1)]
        for i in range(pivot + 1):
            values[i] = values[i] + column[i] * normal[pivot]
            for j in range(i + 1):
                rest[i][j] = rest[j][i] = rest[i][j] - column[i] * column[j]
    return Vector(values)
