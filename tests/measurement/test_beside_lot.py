"""A rate-table test beside the lot of a model."""

import json

import numpy as np
import pytest
from oracles.rate_table import back_to_zero
from scipy import stats

import memsgyro_jax as mg
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.measurement.beside_lot import laid_beside


RATES = np.array(back_to_zero(100.0, -100.0, 300.0, -300.0, 200.0, -200.0))
SETTINGS = Settings(1e5, 0.1, 0, "", ())


def measured(curve, unit="deg/s", scale=1.0):
    output = scale * curve(RATES) + scale * 1e-3 * np.random.default_rng(0).standard_normal(len(RATES))
    return mg.scale_factor_test({"table rate [deg/s]": RATES, f"output [{unit}]": output})


def lot(test, curve=lambda rate: 0.0, dies=20):
    """Dies whose scale differs by 0.1 % and whose zero-rate output by 0.5 deg/s, [rad/s]."""
    scale, zero = np.random.default_rng(1).standard_normal((2, dies, 1))
    rate = np.degrees(test.levels)
    return np.radians((1.0 + 1e-3 * scale) * rate + 0.5 * zero + curve(rate))


def test_a_gyro_of_the_lot_lies_within_it():
    test = measured(lambda rate: 1.0007 * rate + 0.3)
    found = laid_beside(test, lot(test), SETTINGS)
    assert found.status == "within"
    row = found.rows["scale_factor"]
    spread = np.std(np.polyfit(test.levels, lot(test).T, 1)[0], ddof=1)
    assert row.high - row.low == pytest.approx(2.0 * stats.t.ppf(0.975, 19) * spread * np.sqrt(1.05), rel=1e-6)
    assert found.rows["zero_rate_line"].verdict == "within"
    assert np.all(np.abs(found.deviation) < 1e-6)


def test_what_the_model_lacks_is_named():
    bent = lambda rate: rate + 300.0 * 5e-4 * (rate / 300.0) ** 2  # noqa: E731
    test = measured(lambda rate: 1.02 * bent(rate) + 0.3)
    found = laid_beside(test, lot(test), SETTINGS)
    lies = {name: row.verdict for name, row in found.rows.items()}
    assert lies["scale_factor"] == lies["quadratic"] == lies["nonlinearity_max"] == lies["asymmetry"] == "outside"
    assert lies["cubic"] == "within"
    assert "even part of" in str(found)
    assert "may be the trim" in str(found)
    same = laid_beside(test, lot(test, lambda rate: bent(rate) - rate), SETTINGS)
    assert same.rows["quadratic"].verdict == "within"
    assert same.rows["quadratic"].typical == pytest.approx(500.0, rel=5e-3)
    assert json.loads(found.to_json())["figures"]["quadratic"]["lies"] == "outside"
    assert found.to_xarray()["deviation"].dims == ("die", "level")
    found.plot().figure.clear()


def test_of_volts_only_what_is_relative_is_compared():
    test = measured(lambda rate: rate + 0.3, unit="V", scale=0.01)
    outputs = lot(test)
    outputs[3] = np.nan
    found = laid_beside(test, outputs, SETTINGS)
    assert found.rows["scale_factor"].verdict == "not compared"
    assert found.rows["quadratic"].verdict == "within"
    assert "1 of 20 dies are lost" in str(found)
    assert "The conversion to V is not in the model" in str(found)


@pytest.mark.slow
def test_the_lot_of_a_loop_is_run_at_the_rates_of_the_test():
    gyro = mg.SingleMassGyro.from_modes(1e-8, (5e3, 5.3e3), (400.0, 200.0), quadrature=np.radians(30.0))
    readout = mg.DirectReadout(1e5, noise_density=1e-7)
    control = mg.ClassicControl.open_loop(gyro, readout, amplitude=1e-6, bandwidth=60.0, drive_bandwidth=400.0)
    loop = mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), control, start=(0.0,) * 4)
    options = {"dies": 4, "sample_rate": 100e3, "duration": 0.2, "settle": 0.15}
    test = measured(lambda rate: rate + 0.3)
    found = mg.beside_lot(test, loop, mg.Spread.relative(0.002), **options)
    sheet = mg.datasheet(loop, mg.Spread.relative(0.002), **options, noise_duration=0.3)
    expected = sheet.row("scale factor").values
    each = np.polyfit(test.levels, found.outputs.T, 1)[0]
    np.testing.assert_allclose(each, expected, rtol=2e-5)
    early = mg.beside_lot(test, loop, mg.Spread.relative(0.002), **{**options, "duration": 0.02, "settle": 0.0})
    assert "4 of 4 dies are lost, or still move" in str(early)
    assert early.status == "not compared"
