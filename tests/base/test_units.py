"""Conversions at the border, against definitions written out by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from memsgyro_jax import InputError
from memsgyro_jax.base import units


pytestmark = pytest.mark.smoke

positive = st.floats(1e-12, 1e12)
CLOSE = {"rtol": 1e-14}


@given(positive)
def test_rate_there_and_back(rate):
    np.testing.assert_allclose(units.rate_to_dps(units.rate_from_dps(rate)), rate, **CLOSE)
    assert units.rate_from_dps(180.0) == math.pi


@given(positive, positive)
def test_density_there_and_back(density, sample_rate):
    std = units.std_from_density(density, sample_rate)
    np.testing.assert_allclose(units.density_from_std(std, sample_rate), density, **CLOSE)


@given(positive, st.booleans())
def test_angle_random_walk_there_and_back(arw, one_sided):
    psd = units.rate_psd_from_arw(arw, one_sided=one_sided)
    np.testing.assert_allclose(units.arw_from_rate_psd(psd, one_sided=one_sided), arw, **CLOSE)
    np.testing.assert_allclose(units.arw_to_deg_per_sqrt_hour(units.arw_from_deg_per_sqrt_hour(arw)), arw, **CLOSE)


@given(positive, positive)
def test_the_three_conventions_describe_the_same_noise(arw, sample_rate):
    density = units.rate_psd_from_arw(arw, one_sided=True) ** 0.5
    std = units.std_from_density(density, sample_rate)
    np.testing.assert_allclose(units.arw_from_std(std, sample_rate), arw, **CLOSE)


def test_density_of_drawn_noise_by_periodogram():
    """The one-sided density that an analyser would show for samples of standard deviation `std_from_density`."""
    from scipy.signal import welch

    sample_rate, density = 2000.0, 0.03
    samples = units.std_from_density(density, sample_rate) * np.random.default_rng(7).standard_normal(400_000)
    _, psd = welch(samples, fs=sample_rate, nperseg=500)
    # 1600 averages of 250 bins: the mean over all bins is known to well under 1 %
    assert np.sqrt(psd[1:-1].mean()) == pytest.approx(density, rel=0.01)


def test_angle_random_walk_of_integrated_noise():
    """Definition: one hour of noise of N deg/√h integrates to an angle with a standard deviation of N degrees."""
    arw = 0.5
    per_second = units.rate_psd_from_arw(units.arw_from_deg_per_sqrt_hour(arw), one_sided=False)
    angle_std = math.degrees(math.sqrt(per_second * 3600.0))
    assert angle_std == pytest.approx(arw, rel=1e-14)


def test_conversions_take_arrays():
    np.testing.assert_allclose(units.std_from_density(np.array([1.0, 2.0]), 8.0), [2.0, 4.0])


@pytest.mark.parametrize(
    ("value", "unit", "expected", "result"),
    [
        (3.0, "deg/s", "rad/s", math.radians(3.0)),
        (3.0, "°/s", "rad/s", math.radians(3.0)),
        (60.0, "rpm", "rad/s", 2.0 * math.pi),
        (2.5, "kHz", "Hz", 2500.0),
        (20.0, "degC", "K", 293.15),
        (7.0, "nN", "N", 7e-9),
        (7.0, "um", "m", 7e-6),
        (7.0, "µm", "m", 7e-6),
        (15.0, "%", "1", 0.15),
        (4.0, "1", "1", 4.0),
        (4.0, "uV/sqrt(Hz)", "V/sqrt(Hz)", 4e-6),
        (4.0, "µV/√Hz", "V/sqrt(Hz)", 4e-6),
        (60.0, "deg/√h", "rad/sqrt(s)", math.radians(1.0)),
        (1.0, "uN/um", "N/m", 1.0),
        (2.0, "g_0", "m/s^2", 19.6133),
    ],
)
def test_to_si(value, unit, expected, result):
    assert units.to_si(value, unit, expected, "x") == pytest.approx(result, rel=1e-13)


def test_to_si_of_an_array():
    np.testing.assert_allclose(units.to_si(np.array([0.0, 180.0]), "deg", "rad", "phase"), [0.0, math.pi])


@pytest.mark.parametrize(
    ("unit", "expected"),
    [("Hz", "rad/s"), ("rad/s", "Hz"), ("deg", "1"), ("kg", "N"), ("1", "m"), ("V", "V/sqrt(Hz)")],
)
def test_another_dimension_is_refused(unit, expected):
    with pytest.raises(InputError, match=r"^Unit of column 3 must measure the same as .*, but is "):
        units.to_si(1.0, unit, expected, "column 3")


@pytest.mark.parametrize("unit", ["", " ", "furlongs_of_noise", "kg*/", "m )", "3 kg", "[V]", "m^", "import os"])
def test_a_unit_that_cannot_be_read_is_refused(unit):
    with pytest.raises(InputError, match=r"^Unit of key `mass` must be one that can be read"):
        units.to_si(1.0, unit, "kg", "key `mass`")


@given(st.from_regex(r"[A-Za-z_]\w{0,9}", fullmatch=True), st.sampled_from(["V", "deg/s", "1", "uV/sqrt(Hz)"]))
def test_headers_there_and_back(name, unit):
    assert units.parse_header(f" {name} [{unit}] ") == (name, unit)


@pytest.mark.parametrize(
    "text", ["rate", "rate []", "[V]", "rate [V", "rate V]", "rate [V] x", "", "rate (V)", "a [V] [s]"]
)
def test_headers_that_are_refused(text):
    with pytest.raises(InputError, match=r'^Column header must read "name \[unit\]"'):
        units.parse_header(text)
