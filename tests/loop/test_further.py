"""Where a Bode diagram looks further than it was asked, against formulas, and what it says of a lost loop."""

import dataclasses

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.effects import ReadoutDelay
from memsgyro_jax.loop.frequency_response import FrequencyResponse
from memsgyro_jax.loop.further import around_split, expected_half_power, looked_further


GYRO = mg.SingleMassGyro.from_modes(2e-9, (10e3, 10.3e3), 1000.0, quadrature=np.radians(50.0))
READOUT = mg.DirectReadout(1e6)
RUN = {"sample_rate": 100e3, "duration": 0.15, "settle": 0.1}


def response_of(answer, asked, first=()):
    asked = np.array(asked, float)
    tried = []

    def answers(frequency):
        tried.append(frequency)
        return np.append(answer(frequency), 1.0 + 0j), np.append(0.0 * frequency, 0.0)

    known = asked, answer(asked), 0.0 * asked
    further = looked_further(answers, known, 1.0 + 0j, np.array(first, float))
    return FrequencyResponse("rate", *known, 0.0, 1.0 + 0j, None, None if further is known else further), tried


@pytest.mark.parametrize("asked", [[1.0, 3.0, 10.0, 30.0], [1.0, 300.0], np.arange(5.0, 45.0, 5.0)])
def test_half_the_power_is_where_the_formula_has_it_on_any_grid(asked):
    """Second order: 17.2 Hz read off [1, 3, 10, 30] by a line between the last two were 15 % less."""
    corner = 17.2
    found, _ = response_of(lambda f: 1.0 / (1.0 + np.sqrt(2.0) * 1j * f / corner - (f / corner) ** 2), asked)
    assert found.bandwidth == pytest.approx(corner, rel=2e-4)
    assert f"half the power of a constant rate at {found.bandwidth:.4g} Hz" in str(found)
    assert str(found).count("rest") == len(asked)


def test_a_peak_between_the_frequencies_is_found_and_told():
    quality, split = 80.0, 900.0
    answer = lambda f: 1.0 / (1.0 - (f / split) ** 2 + 1j * f / split / quality)  # noqa: E731
    found, tried = response_of(answer, np.geomspace(10.0, 1100.0, 24), [890.0, 900.0])
    assert found.peak == pytest.approx((split, quality), rel=0.01)
    assert f"a peak of {found.peak[1]:.4g} at {found.peak[0]:.4g} Hz lies between" in str(found)
    assert len({each.shape for each in tried}) == 1, "one program for all"
    assert not response_of(answer, [10.0, 20.0])[1], "nothing to look for"
    dense, _ = response_of(answer, np.append(np.arange(895.0, 905.0, 0.5), 1100.0))
    assert "lies between" not in str(dense)


def test_the_split_is_looked_at_where_it_lies_in_between():
    width = 10.3e3 / 2000.0
    np.testing.assert_allclose(
        around_split(GYRO, 10.0, 1000.0), 300.0 + width * np.arange(-3, 4)[[0, 2, 3, 4, 6]], 0.01
    )
    assert around_split(GYRO, 10.0, 200.0).size == 0


def test_an_open_sense_axis_shows_its_split():
    control = mg.ClassicControl.open_loop(GYRO, READOUT, amplitude=1e-6)
    loop = mg.ClosedLoop(GYRO, READOUT, mg.NoObserver.for_device(GYRO, READOUT), control)
    found = mg.frequency_response(loop, [40.0, 150.0, 600.0], **RUN)
    assert found.peak[0] == pytest.approx(300.0, abs=5.0)
    assert found.peak[1] > 5.0 * np.max(np.abs(found.response))
    assert "lies between these frequencies" in str(found)
    assert f"Hz, a peak of {found.peak[1] / abs(found.static):.4g} times at {found.peak[0]:.4g} Hz" in found.headline
    assert expected_half_power(loop) == pytest.approx(found.bandwidth, rel=0.05)
    slow = dataclasses.replace(loop, filter=mg.Lowpass("20 Hz"))
    assert expected_half_power(slow) == pytest.approx(20.0)
    assert expected_half_power(mg.default_study().loop) is None


def test_a_rebalanced_axis_has_the_half_power_of_its_averaged_loops():
    control = mg.ClassicControl.force_rebalance(GYRO, READOUT, amplitude=1e-6)
    loop = mg.ClosedLoop(GYRO, READOUT, mg.NoObserver.for_device(GYRO, READOUT), control)
    found = mg.frequency_response(loop, [7.0, 60.0], sample_rate=100e3, duration=0.3)
    assert expected_half_power(loop) == pytest.approx(found.bandwidth, rel=0.05)
    assert "a peak of" not in found.headline


@pytest.mark.slow
def test_a_lost_loop_has_no_half_power():
    late = GYRO.with_effect(ReadoutDelay(0.24 / 10e3))
    control = mg.ClassicControl.force_rebalance(GYRO, READOUT, amplitude=1e-5, demodulator_bandwidth="2 kHz")
    loop = mg.ClosedLoop(late, READOUT, mg.NoObserver.for_device(GYRO, READOUT), control)
    trace = mg.simulate(loop, 0.0, sample_rate=100e3, duration=0.15)
    found = mg.frequency_response(loop, [40.0, 150.0], **RUN)
    assert found.lost_at == pytest.approx(trace.lost_at, abs=2e-5)
    assert f"none, as the loop was lost at {found.lost_at:.4g} s" in str(found)
    assert "half the power" not in str(found)
    assert "nan" not in str(found)
    assert np.isnan(found.bandwidth)
    assert found.as_dict()["lost_at_s"] == found.lost_at
    assert found.as_dict()["peak"] == {"frequency_hz": None, "gain": None}
