"""Amplitude, frequency and decay rate of a free vibration over time, told by its record alone.

In each short window the strongest vibration is (a + b·τ)·e^{iωτ}: least squares for a and b, and of b the part in phase
with a is the change of the amplitude, the part in quadrature what the frequency misses; it is moved there until nothing
is missing.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .clock import usual_period
from .standing_line import without_steady_lines


CYCLES = 6  # of the vibration in a window at least
FEWEST = 2  # the same of a record that holds few of them
ROWS = 12  # in a window at least
ROUNDS = 8  # of moving the frequency
UNTOLD = 5e8  # the quality factor of what does not fall: none that a record tells
STRAYED = 0.5  # of a frequency: a window that moves it farther, or out of its band, shows no vibration there
SURE = 2.0  # standard deviations by which a frequency must differ
SEEN = 10.0  # standard deviations of its own from which an amplitude counts


@dataclass(frozen=True, eq=False)
class Track:
    """A vibration in windows that follow each other.

    Args:
        time: middle of each window (k,) [s].
        phasor: of the vibration there (k,), complex, in the unit of the record.
        amplitude_std: of its size (k,).
        omega, omega_std: angular frequency (k,) [rad/s].
        decay, decay_std: −a'/a, half of the damping per mass (k,) [1/s].
        offset: mean of each window beside the vibration (k,); zero for phasors.
    """

    time: np.ndarray
    phasor: np.ndarray
    amplitude_std: np.ndarray
    omega: np.ndarray
    omega_std: np.ndarray
    decay: np.ndarray
    decay_std: np.ndarray
    offset: np.ndarray

    @property
    def amplitude(self) -> np.ndarray:
        """(k,) in the unit of the record."""
        return np.abs(self.phasor)

    def where(self, rows: np.ndarray) -> "Track":
        """Some of the windows."""
        return Track(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    @property
    def seen(self) -> "Track":
        """The windows in which the vibration stands clear of the noise."""
        return self.where(self.amplitude > SEEN * self.amplitude_std)

    @property
    def usual(self) -> tuple[float, float]:
        """Angular frequency [rad/s] and decay rate [1/s], means weighted with the squared amplitude over the windows in
        which it is seen, or all where there are none; of the decay where there are two or more, by how the amplitude
        falls between them, which tells it far better than they do.
        """
        seen = self.seen
        told = seen if seen.time.size else self
        weight = told.amplitude**2 / np.sum(told.amplitude**2)
        omega, decay = float(weight @ told.omega), float(weight @ told.decay)
        if seen.time.size < 2:
            return omega, decay
        fall, _ = _slope(seen.time, np.log(seen.amplitude), 1.0 / seen.amplitude)
        return omega, -fall

    def turned(self, span: float, reference: float = 0.0) -> float:
        """Phase [rad] by which its highest frequency surely turns it farther than its lowest in a `span` of seconds.

        Frequencies are slopes of the phase over sixteenths of the span: from window to window noise does not add up.
        `reference` is that of the record's phasors [rad/s].
        """
        if self.time.size < 2:
            return 0.0
        mean = float(np.average(self.omega, weights=self.amplitude**2))
        turn = np.exp(1j * (reference - mean) * (self.time - self.time[0]))
        phase, noise = np.unwrap(np.angle(self.phasor * turn)), self.amplitude_std / self.amplitude
        count = min(self.time.size, int(np.ceil(16.0 * np.ptp(self.time) / span)))
        told = []
        for part in np.array_split(np.arange(self.time.size), count):
            alone = self.omega[part[0]] - mean, self.omega_std[part[0]]
            told.append(alone if part.size == 1 else _slope(self.time[part], phase[part], noise[part]))
        slopes, std = np.transpose(told)
        return span * max(0.0, float(np.max(slopes - SURE * std) - np.min(slopes + SURE * std)))


def tracked(
    time: np.ndarray, values: np.ndarray, band: tuple[float, float], *, reference: float = 0.0, rows: int = 0
) -> Track:
    """The strongest vibration within a band of a record.

    Args:
        time: (n,) [s]; where it is not uniform, of one clock but for jitter and lost rows.
        values: (n,) a real signal, or complex phasors of e^{iωt} at the frequency `reference`.
        band: lowest and highest angular frequency [rad/s] at which it is looked for.
        reference: of phasors [rad/s].
        rows: of a window; 0 takes `CYCLES` cycles.
    """
    period = usual_period(time)
    phasors = np.iscomplexobj(values)
    omega = _loudest(time, values, period, band, reference)
    width = rows or _width(omega, period, phasors, len(time))
    width = min(width, len(time))
    band = band if phasors else _apart(band, period, width)
    omega = omega if phasors else float(np.clip(omega, *band))
    found: list[tuple[Any, ...]] = []
    for begin in range(0, len(time) - width + 1, width):
        middle = time[begin : begin + width].mean()
        some, away = values[begin : begin + width], time[begin : begin + width] - middle
        # A stiff spring's frequency falls so fast at first that that of many windows is none of the first.
        starts = (omega,) if found else (omega, _strongest(time, values, period, band, reference, width))
        every = [_phasors(some, away, w - reference) if phasors else _window(some, away, w, band) for w in starts]
        one = min(every, key=lambda told: told[1])
        found.append((middle, *one))
        # From noise, which has no frequency, the next windows would begin anywhere.
        if abs(one[0]) > SEEN * one[1] and band[0] < one[2] + reference < band[1]:
            omega = one[2] + reference
    columns = [np.array(column) for column in zip(*found, strict=True)]
    columns[3] = columns[3] + reference
    return Track(*columns)


def _width(omega: float, period: float, phasors: bool, rows: int) -> int:
    """Rows of a window: `CYCLES` of the vibration, and of a waveform as many of its beat with the sampling; an eighth
    of the record at most, but `FEWEST` cycles of a waveform, which over less than one is no other than a constant.
    """
    beat = 2 * np.pi / period - 2.0 * omega
    slow = omega if phasors or beat > omega else max(beat, 0.0)
    cycle = 2 * np.pi / max(slow * period, 1e-300)
    least = max(rows // 8, 1) if phasors else max(rows // 8, min(FEWEST * cycle, rows // 2))
    return max(ROWS, int(np.ceil(min(CYCLES * cycle, least))))


def _apart(band: tuple[float, float], period: float, width: int) -> tuple[float, float]:
    """The part of a band in which a sine, a cosine and a constant are no sums of each other over a window of rows."""
    cycle = 2 * np.pi / (width * period)
    low, high = max(band[0], cycle), min(band[1], np.pi / period - cycle)
    return (low, high) if low < high else band


def _slope(time: np.ndarray, phase: np.ndarray, noise: np.ndarray) -> tuple[float, float]:
    """Slope of the straight line through phases with some noise, and its standard deviation."""
    weight = 1.0 / noise**2
    away = time - np.average(time, weights=weight)
    size = np.sum(weight * away**2)
    return float(np.sum(weight * away * phase) / size), float(1.0 / np.sqrt(size))


def rough_decay(time: np.ndarray, signal: np.ndarray, reference: float = 0.0) -> dict[str, tuple[float, str]]:
    """Frequency and quality factor of the strongest vibration that dies out, means weighted with its energy.

    Lines that stand in the whole record, as of the mains, are none.

    Args:
        time: (n,) [s].
        signal: (n,) real, or phasors at `reference` [Hz].

    Returns:
        Name of the design to value and unit; the quality factor is `UNTOLD` where nothing falls.
    """
    period, omega = usual_period(time), 2 * np.pi * reference
    slowest = 8 * np.pi / (period * len(time))
    band = (omega - np.pi / period if np.iscomplexobj(signal) else slowest, omega + np.pi / period)
    if np.all(np.diff(time) < 1.5 * period):  # among lost rows lines are not told
        signal = without_steady_lines(time, signal)
    track = tracked(time, signal, band, reference=omega)
    resonance, decay = track.usual
    quality = min(resonance / (2 * decay), UNTOLD) if decay > 0 else UNTOLD
    return {"resonance": (resonance / (2 * np.pi), "Hz"), "quality_factor": (max(quality, 1.0), "1")}


def too_slow(time: np.ndarray, signal: np.ndarray) -> float:
    """The frequency [Hz] below which `rough_decay` looks for nothing, four periods in a record (n,) [s], where most of
    what a real signal (n,) is beside a straight line lies there; zero elsewhere.
    """
    period, count = usual_period(time), len(time)
    even = np.interp(np.arange(count) * period + time[0], time, signal)
    place = np.linspace(-1.0, 1.0, count)
    even = (even - np.polyval(np.polyfit(place, even, 1), place)) * np.hanning(count)
    power = np.abs(np.fft.rfft(even)) ** 2
    return 4.0 / (period * count) if np.sum(power[1:4]) > np.sum(power[5:]) else 0.0


def _loudest(time: np.ndarray, values: np.ndarray, period: float, band: tuple[float, float], reference: float) -> float:
    """The strongest line of the first rows of a record, of so many that a waveform has `CYCLES` cycles in them."""
    rows = max(64, len(values) // 8)
    while True:
        omega = _strongest(time, values, period, band, reference, rows)
        if rows >= len(values) or np.iscomplexobj(values) or omega * period * rows > CYCLES * 2 * np.pi:
            return omega
        rows *= 2


def _strongest(
    time: np.ndarray, values: np.ndarray, period: float, band: tuple[float, float], reference: float, rows: int
) -> float:
    """The strongest line of the first rows of a record within a band."""
    first = slice(rows)
    some = np.interp(np.arange(time[0], time[first][-1] + 0.5 * period, period), time[first], values[first])
    some = (some - (0.0 if np.iscomplexobj(some) else some.mean())) * np.hanning(len(some))
    count = 8 * len(some)
    omega = 2 * np.pi * np.fft.fftfreq(count, period) + reference
    size = np.where((omega > band[0]) & (omega < band[1]), np.abs(np.fft.fft(some, count)), -1.0)
    return float(omega[np.argmax(size)])


def _window(values: np.ndarray, tau: np.ndarray, omega: float, band: tuple[float, float]) -> tuple[Any, ...]:
    """Phasor, its standard deviation, frequency within a band, its, decay rate, its, and the constant beside it, from
    values at times `tau` about the middle of their window [s].
    """
    half, start, first = max(float(tau[-1]), 1e-300), omega, None
    if not np.ptp(values) > 0:  # what has died away below the step of a converter
        return 0j, 0.0, omega, np.inf, 0.0, np.inf, float(values[0])
    for _ in range(ROUNDS):
        columns, found = _wave(values, tau, half, omega)
        first = first or (columns, found)
        rate = (found[2] + 1j * found[3]) / (found[0] + 1j * found[1]) / half
        move = float(np.clip(rate.imag, -1.0 / half, 1.0 / half))
        omega += move
        if abs(omega - start) > STRAYED * start or not band[0] <= omega <= band[1]:
            (columns, found), omega = first, start
            rate = (found[2] + 1j * found[3]) / (found[0] + 1j * found[1]) / half
            break
        if abs(move) < 1e-9 * abs(omega) + 1e-12:
            break
    a = found[0] + 1j * found[1]
    left = values - columns @ found
    freedom = max(1, len(values) - columns.shape[1])
    spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(columns.T @ columns)), 0.0) * float(left @ left) / freedom)
    slope = float(np.hypot(spread[2], spread[3])) / np.sqrt(2) / half / abs(a)
    level = float(np.hypot(spread[0], spread[1])) / np.sqrt(2)
    return a, level, omega, slope, -rate.real, slope, float(found[4])


def _wave(values: np.ndarray, tau: np.ndarray, half: float, omega: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns of a vibration whose size changes evenly, and of a constant, and how much of each there is."""
    turn = np.exp(1j * omega * tau)
    wave = np.stack([turn, 1j * turn, tau / half * turn, 1j * tau / half * turn], axis=1)
    columns = np.concatenate([wave.real, np.ones((len(tau), 1))], axis=1)
    return columns, np.linalg.lstsq(columns, values)[0]


def _phasors(values: np.ndarray, tau: np.ndarray, omega: float) -> tuple[Any, ...]:
    """`_window` of phasors, which have no constant: turned back they lie along a straight line."""
    half, mean = max(float(tau[-1]), 1e-300), tau.mean()
    away = tau - mean
    size = float(away @ away)
    for _ in range(ROUNDS):
        still = values * np.exp(-1j * omega * tau)
        b = away @ still / size if size else np.complex128(0.0)
        a = still.mean() - b * mean
        move = float(np.clip((b / a).imag, -1.0 / half, 1.0 / half))
        omega += move
        if abs(move) < 1e-9 * abs(omega) + 1e-12:
            break
    left = still - a - b * tau
    variance = float(np.vdot(left, left).real) / max(1, 2 * len(values) - 4)
    slope = float(np.sqrt(variance / size)) / abs(a) if size else 0.0
    level = float(np.sqrt(variance * (1.0 / len(values) + (mean**2 / size if size else 0.0))))
    return a, level, omega, slope, -(b / a).real, slope, 0.0
