"""Butterworth filters that run inside the loop's scan or over a finished record.

The bandwidth is a number with a gradient, so it can be tuned. Second-order sections are trapezoidal state-variable
filters: the same transfer function as the bilinear transform of the analogue filter with prewarping, but free of the
cancellation that spoils direct forms when the bandwidth is a millionth of the sample rate.
"""

import abc
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import in_unit, quantity
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar, check_positive, is_concrete


class Section(NamedTuple):
    """Warped frequency tan(π f T), damping 1/Q and gain of a second-order section."""

    warped: Scalar
    damping: Scalar
    gain: Scalar


def _frequency() -> Scalar:
    """A field in Hz: a float even where a whole number is given, so that it has a gradient and may differ per die."""
    return eqx.field(converter=in_unit("Hz", float))


class AbstractFilter(Displayed):
    """A causal linear filter. `init` and `step` serve a scan, `apply` a record."""

    @abc.abstractmethod
    def init(self, level: Scalar = 0.0) -> tuple:
        """The state after an input that has been `level` forever; shape of `level` is that of one sample."""

    @abc.abstractmethod
    def step(self, state: tuple, value: Scalar, period: Scalar) -> tuple[Scalar, tuple]:
        """Output and new state for one sample `value`, `period` [s] after the last."""

    @abc.abstractmethod
    def edges(self) -> tuple[Scalar, ...]:
        """The frequencies [Hz] that must lie below half the sample rate."""

    def apply(
        self, signal: Float[Array, "samples ..."], sample_rate: float, start: Scalar = 0.0
    ) -> Float[Array, "samples ..."]:
        """The filtered record, along the first axis, sampled at `sample_rate` [Hz]; `start` is the input before it.

        Raises `InputError` when the filter does not fit below half the sample rate.
        """
        check_fits(self, sample_rate)
        signal = jnp.asarray(signal, float)
        begin = self.init(jnp.broadcast_to(jnp.asarray(start, float), signal.shape[1:]))
        return _scan(self, begin, signal, 1.0 / sample_rate)


class Lowpass(AbstractFilter):
    """Butterworth low-pass, `order` 1 to 4, unity gain at rest.

    `bandwidth` in Hz is where the power has halved (-3 dB), whatever the order and the sample rate. Raises `InputError`
    for a bandwidth that is not positive or another order.
    """

    bandwidth: Scalar = _frequency()
    order: int = eqx.field(static=True, default=3)

    def __check_init__(self):
        check_positive("bandwidth", self.bandwidth)
        _check_order(self.order)

    def init(self, level: Scalar = 0.0) -> tuple:
        """At rest at `level`."""
        level = jnp.asarray(level, float)
        simple = (level,) if self.order % 2 else ()
        return (*simple, *((jnp.zeros_like(level), level) for _ in range(self.order // 2)))

    def step(self, state: tuple, value: Scalar, period: Scalar) -> tuple[Scalar, tuple]:
        """Sections in cascade, each passing its low output on."""
        warped, new = jnp.tan(jnp.pi * self.bandwidth * period), []
        for held, damping in zip(state, _low_dampings(self.order), strict=True):
            if damping is None:
                move = (value - held) * (warped / (1.0 + warped))
                value = held + move
                new.append(value + move)
            else:
                (_, value), held = _state_variable(Section(warped, damping, 1.0), held, value)
                new.append(held)
        return value, tuple(new)

    def flow(self, state: Array, value: Scalar) -> tuple[Scalar, Array]:
        """Output and slope [1/s] of the state, `order` numbers, of the analogue filter; complex where `value` is."""
        pole, held, slopes = 2.0 * jnp.pi * self.bandwidth, list(state), []
        for damping in _low_dampings(self.order):
            if damping is None:
                value, low = held.pop(0), value
                slopes.append(pole * (low - value))
            else:
                band, low = held.pop(0), held.pop(0)
                slopes += [pole * (value - low - damping * band), pole * band]
                value = low
        return value, jnp.stack(slopes)

    def edges(self) -> tuple[Scalar, ...]:
        """The bandwidth."""
        return (self.bandwidth,)

    def delay(self, period: Scalar, frequency: float = 0.0) -> Scalar:
        """Seconds by which a sine of `frequency` [Hz] comes out late, sampled every `period` [s]; zero: slowly."""
        corner, frequency = jnp.tan(jnp.pi * self.bandwidth * period), quantity("frequency", frequency, "Hz")
        if frequency == 0.0:
            return 0.5 * period * _slope(self.order) / corner
        s = 1j * jnp.tan(jnp.pi * frequency * period) / corner
        late = sum(
            jnp.angle(s + 1.0 if damping is None else 1.0 + damping * s + s**2) for damping in _low_dampings(self.order)
        )
        return late / (2.0 * jnp.pi * frequency)


class Bandpass(AbstractFilter):
    """Butterworth band-pass with 2·`order` poles, `order` 1 to 4, unity gain in the middle of the band.

    `low` and `high` in Hz are where the power has halved (-3 dB). Raises `InputError` unless 0 < low < high.
    """

    low: Scalar = _frequency()
    high: Scalar = _frequency()
    order: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        check_positive("low", self.low)
        check_positive("high - low", jnp.asarray(self.high) - jnp.asarray(self.low))
        _check_order(self.order)

    def init(self, level: Scalar = 0.0) -> tuple:
        """At rest: the first section holds `level` back, the others see nothing."""
        level = jnp.asarray(level, float)
        zero = jnp.zeros_like(level)
        return tuple((zero, level if first else zero) for first in (True, *(False,) * (self.order - 1)))

    def step(self, state: tuple, value: Scalar, period: Scalar) -> tuple[Scalar, tuple]:
        """Sections in cascade, each passing its band output on."""
        new = []
        for section, held in zip(self._sections(period), state, strict=True):
            (value, _), held = _state_variable(section, held, value)
            value = section.gain * value
            new.append(held)
        return value, tuple(new)

    def edges(self) -> tuple[Scalar, ...]:
        """Both ends of the band."""
        return (self.low, self.high)

    def delay(self, period: Scalar) -> Scalar:
        """Seconds by which a slow envelope of the middle of the band comes out late, sampled every `period` [s]."""
        low, high = (jnp.tan(jnp.pi * edge * period) for edge in (self.low, self.high))
        return period * _slope(self.order) * (1.0 + low * high) / (high - low)

    def _sections(self, period: Scalar) -> tuple[Section, ...]:
        """Poles of s² - p·width·s + middle² for every pole p of the low-pass prototype, in warped frequency."""
        low, high = (jnp.tan(jnp.pi * edge * period) for edge in (self.low, self.high))
        width, middle = high - low, jnp.sqrt(low * high)
        found = []
        for damping in _low_dampings(self.order):
            if damping is None:
                found.append(Section(middle, width / middle, width / middle))
                continue
            pole = width * complex(-0.5 * damping, math.sqrt(1.0 - 0.25 * damping**2))
            root = jnp.sqrt(pole**2 - 4.0 * middle**2)
            for placed in (0.5 * (pole + root), 0.5 * (pole - root)):
                size = jnp.abs(placed)
                found.append(Section(size, -2.0 * placed.real / size, width / size))
        return tuple(found)


def check_fits(filter_: AbstractFilter, sample_rate: float) -> None:
    """Raise `InputError` unless the filter lies below half of `sample_rate` [Hz]; traced values pass."""
    if not is_concrete(*filter_.edges(), sample_rate):
        return
    highest = max(float(np.max(np.asarray(edge))) for edge in filter_.edges())
    if not highest < 0.5 * sample_rate:
        raise InputError(
            f"Argument `sample_rate` must be more than twice the filter's {highest:g} Hz, "
            f"but {sample_rate:g} Hz was given."
        )


def _state_variable(section: Section, held: tuple[Scalar, Scalar], value: Scalar) -> tuple[tuple, tuple]:
    """One trapezoidal step: (band, low) outputs and the two integrators; the band peaks at Q."""
    first, second = held
    warped = section.warped
    band = (first + warped * (value - second)) / (1.0 + warped * (warped + section.damping))
    low = second + warped * band
    return (band, low), (2.0 * band - first, 2.0 * low - second)


def _low_dampings(order: int) -> tuple[float | None, ...]:
    """1/Q of each conjugate pair of the Butterworth prototype; None stands for the real pole of an odd order."""
    pairs = tuple(2.0 * math.sin(math.pi * (2 * k + 1) / (2 * order)) for k in range(order // 2))
    return ((None,) if order % 2 else ()) + pairs


def _slope(order: int) -> float:
    """The prototype's delay at rest in units of one over its corner: the sum of 1/Q, 1 for the real pole."""
    return sum(1.0 if damping is None else damping for damping in _low_dampings(order))


def _check_order(order: int) -> None:
    if order not in (1, 2, 3, 4):
        raise InputError(f"Argument `order` must be 1, 2, 3 or 4, but {order} was given.")


@eqx.filter_jit
def _scan(filter_: AbstractFilter, state: tuple, signal: Array, period: Scalar) -> Array:
    def one(state, value):
        output, state = filter_.step(state, value, period)
        return state, output

    return jax.lax.scan(one, state, signal)[1]
