"""How a device is operated where nobody says otherwise: numbers that follow its modes and how far its mass may travel.

The ratios are those of the thesis' runs (5.2), so that its device starts at 1 µm, is driven beside its modes by
53.95 m/s² at 600 Hz, and runs 0.1 s at 100 kHz.
"""

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from memsgyro_jax.base.arguments import plain_quantity
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import AbstractGyro, mode_frequencies

from .controllers import DampingCompensation, Tone
from .loop import ClosedLoop
from .observers import Annealing, ExtendedKalmanFilter, design_prior
from .readout import AbstractReadout, ChargeAmplifier
from .settling import duration_to_settle, settling_time_constant


_START = 0.02  # of the travel
_TONE = 0.2074  # of the lower mode: far below both, in every die of a usual spread
_RESPONSE = 3.4122e-3  # of the travel: how far the tone moves the mass at the lower mode's stiffness
_DECAY = 1.447  # periods of the lower mode: the start's caution lasts until a period has been seen
_SCALE = 1.037  # of the lower mode: the frequency that makes the Lyapunov observer's gains numbers
_SAMPLES = 26.6  # per period of the higher mode
_LENGTH = 10_000  # samples: 376 periods of the higher mode
_LONGEST = 20.0  # times that, for loops that take long to rest


@dataclass(frozen=True, repr=False)
class Operation(Shown):
    """How `gyro` behind `readout` is operated unless told otherwise. Make one with `of`.

    `travel` [m] is how far the mass may move, `amplitude` [m] the displacement along x at which it starts, `tone` the
    auxiliary acceleration [m/s²] on both axes, `decay` [s] that of the filter's annealing, `frequency` [Hz] that of a
    Lyapunov observer's units; `sample_rate` in Hz, `duration` in s.
    """

    gyro: AbstractGyro
    readout: AbstractReadout
    travel: float
    amplitude: float
    tone: Tone
    decay: float
    frequency: float
    sample_rate: float
    duration: float

    @classmethod
    def of(cls, gyro: AbstractGyro, readout: AbstractReadout | None = None, travel: float | None = None) -> "Operation":
        """For a device with design values (one number each); `travel` [m] is that of the read-out unless given.

        The start is 2 % of the travel; the tone, at a fifth of the lower mode, moves the mass by a sixth of that. The
        higher mode is sampled 26.6 times per period, for 10 000 samples.
        """
        readout = ChargeAmplifier.chi2010() if readout is None else readout
        travel = readout.travel if travel is None else travel
        low = float(mode_frequencies(gyro)[0])
        frequency, sample_rate = _rounded(_TONE * low, 3), _usual_sample_rate(gyro)
        push = _RESPONSE * travel * (2.0 * np.pi) ** 2 * (low**2 - frequency**2)
        return cls(
            gyro=gyro,
            readout=readout,
            travel=travel,
            amplitude=_rounded(_START * travel, 3),
            tone=Tone(frequency, _rounded(push, 4)),
            decay=_rounded(_DECAY / low, 3),
            frequency=_rounded(_SCALE * low, 3),
            sample_rate=sample_rate,
            duration=_LENGTH / sample_rate,
        )

    @property
    def run(self) -> dict[str, Any]:
        """`sample_rate` and `duration`, as `simulate` and `sweep` take them."""
        return {"sample_rate": self.sample_rate, "duration": self.duration}

    def loop(self, spread: float = 0.15) -> ClosedLoop:
        """Kalman filter, told a device that varies by `spread` (each parameter, of itself), and damping compensation.

        `sweep(made.loop(), Spread.relative(0.15), **made.run)` is the default study of the device.
        """
        prior = design_prior(self.gyro, spread=spread, amplitude=self.amplitude)
        observer = ExtendedKalmanFilter.for_device(
            self.gyro, self.readout, prior=prior, annealing=Annealing(decay=self.decay)
        )
        start = (self.amplitude, 0.0, 0.0, 0.0)
        return ClosedLoop(self.gyro, self.readout, observer, DampingCompensation(self.tone), start, self.travel)


def sample_rate_of(gyro: AbstractGyro, given: float | str | None) -> float:
    """`sample_rate` [Hz] as a plain number; left out, the higher mode of `gyro` is sampled as `Operation` does.

    **Raises:** `InputError` for text without a unit, for a traced one, and where a traced device is to tell it.
    """
    return plain_quantity("sample_rate", _usual_sample_rate(gyro) if given is None else given, "Hz")


def run_of(loop: ClosedLoop, sample_rate: float | str | None, duration: float | str | None) -> tuple[float, float]:
    """`sample_rate` [Hz] and `duration` [s] of a run as plain numbers; what is left out follows the device of `loop`,
    as in `Operation` (a default that suits one device samples another twice a period), and `usual_duration`.

    **Raises:** `InputError` for text without a unit, for traced ones, and where a traced device is to tell them.
    """
    usual = usual_duration(loop) if duration is None else duration
    return sample_rate_of(loop.device, sample_rate), plain_quantity("duration", usual, "s")


def usual_duration(loop: ClosedLoop) -> float:
    """A duration [s] that shows what `loop` does: 376 periods of the higher mode, or as long as a loop of classic
    control takes to have come to rest for half of it, up to twenty times that.

    **Raises:** `InputError` for a traced device.
    """
    usual = _LENGTH / _usual_sample_rate(loop.device)
    rested = 0.0 if settling_time_constant(loop) is None else duration_to_settle(loop, 0.0, usual)
    return min(max(usual, rested), _LONGEST * usual)


def _usual_sample_rate(gyro: AbstractGyro) -> float:
    if not is_concrete(gyro):
        raise InputError(
            "Argument `sample_rate`, and `duration` where there is one, must be given for a device whose numbers "
            "jax.grad, jax.jvp, jax.vmap or jax.jit traces: what is usual follows its modes, which are not known then."
        )
    with jax.ensure_compile_time_eval():
        highest = float(np.max(np.asarray(mode_frequencies(gyro))))
    return _rounded(_SAMPLES * highest, 2)


def _rounded(number: float, digits: int) -> float:
    """To so many significant digits, as a person would set it."""
    return float(f"{number:.{digits - 1}e}")
