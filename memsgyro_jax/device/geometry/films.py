"""Gas between plates: sliding and squeezed films, at pressures where molecules hit the walls more than each other."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.fields import Scalar


AIR = 1.82e-5  # Pa·s at 293 K
_FREE_PATH = 68e-9  # m, of air at one atmosphere
_ATMOSPHERE = 101325.0
_ODD = np.arange(1.0, 1025.0, 2.0)
_TAIL = float(np.sum(np.arange(1025.0, 200_001.0, 2.0) ** -4.0))


class SqueezeFilm(NamedTuple):
    """Force on a plate per velocity, `damping` [N·s/m], and per displacement, `stiffness` [N/m]."""

    damping: Scalar
    stiffness: Scalar


def effective_viscosity(gap: Scalar, pressure: Scalar, viscosity: Scalar = AIR) -> Scalar:
    """μ/(1 + 9.638 Kn^1.159) [Pa·s], with the Knudsen number Kn, the free path (68 nm of air at 101 325 Pa) over the
    `gap` [m]; `pressure` in Pa.

    Veijola, Kuisma, Lahdenperä and Ryhänen, Sensors and Actuators A 48 (1995): within 5 % for Kn up to 880.
    """
    knudsen = _FREE_PATH * _ATMOSPHERE / pressure / gap
    return viscosity / (1.0 + 9.638 * knudsen**1.159)


def couette_damping(area: Scalar, gap: Scalar, viscosity: Scalar = AIR) -> Scalar:
    """μ A/t [N·s/m] of plates that slide past each other (thesis 1.8): gaps far below the depth √(2 μ/(ρ ω)) to which
    the motion drags the gas.
    """
    return viscosity * area / gap


def squeeze_film(
    length: Scalar, width: Scalar, gap: Scalar, omega: Scalar, pressure: Scalar, viscosity: Scalar = AIR
) -> SqueezeFilm:
    """The film under a rectangular plate that moves up and down by much less than the `gap` [m] at `omega` [rad/s].

    Blech, Journal of Lubrication Technology 105 (1983), the whole series: with the squeeze number
    σ = 12 μ w² ω/(P t²) and c = w/l, the damping is 64 σ P l w/(π⁶ ω t) Σ (m² + c² n²)/D and the stiffness
    64 σ² P l w/(π⁸ t) Σ 1/D over odd m, n, with D = m² n² ((m² + c² n²)² + σ²/π⁴). (Thesis (1.9) prints one term of it,
    with 1 + (1 + τ)² for 1 + τ².) Isothermal, without inertia of the gas, at ambient pressure on all four edges, for
    squeeze numbers up to 1e5. The sum over m is closed.
    """
    s = 1j * 12.0 * viscosity * omega / (pressure * gap**2)
    number, w = jnp.asarray(_ODD), jnp.asarray(width)[..., None]
    squared = (jnp.pi * number / w) ** 2 + jnp.asarray(s)[..., None]
    half = 0.5 * jnp.asarray(length)[..., None] * jnp.sqrt(squared)
    decay = jnp.exp(-2.0 * half)
    terms = (1.0 - (1.0 - decay) / ((1.0 + decay) * half)) / (number**2 * squared)
    # Behind the last of them only 1/n⁴ is left.
    mean = 8.0 / jnp.pi**2 * (jnp.sum(terms, axis=-1) + _TAIL * (width / jnp.pi) ** 2)
    force = s * pressure / gap * length * width * mean
    return SqueezeFilm(jnp.imag(force) / omega, jnp.real(force))
