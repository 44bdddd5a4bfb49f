"""The detection of a carrier simulated in time: the judge of its equivalent base band.

Between samples everything is linear: the stage has two states (output, charge of the node), 1/f noise a sum of slow
relaxations, and the low-pass behind the multiplication is, seen in a frame that turns with the carrier, a low-pass with
its poles moved by jω_c. So a sample is a matrix exponential, of any length, carrier and noise included. NumPy.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from memsgyro_jax.base.concrete import check_positive
from memsgyro_jax.base.errors import InputError

from ..brownian import BOLTZMANN
from .carrier import CarrierDetection


Tones = tuple[tuple[float, complex], ...]
_SPACING = 3.0  # of the relaxations that make 1/f: it ripples by less than 0.1 %
_SLOWEST = 1e-4  # of the corner
_FASTEST = 1e3  # of the corner, where white noise hides what is missing


class CarrierRun(NamedTuple):
    """Volts at the ends of the samples: `time` [s], `before` the multiplication and `after` the low-pass; runs with
    noise have the realisations as a trailing axis.
    """

    time: Float[np.ndarray, " samples"]
    before: Float[np.ndarray, "samples *runs"]
    after: Float[np.ndarray, "samples *runs"]


class _System(NamedTuple):
    """x' = A x + charge·q + volt·u; the density of what is white in it; the row of the output, turning back."""

    matrix: Float[np.ndarray, "n n"]
    charge: Float[np.ndarray, " n"]
    volt: Float[np.ndarray, " n"]
    white: Float[np.ndarray, "n n"]
    output: Complex[np.ndarray, " n"]


def run_carrier(
    detection: CarrierDetection, tones: Tones, *, sample_rate: float, samples: int, runs: int = 0, seed: int = 0
) -> CarrierRun:
    """The detection from rest, of a ΔC(t) that is the sum of Re(a e^{2πjft}) over `tones` (f [Hz], a [F]).

    `runs` is the number of realisations of the noise, 0 a run without. The op-amp needs a finite `gain_bandwidth`.

    **Raises:** `InputError` for an infinite one, and for a rate or number that is not positive.
    """
    check_positive("sample_rate", sample_rate)
    check_positive("samples", samples)
    if not np.isfinite(float(detection.stage.gain_bandwidth)):
        raise InputError("Argument `detection` must have an op-amp of finite `gain_bandwidth` to run in time.")
    system, period = _system(detection), 1.0 / sample_rate
    carrier = 2.0 * np.pi * float(detection.frequency)
    values, vectors = np.linalg.eig(system.matrix)
    back, grown = np.linalg.inv(vectors), np.exp(values * period)
    step = np.real(vectors * grown @ back)
    forced = []
    for frequency, size in tones:  # V cos ω_c t · Re(a e^{jωt}) is two tones, at ω_c ± ω
        omega = 2.0 * np.pi * frequency
        for turning, half in ((carrier + omega, size), (carrier - omega, np.conj(size))):
            forced.append((turning, 0.5 * float(detection.amplitude) * half * system.charge))
    forced.append((0.0, float(detection.stage.offset) * system.volt + 0j))
    pushes = [(omega, _pushed(values, vectors, back, column, omega, period)) for omega, column in forced]
    shape = (len(values), runs) if runs else (len(values),)
    root = _root(system.white, values, vectors, back, period) if runs else None
    random, state = np.random.default_rng(seed), np.zeros(shape)
    before, after, time = np.empty((samples, *shape[1:])), np.empty((samples, *shape[1:])), period * np.arange(samples)
    for k, start in enumerate(time):
        push = np.real(sum(column * np.exp(1j * omega * start) for omega, column in pushes))
        state = step @ state + (push[:, None] if runs else push)
        if root is not None:
            state = state + root @ random.standard_normal(shape)
        before[k] = state[0]
        after[k] = np.real(np.exp(-1j * carrier * (start + period)) * (system.output @ state))
    return CarrierRun(time + period, before, after)


def _pushed(
    values: np.ndarray, vectors: np.ndarray, back: np.ndarray, column: np.ndarray, omega: float, period: float
) -> np.ndarray:
    """∫ exp(A (h − s)) column e^{jωs} ds over a sample."""
    apart = 1j * omega - values
    small = np.abs(apart) * period < 1e-9
    safe = np.where(small, 1.0, apart)
    gathered = np.where(
        small, period * np.exp(values * period), (np.exp(1j * omega * period) - np.exp(values * period)) / safe
    )
    return vectors @ (gathered * (back @ column))


def _root(
    white: np.ndarray, values: np.ndarray, vectors: np.ndarray, back: np.ndarray, period: float
) -> Float[np.ndarray, "n n"]:
    """A square root of the covariance ∫ exp(A s) W exp(Aᵀ s) ds that a sample gathers."""
    rate = values[:, None] + np.conj(values)[None]
    small = np.abs(rate) * period < 1e-9
    gathered = np.where(small, period, np.expm1(rate * period) / np.where(small, 1.0, rate))
    inner = (back @ white @ back.conj().T) * gathered
    covariance = np.real(vectors @ inner @ vectors.conj().T)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    found, directions = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * directions * np.sqrt(np.maximum(found, 0.0))


def _system(detection: CarrierDetection) -> _System:
    """States: output, node charge over Cf, relaxations of 1/f, and per pole of the low-pass a turning pair."""
    stage = detection.stage
    cf, total = float(stage.feedback), float(stage.total)
    leak, speed, gain = 1.0 / float(stage.resistor), 2.0 * np.pi * float(stage.gain_bandwidth), float(stage.gain)
    relaxing, strength = _flicker(float(stage.noise), float(stage.corner))
    poles = np.asarray(detection.poles)
    size, first = 2 + len(relaxing) + 2 * len(poles), 2 + len(relaxing)
    a, white = np.zeros((size, size)), np.zeros((size, size))
    node = np.array([cf, -cf]) / total  # the op-amp's input by output and node charge, and q/total beside
    a[0, :2] = -speed * node
    a[0, 0] -= speed / gain
    a[1, :2] = -leak / cf * (np.array([1.0, 0.0]) - node)
    charge, volt = np.zeros(size), np.zeros(size)
    charge[0], charge[1], volt[0] = -speed / total, leak / cf / total, speed
    white[0, 0] = speed**2 * 0.5 * float(stage.noise) ** 2
    white[1, 1] = 2.0 * BOLTZMANN * float(stage.temperature) * leak / cf**2
    for k, pole in enumerate(relaxing):
        a[0, 2 + k], a[2 + k, 2 + k] = speed, -pole
        white[2 + k, 2 + k] = 2.0 * pole * strength
    output, carrier, phase = np.zeros(size, complex), 2.0 * np.pi * float(detection.frequency), float(detection.phase)
    for k, pole in enumerate(poles):
        others = np.delete(poles, k)
        here = first + 2 * k
        turning = carrier + pole.imag
        a[here : here + 2, here : here + 2] = [[pole.real, -turning], [turning, pole.real]]
        a[here : here + 2, 0] = 2.0 * abs(pole) * np.array([np.cos(phase), -np.sin(phase)])
        residue = np.prod(-poles) / np.prod(pole - others) / abs(pole)
        output[here : here + 2] = residue * np.array([1.0, 1j])
    return _System(a, charge, volt, white, output)


def _flicker(noise: float, corner: float) -> tuple[np.ndarray, float]:
    """Poles [rad/s] of relaxations and the variance [V²] of each, whose sum has 1/f from far below the corner to far
    above it.
    """
    if noise == 0.0 or corner == 0.0:
        return np.zeros(0), 0.0
    count = round(np.log(_FASTEST / _SLOWEST) / np.log(_SPACING))
    return 2.0 * np.pi * corner * _SLOWEST * _SPACING ** np.arange(count + 1), noise**2 * corner * np.log(_SPACING)
