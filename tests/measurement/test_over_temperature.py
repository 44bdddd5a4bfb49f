"""Zero-rate output and scale factor over temperature against the same devices made for each temperature."""

import dataclasses

import jax
import numpy as np
import pytest
from oracles import classic

import memsgyro_jax as mg


E = mg.effects
RATE, DIES, FULL, AMPLITUDE = 100e3, 3, np.radians(200.0), 1e-6
PLACES, REFERENCE = (233.15, 298.15, 358.15), 298.15
STIFFER, DAMPED, GAIN, DRIVE = -6e-5, 2e-3, 3e-4, 2e-4
PLAIN = mg.SingleMassGyro.from_modes(
    1e-8, (5e3, 5.3e3), (400.0, 100.0), quadrature=np.radians(30.0), cross_damping=1e-2
)
WARM = PLAIN.with_effect(
    E.ThermalStiffness(STIFFER), E.ThermalDamping(DAMPED), E.ThermalGain(GAIN), E.ThermalDrive(DRIVE)
)
READOUT = mg.DirectReadout(1e5)
CONTROL = mg.ClassicControl.force_rebalance(
    PLAIN, READOUT, amplitude=AMPLITUDE, bandwidth=15.0, demodulator_bandwidth=400.0, drive_bandwidth=800.0
)
LOOP = mg.ClosedLoop(WARM, READOUT, mg.NoObserver.for_device(WARM, READOUT), CONTROL, start=(0.0,) * 4)
SPREAD = mg.Spread.relative(0.002)


def expected(gyro, kelvin, rate):
    """Of a device with other springs and dampers, whose loops see less swing and whose electrodes give more force."""
    warmer = kelvin - REFERENCE
    k, d = 1.0 + STIFFER * warmer, 1.0 + DAMPED * warmer
    made = mg.SingleMassGyro(gyro.mass, k * gyro.kxx, k * gyro.kyy, gyro.kxy, d * gyro.dxx, d * gyro.dyy, gyro.dxy)
    near = np.sqrt(float(made.kxx / made.mass)) / (2.0 * np.pi)
    found = classic.steady(made, rate, 1.0 / RATE, AMPLITUDE, 0.0, True, near, velocity=False)[2]
    per_rate = near * float(gyro.mass) / (float(CONTROL.drive.frequency) * float(PLAIN.mass))  # of the design
    return found * per_rate / ((1.0 + GAIN * warmer) * (1.0 + DRIVE * warmer))


@pytest.mark.slow
def test_a_lot_over_temperature():
    lot = mg.over_temperature(
        LOOP,
        SPREAD,
        temperatures=PLACES,
        full_scale=FULL,
        dies=DIES,
        sample_rate=RATE,
        duration=0.16,
        settle=0.15,
        seed=3,
    )
    drawn = SPREAD.draw(LOOP.sampled_at(RATE, duration=0.16), mg.Scenario(), 3, np.arange(DIES)).loop.device
    dies = [jax.tree.map(lambda leaf, n=n: np.broadcast_to(leaf, DIES)[n], drawn) for n in range(DIES)]
    still = np.array([[expected(die, kelvin, 0.0) for die in dies] for kelvin in PLACES])
    turning = np.array([[expected(die, kelvin, FULL) for die in dies] for kelvin in PLACES])
    slope = (turning - still) / FULL
    assert np.all(np.ptp(slope, axis=0) > 0.05)
    np.testing.assert_allclose(lot.scale_factor, slope, atol=5e-5)  # what kicks leave of a drift of springs
    np.testing.assert_allclose(np.degrees(lot.zero_rate), np.degrees(still), atol=2e-3)
    assert np.all(np.degrees(np.ptp(still, axis=0)) > 0.02)
    np.testing.assert_allclose(lot.scale_factor_drift, 0.5 * np.ptp(lot.scale_factor, axis=0))
    assert lot.alive.all()
    assert "(max - min)/2" in str(lot)
    assert lot.to_xarray()["zero_rate"].shape == (3, DIES)


def test_what_does_not_depend_on_temperature_says_so():
    with pytest.raises(mg.InputError, match="nothing in it does"):
        mg.over_temperature(dataclasses.replace(LOOP, device=PLAIN), SPREAD, sample_rate=RATE)
    with pytest.raises(mg.InputError, match="two or more temperatures"):
        mg.over_temperature(LOOP, SPREAD, temperatures=(300.0,), sample_rate=RATE)


def test_a_table_takes_away_what_it_was_fitted_to():
    """Two ramps of an output whose offset and scale are kinked lines: the table of one is right on the other."""
    knots, offset, scale = np.array([230.0, 270.0, 300.0, 360.0]), [0.1, -0.2, 0.05, 0.3], [0.9, 1.05, 1.0, 1.2]
    rng = np.random.default_rng(0)
    first, second = np.linspace(230.0, 360.0, 400), np.linspace(355.0, 232.0, 300)

    def output(warm, rate):
        return np.interp(warm, knots, offset) + np.interp(warm, knots, scale) * rate

    turning = rng.choice([-3.0, 0.0, 3.0], 400)
    table = mg.TemperatureTable.fit(first, output(first, turning), turning, knots=knots)
    np.testing.assert_allclose(table.offset, offset, atol=1e-12)
    np.testing.assert_allclose(table.scale, scale, atol=1e-12)
    other = rng.standard_normal(300)
    np.testing.assert_allclose(table.corrected(output(second, other), second), other, atol=1e-12)
    noise = 0.01 * rng.standard_normal((200, 400))
    noisy = [mg.TemperatureTable.fit(first, output(first, turning) + n, turning, knots=knots).offset for n in noise]
    np.testing.assert_allclose(np.mean(noisy, axis=0), offset, atol=1e-3)
    slope = jax.grad(lambda warm: table.corrected(1.0, warm))(280.0)
    assert np.isfinite(slope)
    with pytest.raises(mg.InputError, match="rate must change"):
        mg.TemperatureTable.fit(first, first, np.ones(400), knots=5)
    with pytest.raises(mg.InputError, match="equally many finite"):
        mg.TemperatureTable.fit(first, first[1:], turning)
    with pytest.raises(mg.InputError, match="must be two or more, and rise"):
        mg.TemperatureTable([300.0, 290.0], [0.0, 0.0], [1.0, 1.0])
