"""Conversions at the border, against definitions written out by hand."""

import math
import os
import string
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from memsgyro_jax import InputError
from memsgyro_jax.base import units


pytestmark = pytest.mark.smoke


def test_a_rate_in_degrees():
    np.testing.assert_allclose(units.rate_to_dps(np.array([math.pi, -0.5])), [180.0, -90.0 / math.pi], rtol=1e-15)


@pytest.mark.parametrize(
    ("value", "unit", "expected", "result"),
    [
        (3.0, "deg/s", "rad/s", math.radians(3.0)),
        (3.0, "°/s", "rad/s", math.radians(3.0)),
        (3.0, "dps", "rad/s", math.radians(3.0)),
        (3.0, "mdps/√Hz", "rad/s/sqrt(Hz)", math.radians(3e-3)),
        (3.0, "mV/dps", "V*s/rad", 3e-3 / math.radians(1.0)),
        (3.0, "Grad", "rad", math.radians(3.0)),  # and not 3e9 rad
        (3.0, "Grad/s", "rad/s", math.radians(3.0)),
        (100.0, "grad", "rad", math.pi / 2.0),
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


@pytest.mark.parametrize(
    ("unit", "end"),
    [
        ("mv", '"mv"; did you mean "mV"?'),
        ("MHZ", '"MHZ"; did you mean "MHz"?'),
        ("mhz", '"mhz"; did you mean "MHz"?'),
        ("KHz", '"KHz"; did you mean "kHz"?'),
        ("uv/√hz", '"uv/√hz"; did you mean "uV/√Hz"?'),
        ("Degrees", '"Degrees"; did you mean "degrees"?'),
        ("mVrms", '"mVrms"; write "mV", and of an amplitude its peak value, 1.414 times the number.'),
        ("V_pk", '"V_pk"; write "V", and of an amplitude its peak value.'),
        ("foo", '"foo".'),
        ("mv**9**9**9", '"mv**9**9**9".'),
    ],
)
def test_a_unit_that_is_nearly_one_is_told_which(unit, end):
    with pytest.raises(InputError) as caught:
        units.to_si(1.0, unit, "V", "it")
    assert str(caught.value) == f'Unit of it must be one that can be read, e.g. "um", "deg/s" or "1", but is {end}'


LETTERS = string.ascii_letters + "_"
# Named one by one, as Hypothesis takes two seconds for a table of all there are.
NAMES = st.builds(str.__add__, st.sampled_from(LETTERS), st.text(LETTERS + string.digits + "µΩéßЖ漢٣", max_size=9))


@given(NAMES, st.sampled_from(["V", "deg/s", "1", "uV/sqrt(Hz)"]))
def test_headers_there_and_back(name, unit):
    assert units.parse_header(f" {name} [{unit}] ") == (name, unit)


@pytest.mark.parametrize(
    "text", ["rate", "rate []", "[V]", "rate [V", "rate V]", "rate [V] x", "", "rate (V)", "a [V] [s]"]
)
def test_headers_that_are_refused(text):
    with pytest.raises(InputError, match=r'^Column header must read "name \[unit\]"'):
        units.parse_header(text)


def test_a_conversion_is_worked_out_once(tmp_path):
    """Importing pint takes a second: the next process multiplies with what the first found."""
    text = (
        "import sys; from memsgyro_jax.base import units; "
        "print(units.to_si(3.0, 'um', 'm', 'x'), units.to_si(20.0, 'degC', 'K', 'x'), 'pint' in sys.modules)"
    )
    once = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "MEMSGYRO_NO_CACHE": "0"}
    told = [subprocess.run([sys.executable, "-c", text], env=once, capture_output=True, text=True) for _ in range(2)]
    assert [each.stdout.split() for each in told] == [["3e-06", "293.15", seen] for seen in ("True", "False")]
