"""Amounts on the command line: a number with its unit, or a sentence that names the option."""

import math

import pytest

from memsgyro_jax import InputError
from memsgyro_jax.base.quantity import amount_of_option


@pytest.mark.parametrize(
    ("text", "number", "unit"),
    [
        ("20 mV", 20.0, "mV"),
        (" 20mV ", 20.0, "mV"),
        ("1e-7 N", 1e-7, "N"),
        ("10 mVrms", 10.0 * math.sqrt(2.0), "mV"),
        ("10 mV RMS", 10.0 * math.sqrt(2.0), "mV"),
        ("10 V_rms", 10.0 * math.sqrt(2.0), "V"),
        ("10 Vpp", 5.0, "V"),
        ("10 Vpk", 10.0, "V"),
        ("-10 dBm", 0.1, "V"),
        ("-20 dBV", 0.1 * math.sqrt(2.0), "V"),
    ],
)
def test_an_amount_is_a_peak_amplitude(text, number, unit):
    assert amount_of_option(text, "--drive", "20 mV") == (pytest.approx(number, rel=1e-14), unit)


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("10 mv", 'can be read, e.g. "um", "deg/s" or "1", but is "mv"; did you mean "mV"?'),
        ("10 foo", 'can be read, e.g. "um", "deg/s" or "1", but is "foo".'),
        (" -10 mV", 'must be a positive number with its unit, like "20 mV", but is "-10 mV".'),
        ("10", 'must be a positive number with its unit, like "20 mV", but is "10".'),
        ("10 dB", 'but is "10 dB", in decibels; convert it to a linear unit.'),
        ("much", 'must be a number with a unit, for example "100 kHz", but is "much".'),
    ],
)
def test_what_is_no_amount_names_the_option(text, end):
    with pytest.raises(InputError) as caught:
        amount_of_option(text, "--drive", "20 mV")
    assert "ption `--drive` must be" in str(caught.value)
    assert str(caught.value).endswith(end)


def test_an_amount_measures_what_it_should():
    assert amount_of_option("32.768 kHz", "--reference", "32.768 kHz", "Hz") == (32.768, "kHz")
    with pytest.raises(InputError, match=r'^Unit of option `--reference` must measure the same as "Hz", but is "mV"'):
        amount_of_option("3 mV", "--reference", "32.768 kHz", "Hz")
