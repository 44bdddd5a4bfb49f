"""The estimators of the paper: least squares on the ratio of sense to drive response, with the corrections the paper
makes beforehand.

    exact        Y/X = (λ Dx − C)/(Dy − λ C),   Di = ωi² − ω² + iωωi/Qi,   C = α + iωη
    truncated    Y/X ≈ (λ Dx − C)/Dy                                        (15), of which the paper uses the real part
    (16)-(18)

Both need the *uncoupled* modes, the ratio of the two read-outs and their phase difference from elsewhere. What that
costs, `identify` avoids.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from scipy import signal

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.plainly import at_once

from .modes import CoupledModes


class RatioEstimate(Displayed):
    """λ [1], η = cxy/m [1/s] and α = kxy/m [1/s²] with standard deviations from the scatter about the fit."""

    force: Array
    damping_coupling: Array
    stiffness_coupling: Array
    std: Float[Array, " 3"]

    def values(self) -> Float[Array, " 3"]:
        """(λ, η, α)."""
        return jnp.stack([self.force, self.damping_coupling, self.stiffness_coupling])


class RatioEstimator(Displayed):
    """From the ratio of responses and the uncoupled modes to the couplings."""

    @abc.abstractmethod
    def __call__(
        self, frequency: Float[Array, " n"], ratio: Complex[Array, " n"], modes: CoupledModes
    ) -> RatioEstimate:
        """Couplings of a sweep with x driven, ratio = Y/X; with y driven pass X/Y and `mirrored(modes)` for λxy."""


class TruncatedRatio(RatioEstimator):
    """The paper's estimator exactly as published: real part of (15), unweighted least squares (18)."""

    @at_once
    def __call__(
        self, frequency: Float[Array, " n"], ratio: Complex[Array, " n"], modes: CoupledModes
    ) -> RatioEstimate:
        """λ·Re(Dx/Dy) + η·Re(−iω/Dy) + α·Re(−1/Dy) = Re(Y/X)."""
        dx, dy, *_ = modes.dynamic_stiffness(frequency)
        return _least_squares(jnp.stack([dx / dy, -1j * frequency / dy, -1 / dy], axis=1).real, ratio.real)


class ComplexRatio(RatioEstimator):
    """Real and imaginary part of the truncated ratio: the same approximation, none of the data thrown away."""

    @at_once
    def __call__(
        self, frequency: Float[Array, " n"], ratio: Complex[Array, " n"], modes: CoupledModes
    ) -> RatioEstimate:
        """As `TruncatedRatio`, with both parts stacked."""
        dx, dy, *_ = modes.dynamic_stiffness(frequency)
        matrix = jnp.stack([dx / dy, -1j * frequency / dy, -1 / dy], axis=1)
        return _least_squares(_parts(matrix), _parts(ratio))


class ExactRatio(RatioEstimator):
    """The exact ratio, complex: Y/X·(Dy − λC) = λDx − C over Dy, bilinear in (λ, η, α), by Gauss and Newton's method.

    From two starts, the truncated solution and the one that takes λη and λα as unknowns of their own; the better end is
    returned. Noise-free data give the couplings to rounding.
    """

    iterations: int = eqx.field(static=True, default=10)

    @eqx.filter_jit  # else every call would compile its loop anew
    def __call__(
        self, frequency: Float[Array, " n"], ratio: Complex[Array, " n"], modes: CoupledModes
    ) -> RatioEstimate:
        """As the other estimators."""
        dx, dy, *_ = modes.dynamic_stiffness(frequency)
        s = 1j * frequency
        linear = jnp.stack([dx, -s, -jnp.ones_like(s)], axis=1) / dy[:, None]
        product = ratio / dy

        def improved(_: int, guess: Array) -> Array:
            return guess + solved(guess).values()

        def solved(guess: Array) -> RatioEstimate:
            force, damping, stiffness = guess
            coupling = stiffness + s * damping
            matrix = linear + jnp.stack([coupling, force * s, force + 0j * s], axis=1) * product[:, None]
            return _least_squares(_parts(matrix), _parts(ratio - linear @ guess - force * coupling * product))

        wide = jnp.concatenate([linear, jnp.stack([s, jnp.ones_like(s)], axis=1) * product[:, None]], axis=1)
        starts = jnp.stack([_solution(_parts(columns), _parts(ratio))[:3] for columns in (linear, wide)])
        ends = jax.vmap(lambda start: jax.lax.fori_loop(0, self.iterations, improved, start))(starts)
        rests = jax.vmap(solved)(ends)
        size = jnp.where(
            jnp.isfinite(rests.std).all(axis=1), jnp.linalg.norm(rests.std / rests.std[0], axis=1), jnp.inf
        )
        best = jnp.argmin(size)
        return _estimate(ends[best], rests.std[best])


@at_once
def relative_error(
    estimator: RatioEstimator, modes: CoupledModes, frequency: Array, ratio: Array | None = None
) -> Float[Array, " 3"]:
    """Theoretical relative error (19) of λyx, cxy, kxy; without `ratio` that of noise-free data (Table 6)."""
    response = modes.response(frequency, 0)
    truth = jnp.stack([modes.force_yx, modes.damping_coupling, modes.stiffness_coupling])
    ratio = response[:, 1] / response[:, 0] if ratio is None else ratio
    return estimator(frequency, ratio, modes).values() / truth - 1


@at_once
def conversion_ratio(x_driven: Complex[Array, "n 2"], y_driven: Complex[Array, "n 2"], modes: CoupledModes) -> Array:
    """kSF = SFy/SFx from the two resonance peaks at equal drive voltage (25): amplitude × ω²/Q of each mode's own
    response, as a ratio.
    """
    own = jnp.stack([jnp.abs(x_driven[:, 0]).max(), jnp.abs(y_driven[:, 1]).max()]) * modes.omega**2 / modes.quality
    return own[1] / own[0]


@at_once
def phase_offset(frequency: Float[Array, " n"], response: Complex[Array, " n"], resonance: Array) -> Array:
    """Phase to subtract from a channel [rad] so that it reads −90° at resonance (26), (27): exact only without
    coupling.
    """
    # interpolate the unwrapped phase: angles of neighbours may lie on both sides of ±180°
    return jnp.interp(resonance, frequency, jnp.unwrap(jnp.angle(response))) + jnp.pi / 2


@at_once
def peak_to_peak(amplitude: Float[Array, " n"], phase: Float[Array, " n"]) -> tuple[Array, Array]:
    """Noise NA (relative) and Nφ [unit of `phase`] at fixed frequency (28): largest less smallest reading."""
    return jnp.ptp(amplitude) / jnp.mean(amplitude), jnp.ptp(phase)


def low_pass(record: Float[np.ndarray, " n"], cutoff: float, sample_rate: float) -> Float[np.ndarray, " n"]:
    """Fourth-order Butterworth low-pass run forwards and backwards, so that it shifts no resonance; cutoff and rate in
    the same unit.
    """
    return signal.sosfiltfilt(signal.butter(4, cutoff, fs=sample_rate, output="sos"), record)


@at_once
def goodness_of_fit(measured: Float[Array, "..."], fitted: Float[Array, "..."]) -> Array:
    """R_NL of (29): 1 − √(Σ(measured − fitted)²/Σ measured²). It says nothing about a coefficient that the curve hardly
    shows.
    """
    return 1 - jnp.linalg.norm(jnp.ravel(measured - fitted)) / jnp.linalg.norm(jnp.ravel(measured))


def _parts(values: Array) -> Array:
    return jnp.concatenate([values.real, values.imag])


def _least_squares(matrix: Float[Array, "r 3"], right: Float[Array, " r"]) -> RatioEstimate:
    norm = jnp.linalg.norm(matrix, axis=0)
    solution = _solution(matrix, right)
    rest = right - matrix @ solution
    inverse = jax.scipy.linalg.solve_triangular(jnp.linalg.qr(matrix / norm, mode="r"), jnp.eye(3))
    std = jnp.linalg.norm(inverse, axis=1) / norm * jnp.sqrt(jnp.sum(rest**2) / (right.size - 3))
    return _estimate(solution, std)


def _estimate(values: Float[Array, " 3"], std: Float[Array, " 3"]) -> RatioEstimate:
    return RatioEstimate(values[0], values[1], values[2], std)


def _solution(matrix: Float[Array, "r c"], right: Float[Array, " r"]) -> Float[Array, " c"]:
    """Least squares with columns of unit length, by QR."""
    norm = jnp.linalg.norm(matrix, axis=0)
    q, r = jnp.linalg.qr(matrix / norm)
    return jax.scipy.linalg.solve_triangular(r, q.T @ right) / norm
