"""A gyro on a rate table, in plain NumPy: what a log would hold."""

import numpy as np
from scipy.signal import lfilter


def low_passed(values, corner, sample_rate):
    """Behind one pole at `corner` [Hz]."""
    pole = np.exp(-2.0 * np.pi * corner / sample_rate)
    return lfilter([1.0 - pole], [1.0, -pole], values, zi=[pole * values[0]])[0]


def rates_over_time(sequence, dwell, sample_rate, acceleration=200.0):
    """Rates [deg/s] of a table that holds each of a `sequence` for `dwell` [s]."""
    parts, before = [], 0.0
    for rate in sequence:
        count = round(abs(rate - before) / acceleration * sample_rate)
        parts += [np.linspace(before, rate, count, endpoint=False), np.full(round(dwell * sample_rate), float(rate))]
        before = rate
    return np.concatenate(parts)


def back_to_zero(*rates):
    """Zero, and each rate with zero behind it."""
    return [0.0, *(each for rate in rates for each in (rate, 0.0))]


def flicker(rng, count, sample_rate, strength):
    """Noise of the two-sided density strength²/(2π f), down to one period in eight counts."""
    frequency = np.fft.rfftfreq(8 * count, 1.0 / sample_rate)
    density = np.concatenate([[0.0], strength**2 / (2.0 * np.pi * frequency[1:])])
    lines = rng.standard_normal((2, len(frequency))) * np.sqrt(density * 8 * count * sample_rate / 2.0)
    return np.fft.irfft(lines[0] + 1j * lines[1])[:count]
