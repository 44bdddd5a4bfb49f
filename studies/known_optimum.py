"""Does tuning by gradient find an optimum that is known?

A rate that forgets itself (Ornstein-Uhlenbeck, 2 Hz) is measured with white noise and smoothed. The best first-order
low-pass and the steady Kalman gain have closed forms; optimistix finds them on the exact loss and on records.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optimistix as optx
from _common import Report

import memsgyro_jax as mg
from memsgyro_jax.base import runtime
from memsgyro_jax.loop.filters import AbstractFilter


runtime.configure()

FORGETTING = 2.0 * np.pi * 2.0  # 1/s, of a rate with unit variance
DENSITY = 2e-3  # s, of the noise, two-sided: its variance per sample is DENSITY * SAMPLE_RATE
SAMPLE_RATE = 1e3
MEMORY, NOISE = np.exp(-FORGETTING / SAMPLE_RATE), DENSITY * SAMPLE_RATE


class Smoothing(AbstractFilter):
    """Exponential smoothing: the low-pass of the closed form, sampled. A filter of one's own is as short as this."""

    bandwidth: jax.Array = eqx.field(converter=jnp.asarray)

    def init(self, level=0.0):
        return (jnp.asarray(level, float),)

    def step(self, state, value, period):
        kept = jnp.exp(-2.0 * jnp.pi * self.bandwidth * period)
        value = kept * state[0] + (1.0 - kept) * value
        return value, (value,)

    def edges(self):
        return (self.bandwidth,)


class Kalman(AbstractFilter):
    """The filter that knows how the rate forgets itself; its gain is free."""

    gain: jax.Array = eqx.field(converter=jnp.asarray)

    def init(self, level=0.0):
        return (jnp.asarray(level, float),)

    def step(self, state, value, period):
        predicted = jnp.exp(-FORGETTING * period) * state[0]
        value = predicted + self.gain * (value - predicted)
        return value, (value,)

    def edges(self):
        return (jnp.zeros(()),)


def continuous_loss(bandwidth):
    """Mean squared error of a first-order low-pass without sampling: lag and noise."""
    corner = 2.0 * jnp.pi * bandwidth
    return FORGETTING / (FORGETTING + corner) + 0.5 * DENSITY * corner


def smoothing_loss(bandwidth):
    """The same for exponential smoothing, sampled."""
    kept = jnp.exp(-2.0 * jnp.pi * bandwidth / SAMPLE_RATE)
    lag = 2.0 * kept**2 * (1.0 - MEMORY) / ((1.0 + kept) * (1.0 - kept * MEMORY))
    return lag + NOISE * (1.0 - kept) / (1.0 + kept)


def kalman_loss(gain):
    """The same for the Kalman filter: error' = (1 - gain)(memory · error + what is new) - gain · noise."""
    new, kept = 1.0 - MEMORY**2, 1.0 - gain
    return (kept**2 * new + gain**2 * NOISE) / (1.0 - (kept * MEMORY) ** 2)


def lowpass_loss(bandwidth):
    """The same for `Lowpass` of order 1, a trapezoidal filter, from its stationary covariance with the rate."""
    warped = jnp.tan(jnp.pi * bandwidth / SAMPLE_RATE)
    share = warped / (1.0 + warped)
    cross = 2.0 * share * MEMORY / (1.0 - (1.0 - 2.0 * share) * MEMORY)  # of the rate and what the filter holds
    own = (4.0 * share**2 * (1.0 + NOISE) + 4.0 * share * (1.0 - 2.0 * share) * cross) / (
        1.0 - (1.0 - 2.0 * share) ** 2
    )
    return (1.0 - share) ** 2 * (1.0 - 2.0 * cross + own) + share**2 * NOISE


def optimum(loss, start: float) -> float:
    """The positive number at which `loss` is least, by its gradient; sought on a logarithmic scale."""

    @jax.custom_jvp
    def scaled(coordinate):
        return loss(jnp.exp(coordinate))

    @scaled.defjvp
    def _slope(at, along):
        # The slope as a number: optimistix would keep every sample of the records to differentiate by itself.
        value, slope = jax.jvp(lambda coordinate: loss(jnp.exp(coordinate)), at, (jnp.ones(()),))
        return value, slope * along[0]

    solver, begin = optx.BFGS(rtol=1e-9, atol=1e-9), jnp.log(jnp.asarray(start))
    return float(jnp.exp(optx.minimise(lambda y, _: scaled(y), solver, begin, max_steps=100).value))


def records(count: int, length: int) -> tuple[jax.Array, jax.Array]:
    """Rates and their measurements, (samples, records)."""
    keys = jax.random.split(jax.random.key(2), 3)
    first = jax.random.normal(keys[0], (count,))
    kicks = np.sqrt(1.0 - MEMORY**2) * jax.random.normal(keys[1], (length, count))
    rates = jax.lax.scan(lambda rate, kick: ((MEMORY * rate + kick),) * 2, first, kicks)[1]
    return rates, rates + np.sqrt(NOISE) * jax.random.normal(keys[2], (length, count))


@eqx.filter_jit
def error_on(filter_: AbstractFilter, data: tuple[jax.Array, jax.Array]):
    """Mean squared error over records, after the start has been forgotten."""
    rates, measured = data

    def sample(carry, row):
        state, total, number = carry
        output, state = filter_.step(state, row[1], 1.0 / SAMPLE_RATE)
        return (state, total + jnp.where(number >= SKIPPED, (output - row[0]) ** 2, 0.0), number + 1), None

    start = (filter_.init(jnp.zeros(rates.shape[1])), jnp.zeros(rates.shape[1]), 0)
    return jnp.mean(jax.lax.scan(sample, start, (rates, measured))[0][1]) / (len(rates) - SKIPPED)


SKIPPED = 500
report = Report()

closed = (np.sqrt(2.0 * FORGETTING / DENSITY) - FORGETTING) / (2.0 * np.pi)
report.row("best bandwidth, continuous [Hz]", "15.84", float(closed), "√(2a/r) - a, in rad/s")
gap = optimum(continuous_loss, 5.0) / closed - 1.0
report.row("  by gradient on the exact loss, relative", "1e-6", f"{gap:.1e}", "from 5 Hz")

# (1 - m) p (2 + (1 - m) p) = R (1 - m p)² for the kept share p of a sample, m the memory of the rate, R the noise
new = 1.0 - MEMORY
roots = np.roots([new**2 - NOISE * MEMORY**2, 2.0 * new + 2.0 * NOISE * MEMORY, -NOISE])
sampled = -np.log(roots[(roots > 0.0) & (roots < 1.0)][0]) * SAMPLE_RATE / (2.0 * np.pi)
report.row("best bandwidth, 1 kHz [Hz]", "15.94", float(sampled), "exponential smoothing")
gap = optimum(smoothing_loss, 5.0) / sampled - 1.0
report.row("  by gradient on the exact loss, relative", "1e-6", f"{gap:.1e}", "from 5 Hz")

count, length = (1000, 3000) if report.quick else (4000, 5000)
data = records(count, length)
remark = f"{count} records of {(length - SKIPPED) / SAMPLE_RATE:g} s"
on_data = optimum(lambda value: error_on(Smoothing(value), data), 5.0)
report.row("  by gradient on records, relative", "0.5 %",
           f"{100.0 * (on_data / sampled - 1.0):+.2f} %", remark)  # fmt: skip

trapezoidal = optimum(lowpass_loss, 5.0)
tuned = optimum(lambda value: error_on(mg.Lowpass(value, 1), data), 5.0)
report.row(
    "best bandwidth of Lowpass, order 1, 1 kHz [Hz]",
    "",
    trapezoidal,
    "trapezoidal: it has no closed form, its loss has",
)
report.row("  by gradient on records, relative", "", f"{100.0 * (tuned / trapezoidal - 1.0):+.2f} %", remark)

before = new * (1.0 + MEMORY)  # Riccati: variance before the measurement, P = m² P R/(P + R) + 1 - m²
half = 0.5 * (NOISE * (1.0 - MEMORY**2) - before)
steady = -half + np.sqrt(half**2 + before * NOISE)
gain = steady / (steady + NOISE)
report.row("steady Kalman gain", "Riccati", float(gain), "of the filter that knows how the rate forgets itself")
report.row(
    "  by gradient on the exact loss, relative", "1e-6", f"{optimum(kalman_loss, 0.02) / gain - 1.0:.1e}", "from 0.02"
)
found = optimum(lambda value: error_on(Kalman(value), data), 0.02)
report.row("  by gradient on records, relative", "0.5 %",
           f"{100.0 * (found / gain - 1.0):+.2f} %", remark)  # fmt: skip

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
at = np.geomspace(3.0, 100.0, 200)
for number, (name, loss, make, best) in enumerate((
    ("exponential smoothing", smoothing_loss, Smoothing, on_data),
    ("Lowpass, order 1", lowpass_loss, lambda value: mg.Lowpass(value, 1), tuned),
)):  # fmt: skip
    left.semilogx(at, [float(loss(f)) for f in at], f"C{number}", label=f"{name}, exact")
    left.plot(best, float(error_on(make(best), data)), f"C{number}o", label=f"{name}, tuned on records")
left.semilogx(at, [float(continuous_loss(f)) for f in at], "k--", lw=1.0, label="without sampling")
left.axvline(sampled, color="0.6", lw=1.0)
left.set(xlabel="bandwidth [Hz]", ylabel="mean squared error", ylim=(0.15, 0.6), title="low-pass")
gains = np.geomspace(0.01, 0.6, 200)
right.semilogx(gains, [float(kalman_loss(k)) for k in gains], "C2", label="exact")
right.plot(found, float(error_on(Kalman(found), data)), "C2o", label="tuned on records")
right.axvline(gain, color="0.6", lw=1.0, label="Riccati")
right.set(xlabel="gain", ylabel="mean squared error", ylim=(0.15, 0.6), title="Kalman filter")
for ax in (left, right):
    ax.legend(frameon=False, fontsize=8)
report.picture(figure, "known_optimum")
report.finish()
