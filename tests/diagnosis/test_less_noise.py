"""A noise that the rows of a record told too large hides no effect, and an estimate that is right is left alone."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden

import memsgyro_jax
from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.fitted import RecordError
from memsgyro_jax.diagnosis.less_noise import less_noise, of_less_noise, with_less_noise
from memsgyro_jax.measurement.case import load_case


def undeclared(hidden=None, times=1.0, patch=None):
    """A resonator of which no record declares its noise; all of them tell it so many times too large."""
    case = bench(hidden or Hidden(), 0, ONE_AXIS, RESONATOR).case
    truth = {record.name: record.noise_std for record in case.records}
    for kind in {type(record) for record in case.records} if times != 1.0 else ():
        patch.setattr(kind, "estimated_noise", lambda self: times * truth[self.name])
    return replace(case, records=tuple(replace(record, noise_std=None) for record in case.records))


def test_a_noise_that_is_told_right_is_left_alone():
    assert less_noise(fit_case(undeclared())) == {}


def test_a_noise_that_is_told_too_large_is_taken_from_what_the_model_leaves(monkeypatch):
    case = undeclared(times=4.0, patch=monkeypatch)
    found = less_noise(fit_case(case))
    assert set(found) == {record.name for record in case.records}
    assert all(share == pytest.approx(0.25, rel=0.25) for share, _ in found.values())
    outcome = diagnose(None, case)
    assert outcome.verdict == "nothing_missing"
    assert "times the noise that a model leaves there" in outcome.sentence
    assert 0.75 < outcome.base.chi2_per_dof < 1.3
    assert outcome.case.records[0].noise_std is None


@pytest.mark.slow
def test_an_effect_that_it_hid_is_found(monkeypatch):
    """Twelve times the noise leaves nothing of it to be seen."""
    case = undeclared(Hidden(cubic_stiffness_x=0.05 * RESONATOR.kxx), 12.0, monkeypatch)
    outcome = diagnose(None, case)
    assert outcome.verdict in ("found", "cannot_tell")
    assert "cubic_stiffness x" in {effect.label for effect in outcome.accepted}


def test_the_channel_alone_is_taken_that_was_told_too_much():
    """Of two that told each its own noise, x three times too much and y rightly."""
    case = load_case(Path(memsgyro_jax.__file__).parent / "demo")
    rng, record = np.random.default_rng(2), replace(case.record("sweep_x"), noise_std=None)
    more = rng.standard_normal((2, record.rows)) * 10.0 * record.noise_level
    record = replace(record, phasors=record.phasors + np.stack([more[0] + 1j * more[1], np.zeros(record.rows)], axis=1))
    case = replace(case, records=(record,))
    white = rng.standard_normal((record.rows, 2, 2)) * np.array([1.0 / 3.0, 1.0])[:, None]
    error = RecordError(record.name, "fit", white.size, float(np.sum(white**2)), record.noise_freedom)
    fit = SimpleNamespace(
        case=case, errors=(error,), whitened=(white,), fitted=(np.ones(record.rows, bool),),
        optimum=SimpleNamespace(free=np.zeros(8)),
    )  # fmt: skip
    found = less_noise(fit)
    (x, y), _ = found[record.name]
    assert x == pytest.approx(1.0 / 3.0, rel=0.1)
    assert y == 1.0
    better = with_less_noise(case, found)
    np.testing.assert_allclose(better.records[0].noise_levels, record.noise_levels * [x, y])
    assert f"told {1 / x:.3g} times the noise of channel x that a model leaves there" in of_less_noise(better)
