"""Rates of known noise, each an average over its sample period; the period is the unit of time."""

import numpy as np


def draw(rng, samples, series, n=0.0, b=0.0, k=0.0, r=0.0, q=0.0):
    """(series, samples) of angle random walk, flicker, rate random walk, ramp and quantisation of these strengths."""
    rate = n * rng.standard_normal((series, samples))
    walk = k * np.cumsum(rng.standard_normal((series, samples + 1)), axis=-1)
    # Between its ends a Wiener process averages to their mean and a number of variance 1/12.
    rate += 0.5 * (walk[:, 1:] + walk[:, :-1]) + k / np.sqrt(12.0) * rng.standard_normal((series, samples))
    rate += r * np.arange(samples)
    rate += np.diff(q * rng.standard_normal((series, samples + 1)), axis=-1)
    return rate + (flicker(rng, samples, series, b) if b else 0.0)


def flicker(rng, samples, series, b):
    """Two-sided density B²/(2π|f|), averaged over the period and so folded; periodic over eight times the record."""
    size = 8 * samples
    f = np.fft.rfftfreq(size)[1:]
    density = sum(np.sinc(f + k) ** 2 / np.abs(f + k) for k in range(-20, 21)) * b**2 / (2.0 * np.pi)
    spectrum = np.concatenate([[0.0], np.sqrt(density)]) * np.fft.rfft(rng.standard_normal((series, size)))
    return np.fft.irfft(spectrum, size)[:, :samples]
