"""A noise that the rows of a record told too large hides no effect, and an estimate that is right is left alone."""

from dataclasses import replace

import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden

from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.less_noise import less_noise


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
