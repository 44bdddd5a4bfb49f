"""From motion to volts: comb pick-off and charge amplifier, an ideal pick-off, and the converter behind them.

Every read-out is `volts = scale * signal + offset + noise` per axis. The observer is given the nominal scale and noise;
the offset it must find. Noise is a one-sided density, so that changing the sample rate keeps the physics.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.device.gyro import (
    VX,
    VY,
    Pair,
    Scalar,
    X,
    Y,
    check_not_negative,
    check_positive,
    is_concrete,
    number,
)
from memsgyro_jax.effects.readout_delay import lag

from .adc import Adc as Adc
from .flicker import Flicker, check_flicker
from .pairs import pair_field, pair_in


PERMITTIVITY = 8.8541878128e-12  # F/m
TRAVEL = 50e-6  # m, the overlap of the thesis' combs
_GAP = 1e-6  # m, of fingers that stand for a given gradient
THESIS_RATE = 10e6  # Hz, the sampling rate at which the thesis states its noise per sample


Effected = tuple[Callable[[Pair], Pair], Callable[[Pair], Pair]]


class AbstractReadout(Displayed):
    """What turns motion into the voltages an observer sees."""

    if TYPE_CHECKING:  # a member's field may stand in the place of a property, not of a class variable

        @property
        def scale(self) -> Pair: ...

        @property
        def offset(self) -> Pair: ...

        @property
        def noise_density(self) -> Pair: ...

        @property
        def adc(self) -> Adc | None: ...

        @property
        def signals(self) -> tuple[int, int]: ...

    else:
        scale: AbstractVar[Pair]  # volts per unit of the signal (V/m or V·s/m)
        offset: AbstractVar[Pair]  # volts at zero signal
        noise_density: AbstractVar[Pair]
        adc: AbstractVar[Adc | None]
        signals: AbstractVar[tuple[int, int]]

    @property
    def flicker(self) -> Flicker | None:
        """Its flicker; None for none."""
        return None

    @property
    def travel(self) -> float:
        """How far in m a mass may move before the read-out no longer follows, 50 µm where nothing limits it."""
        return TRAVEL

    def noise_std(self, period: Scalar) -> Pair:
        """Standard deviation of one sample in volts: density * sqrt(bandwidth), with bandwidth 1/(2·period)."""
        return tuple(density * jnp.sqrt(0.5 / period) for density in self.noise_density)

    def noise_at(self, frequency: Scalar, period: Scalar) -> dict[str, Pair]:
        """One-sided densities in V/√Hz, by source, of signals at `frequency` [Hz] sampled every `period` [s]; rounding
        by a converter is taken as white.
        """
        found: dict[str, Pair] = {"electronics": self.noise_density}
        if self.adc is not None:
            found["converter"] = (self.adc.step * jnp.sqrt(period / 6.0),) * 2
        return found

    def measure(
        self, motion: tuple[Scalar, ...], noise: Pair, drift: Pair, period: Scalar,
        effects: Effected | None = None, late: Pair | None = None,
    ) -> Pair:  # fmt: skip
        """One sample in volts; `noise` is a pair of standard normal numbers, `drift` changes the offsets [V]. `effects`
        are what the device's effects make of the volts before the noise and behind it. `late` are the delays of both
        channels [s], counted to first order, None for none.
        """
        if late is not None:
            moved = (
                place - lag(delay, speed) for place, speed, delay in zip(motion[:2], motion[2:], late, strict=True)
            )
            motion = (*moved, *motion[2:])
        volts = self.clean(motion, drift) if effects is None else effects[0](self.clean(motion, drift))
        volts = tuple(v + n * std for v, n, std in zip(volts, noise, self.noise_std(period), strict=True))
        volts = volts if effects is None else effects[1](volts)
        return volts if self.adc is None else tuple(map(self.adc.convert, volts))

    def clean(self, motion: tuple[Scalar, ...], drift: Pair) -> Pair:
        """The volts without noise."""
        parts = zip(self.signals, self.scale, self.offset, drift, strict=True)
        return tuple(s * motion[signal] + o + d for signal, s, o, d in parts)


class AbstractLinearReadout(AbstractReadout):
    """A read-out whose volts are linear in the motion, and its noise white: a loop can then be advanced by blocks, and
    reads the rows off `clean`.
    """

    @property
    def hindrance(self) -> str | None:
        """What of it is not linear after all, in words; None for nothing."""
        if self.flicker is not None:
            return "the read-out flickers"
        return None if self.adc is None else "the read-out's converter rounds every sample"


class ChargeAmplifier(AbstractLinearReadout):
    """Lateral comb pick-off into a charge amplifier (thesis 3.2 and 3.3.1), two numbers (x, y) per field.

    `fingers` N; finger width `width` W, `gap` Z, initial overlap `overlap` x0 and its mismatch `mismatch` d in m;
    `bias` in V; `feedback` Cf and `parasitic` Cp in F; op-amp `opamp_offset` Vos in V. `rejection` ν in [0, 1] scales
    what the op-amp offset leaves (1: none rejected). The offset is the α + β of (3.10) with (3.12): mismatch and op-amp
    parts add. `noise_density` in V/√Hz (one-sided), zero means noise-free; `adc` None means no converter, `flicker`
    None no flicker.
    """

    fingers: Scalar | Pair = pair_field()
    width: Scalar | Pair = pair_field("m")
    gap: Scalar | Pair = pair_field("m")
    overlap: Scalar | Pair = pair_field("m")
    mismatch: Scalar | Pair = pair_field("m")
    bias: Scalar = number("V")
    feedback: Scalar | Pair = pair_field("F")
    parasitic: Scalar | Pair = pair_field("F")
    opamp_offset: Scalar | Pair = pair_field("V")
    rejection: Scalar = number(default=1.0)
    noise_density: Scalar | Pair = pair_field("V/sqrt(Hz)", default=0.0)
    adc: Adc | None = None
    signals: tuple[int, int] = eqx.field(static=True, default=(X, Y))
    flicker: Flicker | None = None

    def __check_init__(self):
        for name in ("fingers", "width", "gap", "feedback"):
            for value in getattr(self, name):
                check_positive(name, value)
        for value in self.parasitic:
            check_not_negative("parasitic", value)
        if is_concrete(self.rejection) and not all(0.0 <= value <= 1.0 for value in np.ravel(self.rejection)):
            raise InputError(f"Argument `rejection` must lie between 0 and 1, but {self.rejection} was given.")
        _check_density(self.noise_density)
        check_flicker(self.flicker, self.signals)

    @classmethod
    def chi2010(cls, noise_density: float | Pair | None = None) -> "ChargeAmplifier":
        """Thesis Table 5.3: 100 mV/µm, offsets 15 and 11 mV; noise 1 mV per sample at 10 MHz unless given (SNR 100 on 1
        µm).
        """
        density = snr_density(100.0, 1e-6, 1e5, THESIS_RATE) if noise_density is None else noise_density
        return cls(
            fingers=113.0, width=5e-6, gap=1e-6, overlap=50e-6, mismatch=(0.1e-6, 0.085e-6), bias=10.0,
            feedback=1e-12, parasitic=1e-12, opamp_offset=(2e-3, 1e-3), noise_density=density,
        )  # fmt: skip

    @classmethod
    def from_gradient(
        cls, gradient: Scalar | Pair, capacitance: Scalar | Pair, *, bias: Scalar, feedback: Scalar | Pair,
        capacitance_mismatch: Scalar | Pair = 0.0, **further: Any,
    ) -> "ChargeAmplifier":  # fmt: skip
        """The pick-off of which each half's capacitance changes by `gradient` C' [F/m], the one up and the other down,
        from `capacitance` [F] at rest, by which they differ by `capacitance_mismatch` [F]: 2·bias·C'/feedback volts per
        metre. `further` are fields of the circuit.

        The combs are one pair of fingers with that capacitance: the mass may travel until it is gone. Raises
        `InputError` unless gradient and capacitance are positive.
        """
        gradient, capacitance, mismatch = (
            pair_in(f"Argument `{name}`", value, unit)
            for name, unit, value in (
                ("gradient", "F/m", gradient), ("capacitance", "F", capacitance),
                ("capacitance_mismatch", "F", capacitance_mismatch),
            )
        )  # fmt: skip
        for name, pair in (("gradient", gradient), ("capacitance", capacitance)):
            for value in pair:
                check_positive(name, value)
        return cls(
            fingers=1.0, width=tuple(g * _GAP / PERMITTIVITY for g in gradient), gap=_GAP,
            overlap=tuple(c / g for c, g in zip(capacitance, gradient, strict=True)),
            mismatch=tuple(0.5 * m / g for m, g in zip(mismatch, gradient, strict=True)),
            bias=bias, feedback=feedback, **{"parasitic": 0.0, "opamp_offset": 0.0, **further},
        )  # fmt: skip

    @property
    def travel(self) -> float:
        """Until the fingers leave each other."""
        return float(np.min(np.asarray(self.overlap)))

    @property
    def gradient(self) -> Pair:
        """Capacitance per displacement in F/m (3.5)."""
        return tuple(n * PERMITTIVITY * w / z for n, w, z in zip(self.fingers, self.width, self.gap, strict=True))

    @property
    def scale(self) -> Pair:
        """-2V/Cf · dC/dx (3.10)."""
        return tuple(-2.0 * self.bias / cf * g for cf, g in zip(self.feedback, self.gradient, strict=True))

    @property
    def offset(self) -> Pair:
        """α + ν·β of (3.10) and (3.12)."""
        parts = (self.gradient, self.mismatch, self.overlap, self.feedback, self.parasitic, self.opamp_offset)
        return tuple(
            2.0 * g * d * self.bias / cf + self.rejection * (2.0 * g * x0 + cp + cf) * vos / cf
            for g, d, x0, cf, cp, vos in zip(*parts, strict=True)
        )


class DirectReadout(AbstractLinearReadout):
    """A pick-off without circuit: `scale * signal + offset + noise`, on displacement or on velocity.

    `scale` in V/m (or V·s/m), `offset` in V, `noise_density` in V/√Hz one-sided; zeros mean absent, as None for
    `flicker`.
    """

    scale: Scalar | Pair = pair_field()
    offset: Scalar | Pair = pair_field("V", default=0.0)
    noise_density: Scalar | Pair = pair_field("V/sqrt(Hz)", default=0.0)
    adc: Adc | None = None
    signals: tuple[int, int] = eqx.field(static=True, default=(X, Y))
    flicker: Flicker | None = None

    def __check_init__(self):
        for value in self.scale:
            if is_concrete(value) and not np.all((np.asarray(value) != 0.0) & np.isfinite(value)):
                raise InputError(f"Argument `scale` must be finite and not zero, but {np.asarray(value)} was given.")
        _check_density(self.noise_density)
        check_flicker(self.flicker, self.signals)

    @classmethod
    def of_velocity(cls, scale: float | Pair, noise_density: float | Pair = 0.0) -> "DirectReadout":
        """A velocity pick-off, as the thesis' own observer needs (4.1.3.1); `scale` in V·s/m."""
        return cls(scale, noise_density=noise_density, signals=(VX, VY))


class Delayed(AbstractLinearReadout):
    """A displacement read-out whose channels answer `delay` (x, y) [s] late; zero is no delay.

    To first order: the displacement less delay times velocity. What that leaves out is (ω·delay)²/2 of the signal; the
    effect `ReadoutDelay` goes on to the third order.
    """

    inner: AbstractReadout
    delay: Scalar | Pair = pair_field("s")

    @property
    def hindrance(self) -> str | None:
        """Of the read-out itself."""
        if isinstance(self.inner, AbstractLinearReadout):
            return self.inner.hindrance
        return f"the read-out {type(self.inner).__name__} is none that blocks are told of"

    def __check_init__(self):
        if self.inner.signals != (X, Y):
            raise InputError("Argument `inner` must be a displacement read-out, but it shows another signal.")

    def clean(self, motion: tuple[Scalar, ...], drift: Pair) -> Pair:
        """The volts of where the mass was."""
        parts = zip(motion[:2], motion[2:], self.delay, strict=True)
        return self.inner.clean((*(place - lag(delay, speed) for place, speed, delay in parts), *motion[2:]), drift)

    @property
    def travel(self) -> float:
        """Of the read-out itself."""
        return self.inner.travel

    @property
    def flicker(self) -> Flicker | None:
        """Of the read-out itself."""
        return self.inner.flicker

    @property
    def scale(self) -> Pair:
        """Of the read-out itself."""
        return self.inner.scale

    @property
    def offset(self) -> Pair:
        """Of the read-out itself."""
        return self.inner.offset

    @property
    def noise_density(self) -> Pair:
        """Of the read-out itself."""
        return self.inner.noise_density

    @property
    def adc(self) -> Adc | None:
        """Of the read-out itself."""
        return self.inner.adc

    @property
    def signals(self) -> tuple[int, int]:
        """Displacement."""
        return self.inner.signals


def snr_density(snr: float, amplitude: float, scale: float, sample_rate: float) -> float:
    """One-sided noise density [V/√Hz] of the thesis' SNR: an amplitude ratio of `amplitude` [m] (or m/s) to the noise
    per sample.

    The thesis does not define its SNR; this reading alone gives its 7.16 °/s of section 5.2.1.
    """
    return abs(scale) * amplitude / snr * (2.0 / sample_rate) ** 0.5


def _check_density(density: Pair) -> None:
    for value in density:
        check_not_negative("noise_density", value)
