"""Filters against SciPy's own Butterworth designs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.filters import Bandpass, Lowpass


ORDERS = (1, 2, 3, 4)
CASES = [(10.0, 1e6, 4000), (10.0, 1e3, 4000), (400.0, 1e3, 500), (3000.0, 100e3, 3000)]


def noise(count: int, columns: int = 2) -> np.ndarray:
    return np.random.default_rng(3).standard_normal((count, columns)) + 1.0


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("bandwidth", "rate", "count"), CASES)
def test_lowpass_is_scipys(order, bandwidth, rate, count):
    signal = noise(count)
    sections = scipy.signal.butter(order, bandwidth, fs=rate, output="sos")
    want = scipy.signal.sosfilt(sections, signal, axis=0)
    got = np.asarray(Lowpass(bandwidth, order).apply(signal, rate))
    # SciPy's direct form cancels digits in proportion to (rate/bandwidth)²; ours does not.
    room = 1e-13 + 2e-16 * (rate / bandwidth) ** 2
    np.testing.assert_allclose(got, want, rtol=0.0, atol=room * np.max(np.abs(want)))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("low", "high", "rate"), [(2900.0, 3100.0, 100e3), (10.0, 400.0, 1e3), (100.0, 110.0, 1e3)])
def test_bandpass_is_scipys(order, low, high, rate):
    signal = noise(3000)
    want = scipy.signal.sosfilt(scipy.signal.butter(order, (low, high), "band", fs=rate, output="sos"), signal, axis=0)
    got = np.asarray(Bandpass(low, high, order).apply(signal, rate))
    np.testing.assert_allclose(got, want, rtol=0.0, atol=1e-9 * np.max(np.abs(want)))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("rate", [50.0, 1e3, 1e5])
def test_half_the_power_passes_at_the_bandwidth(order, rate):
    count = int(20 * rate / 10.0) * 4
    phase = 2.0 * np.pi * 10.0 * np.arange(count) / rate
    got = np.asarray(Lowpass(10.0, order).apply(np.sin(phase), rate))[count // 2 :]
    carrier = np.exp(-1j * phase[count // 2 :])
    assert abs(2.0 * np.mean(got * carrier)) ** 2 == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("order", ORDERS)
def test_a_steady_start_has_no_transient(order):
    steady = np.full(200, 3.7)
    np.testing.assert_allclose(Lowpass(5.0, order).apply(steady, 1e3, start=3.7), 3.7, rtol=1e-14)
    np.testing.assert_allclose(Bandpass(5.0, 9.0, order).apply(steady, 1e3, start=3.7), 0.0, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_gradient_by_the_edges(order):
    signal = noise(300, 1)[:, 0]

    def low(edge):
        return jnp.sum(Lowpass(edge, order).apply(signal, 1e3) ** 2)

    def band(edge):
        return jnp.sum(Bandpass(20.0, edge, order).apply(signal, 1e3) ** 2)

    for loss in (low, band):
        got, step = jax.grad(loss)(40.0), 1e-4
        want = (loss(40.0 + step) - loss(40.0 - step)) / (2.0 * step)
        assert got == pytest.approx(float(want), rel=1e-6)


def test_step_inside_a_scan_is_apply():
    filter_, signal = Lowpass(30.0, 3), jnp.asarray(noise(50))

    def one(state, value):
        output, state = filter_.step(state, value, 1e-3)
        return state, output

    _, got = jax.lax.scan(one, filter_.init(jnp.zeros(2)), signal)
    np.testing.assert_array_equal(got, filter_.apply(signal, 1e3))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Lowpass(10.0, 5), "`order` must be 1, 2, 3 or 4, but 5"),
        (lambda: Lowpass(-1.0), "`bandwidth` must be positive and finite, but -1"),
        (lambda: Bandpass(20.0, 10.0), "`high - low` must be positive"),
        (lambda: Lowpass(600.0).apply(np.zeros(3), 1e3), "more than twice the filter's 600 Hz, but 1000 Hz"),
    ],
)
def test_bad_filters_are_refused(make, says):
    with pytest.raises(InputError, match=says):
        make()


@pytest.mark.parametrize("order", ORDERS)
def test_delays_are_those_of_scipys_phase(order):
    """Phase over frequency of the low-pass, slope of the phase in the middle of the band."""
    rate, step = 20e3, 1e-3
    sections = scipy.signal.butter(order, 200.0, fs=rate, output="sos")
    late = -np.angle(scipy.signal.sosfreqz(sections, [step, 10.0], fs=rate)[1]) / (2 * np.pi * np.array([step, 10.0]))
    lowpass = Lowpass(200.0, order)
    assert [float(lowpass.delay(1 / rate, f)) for f in (0.0, 10.0)] == pytest.approx(late, rel=1e-5)
    sections = scipy.signal.butter(order, (3000.0, 3400.0), "band", fs=rate, output="sos")
    low, high = np.tan(np.pi * np.array([3000.0, 3400.0]) / rate)
    middle = rate / np.pi * np.arctan(np.sqrt(low * high))
    phase = np.angle(scipy.signal.sosfreqz(sections, [middle - 0.1, middle + 0.1], fs=rate)[1])
    assert float(Bandpass(3000.0, 3400.0, order).delay(1 / rate)) == pytest.approx(
        -np.diff(phase)[0] / (0.2 * 2 * np.pi), rel=1e-5
    )
