"""Numbers that act on rows of their own are derived together, and say what each says alone."""

from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import bench

from memsgyro_jax.diagnosis import joint_residual
from memsgyro_jax.diagnosis.instrument import instrument_terms
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.linearised import WIDER, WIDTH
from memsgyro_jax.diagnosis.rows_of_their_own import SideBySide, by_row
from memsgyro_jax.effects import FiniteSweepRate, RateOffset
from memsgyro_jax.effects.instrument import DriveLevel, FrequencyOffset
from memsgyro_jax.effects.lock_in_terms import LockInBackground, LockInMemory, ReferencePhase
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import model_of, readings_of


@pytest.fixture(scope="module")
def joint() -> Joint:
    """Sweeps alone, beside every term of the instrument that has several numbers."""
    case = bench().case
    terms = [
        t for t in instrument_terms(case) if type(t) in (LockInMemory, ReferencePhase, DriveLevel, FrequencyOffset)
    ]
    readings = [r for r in readings_of(case) if type(r.experiment).__name__ == "HarmonicSweep"]
    return Joint(model_of(case, starting_device(case)).with_effect(*filter(by_row, terms)), readings)


def moved(joint: Joint) -> np.ndarray:
    """Every number a little off, within its bounds."""
    vector, some = joint.start.copy(), joint.owner >= 0
    size = np.minimum(1e-3, 0.3 * np.where(np.isfinite(joint.bounds[1]), joint.bounds[1], 1.0))
    vector[some] = (size * np.linspace(0.5, 1.0, size.size))[some]
    return vector


def test_derived_together_numbers_say_what_each_says_alone(joint):
    vector = moved(joint)
    units = np.eye(vector.size)
    assert len(units) > 2 * WIDER
    value, slopes = joint.linearise(vector, units, joint.fitted)
    alone = Joint(joint.model, joint.readings, joint.programs)
    parts = [alone.linearise(vector, units[i : i + WIDTH], alone.fitted) for i in range(0, len(units), WIDTH)]
    assert value == pytest.approx(parts[0][0], rel=1e-12, abs=1e-12)
    expected = np.concatenate([each for _, each in parts], axis=1)
    assert np.linalg.norm(expected, axis=0) @ (joint.owner >= 0) > 0
    assert slopes == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max(axis=0).min())
    ways = np.random.default_rng(1).normal(size=(40, vector.size)) * np.abs(vector)
    sums = alone.linearise(vector, ways, alone.fitted)[1]
    assert sums == pytest.approx(expected @ ways.T, rel=1e-9, abs=1e-9 * np.abs(sums).max())


def test_they_take_one_pass_of_the_program(joint, monkeypatch):
    seen, vector = [], moved(joint)
    linear = joint.calls.linear
    monkeypatch.setattr(joint.calls, "linear", lambda *a, **k: seen.append(a) or linear(*a, **k))
    joint.linearise(vector, np.eye(vector.size), joint.fitted)
    assert len(seen) == len(joint.fitted)


@pytest.mark.parametrize("rows", [None, "apart"])
def test_only_numbers_without_a_common_row_share_a_direction(rows):
    """Where rows may depend on each other, none of one record does; what moves no row has none."""
    table = np.zeros((2, 2, 3))
    table[0, 0, 0] = table[0, 1, 1] = table[1, :, 2] = 1.0
    model = Model(starting_device(bench().case), scale=1.0).with_effect(
        RateOffset(0.0), DriveLevel(np.ones(3), table), LockInBackground(np.zeros(4))
    )
    labels = np.array([[0, 0], [0, 1], [0, 1]])
    experiment = SimpleNamespace(measured=np.zeros((3, 2)), labels=labels if rows else None)
    readings = SimpleNamespace(experiment=experiment, record=np.zeros(3, int), size=6)
    asked = np.zeros(9 + 1 + 3 + 4, bool)
    asked[[0, 9, 10, 11, 12, 13]] = True
    found = SideBySide.of(model, readings, asked)
    first, second, none = found.lane[10:13]
    assert none == -1
    assert (first == second) == bool(rows)
    others = found.lane[[0, 9, 13]]
    assert len({*others.tolist(), first, second}) == len(found.ways) == (4 if rows else 5)
    assert np.all(found.lane[~asked] == -1)
    slopes = np.arange(1.0, 1.0 + found.ways.shape[0] * 6).reshape(-1, 6)
    apart = found.apart(slopes)
    assert apart[0] == pytest.approx(slopes[found.lane[0]])
    assert not apart[12].any()
    if rows:
        assert apart[10] == pytest.approx([*slopes[first][:2], 0, 0, 0, 0])
        assert apart[11] == pytest.approx([0, 0, *slopes[first][2:]])


def test_a_part_without_such_numbers_is_as_narrow_as_before(joint):
    case = bench().case
    plain = Joint(model_of(case, starting_device(case)).with_effect(RateOffset(0.0)), readings_of(case))
    assert plain._part(plain.start, np.eye(plain.start.size)).width == WIDTH
    assert joint._part(joint.start, np.eye(joint.start.size)).width == WIDER


def test_only_records_whose_frequency_moves_are_predicted_with_its_speed(monkeypatch):
    """All others go through the program that they have without."""
    case = bench().case
    joint = Joint(model_of(case, starting_device(case)).with_effect(FiniteSweepRate(0.0)), readings_of(case))
    asked = {}

    def linear(part, vector, experiment, block=None, *, asked_for=asked, **_):
        asked_for[type(experiment).__name__] = [effect.name for effect in part.model.effects]
        size = next(r.size for r in joint.fitted if r.experiment is experiment)
        return joint_residual.Linear(experiment, block, np.zeros(size), np.zeros((part.width, size)), None)

    monkeypatch.setattr(joint.calls, "linear", linear)
    units = np.eye(joint.start.size)
    _, slopes = joint.linearise(joint.start, units[joint.of_effect(0)], joint.fitted)
    assert slopes.shape == (sum(r.size for r in joint.fitted), 1)
    assert asked.pop("HarmonicSweep") == ["finite_sweep_rate"]
    assert asked
    assert not any(asked.values())
