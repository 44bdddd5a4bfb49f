"""How a device is operated where nobody says otherwise: numbers that follow its modes and how far its mass may travel.

The ratios are those of the thesis' runs (5.2), so that its device starts at 1 µm, is driven beside its modes by
53.95 m/s² at 600 Hz, and runs 0.1 s at 100 kHz.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from memsgyro_jax.base.display import Shown
from memsgyro_jax.device.gyro import AbstractGyro, mode_frequencies

from .controllers import DampingCompensation, Tone
from .loop import ClosedLoop
from .observers import Annealing, ExtendedKalmanFilter, design_prior
from .readout import AbstractReadout, ChargeAmplifier


_START = 0.02  # of the travel
_TONE = 0.2074  # of the lower mode: far below both, in every die of a usual spread
_RESPONSE = 3.4122e-3  # of the travel: how far the tone moves the mass at the lower mode's stiffness
_DECAY = 1.447  # periods of the lower mode: the start's caution lasts until a period has been seen
_SCALE = 1.037  # of the lower mode: the frequency that makes the Lyapunov observer's gains numbers
_SAMPLES = 26.6  # per period of the higher mode
_LENGTH = 10_000  # samples: 376 periods of the higher mode


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
        low, high = (float(mode) for mode in mode_frequencies(gyro))
        frequency, sample_rate = _rounded(_TONE * low, 3), _rounded(_SAMPLES * high, 2)
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


def _rounded(number: float, digits: int) -> float:
    """To so many significant digits, as a person would set it."""
    return float(f"{number:.{digits - 1}e}")
