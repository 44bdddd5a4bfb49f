"""Figures of merit against scipy and exact cases."""

import numpy as np
import pytest
from scipy import signal, stats

from memsgyro_jax.montecarlo.following import following
from memsgyro_jax.montecarlo.merit import Moments, percentiles, proportion, ratio, settling_time, straight_error


def test_a_yield_has_its_wilson_interval():
    """Closed form of Wilson (1927) for 45 of 50."""
    z, n, p = stats.norm.ppf(0.975), 50, 0.9
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    found = proportion(45, 50, "in range")
    assert (found.value, found.low, found.high) == pytest.approx((0.9, middle - half, middle + half))
    assert proportion(0, 0, "nothing").high == 1.0


def test_percentiles_leave_out_what_is_not_finite():
    errors = np.concatenate([np.linspace(-1.0, 1.0, 2001), [np.nan, np.inf]])
    found = percentiles(errors)
    assert found.rms == pytest.approx(1.0 / np.sqrt(3.0), rel=1e-3)
    assert (found.p50, found.p95) == pytest.approx((0.5, 0.95), abs=1e-3)
    assert np.isnan(percentiles(np.array([np.nan])).rms)


@pytest.mark.parametrize(("bandwidth", "delay"), [(10.0, 0.004), (30.0, 0.0), (50.0, 0.002)])
def test_delay_and_bandwidth_of_a_known_lag_are_found(bandwidth, delay):
    time = np.arange(400) * 1e-3
    fine = np.arange(40000) * 1e-5
    rate = lambda t: np.sin(2 * np.pi * 12.0 * t) + 0.5 * np.sin(2 * np.pi * 31.0 * t + 1.0)  # noqa: E731
    lag = 1.0 / (2.0 * np.pi * bandwidth)
    slow = signal.lsim(([1.0], [lag, 1.0]), rate(fine), fine)[1]
    estimate = np.interp(time - delay, fine, slow)
    late = time > 0.1
    rng = np.random.default_rng(0)
    dies = estimate[late] + 0.02 * rng.standard_normal((50, late.sum()))
    found = following(time[late], rate(time[late]), dies)
    assert found is not None
    assert found.bandwidth == pytest.approx(bandwidth, rel=0.03)
    assert found.delay == pytest.approx(delay, abs=2e-4)
    assert found.bandwidth_interval[0] <= bandwidth <= found.bandwidth_interval[1]
    assert found.delay_interval[0] <= delay <= found.delay_interval[1]


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("kind", ["chirp", "step", "walk"])
def test_a_bandwidth_of_thirty_hertz_is_found_whatever_the_law(order, kind):
    """Butterworth lags of 30 Hz: a law of first order alone read 45 Hz and 5 ms off one of second order."""
    fine = np.arange(20_000) * 1e-5
    walk = np.cumsum(np.random.default_rng(1).standard_normal(fine.size)) * 0.01
    rate = {"chirp": signal.chirp(fine, 1.0, 0.2, 60.0), "step": (fine > 0.1) * 1.0, "walk": walk}[kind]
    slow = signal.lfilter(*signal.butter(order, 30.0, fs=1e5), rate)
    time, true, mean = (values.reshape(100, -1).mean(axis=1) for values in (fine, rate, slow))
    dies = mean + 0.02 * np.std(true) * np.random.default_rng(0).standard_normal((50, 100))
    found = following(time, true, dies, settle=0.05)
    assert found is not None
    assert found.bandwidth == pytest.approx(30.0, rel=0.06)
    assert found.bandwidth_interval[0] <= 30.0 <= found.bandwidth_interval[1]
    assert found.bandwidth_interval[1] < 1.3 * found.bandwidth_interval[0]


def test_a_single_frequency_shows_a_shift_and_no_bandwidth():
    """At one frequency every lag with its own delay answers alike; the shift is the phase over the frequency."""
    fine = np.arange(20_000) * 1e-5
    rate, slow = (
        np.sin(2 * np.pi * 20.0 * fine),
        signal.lfilter(*signal.butter(2, 30.0, fs=1e5), np.sin(40 * np.pi * fine)),
    )
    time, true, mean = (values.reshape(100, -1).mean(axis=1) for values in (fine, rate, slow))
    dies = mean + 0.02 * np.random.default_rng(0).standard_normal((50, 100))
    found = following(time, true, dies, settle=0.05)
    assert found is not None
    assert found.bandwidth is None
    phase = -np.angle(signal.freqs(*signal.butter(2, 60 * np.pi, analog=True), worN=[40 * np.pi])[1][0])
    assert found.delay == pytest.approx(phase / (40 * np.pi), rel=0.02)
    assert found.delay_interval[0] < found.delay < found.delay_interval[1]
    assert np.ptp(found.delay_interval) < 1e-3


@pytest.mark.parametrize("length", [0.64e-3, 5.12e-3])
def test_windows_of_blocks_that_grow_tell_no_other_delay(length):
    """Of the windows of a run in blocks the first are closer together; their spacing was taken for that of all."""
    fine = np.arange(40_000) * 1e-5
    rate = signal.chirp(fine, 1.0, 0.4, 50.0)
    slow = signal.lfilter(*signal.butter(1, 30.0, fs=1e5), rate)
    growing = [2.6e-3, 2.64e-3 + 0.5e-3, 2.64e-3 + 0.5e-3 + 0.25 * length]
    time = np.concatenate([growing, np.arange(growing[-1] + length, 0.4, length)])
    true, mean = (np.interp(time, fine, values) for values in (rate, slow))
    dies = mean + 0.02 * np.std(true) * np.random.default_rng(0).standard_normal((50, len(time)))
    found = following(time, true, dies, settle=0.1)
    assert found.bandwidth == pytest.approx(30.0, rel=0.08)
    assert found.delay == pytest.approx(0.0, abs=5e-4)


def test_the_ratio_to_the_bound_has_the_interval_it_says():
    """Errors 1.3 times their bounds, which differ tenfold: the 95 % interval holds 1.3 in 95 % of 400 lots."""
    rng = np.random.default_rng(2)
    bounds = rng.uniform(1.0, 10.0, (400, 32))
    lots = [ratio(1.3 * bound * rng.standard_normal(32), bound) for bound in bounds]
    held = np.mean([lot.low <= 1.3 <= lot.high for lot in lots])
    assert held == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / 400))
    assert np.mean([lot.median for lot in lots]) == pytest.approx(1.3, abs=0.05)
    astray = ratio(np.append(1.3 * rng.standard_normal(99), 1e3), np.ones(100))
    assert astray.median == pytest.approx(1.3, abs=0.4)
    assert astray.high > 3.0 * astray.value  # one die makes the mean: it is as good as unknown
    assert ratio(np.array([np.nan, 1.0]), np.array([1.0, np.nan])) is None


def test_a_constant_rate_is_not_followed():
    assert following(np.arange(50) * 1e-3, np.ones(50), np.ones((3, 50))) is None


def test_each_die_is_measured_by_its_own_rate():
    time, size = np.arange(100) * 1e-3, np.linspace(0.5, 1.5, 9)[:, None]
    rates = size * np.sin(2 * np.pi * 20.0 * time)
    found = following(time, rates, rates + 0.01)
    assert found is not None
    assert found.rms == pytest.approx(0.01)


def test_settling_time():
    time, error = np.arange(5.0), np.array([3.0, 0.1, 2.0, 0.2, 0.1])
    assert settling_time(time, error, 1.0) == 3.0
    assert settling_time(time, error, 5.0) == 0.0
    assert np.isnan(settling_time(time, error[::-1], 1.0))
    assert np.isnan(settling_time(time, np.full(5, np.nan), 1.0))


def test_the_interval_of_a_percentile_holds_it_as_often_as_it_says():
    """True 95th percentile of |normal| 1.96; four standard deviations of a share of 400 draws are 4.4 %."""
    rng = np.random.default_rng(5)
    ends = [percentiles(rng.standard_normal(256)) for _ in range(400)]
    held = np.mean([e.p95_low <= 1.959964 <= e.p95_high for e in ends])
    assert 0.92 <= held <= 1.0
    assert np.isnan(percentiles(rng.standard_normal(8)).p95_high)


def line_of(rate, error, moves=False):
    """Of dies that come in two parts, as those of two shards do."""
    points, gathered = np.stack([rate, error], axis=1), Moments(2)
    for part in np.array_split(points, 2):
        gathered.add(part)
    return straight_error(gathered, moves)


def test_bias_and_scale_factor_are_the_line_through_the_errors():
    rng = np.random.default_rng(0)
    rate = rng.uniform(-2.0, 2.0, 400)
    found = line_of(rate, 0.3 - 0.05 * rate + 0.1 * rng.standard_normal(400))
    assert found.bias == pytest.approx(0.3, abs=4 * found.bias_std)
    assert found.scale == pytest.approx(-0.05, abs=4 * found.scale_std)
    assert found.bias_std == pytest.approx(0.1 / np.sqrt(400), rel=0.15)
    assert found.scale_std == pytest.approx(0.1 / np.sqrt(np.sum(rate**2)), rel=0.15)
    few = stats.linregress(rate[:6], rate[:6] ** 2)
    line = line_of(rate[:6], rate[:6] ** 2)
    assert (line.scale, line.scale_std) == pytest.approx((few.slope, few.stderr), rel=1e-9)
    assert (line.bias, line.bias_std) == pytest.approx((few.intercept, few.intercept_stderr), rel=1e-9)
    alike = line_of(np.full(400, 1.0), 0.3 + 0.1 * rng.standard_normal(400))
    assert alike.bias == pytest.approx(0.3, abs=0.02)
    assert alike.scale is None
    assert line_of(rate, 0.3 - 0.05 * rate, moves=True)[2:] == (None, None), "no line through a lag"
    assert line_of(rate[:2], rate[:2]) is None
