"""Synchronous demodulation: the in-phase and quadrature parts of a voltage beside a turning reference."""

import abc
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.device.gyro import Pair, Scalar, check_positive, number

from ..filters import Lowpass


Held = TypeVar("Held")


class AbstractDemodulator(Displayed, Generic[Held]):
    """Finds I and Q of `value = I cos φ - Q sin φ + constant`, the phase φ given with each sample. `bandwidth` [Hz] is
    where a modulation of I or Q has lost 3 dB.
    """

    bandwidth: AbstractVar[Scalar]

    @abc.abstractmethod
    def init(self) -> Held:
        """The state after silence."""

    @abc.abstractmethod
    def step(self, held: Held, value: Scalar, turn: Pair, period: Scalar) -> Held:
        """The state after one more sample; `turn` is (cos φ, sin φ) at it."""

    @abc.abstractmethod
    def phasor(self, held: Held) -> Pair:
        """(I, Q)."""


class Tracked(NamedTuple):
    """In-phase part, quadrature part and constant of a followed voltage."""

    phasor: Pair
    constant: Scalar


class TrackingDemodulator(AbstractDemodulator[Tracked]):
    """Follows the oscillation and corrects I, Q and the constant by what it missed: no ripple at twice the frequency,
    and none of an offset. In the turning frame a low-pass of first order, `bandwidth` b:

        e = value - (I cos φ - Q sin φ + c),  I += 2 β e cos φ,  Q -= 2 β e sin φ,  c += β e,  β = 2π b · period

    (an observer of a sine and a constant, the recursive form of a lock-in).
    """

    bandwidth: Scalar = number()

    def __check_init__(self):
        check_positive("bandwidth", self.bandwidth)

    def init(self) -> Tracked:
        """Nothing."""
        zero = jnp.zeros(())
        return Tracked((zero, zero), zero)

    def step(self, held: Tracked, value: Scalar, turn: Pair, period: Scalar) -> Tracked:
        """Predict, and correct by the error."""
        (cos, sin), (i, q), share = turn, held.phasor, 2.0 * jnp.pi * self.bandwidth * period
        move = share * (value - (i * cos - q * sin + held.constant))
        return Tracked((i + 2.0 * move * cos, q - 2.0 * move * sin), held.constant + move)

    def phasor(self, held: Tracked) -> Pair:
        """The followed ones."""
        return held.phasor


class Multiplied(NamedTuple):
    """Last output of a low-pass for each product, and its own state."""

    phasor: Pair
    filters: tuple[Any, Any]


class ProductDemodulator(AbstractDemodulator[Multiplied]):
    """Multiplies by twice the reference and smooths, thesis (5.3): `I = LPF(2 value cos φ)`, `Q = LPF(-2 value sin φ)`.

    What the low-pass of `order` leaves of the products at twice the frequency, and of an offset at the frequency, is
    ripple.
    """

    bandwidth: Scalar = number()
    order: int = eqx.field(static=True, default=2)

    def __check_init__(self):
        self._lowpass()

    def _lowpass(self) -> Lowpass:
        return Lowpass(self.bandwidth, self.order)

    def init(self) -> Multiplied:
        """Nothing."""
        zero = jnp.zeros(())
        return Multiplied((zero, zero), (self._lowpass().init(zero), self._lowpass().init(zero)))

    def step(self, held: Multiplied, value: Scalar, turn: Pair, period: Scalar) -> Multiplied:
        """Both products through their low-pass."""
        lowpass, (cos, sin) = self._lowpass(), turn
        i, first = lowpass.step(held.filters[0], 2.0 * value * cos, period)
        q, second = lowpass.step(held.filters[1], -2.0 * value * sin, period)
        return Multiplied((i, q), (first, second))

    def phasor(self, held: Multiplied) -> Pair:
        """The smoothed products."""
        return held.phasor
