"""Lines that stand in a record beside what the device does: of the mains, of another instrument."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


CHANCE = 1e-6  # that noise alone makes a line of one of all bins of a record
BESIDE, WIDE, NEAR = 24, 240, 4  # bins that tell what is beside one, and that are its own under Hann's window
QUIET = 0.25  # of the bins beside one, in order of their power, the last that tells: other lines may stand among them
PARTS = 4  # of a record, in each of which a line must be as strong
EVEN, SIGMAS = 0.1, 4.0  # share of itself, and standard deviations, by which it may be another there
MOST, TRIED = 8, 16  # lines of a record, the mains and their harmonics; peaks that may be such
FEWEST = 64  # rows, below which none is looked for
FALLS = 1.0  # e-foldings of the vibration over a record, below which it does not differ from a line
SLOW = 0.5  # of the lowest vibration of a waveform: a line below that is none of its modes, however long they ring
ROUNDS, SETTLED = 12, 1e-6  # of moving frequencies, until they move by so much of a bin
POWERS = 3  # of what drives a device: lines of these are what it may answer with
CHUNK = 1 << 15  # rows at a time
SMOOTHED = 0.75  # of a gram's inverse: the variance that white noise has through Hann's window


@dataclass(frozen=True)
class StandingLine:
    """A line in a record.

    Args:
        omega: angular frequency beside the reference of phasors, or of a waveform [rad/s].
        amplitude: of each channel, peak [V].
    """

    omega: float
    amplitude: tuple[float, ...]

    def said(self, reference: float | None, unit: str, size: str = "") -> str:
        """Its size and where it is, in words; `reference` is that of phasors [rad/s], `size` what a fit made of it."""
        hertz, beside = self.omega / (2 * np.pi), ""
        if reference is not None:
            beside = f" ({abs(hertz):.6g} Hz {'above' if hertz > 0 else 'below'} the reference)"
            hertz += reference / (2 * np.pi)
        size = size or f"about {max(self.amplitude):.2g}"
        return f"a line of {size}{'' if unit == '1' else f' {unit}'} at {hertz:.9g} Hz{beside}"


def standing_lines(
    time: np.ndarray, signals: np.ndarray, omega: np.ndarray, decay: float, drives: np.ndarray | None = None
) -> tuple[StandingLine, ...]:
    """Lines in rows (n, channels) at even times [s], the strongest first: beyond what noise makes of any bin at 1e-6,
    beside the vibration, and as strong in each quarter of the record, as nothing is that dies out.

    Args:
        time, signals: of the rows; phasors, or a waveform.
        omega: of the vibrations (k,), beside the reference of phasors [rad/s].
        decay: the lowest of their rates [1/s]; infinite where none of them dies out, as they are driven.
        drives: (n, j) what acts on the device: where it, its square or cube has a line, one may be the answer to it.
    """
    span, real = float(time[-1] - time[0]), not np.iscomplexobj(signals)
    lasting = not decay * span > FALLS
    if len(time) < FEWEST or (lasting and not real):
        return ()
    bins, answers = 2 * np.pi * NEAR / span, _lines_of(time, drives, real)
    width = PARTS * bins + (4 * decay if np.isfinite(decay) else 0.0)

    def open_at(freq: np.ndarray) -> np.ndarray:
        """Where a line is none of the device."""
        apart = _distance(freq, omega) > width
        if lasting:
            apart = np.abs(freq) < SLOW * np.min(omega)
        no_constant = np.abs(freq) > bins if real else True
        return np.asarray(apart & no_constant & (_distance(freq, answers) > bins))

    freq, power = _periodogram(time, signals)
    places = np.flatnonzero(_is_line(power) & open_at(freq))
    found = freq[places[np.argsort(-power[places])][:TRIED]]
    while found.size:
        found = _moved(time, signals, found)
        kept = _is_even(time, signals, found) & open_at(found)
        if kept.all():
            break
        found = found[kept]
    size = np.abs(_phasors(time, signals, found)[0])
    order = np.argsort(-size.max(axis=1, initial=0.0))[:MOST]
    return tuple(StandingLine(float(found[k]), tuple(map(float, size[k]))) for k in order)


def without_lines(time: np.ndarray, signals: np.ndarray, lines: Sequence[StandingLine]) -> np.ndarray:
    """Rows (n, channels) without lines that were found in them."""
    omega = np.array([line.omega for line in lines])
    return signals - _drawn(time, _phasors(time, signals, omega)[0], omega, signals) if lines else signals


def without_steady_lines(time: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """A signal (n,) at even times [s] without the lines that stand in it, where nothing is known of what vibrates.

    A vibration that hardly falls stands there as a line does: as the one beside which most is left, since it falls, or
    as the strongest where only noise is left. That one is kept.
    """
    rows, bins = signal[:, None] - signal.mean(), 2 * np.pi * NEAR / (time[-1] - time[0])
    late = slice(len(time) // 2, None)  # where most of what dies out is gone
    lines = standing_lines(time[late], rows[late], np.zeros(0), np.inf)
    freq, power = _periodogram(time, without_lines(time, rows, lines), np.ones)  # Hann's would hide how a decay begins
    top, noise = np.argmax(power), np.median(power) / np.log(2.0)
    alone = power[top] < noise * np.log(power.size / CHANCE)
    near = [abs(line.omega - freq[top]) < bins for line in lines]
    itself = 0 if alone else near.index(True) if any(near) else -1
    others = [line for k, line in enumerate(lines) if k != itself]
    return without_lines(time, signal[:, None], others)[:, 0]


def _periodogram(
    time: np.ndarray, signals: np.ndarray, window: Callable[[int], np.ndarray] = np.hanning
) -> tuple[np.ndarray, np.ndarray]:
    """Angular frequencies (k,) and power (k,) of rows under a window, Hann's, all channels together."""
    windowed, period = signals * window(len(time))[:, None], (time[-1] - time[0]) / (len(time) - 1)
    turns = np.iscomplexobj(signals)
    lines = (np.fft.fft if turns else np.fft.rfft)(windowed, axis=0)
    freq = (np.fft.fftfreq if turns else np.fft.rfftfreq)(len(time), period)
    order = np.argsort(freq)
    return 2 * np.pi * freq[order], np.sum(np.abs(lines[order]) ** 2, axis=1)


def _beside(power: np.ndarray, places: np.ndarray, reach: int = BESIDE) -> np.ndarray:
    """The mean of the bins beside some, as far as they reach, without their own, as the quiet ones of them tell it."""
    wide = np.pad(power, reach, mode="reflect")
    every = np.lib.stride_tricks.sliding_window_view(wide, 2 * reach + 1)[places]
    kept = np.abs(np.arange(-reach, reach + 1)) > NEAR
    return np.quantile(every[:, kept], QUIET, axis=1) / -np.log1p(-QUIET)


def _is_line(power: np.ndarray) -> np.ndarray:
    """Where a bin is the highest of its neighbours, and higher than noise makes one of all."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(power, NEAR), 2 * NEAR + 1)
    peaks = np.flatnonzero((power >= around.max(axis=1)) & (power > 0.0))
    for reach in (BESIDE, WIDE):  # what is near tells the noise where it rises, but so few bins scatter by a half
        peaks = peaks[power[peaks] > _beside(power, peaks, reach) * np.log(power.size / CHANCE)]
    out = np.zeros(power.size, bool)
    out[peaks] = True
    return out


def _lines_of(time: np.ndarray, drives: np.ndarray | None, real: bool) -> np.ndarray:
    """Angular frequencies (k,) of the lines of what drives a device and of its powers, of both signs for phasors."""
    found = []
    scaled = [] if drives is None else [one / max(float(np.max(np.abs(one))), 1e-300) for one in drives.T]
    for drive in [*scaled, *([sum(scaled)] if len(scaled) > 1 else [])]:  # of which powers hold what they do together
        for power in range(1, POWERS + 1):
            raised = drive**power
            freq, height = _periodogram(time, (raised - raised.mean())[:, None])
            found.append(freq[_is_line(height)])
    every = np.concatenate([np.zeros(0), *found])
    return every if real else np.concatenate([every, -every])


def _distance(freq: np.ndarray, places: np.ndarray) -> np.ndarray:
    """How far each frequency is from the nearest of some places; infinite where there are none."""
    return np.min(np.abs(np.subtract.outer(freq, places)), axis=1, initial=np.inf)


class _Members(NamedTuple):
    """The turning phasors of lines, those of a waveform with their conjugates and a constant.

    Args:
        turns: (m,) angular frequency of each [rad/s].
        line: (m,) which line it is of; none for the constant.
        sign: (m,) of its frequency in that of its line.
    """

    turns: np.ndarray
    line: np.ndarray
    sign: np.ndarray

    @classmethod
    def of(cls, omega: np.ndarray, real: bool) -> "_Members":
        every = np.arange(omega.size)
        if not real:
            return cls(omega, every, np.ones(omega.size))
        signs = np.repeat([1.0, -1.0, 0.0], [omega.size, omega.size, 1])
        return cls(np.concatenate([omega, -omega, [0.0]]), np.concatenate([every, every, [-1]]), signs)


def _products(time: np.ndarray, signals: np.ndarray, turns: np.ndarray, powers: int) -> tuple[np.ndarray, np.ndarray]:
    """Under Hann's window: of phasors that turn, times powers of the time, with each other (p·m, p·m), and with the
    rows (p·m, channels).
    """
    window, many = np.hanning(len(time)), powers * len(turns)
    gram, seen = np.zeros((many, many), complex), np.zeros((many, signals.shape[1]), complex)
    for begin in range(0, len(time), CHUNK):
        rows = slice(begin, begin + CHUNK)
        phasors = np.exp(1j * np.outer(time[rows], turns))
        basis = np.concatenate([phasors * time[rows, None] ** k for k in range(powers)], axis=1)
        held = (basis * window[rows, None]).conj().T
        gram, seen = gram + held @ basis, seen + held @ signals[rows]
    return gram, seen


def _moved(time: np.ndarray, signals: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """The frequencies near some that leave least of the rows under Hann's window, all lines together."""
    span, real = time[-1] - time[0], not np.iscomplexobj(signals)
    away, bins = (time - time.mean()) / span, 2 * np.pi / span
    for _ in range(ROUNDS):
        turns, line, sign = _Members.of(omega, real)
        many = len(turns)
        gram, seen = _products(away, signals, turns * span, 2)
        size, beside = (
            np.linalg.solve(gram[:many, :many], seen[:many]),
            np.linalg.solve(gram[:many, :many], gram[:many, many:]),
        )
        left, free = seen[many:] - gram[many:, :many] @ size, gram[many:, many:] - gram[many:, :many] @ beside
        own = (line[:, None] == np.arange(omega.size)) * sign[:, None]
        ways = [1j * own * one[:, None] for one in size.T]  # by which the rows of a channel move with each frequency
        normal = sum((way.conj().T @ free @ way).real for way in ways)
        wanted = sum((way.conj().T @ part).real for way, part in zip(ways, left.T, strict=True))
        step = np.clip(np.linalg.lstsq(normal, wanted, rcond=None)[0] / span, -bins / 2, bins / 2)
        omega = omega + step
        if np.all(np.abs(step) < SETTLED * bins):
            break
    return omega


def _phasors(time: np.ndarray, signals: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phasor of each line and channel (k, channels), and its variance for a white noise of one (k,)."""
    real, half = not np.iscomplexobj(signals), time.mean()
    gram, seen = _products(time - half, signals, _Members.of(omega, real).turns, 1)
    inverse = np.linalg.inv(gram)
    sides = 2 if real else 1
    turned = np.exp(-1j * omega * half)[:, None]
    spread = SMOOTHED * np.diag(inverse).real[: omega.size]
    return sides * turned * (inverse @ seen)[: omega.size], sides**2 * spread


def _is_even(time: np.ndarray, signals: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Which lines are as strong, and turned alike, in each part of the record."""
    whole, _ = _phasors(time, signals, omega)
    strong = np.argmax(np.abs(whole), axis=1)
    size = np.abs(whole)[np.arange(omega.size), strong]
    left, even = signals - _drawn(time, whole, omega, signals), np.ones(omega.size, bool)
    for rows in np.array_split(np.arange(len(time)), PARTS)[1:]:  # the first holds most of what dies out
        part, spread = _phasors(time[rows], signals[rows], omega)
        freq, power = _periodogram(time[rows], left[rows])
        places = np.argmin(np.abs(np.subtract.outer(omega, freq)), axis=1)
        noise = _beside(power, places) / np.sum(np.hanning(len(rows)) ** 2)
        off = np.abs(part - whole)[np.arange(omega.size), strong]
        even &= off < EVEN * size + SIGMAS * np.sqrt(noise * spread)
    return even


def _drawn(time: np.ndarray, phasors: np.ndarray, omega: np.ndarray, signals: np.ndarray) -> np.ndarray:
    """Lines of phasors (k, channels) over the rows."""
    out = np.zeros_like(signals)
    for turn, one in zip(omega, phasors, strict=True):
        values = np.exp(1j * turn * time)[:, None] * one
        out = out + (values if np.iscomplexobj(signals) else values.real)
    return out
