"""A run of the loop as a measurement case: the model that ran explains it to its noise, whoever integrates it."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app import cli


RATE, DURATION = 50e3, 0.02
STUDY = """
[observer]
kind = "ekf"
prior = { amplitude = "1e-7 m", motion_error = 1 }
[controller]
kind = "damping_compensation"
tones = [{ frequency = "600 Hz", amplitude = "54 m/s^2" }, { frequency = "2893 Hz", amplitude = "2 m/s^2", axis = "x" }]
[loop]
displacement = "0 m"
[scenario]
rate = { kind = "ramp", slope = "2000 rad/s^2" }
[sweep]
sample_rate = "50 kHz"
duration = "20 ms"
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("loop") / "study.toml"
    path.write_text(STUDY)
    return path, mg.load_study(path)


@pytest.fixture(scope="module")
def trace(study):
    loop, scenario = study[1].die(None)
    return mg.simulate(loop, scenario, sample_rate=RATE, duration=DURATION, seed=3)


def true_model(trace, device=None):
    loop = trace.loop
    return mg.Model(device or loop.device, scale=np.array(loop.readout.scale), offset=np.array(loop.readout.offset))


def test_what_ran_explains_the_record(trace, tmp_path):
    """The forces are held for the sample that they were held for, and the rate is that of the same sample."""
    written = trace.to_case(tmp_path / "case")
    case = mg.load_case(written.parent)
    (record,) = case.records
    assert record.start == "rest"
    assert record.time[0] == 0.0
    np.testing.assert_array_equal(record.signals[1:], trace.volts[:-1])
    comparison = mg.compare(true_model(trace), case, fitted=False)
    assert comparison.explained
    device = mg.compare(trace.loop.device, case, fitted=False)
    assert device.explained, "of the read-out's constant a device says nothing, and a run from rest has another mean"
    np.testing.assert_allclose(device.model.offset, trace.loop.readout.offset, atol=2e-5)
    late = replace(record, forces=np.roll(record.forces, 1, axis=0))
    still = replace(record, rate=0.0 * record.rate)
    for wrong in (late, still):
        assert not mg.compare(true_model(trace), replace(case, records=(wrong,)), fitted=False).explained


def test_the_design_is_that_of_the_maker(trace, tmp_path):
    stiffer = eqx.tree_at(lambda d: d.kxx, trace.loop.device, np.asarray(70.0))
    case = mg.case_of_trace(trace, design=stiffer, tolerance=0.1)
    assert case.design["kxx"] == mg.DesignValue(70.0, 63.0, 77.0)
    none = eqx.tree_at(lambda d: d.kxy, stiffer, np.asarray(0.0))
    uncoupled = mg.case_of_trace(trace, design=none)
    assert uncoupled.design["kxy"].high == pytest.approx(0.15 * np.sqrt(70.0 * 95.92))
    again = mg.load_case(mg.write_case(uncoupled, tmp_path).parent)
    assert again.design == uncoupled.design, "a limit that NumPy made was written as np.float64(...), which no TOML is"


def test_the_command_adds_runs_to_a_case(study, tmp_path, capsys):
    case, path = tmp_path / "case", study[0]
    for tokens in ((), ("--record", "check", "--role", "validation", "--seed", "1")):
        with pytest.raises(SystemExit) as end:
            cli.main(["simulate", str(path), "--case", str(case), *tokens])
        assert end.value.code == 0, capsys.readouterr().err
    records = mg.load_case(case).records
    assert [(r.name, r.role) for r in records] == [("run", None), ("check", "validation")]
    assert not np.array_equal(records[0].signals, records[1].signals)
    with pytest.raises(SystemExit):
        cli.main(["simulate", str(path), "--case", str(case), "--record", "check"])
    assert "has an experiment `check` already" in capsys.readouterr().err
    assert sorted(p.name for p in case.iterdir()) == ["case.toml", "check.csv", "run.csv"]


@pytest.mark.slow
def test_a_record_that_begins_in_an_unknown_motion_is_solved_for_it(trace, tmp_path):
    """As a recorder beside a running loop has it: long before the motion of its first row would have died out."""
    case = mg.load_case(trace.to_case(tmp_path / "case").parent)
    (whole,) = case.records
    rows = slice(200, None)
    cut = replace(
        whole, start="unknown", lines=whole.lines[rows], time=whole.time[rows], forces=whole.forces[rows],
        signals=whole.signals[rows], rate=whole.rate[rows],
    )  # fmt: skip
    from_rest = mg.compare(trace.loop.device, replace(case, records=(replace(cut, start="rest"),)), fitted=False)
    assert not from_rest.explained
    case = replace(case, records=(cut,))
    assert mg.compare(trace.loop.device, case, fitted=False).explained
    found = mg.compare(trace.loop.device, case)
    assert found.explained
    assert found.fit.optimum.converged
    stiffness = next(p for p in found.fit.estimates if p.name == "kxx/m")
    assert abs(stiffness.value - float(trace.loop.device.kxx / trace.loop.device.mass)) < 4 * stiffness.std
    wrong = eqx.tree_at(lambda d: d.kxx, trace.loop.device, 1.001 * trace.loop.device.kxx)
    assert not mg.compare(wrong, case, fitted=False).explained


@pytest.mark.slow
def test_each_channel_keeps_its_noise(study, trace, tmp_path):
    loop = trace.loop
    uneven = eqx.tree_at(lambda r: r.noise_density, loop.readout, (4.5e-7, 1.8e-6))
    run = mg.simulate(replace(loop, readout=uneven), study[1].die(None)[1], sample_rate=RATE, duration=DURATION, seed=4)
    case = mg.load_case(run.to_case(tmp_path / "case").parent)
    (record,) = case.records
    np.testing.assert_allclose(record.noise_of_rows, np.tile(uneven.noise_std(1 / RATE), (record.rows, 1)), rtol=1e-12)
    found = mg.compare(run.loop.device, case, fitted=False)
    assert found.explained
    np.testing.assert_allclose(np.std(found.fit.whitened[0], axis=0).ravel(), 1.0, atol=0.1)


def test_what_a_case_cannot_hold_is_refused(trace, tmp_path):
    loop = trace.loop
    coarse = eqx.tree_at(lambda t: t.time, trace, trace.time[9::10])  # what `decimation=10` keeps
    lost = eqx.tree_at(lambda t: t.intact_until, trace, np.asarray(0.01))
    uneven = eqx.tree_at(
        lambda t: t.loop.readout, trace, mg.DirectReadout((1e5, 9e4)), is_leaf=lambda part: part is loop.readout
    )
    for wrong, words in ((coarse, "decimation=1"), (lost, "lost at 0.01 s"), (uneven, "one scale")):
        with pytest.raises(mg.InputError, match=words):
            wrong.to_case(tmp_path / "none")
    assert not (tmp_path / "none").exists()
