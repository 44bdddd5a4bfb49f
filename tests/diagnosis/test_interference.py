"""A line of interference in decays of a linear device is what the instrument does, and is told with its frequency."""

import numpy as np
import pytest
from phasor_decay import CASE, RECORD

from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.instrument import instrument_terms, of_lines
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
    assert "in r0 a line of about 0.00099 V at 14077.0" in of_lines(case)
    assert "r1" not in of_lines(case)
    assert of_lines(decays(tmp_path, (0.0,))) == ""
    assert not [t for t in instrument_terms(decays(tmp_path, (0.0,))) if isinstance(t, InterferingLine)]


def test_with_a_line_a_linear_device_leaves_noise_alone(tmp_path):
    case = decays(tmp_path, (87.0, -71.0))
    term, without = line_of(case), fit_case(case)
    fit = fit_case(case, [term])
    assert without.chi2_per_dof > 10.0 > 1.3 > fit.chi2_per_dof
    strength = np.asarray(fit.model.effects[0].strength).reshape(2, 2) @ [1.0, 1j]
    began = strength * np.exp(1j * np.asarray(term.omega)[::2] * 3.0)
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
