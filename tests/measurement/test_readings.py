"""From records to experiments: nothing is lost, counted twice, or fitted that should validate."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from bench_case import DIE, RESONATOR, bench, truth
from lab.die import Hidden
from lab.protocol import Laboratory, Multisine, RingDown

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.measurement.experiments import HarmonicSweep, RawCapture
from memsgyro_jax.measurement.readings import readings_of


def with_roles(case, **roles):
    """The same case with roles declared."""
    return replace(case, records=tuple(replace(r, role=roles.get(r.name, r.role)) for r in case.records))


@pytest.fixture(scope="module")
def case():
    return bench().case


def places(readings):
    """(record, row, fitted) of everything real."""
    return [(k, i, r.fitted) for r in readings for k, i in zip(r.record, r.row, strict=True) if k >= 0]


@pytest.mark.parametrize("roles", [{}, {"sweep_x": "validation", "raw": "validation"}, {"sweep_y": "fit"}])
def test_every_row_of_every_record_is_there_once(case, roles):
    found = sorted((k, i) for k, i, _ in places(readings_of(with_roles(case, **roles))))
    assert found == [(k, i) for k, r in enumerate(case.records) for i in range(r.rows)]


def test_without_roles_sweeps_alternate_and_ring_downs_validate(case):
    for k, i, fitted in places(readings_of(with_roles(case, ringdown=None))):
        kind = case.records[k].name
        assert fitted == {"ringdown": False, "rate": True, "raw": True}.get(kind, i % 2 == 0)


def test_declared_roles_hold(case):
    roles = {"sweep_x": "validation", "sweep_y": "fit", "ringdown": "fit", "rate": "validation"}
    for k, _, fitted in places(readings_of(with_roles(case, **roles))):
        if (name := case.records[k].name) in roles:
            assert fitted == (roles[name] == "fit")


def test_a_ring_down_alone_is_fitted(case):
    alone = with_roles(replace(case, records=case.records[4:5]), ringdown=None)
    assert [r.fitted for r in readings_of(alone)] == [True]


def test_fitted_and_validating_sweeps_have_one_shape(case):
    """So that one compiled program serves both."""
    both = readings_of(with_roles(case, sweep_x="fit"))
    fitted, validating = (r for r in both if isinstance(r.experiment, HarmonicSweep))
    assert np.sum(validating.record == -1) > 0, "this test is about padding"
    assert [x.shape for x in jax.tree.leaves(fitted.experiment)] == [
        x.shape for x in jax.tree.leaves(validating.experiment)
    ]


def test_padding_does_not_count(case):
    """Padded rows have no residual, and the errors of the records are those without padding."""
    padded = next(r for r in readings_of(with_roles(case, sweep_x="fit")) if np.any(r.record == -1))
    sweep = padded.experiment
    white = np.asarray(sweep.noise.whiten(sweep.measured, sweep.measured + 1.0))
    np.testing.assert_array_equal(white[padded.record == -1], 0.0)
    assert np.all(white[padded.record >= 0][..., 0] < 0.0)


def test_errors_count_each_reading_once():
    made = bench()
    halves = replace(made.case, records=tuple(r for r in made.case.records if r.name in ("sweep_x", "sweep_y")))
    model = truth(made.case, DIE, Hidden(), ())
    fit = fit_case(with_roles(halves, sweep_x="fit"), model=model, held=True)
    assert [e.count for e in fit.errors] == [4 * n for n in (28, 14, 14)], "two channels, I and Q"
    for record in halves.records:
        noise = (record.readings - made.records[record.name].clean).view(float) / made.records[record.name].noise
        total = sum(e.chi2 for e in fit.errors if e.name == record.name)
        assert total == pytest.approx(np.sum(noise**2), rel=1e-6)


def test_raw_captures_take_steps_that_resolve_the_motion(case):
    raw = next(r.experiment for r in readings_of(case) if isinstance(r.experiment, RawCapture))
    fastest = 2 * np.pi * DIE.resonances()[1]
    assert float(raw.step) * fastest < 0.12
    assert raw.forces.shape[0] == 300 * raw.substeps
    np.testing.assert_array_equal(raw.increments, 0.0)


def test_an_unknown_start_is_simulated_but_not_compared():
    case = bench(protocol=Laboratory((Multisine("multisine", samples=2048),)), die=RESONATOR).case
    (readings,) = readings_of(case)
    skipped = readings.experiment.skipped
    time_constant = 2 * 11.0 / (2 * np.pi * 68.6)
    assert skipped * case.records[0].period > 10 * time_constant
    assert readings.row[0] == skipped
    assert readings.experiment.measured.shape == (2048 - skipped, 1)


def test_a_start_that_would_not_die_out_in_half_the_record_is_solved_for():
    case = bench(protocol=Laboratory((Multisine("multisine", samples=512),)), die=RESONATOR).case
    (readings,) = readings_of(case)
    assert readings.experiment.solved
    assert readings.experiment.skipped == 0
    assert readings.size == 512
    fit = fit_case(case, model=truth(case, RESONATOR, Hidden(), ()), held=True)
    rms = np.sqrt(np.nanmean(fit.whitened[0] ** 2))
    assert 0.9 < rms < 1.1, rms


def test_a_ring_down_needs_a_drive_cycle():
    short = RingDown("ringdown", 0, force=0.012, duration=0.5, samples=40, noise=2.3e-4, interval=1e-3)
    case = bench(protocol=Laboratory((short,)), die=RESONATOR).case
    brief = replace(case, records=(replace(case.records[0], drive_duration=0.01),))
    with pytest.raises(InputError, match=r"`drive_duration` must hold at least one drive cycle, but holds 0\.6"):
        readings_of(brief)
