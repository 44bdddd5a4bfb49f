"""A device in the coordinates that measurements see: everything per mass.

Stiffness and mass free together make a valley of condition 1e10 in every likelihood; stiffness per mass, damping per
mass and 1/mass do not. The comparison with measurements works in these.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError

from .gyro import SingleMassGyro
from .resonator import Resonator


class NormalisedDevice(Displayed):
    """Oscillator per mass, symmetric, with one axis or two.

    | field | unit | holds |
    |---|---|---|
    | `stiffness` | rad²/s² | (xx,) or (xx, yy, xy) over mass |
    | `damping` | 1/s | (xx,) or (xx, yy, xy) over mass |
    | `mobility` | 1/kg | 1/mass: acceleration per force |

    Two masses, which effects may meet in the loop, have (xx, yy, xy, yx) and a mobility for each axis; the mass along y
    is that which also moves along x.
    """

    stiffness: Float[Array, " k"] = eqx.field(converter=jnp.asarray)
    damping: Float[Array, " k"] = eqx.field(converter=jnp.asarray)
    mobility: Float[Array, "..."] = eqx.field(converter=jnp.asarray)

    @classmethod
    def of(cls, device: "SingleMassGyro | Resonator | NormalisedDevice") -> "NormalisedDevice":
        """A device of the package in these coordinates, without its effects and the difference of its cross dampings,
        which `effects.evaluation.carried` gives.

        **Raises:** `InputError` for any other device.
        """
        if isinstance(device, NormalisedDevice):
            return device
        if isinstance(device, Resonator):
            w, q = device.resonance, device.quality_factor
            return cls(jnp.stack([w**2]), jnp.stack([w / q]), device.static_gain * w**2)
        if isinstance(device, SingleMassGyro):
            k, m = (device.kxx, device.kyy, device.kxy), device.mass
            d = (device.dxx, device.dyy, device.dxy + 0.5 * device.cross_damping_asymmetry)
            return cls(jnp.stack(k) / m, jnp.stack(d) / m, 1.0 / m)
        raise InputError(
            "Argument `device` must be a SingleMassGyro or a Resonator to be compared with measurements, "
            f"but is a {type(device).__name__}."
        )

    @property
    def axes(self) -> int:
        """Number of axes, 1 or 2."""
        return 1 if self.stiffness.shape[-1] == 1 else 2

    @property
    def stiffness_matrix(self) -> Float[Array, "axes axes"]:
        """Stiffness per mass [rad²/s²]."""
        return _symmetric(self.stiffness)

    @property
    def damping_matrix(self) -> Float[Array, "axes axes"]:
        """Damping per mass [1/s]."""
        return _symmetric(self.damping)

    @property
    def is_held(self) -> bool:
        """Whether it is pushed back whichever way it moves: its stiffness is positive definite."""
        return is_positive(np.asarray(self.stiffness))

    @property
    def is_slowed(self) -> bool:
        """Whether its damping takes energy from every motion: it is positive definite."""
        return is_positive(np.asarray(self.damping))

    def mass(self, axis: int) -> Float[Array, ""]:
        """The mass that moves along an axis [kg]."""
        return 1.0 / (self.mobility if self.mobility.ndim == 0 else self.mobility[axis])

    def physical(self, **carried: Any) -> SingleMassGyro | Resonator:
        """The device with its mass: the gyro of two axes, the resonator of one; `carried` are the fields of
        `CarriesEffects`.
        """
        if self.axes == 1:
            w = jnp.sqrt(self.stiffness[0])
            return Resonator(w, w / self.damping[0], self.mobility / self.stiffness[0], **carried)
        m = 1.0 / self.mobility
        return SingleMassGyro(m, *(self.stiffness * m), *(self.damping * m), **carried)

    def resonances(self) -> np.ndarray:
        """Undamped mode frequencies [rad/s], ascending."""
        return np.sqrt(np.linalg.eigvalsh(np.asarray(self.stiffness_matrix)))


def is_positive(entries: np.ndarray) -> bool:
    """Whether the matrix of (xx,), (xx, yy, xy) or (xx, yy, xy, yx) is positive definite, by its part below."""
    if len(entries) == 1:
        return bool(entries[0] > 0.0)
    return bool(np.all(np.linalg.eigvalsh(np.array([[entries[0], 0.0], [entries[-1], entries[1]]])) > 0.0))


def _symmetric(entries: Array) -> Array:
    if entries.shape[-1] == 1:
        return entries[None]
    xx, yy, xy, yx = (*entries, *entries[2:])[:4]
    return jnp.stack([jnp.stack([xx, xy]), jnp.stack([yx, yy])])
