"""A line of interference in records of a linear device is what the instrument does, and is told with its frequency."""

import re

import numpy as np
import pytest
from phasor_decay import CASE, RECORD

from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.instrument import instrument_terms
from memsgyro_jax.diagnosis.instrument_told import of_lines
from memsgyro_jax.diagnosis.promise import offers_of
from memsgyro_jax.effects.lock_in_terms import InterferingLine
from memsgyro_jax.measurement.case import load_case


NOISE, SIZE = 1e-4, 1e-3


def decays(folder, lines):
    """A record for each line [Hz beside the reference] of a linear device; zero for none."""
    text = CASE
    for number, hertz in enumerate(lines):
        time = 3.0 + np.arange(150) * 2e-3
        phasors = 0.3 * np.exp((2j * np.pi * 10.0 - 15.0) * (time - time[0]) + 1j * number)
        phasors += SIZE * (hertz != 0) * np.exp(2j * np.pi * hertz * (time - time[0]))
        noise = NOISE * np.random.default_rng(number).standard_normal((2, time.size))
        table = np.column_stack([time, phasors.real + noise[0], phasors.imag + noise[1]])
        np.savetxt(folder / f"r{number}.csv", table, "%.9g", ",", header="t [s],Vx_I [V],Vx_Q [V]", comments="")
        text += RECORD.format(name=f"r{number}")
    (folder / "case.toml").write_text(text)
    return load_case(folder)


def line_of(case):
    (term,) = [t for t in instrument_terms(case) if isinstance(t, InterferingLine)]
    return term


def test_a_line_is_offered_where_it_stands_and_there_alone(tmp_path):
    case = decays(tmp_path, (87.0, 0.0))
    term = line_of(case)
    np.testing.assert_allclose(term.omega, [2 * np.pi * 87.0] * 2, rtol=1e-3)
    np.testing.assert_array_equal(np.asarray(term.entry)[:, 0], [[1.0, 1.0], [0.0, 0.0]])
    assert "in r0 a line of about 0.00099 V at 14077.0" in of_lines(case, (), True)
    assert "r1" not in of_lines(case, (), True)
    assert of_lines(case, (), False) == of_lines(decays(tmp_path, (0.0,)), (), True) == ""
    assert not [t for t in instrument_terms(decays(tmp_path, (0.0,))) if isinstance(t, InterferingLine)]


def test_with_a_line_a_linear_device_leaves_noise_alone(tmp_path):
    case = decays(tmp_path, (87.0, -71.0))
    term, without = line_of(case), fit_case(case)
    fit = fit_case(case, [term])
    assert without.chi2_per_dof > 10.0 > 1.3 > fit.chi2_per_dof
    strength = np.asarray(fit.model.effects[0].strength).reshape(2, 2) @ [1.0, 1j]
    began = strength * np.exp(1j * (np.asarray(term.omega) * (3.0 - np.asarray(term.middle)))[::2])
    np.testing.assert_allclose(began, SIZE, atol=6 * NOISE / np.sqrt(150))
    (offer,) = offers_of(without, [term])
    units = np.eye(without.joint.start.size)
    assert offer.slopes.shape == (without.optimum.residual.size, 4)
    joint = fit.joint
    units = np.eye(joint.start.size)[joint.of_effect(0)]
    slopes = joint.linearise(fit.optimum.vector, units, joint.fitted)[1]
    near = np.sum(slopes * offer.slopes, axis=0) / np.sum(offer.slopes**2, axis=0)
    np.testing.assert_allclose(near, 1.0, atol=0.1)  # but for what another start would change


@pytest.mark.slow
def test_a_diagnosis_says_that_the_instrument_alone_does_it(tmp_path):
    told = diagnose(None, decays(tmp_path, (87.0,)))
    assert told.verdict == "instrument_only"
    assert [term.label for term in told.instrument] == ["interfering_line"]
    assert "Hz above the reference" in told.sentence


VOLTS = """
schema = "memsgyro-case/1"
name = "volts"
device = "resonator"
[design]
resonance = { value = 6000, unit = "Hz", tolerance = 0.05 }
quality_factor = { low = 100, high = 3000, unit = "1" }
static_gain = { value = 1, unit = "1", tolerance = 0.5 }
[readout]
quantity = "displacement"
[[experiment]]
name = "volts"
file = "volts.csv"
role = "fit"
"""
DRIVE = """drive_axis = "x"
drive_force = { value = 1, unit = "V" }
drive_frequency = { value = 6000, unit = "Hz" }
drive_duration = { value = 0.1, unit = "s" }
"""
KINDS = {
    "free_decay": 'kind = "free_decay"\n',
    "ring_down": 'kind = "ring_down"\n' + DRIVE,
    "time_record": 'kind = "time_record"\nhold = "zero_order"\nstart = "rest"\n',
}
HERTZ, SIZES = (50.0, 150.0, 9117.0), (0.03, 0.01, 0.02)


def waveform(folder, kind, lines=HERTZ):
    """Volts of a linear device of 6 kHz and a quality factor of 400, with lines."""
    period, rows = 1 / 40e3, 4800
    rng, time = np.random.default_rng(3), period * np.arange(rows)
    pole = 2 * np.pi * 6000.0 * (np.sqrt(1 - 0.25 / 400**2) * 1j - 0.5 / 400)
    weight = -(np.abs(pole) ** 2) / pole.imag  # of a force at once, at rest
    drive = 0.05 * np.cos(2 * np.pi * (5500.0 * time + 4000.0 * time**2)) * (kind == "time_record")
    volts, motion = [], 150j * np.exp(0.3j) if kind == "free_decay" else 0j
    if kind == "ring_down":  # 600 periods of the drive, from rest
        omega = 2 * np.pi * 6000.0
        settled = [0.5 * weight * 1j / (turn - pole) for turn in (1j * omega, -1j * omega)]
        motion = sum(settled) * (1 - np.exp(pole * 0.1))
    for force in drive:
        volts.append(motion.real)
        motion = motion * np.exp(pole * period) + 1j * weight * force * np.expm1(pole * period) / pole
    seen = zip(lines, SIZES, strict=False)
    volts = np.array(volts) + sum(size * np.cos(2 * np.pi * hertz * time + hertz) for hertz, size in seen)
    table = [time, *([drive] if kind == "time_record" else []), volts + 5e-3 * rng.standard_normal(rows)]
    header = "t [s],u [V],y [V]" if kind == "time_record" else "t [s],y [V]"
    np.savetxt(folder / "volts.csv", np.column_stack(table), "%.9g", ",", header=header, comments="")
    (folder / "case.toml").write_text(VOLTS + KINDS[kind])
    return load_case(folder)


@pytest.mark.parametrize("kind", KINDS)
def test_volts_over_time_have_lines_of_their_own(tmp_path, kind):
    case = waveform(tmp_path, kind)
    term, without = line_of(case), fit_case(case)
    fit = fit_case(case, [term])
    assert without.chi2_per_dof > 8.0
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    parts = np.asarray(fit.model.effects[0].strength).reshape(-1, 2)
    omega, middle = np.asarray(term.omega)[::2], np.asarray(term.middle)[::2]
    told = {
        w / 2 / np.pi: part @ [1.0, 1j] * np.exp(-1j * w * t) for w, part, t in zip(omega, parts, middle, strict=True)
    }
    for hertz, size in zip(HERTZ, SIZES, strict=True):
        near = min(told, key=lambda one: abs(one - hertz))
        assert near == pytest.approx(hertz, abs=0.25)
        assert abs(told[near]) == pytest.approx(size, abs=5 * 5e-3 * np.sqrt(2 / 4800))
    assert np.sqrt(fit.model.device.stiffness[0]) / 2 / np.pi == pytest.approx(6000.0, abs=0.05)
    (offer,) = offers_of(without, [term])
    joint = fit.joint
    slopes = joint.linearise(fit.optimum.vector, np.eye(joint.start.size)[joint.of_effect(0)], joint.fitted)[1]
    near = np.sum(slopes * offer.slopes, axis=0) / np.sum(offer.slopes**2, axis=0)
    np.testing.assert_allclose(near, 1.0, atol=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_volts_without_a_line_are_offered_none(tmp_path, kind):
    case = waveform(tmp_path, kind, ())
    assert not [t for t in instrument_terms(case) if isinstance(t, InterferingLine)]
    assert fit_case(case).chi2_per_dof == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_diagnosis_of_volts_with_lines(tmp_path, kind):
    told = diagnose(None, waveform(tmp_path, kind))
    assert told.verdict == "instrument_only"
    assert [term.label for term in told.instrument] == ["interfering_line"]
    assert re.search(r"in volts a line of 0\.0(199|200|201)\d* ± 0\.0001 V at 9117\.", told.sentence)
