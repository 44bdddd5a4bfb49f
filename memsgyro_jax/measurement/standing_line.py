"""Lines that stand in a record of something that dies out: of the mains, of another instrument."""

from dataclasses import dataclass

import numpy as np
from scipy import optimize


CHANCE = 1e-6  # that noise alone makes a line of one of all bins of a record
BESIDE, NEAR = 24, 4  # bins that tell what is beside one, and that belong to itself under Hann's window
PARTS = 4  # of a record, in each of which a line must be as strong
EVEN, SIGMAS = 0.1, 4.0  # share of itself, and standard deviations, by which it may be another there
MOST = 3  # lines of a record
FEWEST = 64  # rows, below which none is looked for
FALLS = 1.0  # e-foldings of the vibration over a record, below which it does not differ from a line
FINE = 1e-5  # of a bin, to which the frequency of a line is looked for


@dataclass(frozen=True)
class StandingLine:
    """A line in a record.

    Args:
        omega: angular frequency beside the reference of phasors, or of a waveform [rad/s].
        amplitude: of each channel, peak [V].
    """

    omega: float
    amplitude: tuple[float, ...]

    def said(self, reference: float | None, unit: str) -> str:
        """Its size and where it is, in words; `reference` is that of phasors [rad/s]."""
        hertz, beside = self.omega / (2 * np.pi), ""
        if reference is not None:
            beside = f" ({abs(hertz):.6g} Hz {'above' if hertz > 0 else 'below'} the reference)"
            hertz += reference / (2 * np.pi)
        size = f"{max(self.amplitude):.2g}" + (f" {unit}" if unit != "1" else "")
        return f"a line of about {size} at {hertz:.9g} Hz{beside}"


def standing_lines(time: np.ndarray, signals: np.ndarray, omega: np.ndarray, decay: float) -> tuple[StandingLine, ...]:
    """Lines in rows (n, channels) at even times [s], the strongest first: beyond what noise makes of any bin at 1e-6,
    beside the vibration, and as strong in each quarter of the record, as nothing is that dies out.

    Args:
        time, signals: of the rows; phasors, or a waveform.
        omega: of the vibrations (k,), beside the reference of phasors [rad/s].
        decay: the lowest of their rates [1/s].
    """
    span, left = float(time[-1] - time[0]), np.array(signals)
    found: list[StandingLine] = []
    if len(time) < FEWEST or not decay * span > FALLS:
        return ()
    away = 2 * np.pi * NEAR * PARTS / span + 4 * decay
    while len(found) < MOST:
        freq, power = _periodogram(time, left)
        loud = power > _beside(power) * np.log(len(power) / CHANCE) / np.log(2)
        apart = np.min(np.abs(np.subtract.outer(freq, omega)), axis=1) > away
        if not np.iscomplexobj(signals):
            apart &= np.abs(freq) > away  # a constant is none
        places = [place for place in np.argsort(-power) if loud[place] and apart[place] and _is_peak(power, place)]
        line = next((one for place in places[: 2 * MOST] if (one := _even(time, left, freq[place])) is not None), None)
        if line is None:
            break
        found.append(line)
        left = left - _drawn(time, left, line.omega)
    return tuple(found)


def _periodogram(time: np.ndarray, signals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angular frequencies (k,) and power (k,) of rows under Hann's window, all channels together."""
    windowed, period = signals * np.hanning(len(time))[:, None], (time[-1] - time[0]) / (len(time) - 1)
    turns = np.iscomplexobj(signals)
    lines = (np.fft.fft if turns else np.fft.rfft)(windowed, axis=0)
    freq = (np.fft.fftfreq if turns else np.fft.rfftfreq)(len(time), period)
    order = np.argsort(freq)
    return 2 * np.pi * freq[order], np.sum(np.abs(lines[order]) ** 2, axis=1)


def _beside(power: np.ndarray) -> np.ndarray:
    """The median of the bins beside each, without its own."""
    wide = np.pad(power, BESIDE, mode="reflect")
    every = np.lib.stride_tricks.sliding_window_view(wide, 2 * BESIDE + 1)
    kept = np.abs(np.arange(-BESIDE, BESIDE + 1)) > NEAR
    return np.median(every[:, kept], axis=1)


def _is_peak(power: np.ndarray, place: int) -> bool:
    return power[place] >= power[max(0, place - NEAR) : place + NEAR + 1].max()


def _even(time: np.ndarray, signals: np.ndarray, omega: float) -> StandingLine | None:
    """The line near a frequency, if it is as strong in each part of the record."""
    reach = 2 * np.pi / (time[-1] - time[0])
    lost = lambda one: -np.sum(np.abs(_phasor(time, signals, one)) ** 2)  # noqa: E731
    ends = omega - reach, omega + reach
    omega = float(optimize.minimize_scalar(lost, bounds=ends, method="bounded", options={"xatol": FINE * reach}).x)
    whole = _phasor(time, signals, omega)
    rows = np.array_split(np.arange(len(time)), PARTS)
    parts = np.array([_phasor(time[part], signals[part], omega) for part in rows])
    rest = signals - _drawn(time, signals, omega)
    # What noise makes of a part, from the rows of the quietest: a vibration that dies out is in the others, too.
    noise = min(np.sqrt(np.mean(np.abs(np.diff(rest[part], axis=0)) ** 2) / 2) for part in rows)
    std = noise * np.sqrt(1.5 * (1 if np.iscomplexobj(signals) else 2) / len(rows[0]))
    size, strong = np.abs(whole), int(np.argmax(np.abs(whole)))
    off = np.abs(parts[1:, strong] - whole[strong])  # the first holds most of what dies out
    if np.any(off > EVEN * size[strong] + SIGMAS * std):
        return None
    return StandingLine(float(omega), tuple(float(one) for one in size))


def _phasor(time: np.ndarray, signals: np.ndarray, omega: float) -> np.ndarray:
    """Of each channel at a frequency, under Hann's window."""
    window = np.hanning(len(time)) + 0j
    sides = 1 if np.iscomplexobj(signals) else 2
    return sides * (window * np.exp(-1j * omega * time)) @ signals / np.sum(window.real)


def _drawn(time: np.ndarray, signals: np.ndarray, omega: float) -> np.ndarray:
    """A line over the rows."""
    values = np.exp(1j * omega * time)[:, None] * _phasor(time, signals, omega)
    return values if np.iscomplexobj(signals) else values.real
