"""A charge amplifier and the detection of its carrier: against Kirchhoff's law, and base band against carrier."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import memsgyro_jax as mg
from memsgyro_jax.device.electronics import CarrierDetection, ChargeStage, run_carrier


THESIS = {"feedback": 2e-12, "sensor": 0.4e-12, "parasitic": 1e-12}
MISMATCH, SIGNAL = 40e-15, 100e-15 * np.exp(-0.5j * np.pi)  # of both halves together: 20 fF and 50 fF sin each
POOR = ChargeStage(**THESIS, resistor=50e6, gain_bandwidth=20e6, gain=1e5, offset=20e-3)


def test_an_ideal_stage_is_the_formula_of_the_thesis():
    """(3.10): 50 mV of signal, 20 mV of mismatch, 34 mV of offset."""
    ideal = ChargeStage(**THESIS)
    seen = ideal.responses(2 * np.pi * 300e3)
    assert complex(seen.charge) == pytest.approx(-1.0 / 2e-12, rel=1e-14)
    assert 1e3 * abs(SIGNAL) * abs(complex(seen.charge)) == pytest.approx(50.0)
    assert 1e3 * MISMATCH * abs(complex(seen.charge)) == pytest.approx(20.0)
    assert complex(seen.volt) * 20e-3 == pytest.approx(34e-3)
    leaking = ChargeStage(**THESIS, resistor=50e6)
    assert complex(leaking.responses(1e-6).volt) * 20e-3 == pytest.approx(20e-3), "in the end the offset itself"


def circuit(stage, detection, duration, times):
    """Kirchhoff's law at the node with both capacitances as functions of time, and the low-pass as an equation of the
    second order, by an implicit solver.
    """
    carrier, speed = 2 * np.pi * float(detection.frequency), 2 * np.pi * float(stage.gain_bandwidth)
    cf, cp, resistor = float(stage.feedback), float(stage.parasitic), float(stage.resistor)
    wb, slow = 2 * np.pi * float(detection.bandwidth), 2 * np.pi * 3e3

    def slope(t, y):
        out, node, low, rising = y
        difference = MISMATCH + 100e-15 * np.sin(slow * t)
        change = 100e-15 * slow * np.cos(slow * t)
        c1, c2 = 0.5 * (float(stage.sensor) + difference), 0.5 * (float(stage.sensor) - difference)
        v, dv = np.cos(carrier * t), -carrier * np.sin(carrier * t)
        dout = speed * (float(stage.offset) - node) - speed / float(stage.gain) * out
        currents = 0.5 * change * (v - node) - 0.5 * change * (-v - node) + (c1 - c2) * dv
        dnode = (currents + cf * dout + (out - node) / resistor) / (c1 + c2 + cp + cf)
        product = 2.0 * out * np.cos(carrier * t + float(detection.phase))
        return [dout, dnode, rising, wb**2 * (product - low) - np.sqrt(2.0) * wb * rising]

    start = [0.0, MISMATCH / float(stage.total), 0.0, 0.0]  # no charge at the node
    return solve_ivp(slope, (0.0, duration), start, method="LSODA", rtol=1e-9, atol=1e-13, t_eval=times).y


def test_the_run_is_the_circuit():
    detection = CarrierDetection(POOR, 1.0, 300e3, 20e3, phase=0.2)
    run = run_carrier(detection, ((0.0, MISMATCH), (3e3, SIGNAL)), sample_rate=70e3, samples=5)
    expected = circuit(POOR, detection, run.time[-1], run.time)
    np.testing.assert_allclose(run.before, expected[0], atol=1e-7)
    np.testing.assert_allclose(run.after, expected[2], atol=1e-7)
    assert np.max(np.abs(run.after)) > 0.01


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize(("resistor", "speed", "phase"), [(50e6, 20e6, 0.2), (np.inf, 3e6, 0.0), (1e6, 2e9, -1.0)])
def test_base_band_and_carrier_are_equal(order, resistor, speed, phase):
    """Amplitude, phase and offset to 1e-6 of the signal."""
    stage = ChargeStage(**THESIS, resistor=resistor, gain_bandwidth=speed, offset=20e-3)
    detection = CarrierDetection(stage, 1.0, 300e3, 20e3, phase=phase, order=order)
    run = run_carrier(detection, ((0.0, MISMATCH), (3e3, SIGNAL)), sample_rate=61.7e3, samples=2500)
    t, y = run.time[900:], run.after[900:]
    ripple = (300e3, 600e3, 597e3, 603e3)
    waves = [wave(2 * np.pi * f * t) for f in (3e3, *ripple) for wave in (np.cos, np.sin)]
    found = np.linalg.lstsq(np.stack([np.ones_like(t), *waves], axis=1), y, rcond=None)[0]
    expected = complex(detection.response(2 * np.pi * 3e3)) * SIGNAL
    assert abs(found[1] - 1j * found[2] - expected) < 1e-6 * abs(expected)
    steady = float(jnp.real(detection.response(1e-9))) * MISMATCH
    assert abs(found[0] - steady) < 1e-6 * abs(expected)
    rejected = abs(complex(detection.lowpass(2 * np.pi * 300e3)))
    offset = 2.0 * 20e-3 * (abs(complex(stage.responses(1e-3).volt)))
    assert np.hypot(found[3], found[4]) == pytest.approx(rejected * offset, rel=1e-3), "what (3.12) calls rejection"


def test_noise_of_the_base_band():
    """Variance behind the low-pass by Monte Carlo within 2 %: op-amp, its 1/f and the resistor, each and together."""
    quiet = {"resistor": 2e6, "gain_bandwidth": 20e6, "gain": 1e5}
    parts = {"op-amp": {"noise": 10e-9}, "feedback resistor": {"temperature": 300.0}}
    parts["op-amp 1/f"] = {"noise": 10e-9, "corner": 1e6}
    frequency = np.linspace(1.0, 160e3, 1601)
    for source, noisy in parts.items():
        detection = CarrierDetection(ChargeStage(**THESIS, **quiet, **noisy), 1.0, 300e3, 20e3, order=3)
        run = run_carrier(detection, (), sample_rate=23e3, samples=60, runs=800, seed=3)
        powers = detection.powers(2 * np.pi * frequency)
        told = np.trapezoid(np.sum([np.asarray(power) for power in powers.values()], axis=0), frequency)
        assert float(np.max(powers[source])) > 0.0
        assert np.var(run.after[20:]) == pytest.approx(told, rel=0.02), source


def test_derivatives_and_refusals():
    def gain(parasitic):
        stage = ChargeStage(2e-12, 0.4e-12, parasitic, gain_bandwidth=20e6)
        return jnp.abs(CarrierDetection(stage, 1.0, 300e3, 20e3).response(2 * np.pi * 3e3))

    step = 1e-18
    slope = float(gain(1e-12 + step) - gain(1e-12 - step)) / (2 * step)
    assert float(jax.grad(gain)(1e-12)) == pytest.approx(slope, 1e-5)
    ideal = CarrierDetection(ChargeStage(**THESIS), 1.0, 300e3, 20e3)
    with pytest.raises(mg.InputError, match="gain_bandwidth"):
        run_carrier(ideal, (), sample_rate=1e5, samples=3)
    with pytest.raises(mg.InputError, match="resistor"):
        ChargeStage(**THESIS, resistor=-1.0)
