"""What a fit found beside what the design expects."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from memsgyro_jax.diagnosis.modes import mode_estimates
from memsgyro_jax.diagnosis.optimum import Optimum
from memsgyro_jax.diagnosis.outside_design import outside_design
from memsgyro_jax.measurement.declared import DesignValue


def around(value, share):
    return DesignValue(value, value * (1 - share), value * (1 + share))


def optimum(vector, std):
    """A fit all of whose numbers are known that well, each for itself."""
    free = np.arange(len(std))
    return Optimum(np.asarray(vector), free, np.zeros(len(std)), np.diag(1.0 / np.asarray(std)), np.zeros(0), True, 1)


def fork():
    """A 6.0 and 6.4 kHz fork, within 2 % of its springs and 10 % of its dampings, at 2.5e-7 kg within 1 %."""
    mass, omega, quality = 2.5e-7, 2 * np.pi * np.array([6000.0, 6400.0]), np.array([3000.0, 1200.0])
    springs, dampings = mass * omega**2, mass * omega / quality
    design = {
        "mass": around(mass, 0.01),
        "kxx": around(springs[0], 0.02),
        "kyy": around(springs[1], 0.02),
        "dxx": around(dampings[0], 0.1),
        "dyy": around(dampings[1], 0.1),
    }
    vector = np.array([*omega**2, 0.0, *(omega / quality), 0.0, 1 / mass, 0.0, 0.0])
    return SimpleNamespace(device="single_mass", design=design), vector


@pytest.mark.parametrize(("place", "share", "told"), [
    (0, 1.025, ()), (0, 1.07, ("resonance of x: 6206.4",)), (1, 0.9, ("resonance of y: 6071.57",)),
    (4, 1.1, ()), (4, 1.5, ("quality factor of y: 800",)), (4, 0.5, ("quality factor of y: 2400",)),
])  # fmt: skip
def test_what_lies_outside_is_told(place, share, told):
    case, vector = fork()
    vector[place] *= share
    found = outside_design(case, optimum(vector, 1e-5 * np.abs(vector) + 1e-9))
    assert len(found) == len(told)
    for one, start in zip(found, told, strict=True):
        assert one.startswith(start), one
        assert "where `[design]` has " in one


def test_what_the_records_leave_unsure_is_not():
    case, vector = fork()
    vector[4] *= 1.5
    std = 1e-5 * np.abs(vector) + 1e-9
    std[4] = 0.2 * vector[4]
    assert outside_design(case, optimum(vector, std)) == ()
    case.design["dyy"] = replace(case.design["dyy"], unknown=True)
    assert outside_design(case, optimum(vector, 1e-5 * np.abs(vector) + 1e-9)) == ()


def test_of_one_axis():
    omega, quality = 2 * np.pi * 32768.0, 20e3
    design = {"resonance": around(omega, 0.001), "quality_factor": around(quality, 0.3)}
    case = SimpleNamespace(device="resonator", design=design)
    vector = np.array([(1.002 * omega) ** 2, omega / quality, 1.0, 0.0])
    (said,) = outside_design(case, optimum(vector, 1e-8 * vector + 1e-9))
    assert said.startswith("resonance: 32833.53")
    assert "where `[design]` has 32735 to 32801 Hz" in said


def test_a_damping_that_is_not_told_bounds_the_quality_factor():
    """1/Q of 1e-5 ± 2e-5: less than 4.29e-5 with 95 %."""
    w = 2 * np.pi * 25e3
    quality = mode_estimates(optimum([w**2, 1e-5 * w, 1.0, 0.0], [1e-9 * w**2, 2e-5 * w]), 1)[1]
    assert np.isinf(quality.std)
    assert quality.above == pytest.approx(1.0 / (1e-5 + 1.645 * 2e-5), rel=1e-3)
    assert str(quality) == "quality factor           above 2.3e+04 (95 %), as its damping is not told from none"
    assert quality.roughly == "quality factor           not determined by these records"  # by a model that leaves more
    known = mode_estimates(optimum([w**2, 1e-5 * w, 1.0, 0.0], [1e-9 * w**2, 3e-6 * w]), 1)[1]
    assert known.above is None
    assert known.std == pytest.approx(0.3 * known.value, rel=1e-3)
