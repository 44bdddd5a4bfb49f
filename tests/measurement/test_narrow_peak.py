"""The one row of a resonance that is narrower than the steps of its sweep is no wrong digit."""

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.measurement.beside_design import beside_design
from memsgyro_jax.measurement.case import assess
from memsgyro_jax.measurement.narrow_peak import is_narrow_peak
from memsgyro_jax.measurement.outliers import lone_rows


HERTZ = np.arange(1.0, 190.0)
NOISE = 0.004 * (np.random.default_rng(0).standard_normal((2, HERTZ.size)).T @ [1.0, 1.0j])


def beam(*modes):
    """Accelerance of modes, each a frequency [Hz], a quality factor and a share, at lines 1 Hz apart."""
    return NOISE + sum(
        -share * HERTZ**2 / (at**2 - HERTZ**2 + 1j * at * HERTZ / quality) for at, quality, share in modes
    )


@pytest.mark.parametrize("at", [141.8, 142.0, 142.2, 142.45])
@pytest.mark.parametrize("quality", [400.0, 2000.0])
@pytest.mark.parametrize("modulus", [False, True])
def test_the_top_of_a_narrow_resonance_is_no_wrong_digit(at, quality, modulus):
    values = beam((51.4, 400.0, -0.1), (at, quality, 0.13))
    values = np.abs(values) if modulus else values
    lone = [row for row, _ in lone_rows(HERTZ, values, 0.004)]
    assert all(is_narrow_peak(HERTZ, values, row) for row in lone), (lone, HERTZ[lone])


@pytest.mark.parametrize("row", [20, 90, 139, 141, 143, 170])
@pytest.mark.parametrize("factor", [10.0, 0.1, -1.0])
def test_a_wrong_digit_beside_one_stays_one(row, factor):
    """Of a resonance that some rows show, and far from one."""
    values = beam((51.4, 400.0, -0.1), (142.0, 40.0, 0.13))
    values[row] *= factor
    assert not is_narrow_peak(HERTZ, values, row)


def test_check_names_no_line_of_a_beam(tmp_path):
    """It took the top of the second mode for a wrong digit, and `diagnose` left it out."""
    values = beam((51.4, 400.0, -0.1), (142.2, 2000.0, 0.13))
    rows = np.column_stack([HERTZ, values.real, values.imag])
    np.savetxt(tmp_path / "hit_1N.csv", rows, delimiter=",", header="f [Hz],X [m/s^2],Y [m/s^2]", comments="")
    case = mg.import_case([tmp_path / "hit_1N.csv"], tmp_path / "case").case
    assert not [warning for warning in assess(case).warnings if "digit" in warning]


def test_rows_far_narrower_than_a_resonance_show_none(tmp_path):
    """A crystal's shunt alone, 1 kHz at 3.3 MHz, was "resonance: the records show 3.103 MHz" with a quality factor of
    half.
    """
    hertz = 3.288594e6 + 31.25 * np.arange(32)
    knots = 3e-6 * np.random.default_rng(1).standard_normal((2, 8))  # of which the analyser interpolates four rows each
    wander = [np.interp(np.arange(32), 5 * np.arange(8), one) for one in knots]
    read = 0.0277 * np.exp(-0.064j) + wander[0] + 1j * wander[1]
    rows = np.column_stack([hertz, read.real, read.imag])
    np.savetxt(tmp_path / "crystal_1V.csv", rows, delimiter=",", header="f [Hz],X [V],Y [V]", comments="", fmt="%.12g")
    case = mg.import_case([tmp_path / "crystal_1V.csv"], tmp_path / "case").case
    said = beside_design(case)
    assert said[0].startswith("resonance: the records show none"), said
    assert "968.8 Hz" in said[0]
    assert not any(sentence.startswith("quality_factor") for sentence in said)
