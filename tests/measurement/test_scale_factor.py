"""Rate-table tests of gyros that plain NumPy makes up: figures, their intervals, and what a test cannot tell."""

import json

import numpy as np
import pytest
from oracles.rate_table import back_to_zero, flicker, low_passed, rates_over_time

import memsgyro_jax as mg


STEPS = (50.0, 100.0, 150.0, 200.0, 250.0, 300.0)


def log(path, header, *columns):
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=header, comments="")
    return path


def automotive(seed=0, curve=500e-6, sample_rate=200.0):
    """±300 deg/s with 0.2 % of scale, 0.7 deg/s on average and 20 Hz, 5 mdeg/s/√Hz and flicker: time, rate, output."""
    rng = np.random.default_rng(seed)
    rate = rates_over_time(back_to_zero(*STEPS, *(-step for step in STEPS)), 4.0, sample_rate)
    time = np.arange(len(rate)) / sample_rate
    white = 0.005 * np.sqrt(sample_rate / 2.0) * rng.standard_normal(len(rate))
    output = low_passed(1.002 * rate + 0.7 + curve * 1.002 * rate**2 / 300.0 + white, 20.0, sample_rate)
    wander = flicker(rng, len(rate), sample_rate, 0.002)
    return time, rate + 0.002 * rng.standard_normal(len(rate)), output + wander - wander.mean()


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / "raw.csv"
    return log(path, "t [s],table rate [deg/s],gyro [deg/s]", *automotive())


def held(figure, truth):
    return figure.low <= truth <= figure.high


def test_a_raw_log_of_an_automotive_gyro(raw):
    found = mg.scale_factor_test(raw)
    figures = found.figures
    assert len(found.rate) == 25
    assert held(figures["scale_factor"], 1.002)
    assert figures["scale_factor"].high - figures["scale_factor"].low < 2e-4
    assert held(figures["zero_rate_plateaus"], 0.7)
    assert held(figures["quadratic"], 500.0)
    assert figures["quadratic"].low > 400.0
    assert figures["cubic"].verdict == "within the noise"
    assert "of a curve" in figures["asymmetry"].verdict
    assert "off the line" in figures["zero_rate_plateaus"].verdict
    assert "settling" in found.notes[0]
    entries = json.loads(found.to_json())
    assert entries["schema"] == "memsgyro-scale-factor-test/1"
    assert entries["figures"]["scale_factor"]["unit"] == "1"
    table = found.to_xarray()
    assert table["rate"].attrs["units"] == "rad/s"
    assert "scale factor" in found._repr_html_()
    assert len(found.to_pandas()) == 25
    found.plot().figure.clear()
