"""The response over frequency that the answer to a step tells: where it falls, and where it rises before."""

import numpy as np
from jaxtyping import Float


HALF = np.sqrt(0.5)  # 3 dB down
_RISES, _SURE = 1.3, 3.0  # share by which power must rise to count, and standard deviations beyond
_EVERY = 600  # frequencies that are looked at
_AT_ONCE = 500_000  # sines
_FINE = 101  # of them about the highest, where a resonance is narrower than their steps


def first_half_power(answers: Float[np.ndarray, "dies times"], period: float) -> Float[np.ndarray, " dies"]:
    """The first frequency [Hz] at which the spectrum of the slope of each answer to a step, means over windows of
    `period` [s], is 3 dB down; NaN where it is not, up to 0.4 of a window's frequency.
    """
    whole = np.flatnonzero(np.all(np.isfinite(answers), axis=1))
    frequencies, sizes = spectrum_of_step(answers[whole], period)
    found = np.full(len(answers), np.nan)
    for k, size in zip(whole, sizes, strict=True):
        below = np.flatnonzero(size < HALF)
        if below.size and below[0] > 0:
            place = slice(below[0] - 1, below[0] + 1)
            found[k] = np.exp(np.interp(-HALF, -size[place], np.log(frequencies[place])))
    return found


def resonance_in_band(answers: Float[np.ndarray, "dies times"], period: float) -> str:
    """A sentence where the response of most dies rises by 3 dB or more before it falls by as much, as that of an open
    sense axis does at the mode split; else empty.
    """
    whole = answers[np.all(np.isfinite(answers), axis=1)]
    frequencies, sizes = spectrum_of_step(whole, period)
    found = [_rise(one, period, frequencies, size) for one, size in zip(whole, sizes, strict=True)]
    high = [rise for rise in found if rise is not None]
    if 2 * len(high) <= len(found) or not high:
        return ""
    gain, at, flat = np.median(np.array(high), axis=0)
    return (
        f"The bandwidth lies beyond a resonance of the response, {gain:.3g} times the static one at {at:.3g} Hz; it is "
        f"flat within 3 dB up to {flat:.3g} Hz alone."
    )


def spectrum_of_step(answers: Float[np.ndarray, "dies times"], period: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and the size (dies, frequencies) of the spectrum of the slope of answers there, means over
    windows of `period` [s].
    """
    frequencies = np.geomspace(0.02 / (answers.shape[1] * period), 0.4 / period, _EVERY)
    return frequencies, _size_at(frequencies, answers, period)


def _size_at(frequencies: np.ndarray, answers: Float[np.ndarray, "dies times"], period: float) -> np.ndarray:
    """The sines, which cost most, are made once for all dies, and not at all frequencies at a time."""
    slopes, times = np.diff(answers, prepend=0.0).T.astype(complex), np.arange(answers.shape[1])
    parts = np.array_split(frequencies, -(-frequencies.size * times.size // _AT_ONCE))
    sums = [np.exp(-2j * np.pi * part[:, None] * period * times) @ slopes for part in parts]
    return np.abs(np.concatenate(sums)).T / np.sinc(frequencies * period)


def spectrum_of(rate: Float[np.ndarray, "dies times"], period: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and one-sided power of each die there, per Hz, of means over a `period` [s] less their own."""
    moving = rate - rate.mean(axis=1, keepdims=True)
    power = 2.0 * period / rate.shape[1] * np.abs(np.fft.rfft(moving)) ** 2
    return np.fft.rfftfreq(rate.shape[1], period), power


def flat_up_to(frequencies: np.ndarray, power: Float[np.ndarray, "dies lines"], top: float) -> float:
    """The frequency [Hz] up to which noise does not rise, `top` at most: halved while the upper half of what is below
    has more power than the lower one. A rate from a displacement rises so beyond the mode split.
    """
    while True:
        halves = [(frequencies > low * top) & (frequencies <= high * top) for low, high in ((0.0, 0.5), (0.5, 1.0))]
        lines = min(int(half.sum()) for half in halves)
        if lines < 2:
            return top
        lower, upper = (float(np.mean(power[:, half])) for half in halves)
        chance = _SURE * np.sqrt(2.0 / (lines * len(power)))  # of two means of so many exponential numbers
        if upper <= lower * (_RISES + chance):
            return top
        top *= 0.5


def _rise(
    answer: Float[np.ndarray, " times"], period: float, frequencies: np.ndarray, size: np.ndarray
) -> tuple[float, float, float] | None:
    """The highest gain before the response falls by 3 dB, where it is [Hz], and up to where it has risen by no more
    than 3 dB; `None` where it never does. `size` is its spectrum at the `frequencies`.
    """
    below = np.flatnonzero(size < HALF)
    size = size[: below[0]] if below.size else size
    if not size.size or np.max(size) < 1.0 / HALF:
        return None
    top = int(np.argmax(size))
    near = np.linspace(frequencies[max(top - 1, 0)], frequencies[min(top + 1, len(frequencies) - 1)], _FINE)
    fine = _size_at(near, answer[None], period)[0]
    return float(np.max(fine)), float(near[np.argmax(fine)]), float(frequencies[np.argmax(size > 1.0 / HALF)])
