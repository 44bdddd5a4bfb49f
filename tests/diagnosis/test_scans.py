"""Effects with a moment are found on their grid, in the record that shows them; `test_diagnose.py` scans for a mode."""

from dataclasses import replace

import pytest
from bench_case import bench
from lab.die import Hidden
from lab.strengths import visible

from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.scans import scan, scans
from memsgyro_jax.effects import DampingStep


STEP = replace(visible("damping_step"), damping_step_record="rate", damping_step_time=0.08)


def best(name, hidden):
    """What the scan for an effect finds beside the base model."""
    fit = fit_case(bench(hidden).case)
    (grid,) = [g for g in scans(fit.case) if g[0].label == name]
    return scan(fit.model, fit.optimum, fit.joint.fitted, grid)


@pytest.mark.slow
def test_a_damping_step_is_found_in_its_record_at_its_time():
    case = bench(STEP).case
    found = best("damping_step", STEP)
    assert isinstance(found.effect, DampingStep)
    assert case.records[int(found.effect.record)].name == "rate"
    assert float(found.effect.time) == pytest.approx(0.08, abs=case.record("rate").time[-1] / 24)
    assert found.score.statistic > 100.0


@pytest.mark.slow
def test_a_step_that_is_not_there_is_not_significant():
    found = best("damping_step", Hidden())
    assert found.score.p_value * found.points > 0.01
