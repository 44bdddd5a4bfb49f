"""Where a waveform that nothing drives, or a lock-in's phasors of it, begin to die out, and where it can no longer be
read.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import fftconvolve

from .experiments.clipping import clipped_rows
from .experiments.converter_steps import lost_in_steps, rms_around
from .noise import noise_over_time


_LOUD = 0.9  # of the largest envelope: the decay has not begun
_FIRST = 0.02  # of the rows: a decay that begins in them begins with the first
_LOUDER = 1.05  # times the rows that count: what is said of those before
_PERIODS = 4  # in a window at least over which the size of a vibration is told
_UNSURE = 0.3  # of the fall over a window, by which noise may change it
_FALLEN = 0.02  # in natural logarithms: an envelope that falls by less is kept up
_EARLY = 0.94  # of the usual fall: an envelope that falls by so much in its first quarter falls from the start
_SEEN = 10.0  # standard deviations of noise from which a phasor counts
_ROWS = 24  # in which a rise can be told from a decay
_SURE, _SLOWER = 10.0, 0.5  # standard deviations by which phasors would have fallen; share of it that is a slow start
_KEPT_UP, _RISING, _HALF = 0.99, 0.9, 0.5  # of the largest phasor or envelope
_QUICKER, _STANDS_OUT = 10.0, 20.0  # than the decay is what a filter leaves; χ² that it must explain
_MORE = 0.5  # of the time that it is seen for, until it is gone
_DIES, _OTHER = 0.5, 0.03  # in natural logarithms: a fall that tells a decay; a part that is of another vibration


class DecayRows(NamedTuple):
    """The rows of a record that are a free decay.

    Args:
        begin, end: the first row, and the one behind the last.
        why: where it begins and why, in words to put a time into; empty for the first row. `until` likewise of its end.
    """

    begin: int
    end: int
    why: str = ""
    until: str = ""


def part_of_decay(signal: np.ndarray, unit: str, fewest: int) -> DecayRows:
    """What of a waveform (n,) in a unit is a free decay that its converter could read, of `fewest` rows at least.

    It begins where its envelope was last near its largest, or is no longer clipped.
    """
    rows, begin = len(signal), begin_of_decay(signal)
    why = "begins at {}, where its envelope falls for good" if begin else ""
    if begin < (whole := _behind_clipping(signal)) < rows - fewest:
        begin, why = whole, "begins at {}, where it is no longer clipped, as at the end of a range"
    why += _louder_before(signal, begin, unit)
    end, step = lost_in_steps(signal)
    if end == rows or end - begin < fewest:
        return DecayRows(begin, rows, why)
    small = f"where it falls below four steps of {step:.3g} {unit}, in which it was read and which hide what is smaller"
    return DecayRows(begin, end, why, f"ends at {{}}, {small}")


def _louder_before(signal: np.ndarray, begin: int, unit: str) -> str:
    """How loud the rows before the first are that counts, in words; empty where they are not louder."""
    size = np.abs(signal - np.median(signal))
    before, after = np.max(size[:begin], initial=0.0), np.max(size[begin:])
    if before < _LOUDER * after:
        return ""
    return f"; louder rows before it, up to {before:.3g} {unit} beside {after:.3g} {unit}, are left out"


def begin_of_decay(signal: np.ndarray) -> int:
    """The row (n,) from which on a waveform dies out: behind where its envelope was last near its largest, told to a
    few periods where noise allows it, or the first.
    """
    width, moved = max(len(signal) // 50, 3), signal - np.mean(signal)
    envelope = rms_around(moved, width)
    if _falls_from_the_start(envelope, width):
        return 0
    late = int(np.flatnonzero(envelope >= _LOUD * envelope.max())[-1])
    return _told_finely(moved, late, envelope) if late > _FIRST * len(signal) else 0


def _told_finely(moved: np.ndarray, late: int, envelope: np.ndarray) -> int:
    """From where on the vibration that dies out at the row `late` has fallen as fast as there.

    Its size is told over windows so long that the fall from one to the next is sure beside the noise; where that asks
    for as many rows as the `envelope` (n,) was told over, that row remains.
    """
    width = max(len(moved) // 50, 3)
    after = moved[late : late + width + 1]
    if len(after) <= width:
        return late
    omega = 2 * np.pi * np.argmax(np.abs(np.fft.rfft(after * np.hanning(width + 1), 8 * width))) / (8 * width)
    rate = np.log(envelope[late] / envelope[late + width]) / width
    unclear = noise_over_time(moved[:, None]) / (np.sqrt(2.0) * envelope[late])
    sure = (_SEEN * unclear / max(_UNSURE * rate, 1e-300)) ** (2 / 3)
    rows = int(np.ceil(min(width, max(sure, _PERIODS * 2 * np.pi / max(omega, 1e-300)))))
    if rows >= width:
        return late
    part = moved[: late + 3 * rows]
    turned = part * np.exp(-1j * omega * np.arange(len(part)))
    size = np.abs(fftconvolve(turned, np.hanning(rows + 2)[1:-1], mode="same"))
    fall = np.log(size[:-rows] / size[rows:])
    slower = np.flatnonzero(fall[: late + 1] < (1.0 - _UNSURE) * np.median(fall[late : late + rows]))
    # A window in which less than `_UNSURE` was kept up falls so fast already: half a window more is none of it.
    return min(late, int(slower[-1]) + 1 + rows // 2) if slower.size else late


def _behind_clipping(signal: np.ndarray) -> int:
    """The row (n,) behind the last one in which a waveform seems to be clipped, 0 where it is not."""
    rows = clipped_rows(signal)
    return int(rows[-1]) + 1 if len(rows) else 0


def _falls_from_the_start(envelope: np.ndarray, width: int) -> bool:
    """Whether a free decay has begun before the first row: until it has halved, or the record ends, it falls by nearly
    as much in the first quarter as in the others, while one that is kept up first falls later.
    """
    whole = envelope[width // 2 :]  # before, there are not as many rows around each, and it seems to fall more slowly
    halved = whole < 0.5 * whole[0]
    end = int(np.argmax(halved)) if halved.any() else len(whole) - 1
    quarter, fall = end // 4, float(np.log(whole[0] / whole[end]))
    if quarter < width or fall < _FALLEN or whole[0] < _HALF * whole.max():
        return False
    return bool(4.0 * np.log(whole[0] / whole[quarter]) > _EARLY * fall)


def behind_the_filter(time: np.ndarray, phasors: np.ndarray) -> int:
    """The row (n,) from which on phasors at times [s] show nothing more of what a lock-in's filter held before: zero
    where they fall from the first one on, and where what they do is no low pass that settles.

    What a low pass holds dies out ten times faster than a vibration, or more. It shows beside a decay whose rate and
    frequency are a constant, and two parts in proportion to the amplitude and to its square.
    """
    noise = max(noise_over_time(phasors[:, None]), 1e-300)
    loud = np.abs(phasors) > _SEEN * noise
    first = int(np.argmax(loud))
    count = int(np.argmin(np.append(loud[first:], False)))
    if count < 2 * _ROWS:
        return 0
    t, z = time[first : first + count] - time[first], phasors[first : first + count]
    size = np.abs(z)
    peak = int(np.argmax(size))
    end = min(count - 1, peak + int(np.argmax(np.append(size[peak:] < size[peak] / np.e, True))))
    fall = float(np.log(size[peak] / size[end]))
    decay = fall / (t[end] - t[peak]) if end > peak and fall > _DIES else 0.0
    sure = int(np.argmax(decay * t * size[0] > _SURE * np.sqrt(2) * noise))
    if not sure or np.log(size[sure] / size[0]) < -_SLOWER * decay * t[sure]:
        return 0
    rises = size[0] < _RISING * size[peak]
    start = 0 if rises else int(np.flatnonzero(size >= _KEPT_UP * size[peak])[-1])
    row = peak if rises else start
    while size[row] > _HALF * size[peak]:
        held, left = _beside_a_decay(t[row:], z[row:], decay, noise)
        if held < _STANDS_OUT:
            return 0 if left > _OTHER else first + row + int(np.ceil(_MORE * (row - start)))
        row += max(1, (row - start) // 8)
    return 0


def _beside_a_decay(time: np.ndarray, phasors: np.ndarray, decay: float, noise: float) -> tuple[float, float]:
    """Of phasors over about a time constant of their `decay` [1/s]: the χ² that what dies out faster explains, and the
    part of themselves by which they lie off a lone decay beyond their noise.
    """
    end = max(_ROWS, int(np.searchsorted(time, time[0] + 1.0 / decay)))
    t, size = time[:end] - time[0], np.abs(phasors[:end])
    weight, part = (size / noise)[:, None], size / size[0]
    rates, steps = np.stack([part**0, part, part**2], axis=1), decay * np.diff(t)[:, None]
    course = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (rates[1:] + rates[:-1]) * steps, axis=0)])
    usual, _ = np.linalg.qr(np.concatenate([np.ones((len(t), 1)), course], axis=1) * weight)
    spans = t[-1] / _QUICKER / 2.0 ** np.arange(64)
    held = np.exp(-t[:, None] / spans[spans > 0.5 * np.median(np.diff(t))]) * weight
    seen = (np.log(size) + 1j * np.unwrap(np.angle(phasors[:end])))[:, None] * weight
    held, seen = (one - usual @ (usual.T @ one) for one in (held, seen))
    gained = np.abs(held.T @ seen)[:, 0] ** 2 / np.sum(held**2, axis=0)
    beyond = max(float(np.mean(np.abs(seen) ** 2)) - 2.0, 0.0)
    return float(np.max(gained, initial=0.0)), float(np.sqrt(beyond / np.mean(weight**2)))
