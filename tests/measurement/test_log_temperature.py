"""A rate that goes with the temperature beside it, and one that only changes as slowly."""

import numpy as np

import memsgyro_jax as mg
from memsgyro_jax.measurement.log_temperature import _slope


def log(path, by_kelvin):
    """White noise of 0.15 deg/√h at 1 Hz over two hours in which it gets warm by 5 K."""
    rng, time = np.random.default_rng(2), np.arange(7200.0)
    warm = 5.0 * (1.0 - np.exp(-np.maximum(time - 2000.0, 0.0) / 900.0))
    rate = 0.15 / 60.0 * rng.standard_normal(time.size) + by_kelvin / 3600.0 * warm
    table = np.column_stack([time, rate, 25.0 + warm])
    np.savetxt(path, table, "%.9g", ",", header="t [s],rate [deg/s],T [degC]", comments="")
    return path


def test_the_temperature_is_tried_as_the_cause_of_a_drift(tmp_path):
    """The drift was told as a noise of the sensor, and the column beside it was not used."""
    found = mg.allan(log(tmp_path / "warm.csv", 30.0))
    assert any(found.terms[0][name].value for name in "BKR")
    (note,) = [note for note in found.notes if "goes with the temperature" in note]
    slope, std = (float(note.split("by ")[1].split(" ± ")[k].split()[0]) for k in (0, 1))
    assert abs(slope - 30.0) < 3.0 * std < 6.0
    told = float(note.split("N ")[1].split()[0])
    assert abs(told - 0.15) < 0.02
    assert "B not told, K not told, R not told" in note


def test_what_is_slow_by_itself_does_not_go_with_it(tmp_path):
    rng = np.random.default_rng(3)
    walks = np.cumsum(rng.standard_normal((200, 2, 1280)), axis=2)
    assert not any(_slope(rate, temperature) for rate, temperature in walks)
    warm = np.convolve(walks[0, 1], np.ones(60) / 60.0, "same")
    assert not any(_slope(rate, warm) for rate, _ in walks)
    assert not any("temperature," in note for note in mg.allan(log(tmp_path / "still.csv", 0.0)).notes)
