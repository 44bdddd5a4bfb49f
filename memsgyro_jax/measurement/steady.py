"""Steady vibration under a harmonic drive: exact where the model is linear, harmonic balance where it is not.

The state is s(θ) = S₀ + Re Σ S_h e^{ihθ}, θ = ωt. The linear part of the model is inverted exactly per harmonic; the
unknowns of the balance are the Fourier coefficients of the *nonlinear* accelerations alone, so their number does not
grow with the effects' own linear states. Of a model that is affine nothing is sampled and nothing balanced.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.linalg import at_place, inverse, of_few, product

from .model import Conditions, Model


class Fineness(NamedTuple):
    """How finely a period is resolved: highest harmonic of the balance, and samples of the waveform."""

    harmonics: int = 3
    samples: int = 32


FINENESS = (Fineness(), Fineness(7, 128), Fineness(15, 512))  # a smooth law needs the first, one with a kink the others
HARMONICS, SAMPLES = FINENESS[0]
SHARP_SAMPLES = 256
STEPS = 30


def phases(samples: int = SAMPLES) -> Float[np.ndarray, " m"]:
    """Phases θ of one period at which waveforms are sampled."""
    return 2 * np.pi * np.arange(samples) / samples


def waveform(coefficients: Complex[Array, "*r h n"], samples: int = SAMPLES) -> Float[Array, "*r m n"]:
    """Samples over one period of S₀ + Re Σ S_h e^{ihθ}."""
    angle = np.outer(phases(samples), np.arange(coefficients.shape[-2]))
    return of_few(np.cos(angle), coefficients.real) - of_few(np.sin(angle), coefficients.imag)


def spectrum(samples: Float[Array, "m n"], harmonics: int = HARMONICS) -> Complex[Array, "h n"]:
    """Fourier coefficients S₀ ... S_H of one period: the inverse of `waveform` for band-limited ones."""
    count = samples.shape[0]
    angle = np.outer(np.arange(harmonics + 1), phases(count))
    weight = np.where(np.arange(harmonics + 1) == 0, 1.0, 2.0)[:, None] / count
    return of_few(weight * np.cos(angle), samples) - 1j * of_few(weight * np.sin(angle), samples)


def drive_waveform(force: Complex[Array, " axes"], samples: int = SAMPLES) -> tuple[Array, Array]:
    """Command Re[F e^{iθ}] at each phase and its derivative by θ, both (m, axes)."""
    turning = np.exp(1j * phases(samples))[:, None] * force
    return turning.real, (1j * turning).real


class Remainder(eqx.Module):
    """What a linear part leaves out of a model that is affine: other conditions, and constant accelerations.

    Args:
        matrix: (n, n) per state.
        load: (2, n) harmonics 0 and 1 of what is left out at rest, under the drive.
    """

    matrix: Array
    load: Array

    @classmethod
    def of(
        cls, model: Model, linear: tuple[Array, Array], conditions: Conditions, force: Complex[Array, " axes"]
    ) -> "Remainder":
        """Beside the matrix and the gain of the linear part, under a drive of phasor `force` [N]."""
        matrix, gain = model.linear(conditions)
        at_rest = model.derivative(jnp.zeros(model.size), jnp.zeros(model.axes), conditions)
        left = np.isin(np.arange(model.size), model.nonlinear_rows)
        load = jnp.stack([at_rest + 0j, (gain - linear[1]) @ force])
        return cls(jnp.where(left[:, None], matrix - linear[0], 0.0), jnp.where(left, load, 0.0))

    def spectrum(self, state: Complex[Array, "h n"]) -> Complex[Array, "h n"]:
        """Its Fourier coefficients."""
        return product(self.matrix, state) + jnp.pad(self.load, ((0, len(state) - 2), (0, 0)))


def nonlinear_spectrum(
    model, linear, state: Complex[Array, "h n"], force, conditions, samples: int = SAMPLES, harmonics: int = HARMONICS
) -> Complex[Array, "h k"]:
    """Fourier coefficients of what the linear part leaves out, in the rows that may be nonlinear."""
    command, _ = drive_waveform(force, samples)
    left = jax.vmap(lambda s, u: _left(model, linear, s, u, conditions))(waveform(state, samples), command)
    return spectrum(left, harmonics)


def _left(model: Model, linear: tuple[Array, Array], s: Array, u: Array, conditions: Conditions) -> Float[Array, " k"]:
    """What the linear part leaves out at one moment, in the rows that may be nonlinear."""
    matrix, gain = linear
    left = model.derivative(s, u, conditions) - product(matrix, s) - product(gain, u)
    return left[np.asarray(model.nonlinear_rows)]


@eqx.filter_jit
def steady_state(
    model: Model,
    omega: Float[Array, ""],
    force: Complex[Array, " axes"],
    conditions: Conditions,
    guess: Complex[Array, " axes"],
    fineness: Fineness = FINENESS[0],
    added: Complex[Array, "h axes"] | None = None,
) -> Complex[Array, "h n"]:
    """Fourier coefficients of the settled state under the force Re[F e^{iωt}] at one condition.

    Where several steady states exist (a hardening spring driven hard), the one nearest to `guess`, the phasor of the
    displacement, is found. Derivatives are those of the exact solution (implicit function theorem). `added`, zero but
    for its derivative, are accelerations that the model lacks.
    """
    rows, (harmonics, samples) = np.asarray(model.nonlinear_rows), fineness

    def balance(flat: Array, response: tuple, model: Model, force: Array, conditions: Conditions) -> Array:
        linear, driven, push = response
        state = driven + product(push, _unflatten(flat, model, harmonics))
        return flat - _flatten(nonlinear_spectrum(model, linear, state, force, conditions, samples, harmonics))

    def slopes(flat: Array, response: tuple, model: Model, force: Array, conditions: Conditions) -> Array:
        linear, driven, push = response
        moments = waveform(driven + product(push, _unflatten(flat, model, harmonics)), samples)
        at_once = jax.vmap(jax.jacfwd(lambda s, u: _left(model, linear, s, u, conditions)))
        return jnp.eye(flat.size) - _harmonic_slopes(at_once(moments, drive_waveform(force, samples)[0]), push)

    linear = model.linear(conditions)
    driven, push = linear_response(model, omega, force, linear, harmonics)
    more = jnp.zeros((harmonics + 1, rows.size), complex) if added is None else _widened(added, rows.size)
    if model.is_linear:
        constant = model.derivative(jnp.zeros(model.size), jnp.zeros(model.axes), conditions)[rows]
        return driven + product(push[:, :, rows], more + at_place(constant, 0, harmonics + 1))
    response = linear, driven, push[:, :, rows]
    frozen = jax.lax.stop_gradient((response, model, force, conditions))
    start = _displacement_only(model, jax.lax.stop_gradient(omega), guess, harmonics)
    first = _flatten(nonlinear_spectrum(frozen[1], frozen[0][0], start, frozen[2], frozen[3], samples, harmonics))
    # What is left out is a difference of accelerations ω²·q: steps below their rounding are noise.
    rounding = 1e-15 * jax.lax.stop_gradient(omega**2 * jnp.max(jnp.abs(driven[1, : model.axes])))
    found, solve = _newton(lambda x: balance(x, *frozen), lambda x: slopes(x, *frozen), first, rounding)
    # One more step with everything differentiable but the Jacobian: value unchanged, derivative that of the solution.
    found = found - solve @ (balance(found, response, model, force, conditions) - _flatten(more))
    return driven + product(push[:, :, rows], _unflatten(found, model, harmonics))


def _widened(added: Complex[Array, "h axes"], rows: int) -> Complex[Array, "h k"]:
    """Accelerations, which come first, with zeros for the other rows that may be nonlinear."""
    return jnp.pad(added, ((0, 0), (0, rows - added.shape[1])))


def linear_response(
    model, omega, force, linear, harmonics: int
) -> tuple[Complex[Array, "h n"], Complex[Array, "h n n"]]:
    """The settled state of the linear part under the drive, and its response to a load, harmonic by harmonic."""
    matrix, gain = linear
    order = np.arange(harmonics + 1)
    operator = 1j * order[:, None, None] * omega * jnp.eye(model.size) - matrix
    push = jax.vmap(inverse)(operator)
    drive = (order == 1)[:, None] * (gain @ force)
    return product(push, drive), push


def _displacement_only(model, omega, guess, harmonics: int):
    state = jnp.zeros((harmonics + 1, model.size), dtype=complex)
    return state.at[1, : 2 * model.axes].set(jnp.concatenate([guess, 1j * omega * guess]))


def _harmonic_slopes(local: Float[Array, "m k n"], push: Complex[Array, "h n k"]) -> Float[Array, "f f"]:
    """Derivative of the coefficients of what is left out by those of what acts, both flat, from how it depends on the
    state at every sample of a period.

    Harmonic h of the state, ½(S e^{ihθ} + S̄ e^{−ihθ}), shows in harmonic j by the Fourier coefficients j − h and j + h
    of that dependence: no harmonic is carried through the law by itself.
    """
    highest = push.shape[0] - 1
    order, count = np.arange(highest + 1), local.shape[0]
    angle = np.outer(np.arange(-highest, 2 * highest + 1), phases(count))
    columns = local.reshape(count, -1)
    series = (np.cos(angle) / count) @ columns - 1j * ((np.sin(angle) / count) @ columns)
    series = series.reshape(-1, *local.shape[1:])
    direct, mirrored = (
        jnp.einsum("jhkn,hnl->jkhl", series[highest + order[:, None] + sign * order], some)
        for sign, some in ((-1, push), (1, jnp.conj(push)))
    )
    half = np.where(order == 0, 0.5, 1.0)[:, None, None, None]
    real, imaginary = half * (direct + mirrored), 1j * half * (direct - mirrored)[:, :, 1:]
    both = jnp.concatenate([part.reshape(*part.shape[:2], -1) for part in (real, imaginary)], axis=2)
    return jnp.concatenate([both.real.reshape(-1, both.shape[2]), both.imag[1:].reshape(-1, both.shape[2])])


def _newton(function, slopes, start: Float[Array, " n"], rounding: Array) -> tuple[Array, Float[Array, "n n"]]:
    """Newton's method until the step is lost in rounding, at most `STEPS` steps; also the last inverse Jacobian."""

    def step(carry):
        x, _, _, count = carry
        solve = inverse(slopes(x))
        change = solve @ function(x)
        small = jnp.max(jnp.abs(change)) <= 1e-13 * jnp.max(jnp.abs(x)) + rounding
        return x - change, solve, small | ~jnp.all(jnp.isfinite(change)), count + 1

    def going(carry):
        return ~carry[2] & (carry[3] < STEPS)

    begin = (start, jnp.eye(start.size), jnp.asarray(False), 0)
    return jax.lax.while_loop(going, step, begin)[:2]


def _flatten(coefficients: Complex[Array, "h k"]) -> Float[Array, " n"]:
    return jnp.concatenate([coefficients.real.ravel(), coefficients.imag[1:].ravel()])


def _unflatten(flat: Float[Array, " n"], model: Model, harmonics: int) -> Complex[Array, "h k"]:
    width = len(model.nonlinear_rows)
    real, imaginary = flat[: (harmonics + 1) * width], flat[(harmonics + 1) * width :]
    imaginary = jnp.concatenate([jnp.zeros(width), imaginary])
    return (real + 1j * imaginary).reshape(harmonics + 1, width)


def reading_samples(model: Model, fineness: Fineness) -> int:
    """Samples a period of what is read: more where a waveform has corners."""
    return max(SHARP_SAMPLES if model.is_sharp else 0, fineness.samples)


def as_seen(state: Complex[Array, "h n"], earlier: Array) -> Complex[Array, "h n"]:
    """A vibration as it was when its fundamental was turned by the factor `earlier` of modulus 1."""
    return state * earlier ** jnp.arange(state.shape[-2])[:, None]


@eqx.filter_jit
def fundamental(
    model, omega, state: Complex[Array, "h n"], force, conditions, fineness: Fineness = FINENESS[0]
) -> Complex[Array, " axes"]:
    """Phasor of each channel's voltage at the drive frequency, all read-out effects included; a late read-out sees the
    vibration as it was, exactly where it is settled.
    """
    samples, prompt = reading_samples(model, fineness), model.prompt
    earlier = model.behind(omega, conditions, state[0].real)
    if prompt.is_read_linearly:
        leaking = force * earlier
        return _read_linearly(prompt, (state[1] * earlier, leaking, 1j * omega * leaking, force), conditions)
    command, turn = drive_waveform(force * earlier, samples)
    rows = waveform(as_seen(state, earlier), samples), command, turn, drive_waveform(force, samples)[0]
    volts = jax.vmap(lambda s, u, du, now: prompt.observe(s, u, omega * du, conditions, now))(*rows)
    # Without its mean: a constant must leave exactly nothing, for what rounding leaves passes for a sensitivity.
    return spectrum(volts - jnp.mean(volts, axis=0), 1)[1]


def _read_linearly(prompt: Model, phasors: tuple[Array, ...], conditions: Conditions) -> Complex[Array, " axes"]:
    """Phasor of each channel that goes with those of state, command, its rate and the command that leaks."""
    still = tuple(jnp.zeros(part.shape) for part in phasors)
    _, along = jax.linearize(lambda s, u, du, now: prompt.observe(s, u, du, conditions, now), *still)
    return along(*(part.real for part in phasors)) + 1j * along(*(part.imag for part in phasors))
