"""Poles and residues of two coupled modes: where the resonances really are, beside the uncoupled parameters they are
mistaken for.

The peak and the half-power points of a measured curve belong to the *coupled* poles, roots of Dx·Dy = Cxy·Cyx; the
formulas of the paper need ωx, Qx, ωy, Qy of the *uncoupled* axes. The two differ by about α²/(4ω²·split), which is
small and yet rules the error.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.plainly import at_once

from .modes import CoupledModes


class SingleMode(Displayed):
    """Resonance frequency [rad/s] and quality factor of one mode."""

    omega: Array = eqx.field(converter=jnp.asarray)
    quality: Array = eqx.field(converter=jnp.asarray)

    @classmethod
    def of_pole(cls, pole: Array) -> "SingleMode":
        """The mode s² + sω/Q + ω² with this root: ω = |s|, Q = |s| / (−2 Re s)."""
        return cls(jnp.abs(pole), jnp.abs(pole) / (-2 * pole.real))


class PartialFractions(NamedTuple):
    """Response to a unit acceleration as Σ residue/(iω − pole): poles (4,) [rad/s] with their conjugates, residues (4,
    2) [s/m per m/s²].
    """

    poles: Complex[Array, " 4"]
    residues: Complex[Array, "4 2"]


@at_once
def coupled_poles(modes: CoupledModes, rate: float = 0.0) -> Complex[Array, " 2"]:
    """The two poles in the upper half plane [rad/s], the one that tends to x first; exactly the uncoupled ones without
    coupling.

    Newton's method from the narrow-band solution, which knows the splitting by the coupling already; the derivative is
    that of the implicit equation.
    """
    start = jax.lax.stop_gradient(_narrow_band_poles(modes, rate))
    frozen = jax.lax.stop_gradient(modes)

    def aberth(_: int, poles: Array) -> Array:
        step = jax.vmap(lambda s: _newton_step(frozen, s, rate))(poles)
        others = jnp.stack([poles[1], poles[0]])
        return poles - step / (
            1 - step * (1 / (poles - others) + 1 / (poles - poles.conj()) + 1 / (poles - others.conj()))
        )

    distinct = start[0] != start[1]
    poles = jnp.where(
        distinct, jax.lax.fori_loop(0, 6, aberth, jnp.where(distinct, start, start + jnp.array([1e-3, -1e-3]))), start
    )
    return jax.vmap(lambda s: s - _implicit_step(modes, frozen, s, rate))(jax.lax.stop_gradient(poles))


@at_once
def partial_fractions(modes: CoupledModes, axis: int, rate: float = 0.0) -> PartialFractions:
    """Poles and residues of `CoupledModes.response` for a force on electrode `axis`."""
    upper = coupled_poles(modes, rate)
    poles = jnp.concatenate([upper, upper.conj()])
    gaps = poles[:, None] - poles[None, :] + jnp.eye(4)
    dx, dy, cxy, cyx = _at(modes, poles, rate)
    fx, fy = modes.force()[:, axis]
    numerator = jnp.stack([dy * fx - cxy * fy, dx * fy - cyx * fx], axis=-1)
    return PartialFractions(poles, numerator / jnp.prod(gaps, axis=1)[:, None])


@at_once
def half_power(frequency: Float[Array, " n"], amplitude: Float[Array, " n"]) -> SingleMode:
    """Mode from the peak and the half-power points of an amplitude curve, as the paper does (section 3.1).

    The peak is the vertex of the parabola through the highest point and its neighbours, the half-power frequencies are
    interpolated linearly; Q = ω/(ω₂ − ω₁). NaN where the curve does not fall to 1/√2 of its peak on both sides.
    """
    top = jnp.clip(jnp.argmax(amplitude), 1, amplitude.size - 2)
    y, f = amplitude[top + jnp.arange(-1, 2)], frequency[top + jnp.arange(-1, 2)]
    low, high = (y[1] - y[0]) / (f[1] - f[0]), (y[2] - y[1]) / (f[2] - f[1])
    curvature = (high - low) / (f[2] - f[0])
    peak = jnp.where(curvature < 0, 0.5 * (f[0] + f[1]) - low / (2 * jnp.where(curvature < 0, curvature, -1.0)), f[1])
    height = y[0] + low * (peak - f[0]) + curvature * (peak - f[0]) * (peak - f[1])
    left = _crossing(frequency, amplitude, height / jnp.sqrt(2.0), top, -1)
    right = _crossing(frequency, amplitude, height / jnp.sqrt(2.0), top, +1)
    return SingleMode(peak, peak / (right - left))


def circle(
    frequency: Float[Array, " n"], response: Complex[Array, " n"], weight: Float[Array, " n"] | None = None
) -> SingleMode:
    """Mode from a complex fit of one resonance: amplitude and phase of every point, no phase correction; it finds the
    *coupled* pole.

    Args:
        frequency: angular frequencies [rad/s].
        response: phasors of one channel, any unit.
        weight: relative weight of each equation; by default 1/|response|, right for noise in proportion to the signal.
    """
    return SingleMode.of_pole(circle_pole(frequency, response, weight))


@at_once
def circle_pole(
    frequency: Float[Array, " n"], response: Complex[Array, " n"], weight: Float[Array, " n"] | None = None
) -> Array:
    """The pole p [rad/s] of response·(iω − p) = b0 + b1·ω, by weighted linear least squares, re-weighted until it is
    the error of the response itself.

    A positive real part means that no decaying mode explains the response.
    """
    centre, half = frequency.mean(), 0.5 * (frequency.max() - frequency.min())
    t = (frequency - centre) / half
    weight = 1 / jnp.abs(response) if weight is None else weight

    def reweighted(_: int, pole: Array) -> Array:
        w = weight / jnp.abs(t - pole)
        matrix = jnp.stack([response, jnp.ones_like(response), t + 0j], axis=1) * w[:, None]
        scale = jnp.linalg.norm(matrix, axis=0)
        return jnp.linalg.lstsq(matrix / scale, response * t * w)[0][0] / scale[0]

    start = t[jnp.argmax(jnp.abs(response))] + 0.05j
    return 1j * (centre + half * jax.lax.fori_loop(0, 12, reweighted, start))


def _crossing(frequency: Array, amplitude: Array, level: Array, top: Array, side: int) -> Array:
    """Frequency where the curve first falls below `level` on one side of its peak."""
    index = jnp.arange(amplitude.size)
    beyond = (index < top) if side < 0 else (index > top)
    low = beyond & (amplitude < level)
    first = jnp.max(jnp.where(low, index, -1)) if side < 0 else jnp.min(jnp.where(low, index, amplitude.size))
    inner, outer = jnp.clip(first - side, 0, amplitude.size - 1), jnp.clip(first, 0, amplitude.size - 1)
    share = (amplitude[inner] - level) / (amplitude[inner] - amplitude[outer])
    return jnp.where(low.any(), frequency[inner] + share * (frequency[outer] - frequency[inner]), jnp.nan)


def _uncoupled(modes: CoupledModes) -> Complex[Array, " 2"]:
    decay = modes.omega / (2 * modes.quality)
    return -decay + 1j * jnp.sqrt(modes.omega**2 - decay**2)


def _narrow_band_poles(modes: CoupledModes, rate: float) -> Complex[Array, " 2"]:
    """Poles with the far (conjugate) resonances replaced by their value: (s − ux)(s − uy) = −Cxy·Cyx/(4 ωx ωy)."""
    ux, uy = _uncoupled(modes)
    middle, half = 0.5 * (ux + uy), 0.5 * (ux - uy)
    _, _, cxy, cyx = _at(modes, middle, rate)
    shift = jnp.sqrt(half**2 - cxy * cyx / (4 * modes.omega[0] * modes.omega[1]))
    shift = jnp.where((shift * half.conj()).real < 0, -shift, shift)
    return jnp.stack([middle + shift, middle - shift])


def _at(modes: CoupledModes, s: Array, rate: float) -> tuple[Array, Array, Array, Array]:
    """Dx, Dy, Cxy, Cyx at complex frequency s, the first two as products so that they are accurate near their roots."""
    ux, uy = _uncoupled(modes)
    coupling = modes.stiffness_coupling + s * modes.damping_coupling
    return (s - ux) * (s - ux.conj()), (s - uy) * (s - uy.conj()), coupling - 2 * s * rate, coupling + 2 * s * rate


def _characteristic(modes: CoupledModes, s: Array, rate: float) -> Array:
    dx, dy, cxy, cyx = _at(modes, s, rate)
    return dx * dy - cxy * cyx


def _newton_step(modes: CoupledModes, s: Array, rate: float) -> Array:
    value, slope = jax.jvp(lambda z: _characteristic(modes, z, rate), (s,), (jnp.ones_like(s),))
    return value / slope


def _implicit_step(modes: CoupledModes, frozen: CoupledModes, s: Array, rate: float) -> Array:
    _, slope = jax.jvp(lambda z: _characteristic(frozen, z, rate), (s,), (jnp.ones_like(s),))
    return _characteristic(modes, s, rate) / slope
