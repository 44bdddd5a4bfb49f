"""The noise of a rate by its sources: against plain formulas, and against the walk of simulated rates."""

import dataclasses
import re

import jax
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.observers.no_observer import NoObserver


KT = 1.380649e-23 * 300.0
DEGREES = 180.0 / np.pi
RATE = 100e3
DECOUPLED = mg.SingleMassGyro(mass=1.8e-7, kxx=63.96, kyy=95.92, kxy=0.0, dxx=3.6e-6, dyy=4.5e-6, dxy=0.0)
SPLIT = mg.SingleMassGyro.from_modes(2e-9, (10e3, 10.3e3), 1000.0, quadrature=np.radians(50.0))
MATCHED = mg.SingleMassGyro.from_modes(2e-9, (10e3, 10.001e3), 25.0)  # as fast as the others
NEGATIVE = mg.SingleMassGyro.from_modes(3e-9, (12e3, 11.5e3), (800.0, 400.0), quadrature=np.radians(30.0))


def classic(device, readout, temperature=300.0, amplitude=1e-6):
    device = device.at_temperature(temperature)
    control = mg.ClassicControl.open_loop(device, readout, amplitude=amplitude)
    return mg.ClosedLoop(device, readout, NoObserver.for_device(device, readout), control, filter=mg.Lowpass(200.0))


def test_the_thesis_device_walks_by_the_damping_of_its_sense_axis():
    readout = mg.ChargeAmplifier.chi2010()
    device = DECOUPLED.at_temperature(300.0)
    observer = mg.ExtendedKalmanFilter.for_device(device, readout)
    budget = mg.noise_budget(mg.ClosedLoop(device, readout, observer, mg.DampingCompensation()))
    assert float(budget.of("Brownian force")) * DEGREES * 60.0 == pytest.approx(0.1383, abs=5e-5)
    # Displacement noise times |Δ|/(2ωA), by hand.
    wx, wy = np.sqrt(63.96 / 1.8e-7), np.sqrt(95.92 / 1.8e-7)
    stiff = abs(wy**2 - wx**2 + 1j * wx * 4.5e-6 / 1.8e-7)
    by_hand = stiff * readout.noise_density[1] / abs(readout.scale[1]) / (2.0 * wx * 1e-6)
    assert float(budget.of("electronics")) == pytest.approx(float(by_hand), rel=1e-9)
    assert float(budget.total) == pytest.approx(float(np.hypot(*budget.walk)))
    assert "phase of the swing" in str(budget)
    with pytest.raises(mg.InputError, match="must be one of"):
        budget.of("gremlins")


def test_over_frequency():
    """A force stays as it is where its sideband is far from the other; the read-out's noise falls to the split."""
    loop = classic(SPLIT, mg.DirectReadout(1e6, noise_density=(1e-6, 3e-7)))
    budget = mg.noise_budget(loop, sample_rate=RATE)
    low = np.sqrt(2.0) * np.asarray(budget.walk)
    np.testing.assert_allclose(budget.density[:, 0], low, rtol=1e-4)
    f = np.asarray(budget.frequency)
    square, damping = (2 * np.pi * 10.3e3) ** 2, 2 * np.pi * 10.3e3 / 1000.0
    omega = 2 * np.pi * float(budget.swing)
    at = [1.0 / (square - w**2 + 1j * w * damping) for w in (omega + 2 * np.pi * f, omega - 2 * np.pi * f)]
    start = 1.0 / (square - omega**2 + 1j * omega * damping)
    gain = np.abs(0.5 * (at[0] / start + np.conj(at[1] / start)))
    np.testing.assert_allclose(budget.density[1], low[1] / gain, rtol=5e-3)  # a coupling moves the modes a little
    table = budget.to_xarray()
    assert table["density"].shape == (3, len(f))
    ax = budget.plot()
    assert len(ax.collections) == 3
    ax.figure.clear()


def test_derivatives_and_what_is_said():
    readout = mg.DirectReadout(1e6, noise_density=3e-8, adc=mg.Adc(2.0, 12))
    cold, warm = (mg.noise_budget(classic(SPLIT, readout, t), sample_rate=RATE) for t in (None, 300.0))
    assert float(cold.of("Brownian force")) == 0.0
    assert "knows no temperature" in str(cold)
    assert "rounding is taken as white" in str(warm)
    step = 4.0 / 2**12
    ratio = float(warm.of("converter") / warm.of("electronics"))
    assert ratio == pytest.approx(step / np.sqrt(6.0 * RATE) / 3e-8, rel=1e-9)

    @jax.jit
    @jax.grad
    def slope(temperature):
        loop = classic(SPLIT, mg.DirectReadout(1e6, noise_density=3e-8))
        made = dataclasses.replace(loop, device=loop.device.at_temperature(temperature))
        return mg.noise_budget(made, sample_rate=RATE).of("Brownian force")

    assert float(slope(300.0)) == pytest.approx(float(warm.of("Brownian force")) / 600.0, rel=1e-9)


def test_the_budget_is_differentiated_by_the_device_and_asks_for_what_it_misses():
    """It asked the traced device what sample rate is usual, and its mode at rest made the gradient NaN."""

    def walk(frequency, adc=None):
        device = mg.SingleMassGyro.from_modes(1e-9, (frequency, 10.3e3), (400.0, 200.0))
        readout = mg.DirectReadout(1e5, noise_density=1e-7, adc=adc)
        observer = mg.ExtendedKalmanFilter.for_device(DECOUPLED, readout)
        return mg.noise_budget(mg.ClosedLoop(device, readout, observer, mg.DampingCompensation())).total

    at, slope = jax.jit(walk), jax.jit(jax.grad(walk))  # a program each in place of one for every operation
    around = (at(1e4 + 0.5) - at(1e4 - 0.5)) / 1.0
    assert float(slope(1e4)) == pytest.approx(float(around), rel=1e-5)
    with pytest.raises(mg.InputError, match=r"must be given for a device whose numbers jax.grad"):
        jax.grad(lambda frequency: walk(frequency, mg.Adc(2.0, 12)))(1e4)


CASES = {
    "split": (SPLIT, mg.DirectReadout(1e6, noise_density=(1e-6, 3e-7), adc=mg.Adc(2.0, 16))),
    "matched": (MATCHED, mg.DirectReadout(1e6, noise_density=(1e-6, 1e-6))),
    "below": (NEGATIVE, mg.DirectReadout(2e6, noise_density=(1e-6, 1e-7))),
    "phase": (SPLIT.at_temperature(None), mg.DirectReadout(1e6, noise_density=(3e-6, 1e-12))),
}


@pytest.mark.slow
def test_powers_add_in_a_filter_that_follows_the_rate():
    """A swing that hardly decays, and a Kalman filter that knows everything but a walking rate."""
    device = mg.SingleMassGyro.from_modes(1.8e-7, (3e3, 3.6e3), 1e6).at_temperature(300.0)
    readout, start = mg.DirectReadout(1e6, noise_density=1e-10), (1e-6, 0.0, 0.0, 0.0)
    usual = mg.design_prior(device)
    prior = mg.Prior(start, (0.0,) * 4, usual.offset, usual.offset_std, usual.theta, usual.theta_std)
    known = tuple(name for name in device.model.names if name != "rate")
    walk = mg.ProcessNoise.of(device.model, rate=1e-6)
    observer = mg.ExtendedKalmanFilter.for_device(
        device, readout, known=known, with_offsets=False, prior=prior, process_noise=walk
    )
    loop, rows = mg.ClosedLoop(device, readout, observer, mg.OpenLoop(), start), []
    budget = mg.noise_budget(loop, sample_rate=50e3)
    for die in range(24):
        trace = mg.simulate(loop, 0.0, sample_rate=50e3, duration=2.0, die=die, decimation=50)
        rows.append(np.asarray(trace.rate_estimate)[200:])
    factors = (40, 80)
    deviation = mg.allan_deviation(np.array(rows), factors) * np.sqrt(np.array(factors) * 50.0 / 50e3)
    assert np.sqrt(np.mean(deviation**2)) == pytest.approx(float(budget.total), rel=0.05)
    assert min(float(part) for part in budget.walk) > 0.2 * float(budget.total)


def test_a_loop_that_is_rebalanced_beyond_the_split_says_how_its_noise_grows():
    """A 70 kHz disk, 20 Hz apart: 0.00086 deg/s/√Hz of slow rates, and 0.0176 at 866 Hz; a run of 0.6 s has 0.0177 at
    1 kHz. The table alone told that the electronics are 22 % of the power.
    """
    disk = mg.SingleMassGyro.from_modes("60 ug", ("70 kHz", "70.02 kHz"), (50e3, 48e3), angle="1 deg")
    readout = mg.DirectReadout(5e6, noise_density=40e-9)
    control = mg.ClassicControl.force_rebalance(disk, readout, amplitude=0.2e-6)
    loop = mg.ClosedLoop(disk.at_temperature(320.0), readout, NoObserver.for_device(disk, readout), control)
    budget = mg.noise_budget(loop)
    (said,) = budget.notes
    reached, split, there = (float(n) for n in re.findall(r"([\d.]+) (?:Hz|°/s)", said))
    crossover = next(row for row in mg.gain_phase_margins(loop).rows() if row[0] == "rate")[2]
    assert reached == pytest.approx(float(crossover.split()[0]), rel=0.05)
    low = np.sqrt(2.0) * DEGREES * np.asarray(budget.walk)
    assert there == pytest.approx(np.hypot(low[0], np.hypot(*low[1:]) * np.hypot(reached, split) / split), rel=0.01)
    assert mg.noise_budget(dataclasses.replace(loop, filter=mg.Lowpass(10.0))).notes == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_powers_add_to_the_simulated_walk(name):
    """Within 5 %: Allan deviation of 40 dies over 1.1 s of an open loop, at 20 and 40 ms."""
    device, readout = CASES[name]
    loop = classic(device, readout, device.temperature if name == "phase" else 300.0)
    budget, rows = mg.noise_budget(loop, sample_rate=RATE), []
    for die in range(40):
        trace = mg.simulate(loop, 0.0, sample_rate=RATE, duration=1.5, die=die, decimation=50)
        rows.append(np.asarray(trace.rate_estimate)[len(trace.time) // 4 :])
    factors = (40, 80)
    deviation = mg.allan_deviation(np.array(rows), factors) * np.sqrt(np.array(factors) * 50.0 / RATE)
    assert np.sqrt(np.mean(deviation**2)) == pytest.approx(float(budget.total), rel=0.05)
