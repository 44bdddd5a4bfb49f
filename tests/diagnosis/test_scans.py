"""Effects with a moment are found on their grid, in the record that shows them; `test_diagnose.py` scans for a mode."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden
from lab.strengths import visible
from numpy.testing import assert_allclose
from phasor_decay import CASE, RECORD

from memsgyro_jax.diagnosis import scans as scans_room
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.scans import _run, _settled, _stepped, scan, scans
from memsgyro_jax.effects import (
    AdcSaturation,
    CubicStiffness,
    DampingStep,
    ParasiticMode,
    PickoffCubicNonlinearity,
    ReadoutDelay,
)
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


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


@pytest.mark.parametrize(
    ("effect", "bent"), [(DampingStep(0.0, time=0.1, record=0), False), (AdcSaturation(1.0), True)]
)
def test_a_read_out_that_bends_is_left_out_where_slopes_are_scanned(monkeypatch, effect, bent):
    """Slopes of many waveforms and these themselves took twenty seconds a lot; what clips is compared as it is."""
    model = fit_case(bench(protocol=ONE_AXIS, die=RESONATOR).case).model
    model = model.with_effect(CubicStiffness(0, 1e3), PickoffCubicNonlinearity(0, 1e3))
    seen = []

    def slopes(scanned, effects, experiment):
        seen.append([one.label for one in scanned.effects])
        return np.zeros((scans_room.CHUNK, 4))

    monkeypatch.setattr(scans_room, "_slopes", slopes)
    chosen = SimpleNamespace(experiment=SimpleNamespace(coarse=None))
    assert _run(model, chosen, [effect]).shape == (1, 4)
    assert seen == [["cubic_stiffness x", *(["pickoff_cubic_nonlinearity x"] if bent else [])]]


@pytest.mark.parametrize("kind", ["RateTable", "RawCapture"])
def test_a_step_is_scanned_as_a_program_that_carries_it_would_tell(kind):
    """From what a change that always was there adds, moment by moment, by the response of the model."""
    fit = fit_case(bench().case)
    (chosen,) = [r for r in fit.joint.fitted if type(r.experiment).__name__ == kind]
    (grid,) = [g for g in scans(fit.case) if g[0].label == "damping_step"]
    points = [point for point in grid if np.any(chosen.record == int(point.record))][::5]
    joint = Joint(fit.model, fit.joint.readings)
    told, carried = _stepped(joint, chosen, points), _run(fit.model, chosen, points)
    assert_allclose(told, carried, rtol=1e-9, atol=1e-9 * np.abs(carried).max())
    assert np.abs(carried).max() > 0.0


def test_what_a_mode_adds_to_a_sweep_is_the_derivative_of_the_receptance():
    """A mode within the band and one beside it, by the equation of two masses."""
    fit = fit_case(bench(protocol=ONE_AXIS, die=RESONATOR).case)
    joint, device = Joint(fit.model, fit.joint.readings), fit.model.device
    (chosen,) = joint.fitted
    omega = np.asarray(chosen.experiment.frequency)
    own = np.array([omega.mean(), 1.2 * omega.max()])
    found = _settled(joint, chosen, [ParasiticMode(0, 0.0, omega=w, quality=30.0) for w in own])
    (k,), (d,), gain = (np.asarray(part) for part in (device.stiffness, device.damping, device.mobility))
    push = 1.0 / (k - omega**2 + 1j * omega * d)
    motion = gain * push * np.asarray(chosen.experiment.force)[:, 0]
    for w, column in zip(own, found, strict=True):
        apart = w**2 * (w**2 / (w**2 - omega**2 + 1j * omega * w / 30.0) - 1.0)
        moved = -fit.model.scale * push * apart * motion / np.asarray(chosen.experiment.noise.std)[:, 0]
        assert_allclose(column.reshape(-1, 2) @ [1.0, 1j], moved, rtol=1e-6, atol=1e-9 * np.abs(moved).max())


def test_a_mode_is_looked_for_in_a_decay_of_phasors_by_a_program_that_carries_it(tmp_path):
    """Its rows go on from one to the next: to take each for settled ended in a shape that did not fit, and of two
    channels would have fitted by chance.
    """
    time = np.arange(100) * 2e-3
    noise = 1e-4 * np.random.default_rng(1).standard_normal((2, 100)).T
    parts = (0.3 * np.exp((2j * np.pi * 10.0 - 8.0) * time)).view(float).reshape(-1, 2) + noise
    table, header = np.column_stack([time, parts]), "t [s],Vx_I [V],Vx_Q [V]"
    np.savetxt(tmp_path / "decay.csv", table, "%.9g", ",", header=header, comments="")
    (tmp_path / "case.toml").write_text(CASE + RECORD.format(name="decay"))
    fit = fit_case(load_case(tmp_path))
    (chosen,) = fit.joint.fitted
    grid = [ParasiticMode(0, 0.0, omega=2 * np.pi * hertz, quality=100.0) for hertz in (13800.0, 14000.0)]
    assert _settled(Joint(fit.model, fit.joint.readings), chosen, grid) is None
    found = scan(fit.model, fit.optimum, fit.joint.fitted, grid)
    assert np.isfinite(found.score.statistic)
    assert found.score.kept > 0.0


CAPTURE = """
schema = "memsgyro-case/1"
name = "capture"
device = "resonator"
[design]
resonance = { value = 150, unit = "Hz", tolerance = 0.1 }
quality_factor = { value = 80, unit = "1", tolerance = 0.5 }
static_gain = { value = 0.02, unit = "1", tolerance = 0.5 }
[readout]
quantity = "displacement"
[[experiment]]
name = "capture"
kind = "time_record"
file = "capture.csv"
hold = "zero_order"
start = "unknown"
"""


def test_a_scan_of_a_capture_is_as_quick_beside_a_read_out_that_is_late(tmp_path):
    """States and their slopes were written anew in each step: of 2 x 9000 rows a scan took more than 400 s, now 10."""
    rng = np.random.default_rng(1)
    table = np.column_stack([np.arange(3000) / 3e3, rng.standard_normal(3000), 0.05 * rng.standard_normal(3000)])
    np.savetxt(tmp_path / "capture.csv", table, "%.9g", ",", header="t [s],u [V],y [V]", comments="")
    (tmp_path / "case.toml").write_text(CAPTURE)
    case = load_case(tmp_path)
    (readings,) = readings_of(case)
    model = model_of(case, starting_device(case)).with_effect(CubicStiffness(0, 0.1), ReadoutDelay(1e-4))
    points = [ParasiticMode(0, 0.0, omega=900.0 + 10.0 * k, quality=100.0) for k in range(8)]

    def lasted():
        begun = time.perf_counter()
        columns = _run(model, readings, points)
        assert np.isfinite(columns).all()
        return time.perf_counter() - begun

    lasted()  # with its program
    assert min(lasted() for _ in range(2)) < 2.0
