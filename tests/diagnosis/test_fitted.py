"""What is said of a fitted device that is none, and of numbers that a bound has stopped."""

import numpy as np

from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.diagnosis.findings import Accepted
from memsgyro_jax.diagnosis.fitted import ParameterEstimate, at_bounds, of_energy
from memsgyro_jax.diagnosis.instrument_told import of_instrument


def test_a_damping_that_feeds_a_motion_is_said():
    stiffness, mobility = [1.0e9, 1.1e9, 1e6], 1e7
    assert of_energy(NormalisedDevice(stiffness, [10.0, 12.0, 3.0], mobility)) == ""
    assert of_energy(NormalisedDevice([1e9], [0.1], mobility)) == ""
    assert "no study takes it" in of_energy(NormalisedDevice(stiffness, [10.0, 12.0, 11.5], mobility))


def test_a_number_at_its_bound_has_no_error():
    """frequency_offset ends at four times what clocks differ by: that was told as 4e-06 ± 1.2e-08."""
    bounds = np.array([-4e-6, 0.0, -np.inf]), np.array([4e-6, np.inf, np.inf])
    assert at_bounds(np.array([3.99e-6, 0.0, 5.0]), bounds, [0, 1, 2]) == (True, False, False)
    assert at_bounds(np.array([-3.99e-6, 1e-9, 5.0]), bounds, [2, 0]) == (False, True)
    assert at_bounds(np.array([3.8e-6, 0.0, 5.0]), bounds, [0]) == (False,)
    said = str(ParameterEstimate("frequency_offset[1]", 3.99e-6, 1.2e-8, "1", stopped=True))
    assert said.split() == ["frequency_offset[1]", "3.99e-06,", "at", "its", "bound"]
    term = Accepted("drive_level", "", (0.05, -0.2), (0.01, 0.02), "1", 0.0, 9.0, 1.0, stopped=(False, True))
    assert term.told() == ("0.05 ± 0.01", "-0.2 at its bound")
    assert of_instrument((term,), "", 1) == " The instrument: drive_level 0.05 ± 0.01, -0.2 at its bound."


def test_a_number_that_no_record_holds_is_zero():
    """Without a standard deviation it was told as the rounding that it is."""
    unsure = float("nan"), float("nan")
    assert Accepted("drive_level", "", (-0.0155, -1.4e-17), unsure, "1", 0.0, 9.0, 1.0).told() == ("-0.0155", "0")
    assert Accepted("drive_level", "", (-1.4e-17, 3e-18), unsure, "1", 0.0, 9.0, 1.0).told() == ("-1.4e-17", "3e-18")
    small = Accepted("drive_level", "", (1.0, 1e-12), (0.1, 2e-13), "1", 0.0, 9.0, 1.0)
    assert small.told()[1].startswith("1")


def test_a_number_that_is_not_held_has_no_infinite_error():
    """The phase of a decay, one of five, was told as "0 ± inf rad"."""
    term = Accepted("reference_phase", "by record", (-0.18, 0.0), (0.01, np.inf), "rad", 0.0, 9.0, 1.0)
    assert term.told() == ("-0.18 ± 0.01", "not held")
    assert term.told_in_unit == "-0.18 ± 0.01 rad, not held"
    assert Accepted("a", "", (1.0,), (np.inf,), "N", 0.0, 9.0, 1.0).told_in_unit == "not held"
