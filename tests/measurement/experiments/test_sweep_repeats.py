"""Sweeps of one drive that differ by a factor are named, and are no repeats that tell the noise."""

import numpy as np
import pytest

import memsgyro_jax as mg


HERTZ = np.linspace(9900.0, 10100.0, 81)


def response(quality=400.0, resonance=10e3):
    """A settled response of 0.2 V at its peak for a quality factor of 400."""
    return 0.2 / 400.0 / (1.0 - (HERTZ / resonance) ** 2 + 1j * HERTZ / resonance / quality)


def case(tmp_path, *sweeps, noise=1e-4):
    """Of one file, whose sweeps go up and follow each other at one drive."""
    rng, lines = np.random.default_rng(3), ["f [Hz],X [V],Y [V],F_x [V]"]
    for values in sweeps:
        values = values + noise * (rng.normal(size=HERTZ.size) + 1j * rng.normal(size=HERTZ.size))
        lines += [f"{f:.9g},{z.real:.9g},{z.imag:.9g},1" for f, z in zip(HERTZ, values, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    return mg.import_case([tmp_path / "a.csv"], tmp_path / "case").case


@pytest.mark.parametrize(
    ("factors", "said"),
    [((1.0, 2.0), "a factor of 2"), ((2.0, 1.0, 1.0), "a factor of 2"), ((1.0, 1.2), "a factor of 1.2"),
     ((1.0, 3.0, 10.0), "factors of 3, 10")],
)  # fmt: skip
def test_sweeps_that_differ_by_a_factor_are_named_and_tell_no_noise(factors, said, tmp_path):
    """Noise of 1e-4 V was 0.014 V where two sweeps of one declared drive differed twofold."""
    found = case(tmp_path, *(factor * response() for factor in factors))
    (quality,) = mg.assess(found).records
    (sentence,) = [one for one in quality.warnings if "same drive" in one]
    assert sentence == f"a.csv: sweeps at the same drive, 1 V, differ by {said}: is the drive the same?"
    assert quality.noise == pytest.approx(1e-4, rel=0.3)
    assert sum(rows.size for rows in found.records[0].courses) == found.records[0].rows


@pytest.mark.parametrize(
    "sweeps",
    [(response(), response(), response()), (response(), 1.01 * response()), (response(), response(quality=200.0)),
     (response(), response(resonance=10.02e3)), (0.02 * response(), 0.02 * response())],
)  # fmt: skip
def test_repeats_and_changes_of_the_device_are_no_other_drive(sweeps, tmp_path):
    found = case(tmp_path, *sweeps)
    (quality,) = mg.assess(found).records
    assert not any("same drive" in one for one in quality.warnings)
    assert len(found.records[0].courses) == 1
