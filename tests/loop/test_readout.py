"""Volts of the comb and charge amplifier by hand, noise densities, the converter and its derivative, and bad input."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.electronics import CarrierDetection, ChargeStage, run_carrier
from memsgyro_jax.loop.carrier_readout import CarrierReadout
from memsgyro_jax.loop.readout import Adc, ChargeAmplifier, DirectReadout, snr_density


EPSILON = 8.8541878128e-12
COMB = {
    "fingers": 113.0, "width": 5e-6, "gap": 1e-6, "overlap": 50e-6, "mismatch": (0.1e-6, 0.085e-6), "bias": 10.0,
    "feedback": 1e-12, "parasitic": 1e-12, "opamp_offset": (2e-3, 1e-3),
}  # fmt: skip


def test_table_5_3():
    """100 mV per µm, offsets 15 and 11 mV, noise 1 mV per sample at 10 MHz (SNR 100 on 1 µm)."""
    readout = ChargeAmplifier.chi2010()
    assert np.array(readout.scale) * 1e-6 == pytest.approx([-0.1, -0.1], rel=1e-3)
    assert np.array(readout.offset) == pytest.approx([15e-3, 11e-3], rel=0.05)
    assert np.array(readout.noise_std(1e-7)) == pytest.approx([1e-3, 1e-3], rel=1e-12)
    assert np.array(readout.noise_std(1e-5)) == pytest.approx([1e-4, 1e-4], rel=1e-12)


def test_charge_amplifier_is_3_9():
    """V = -2V/Cf·ΔC - (C1 - C2)·V/Cf + (C1 + C2 + Cp + Cf)/Cf·Vos with the two combs' capacitances written out."""
    values = COMB | {"feedback": (1e-12, 2e-12), "parasitic": (1.5e-12, 1e-12), "bias": 8.0, "gap": (1e-6, 1.2e-6)}
    readout, x = ChargeAmplifier(**values), (0.3e-6, -0.7e-6)
    got = readout.measure((*x, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 1e-5)
    for axis in (0, 1):
        gap, cf, cp = values["gap"][axis], values["feedback"][axis], values["parasitic"][axis]
        per_length = 113 * EPSILON * 5e-6 / gap
        low, high = 50e-6, 50e-6 - 2 * values["mismatch"][axis]  # the second comb overlaps less: α of (3.6) is positive
        first, second = per_length * low, per_length * high
        vos = values["opamp_offset"][axis]
        volts = -2 * 8.0 / cf * per_length * x[axis] + (first - second) * 8.0 / cf
        volts += (2 * per_length * 50e-6 + cp + cf) / cf * vos
        assert float(got[axis]) == pytest.approx(volts, rel=1e-12)


def test_rejection_scales_the_op_amps_part_alone():
    """(3.12): ν = 0 leaves the mismatch, the chopper's ideal."""
    full, half, none = (ChargeAmplifier(**COMB, rejection=v) for v in (1.0, 0.5, 0.0))
    a, b, c = (np.array(readout.offset) for readout in (full, half, none))
    assert np.allclose(b, 0.5 * (a + c), rtol=1e-14)
    assert np.allclose(c, [2 * 113 * EPSILON * 5 * d * 10 / 1e-12 for d in (0.1e-6, 0.085e-6)], rtol=1e-12)


def test_noise_and_drift_add():
    readout = DirectReadout(scale=(2.0, 3.0), offset=(0.1, 0.2), noise_density=(1e-3, 2e-3))
    volts = readout.measure((5.0, 7.0, 0.0, 0.0), (1.5, -0.5), (0.01, 0.02), 1e-4)
    std = np.array([1e-3, 2e-3]) * np.sqrt(0.5e4)
    assert np.array(volts) == pytest.approx([10.11 + 1.5 * std[0], 21.22 - 0.5 * std[1]], rel=1e-13)


def test_a_velocity_read_out_sees_velocity():
    readout = DirectReadout.of_velocity((4.0, 5.0))
    assert [float(v) for v in readout.measure((1.0, 2.0, 3.0, 4.0), (1.0, 1.0), (0.0, 0.0), 1e-5)] == [12.0, 20.0]
    assert readout.signals == (2, 3)


def test_one_number_serves_both_axes():
    readout = DirectReadout(2.0)
    assert [float(v) for v in (*readout.scale, *readout.offset, *readout.noise_density)] == [
        2.0,
        2.0,
        0.0,
        0.0,
        0.0,
        0.0,
    ]


@given(st.floats(1.0, 1e5), st.floats(1e-7, 1e-5), st.floats(1e3, 1e7))
def test_snr_is_an_amplitude_ratio(snr, amplitude, rate):
    density = snr_density(snr, amplitude, -1e5, rate)
    readout = DirectReadout(-1e5, noise_density=density)
    assert float(readout.noise_std(1.0 / rate)[0]) == pytest.approx(1e5 * amplitude / snr, rel=1e-9)


@given(st.floats(-2.0, 2.0), st.integers(1, 20), st.floats(0.1, 1.5))
def test_converter_gives_the_nearest_code(volts, bits, limit):
    """Codes are whole steps from -limit to limit - step; inside, the error is at most half a step."""
    got, step = float(Adc(limit, bits).convert(volts)), 2 * limit / 2**bits
    assert abs(got / step - round(got / step)) < 1e-9
    assert -limit <= got <= limit - step
    nearest = min(max(volts, -limit), limit - step)
    assert abs(got - nearest) <= 0.5 * step * (1 + 1e-9)


def test_converter_lets_derivatives_through():
    """One inside the limits, zero where it clips, in both modes."""
    adc = Adc(0.5, 4)
    for mode in (jax.grad, jax.jacfwd):
        slopes = [float(mode(adc.convert)(v)) for v in (-0.7, -0.43, 0.0, 0.11, 0.3, 0.6)]
        assert slopes == [0.0, 1.0, 1.0, 1.0, 1.0, 0.0]
    by_limit = jax.grad(lambda limit: Adc(limit, 4).convert(0.9))(0.5)
    assert float(by_limit) == pytest.approx(1 - 2 / 16)


def test_converter_sits_behind_the_read_out():
    readout = DirectReadout(1.0, noise_density=1.0, adc=Adc(1.0, 3))
    volts = readout.measure((0.3, -3.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 1e-5)
    assert [float(v) for v in volts] == [0.25, -1.0]


BAD = [
    (lambda: ChargeAmplifier(**COMB | {"gap": 0.0}), "`gap` must be positive and finite, but 0"),
    (
        lambda: ChargeAmplifier(**COMB | {"feedback": (1e-12, -1e-12)}),
        "`feedback` must be positive and finite, but -1e-12",
    ),
    (lambda: ChargeAmplifier(**COMB | {"fingers": float("nan")}), "`fingers` must be positive"),
    (
        lambda: ChargeAmplifier(**COMB | {"parasitic": -1e-12}),
        "`parasitic` must be finite and not negative, but -1e-12",
    ),
    (lambda: ChargeAmplifier(**COMB | {"rejection": 1.5}), "`rejection` must lie between 0 and 1, but 1.5"),
    (lambda: ChargeAmplifier(**COMB | {"width": (5e-6,)}), "for the axes x and y, but 1"),
    (lambda: ChargeAmplifier(**COMB | {"overlap": (1.0, 2.0, 3.0)}), "for the axes x and y, but 3"),
    (
        lambda: ChargeAmplifier.chi2010(noise_density=-1e-6),
        "`noise_density` must be finite and not negative, but -1e-06",
    ),
    (lambda: DirectReadout(1.0, noise_density=(0.0, float("nan"))), "`noise_density` must be finite and not negative"),
    (
        lambda: DirectReadout(1.0, noise_density=jnp.array([1.0, -2.0])),
        "`noise_density` must be finite and not negative, but -2",
    ),
    (lambda: Adc(0.0, 12), "`limit` must be positive"),
    (lambda: Adc(1.0, 0), "`bits` of the converter must lie between 1 and 48, but 0"),
    (lambda: Adc(1.0, 49), "between 1 and 48, but 49"),
]


@pytest.mark.parametrize(("make", "words"), BAD, ids=[words for _, words in BAD])
def test_impossible_read_outs_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_carrier_reads_as_its_base_band_says():
    """A motion at the frequency that the base band is taken at, against the carrier itself, within 1e-6; its noise."""
    stage = ChargeStage(2e-12, 0.4e-12, 1e-12, resistor=50e6, gain_bandwidth=20e6, noise=10e-9, temperature=300.0)
    detection = CarrierDetection(stage, 1.0, 300e3, 20e3, phase=0.1)
    readout = CarrierReadout(detection, (5e-9, 4e-9), 3e3, (40e-15, 0.0), sampler=1e-12, sample_rate=1e5)
    run = run_carrier(detection, ((0.0, 40e-15), (3e3, 2 * 5e-9 * 1e-6)), sample_rate=61.7e3, samples=1500)
    time, motion = run.time[500:], 2 * np.pi * 3e3 * run.time[500:]
    shown = readout.clean((1e-6 * np.cos(motion), 0.0, -1e-6 * 2 * np.pi * 3e3 * np.sin(motion), 0.0), (0.0, 0.0))[0]
    waves = [wave(2 * np.pi * f * time) for f in (300e3, 600e3, 597e3, 603e3) for wave in (np.cos, np.sin)]
    table = np.stack(waves, axis=1)  # what the low-pass leaves of the carrier
    left = run.after[500:] - np.asarray(shown)
    left = left - table @ np.linalg.lstsq(table, left, rcond=None)[0]
    assert np.max(np.abs(left)) < 1e-6 * np.max(np.abs(shown))
    powers = np.array([[float(d[0]) ** 2 for d in readout.noise_at(3e3, 1e-5).values()]])
    assert float(readout.noise_density[0]) ** 2 == pytest.approx(powers.sum(), rel=1e-12)
    assert powers[0, -1] == pytest.approx(2 * 1.380649e-23 * 300.0 / 1e-12 / 1e5)
    with pytest.raises(InputError, match="pair"):
        CarrierReadout((detection,), 5e-9, 3e3)


@pytest.mark.parametrize("scale", [0.0, float("nan"), (1e5, 0.0)])
def test_a_scale_that_shows_nothing_is_refused(scale):
    with pytest.raises(InputError, match="`scale` must be finite and not zero"):
        DirectReadout(scale)


def test_a_silent_loop_has_a_converter_without_steps_that_still_ends():
    """Rounding without noise is a dead band of a nulled channel, which noise carries the signal across."""
    gyro = mg.SingleMassGyro.chi2010()
    readout = replace(ChargeAmplifier.chi2010(), adc=Adc(2.5, 6))
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout)
    loop = mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation())
    for made in (loop, replace(loop, readout=mg.LayoutReadout(readout))):
        quiet = made.silent.readout
        scale, offset = float(quiet.scale[0]), float(quiet.offset[0])
        for volts, shown in ((0.01, 0.01), (9.0, 2.5)):
            found, _ = quiet.measure((volts / scale, 0.0, 0.0, 0.0), (9.0, 9.0), (-offset, 0.0), 1e-5)
            assert float(found) == pytest.approx(shown, abs=1e-12)
    assert loop.readout.adc.bits == 6
