"""The numbers of a device as its designer calls them: read off its coefficients, and put back into them.

They are those that `from_modes` takes: a device whose quadrature is changed here is the one that `from_modes` makes
with the other quadrature, its modes and quality factors as before.
"""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import Scalar

from .modes import in_turned_axes


Made = TypeVar("Made", bound=eqx.Module)
Numbers = Mapping[str, Scalar]
_NOTHING = 1e-12  # of a coupling: rounding, where it was given as zero
_OF_MODES = {"frequency.0": "Hz", "frequency.1": "Hz", "quality_factor.0": "1", "quality_factor.1": "1"}
_INSTEAD = {"frequency.0": "kxx", "frequency.1": "kyy", "quality_factor.0": "dxx", "quality_factor.1": "dyy"}


class AbstractNatural(abc.ABC):
    """Names of a kind of device: their `units`, and the coefficients that vary no more by themselves where a name does
    so `instead` of them.
    """

    units: ClassVar[Mapping[str, str]]
    instead: ClassVar[Mapping[str, str]]

    @abc.abstractmethod
    def of(self, gyro: Any) -> Numbers:
        """All numbers of the device, in SI, frequencies in Hz."""

    @abc.abstractmethod
    def coefficients(self, gyro: Any, changes: Numbers) -> dict[str, Scalar]:
        """Its fields once it has the numbers `changes`, all others as they are; NaN where no device has them."""

    def into(self, gyro: Made, changes: Numbers) -> Made:
        """The device with the numbers `changes`, in place of its own."""
        found = self.coefficients(gyro, changes)
        found = {name: np.asarray(value) if is_concrete(value) else value for name, value in found.items()}
        return eqx.tree_at(lambda made: [getattr(made, name) for name in found], gyro, list(found.values()))


class NaturalSingleMass(AbstractNatural):
    """Of one mass, as `SingleMassGyro.from_modes` takes them; of `quadrature` and `angle` one may be changed."""

    units: ClassVar[Mapping[str, str]] = {**_OF_MODES, "quadrature": "rad/s", "angle": "rad", "cross_damping": "1"}
    instead: ClassVar[Mapping[str, str]] = {**_INSTEAD, "quadrature": "kxy", "angle": "kxy", "cross_damping": "dxy"}

    def of(self, gyro):
        stiffness = tuple(jnp.asarray(k) / gyro.mass for k in (gyro.kxx, gyro.kyy, gyro.kxy))
        first, second = _modes(stiffness[0], stiffness[1], stiffness[2] ** 2)
        half = 0.5 * (stiffness[0] - stiffness[1])
        angle = 0.5 * jnp.arctan2(jnp.where(half < 0.0, -stiffness[2], stiffness[2]), jnp.abs(half))
        dxy = gyro.dxy + 0.5 * gyro.cross_damping_asymmetry
        one, two, cross = in_turned_axes(gyro.dxx / gyro.mass, gyro.dyy / gyro.mass, dxy / gyro.mass, -angle)
        cross = cross / jnp.sqrt(one * two)
        if is_concrete(cross):
            cross = jnp.where(jnp.abs(cross) < _NOTHING, 0.0, cross)
        return {
            "frequency.0": first / (2.0 * jnp.pi), "frequency.1": second / (2.0 * jnp.pi),
            "quality_factor.0": first / one, "quality_factor.1": second / two,
            "quadrature": 0.5 * stiffness[2] / first, "angle": angle, "cross_damping": cross,
        }  # fmt: skip

    def coefficients(self, gyro, changes):
        if changes.keys() >= {"angle", "quadrature"}:
            raise InputError("Of `angle` and `quadrature` of a device one may be changed, but both are.")
        now = {**self.of(gyro), **changes}
        first, second = (2.0 * jnp.pi * jnp.asarray(now[f"frequency.{n}"]) for n in "01")
        angle = now["angle"]
        if "angle" not in changes and not changes.keys().isdisjoint(("quadrature", "frequency.0", "frequency.1")):
            angle = 0.5 * jnp.arcsin(4.0 * first * now["quadrature"] / (first**2 - second**2))
        damping = first / now["quality_factor.0"], second / now["quality_factor.1"]
        cross = now["cross_damping"] * jnp.sqrt(damping[0] * damping[1])
        stiff, damp = in_turned_axes(first**2, second**2, 0.0, angle), in_turned_axes(*damping, cross, angle)
        found = {name: gyro.mass * k for name, k in zip(("kxx", "kyy", "kxy"), stiff, strict=True)}
        found |= {name: gyro.mass * d for name, d in zip(("dxx", "dyy", "dxy"), damp, strict=True)}
        return {**found, "dxy": found["dxy"] - 0.5 * gyro.cross_damping_asymmetry}


class NaturalDualMass(AbstractNatural):
    """Of two masses, as `DualMassGyro.from_modes` takes them; both couplings change by as much."""

    units: ClassVar[Mapping[str, str]] = {**_OF_MODES, "quadrature": "rad/s"}
    instead: ClassVar[Mapping[str, str]] = {**_INSTEAD, "quadrature": "kxy kyx"}

    def of(self, gyro):
        first, second = _modes(
            jnp.asarray(gyro.kxx) / gyro.mass_x, jnp.asarray(gyro.kyy) / gyro.mass_y,
            gyro.kxy * gyro.kyx / (gyro.mass_x * gyro.mass_y),
        )  # fmt: skip
        return {
            "frequency.0": first / (2.0 * jnp.pi), "frequency.1": second / (2.0 * jnp.pi),
            "quality_factor.0": gyro.mass_x * first / gyro.dxx, "quality_factor.1": gyro.mass_y * second / gyro.dyy,
            "quadrature": 0.5 * gyro.kyx / (gyro.mass_y * first),
        }  # fmt: skip

    def coefficients(self, gyro, changes):
        now = {**self.of(gyro), **changes}
        first, second = (2.0 * jnp.pi * jnp.asarray(now[f"frequency.{n}"]) for n in "01")
        kyx = 2.0 * gyro.mass_y * first * now["quadrature"]
        kxy = gyro.kxy + (kyx - gyro.kyx)
        x, y = (square**2 for square in _modes(first**2, second**2, -kxy * kyx / (gyro.mass_x * gyro.mass_y)))
        dxx, dyy = gyro.mass_x * first / now["quality_factor.0"], gyro.mass_y * second / now["quality_factor.1"]
        return {"kxx": gyro.mass_x * x, "kyy": gyro.mass_y * y, "kxy": kxy, "kyx": kyx, "dxx": dxx, "dyy": dyy}


def _modes(x: Array, y: Array, coupling: Array) -> tuple[Array, Array]:
    """Angular frequencies of two axes of natural frequencies squared `x` and `y` that couple by `coupling`, a product
    of both couplings per mass: first the mode that is the more along x; of modes, by minus that product, the axes.
    """
    mean, half = 0.5 * (x + y), 0.5 * (x - y)
    split = jnp.where(half < 0.0, -1.0, 1.0) * jnp.sqrt(half**2 + coupling)
    return jnp.sqrt(mean + split), jnp.sqrt(mean - split)
