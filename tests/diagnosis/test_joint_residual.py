"""All records as one residual: its order, its exact sensitivities, and where a fit with it ends."""

from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import DIE, OF_X, bench, truth
from lab.die import Hidden
from lab.strengths import VISIBLE, visible

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.transforms import names
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.diagnosis import linearised
from memsgyro_jax.diagnosis.compare import judged
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.optimum import optimise
from memsgyro_jax.diagnosis.parameters import parameters
from memsgyro_jax.diagnosis.programs import Programs
from memsgyro_jax.effects import CubicStiffness
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import model_of, readings_of


KINDS = (
    "HarmonicSweep",
    # These are integrated, and take long to compile.
    pytest.param("RingDown", marks=pytest.mark.slow),
    pytest.param("RateTable", marks=pytest.mark.slow),
    pytest.param("RawCapture", marks=pytest.mark.slow),
)
BASE = ("kxx/m", "kyy/m", "kxy/m", "dxx/m", "dyy/m", "dxy/m", "1/m", "offset x", "offset y")
# All effects at once, each strong enough to matter, weak enough that all of them together leave the motion tame.
EVERYTHING = replace(visible(*VISIBLE, times=0.2), rate_bias_drift=(0.02, -0.01, 0.01, 0.005, -0.005, 0.002))


@pytest.fixture(scope="module")
def joint() -> Joint:
    """A case with nothing hidden; the model has an effect of every kind."""
    case = bench().case
    return Joint(truth(case, DIE, EVERYTHING, OF_X), readings_of(case))


def only(case, *names):
    return replace(case, records=tuple(r for r in case.records if r.name in names))


# ---- parameters


@pytest.mark.parametrize("effects", [(), OF_X[:1], OF_X])
def test_parameters_come_in_the_order_of_the_vector(effects):
    """`parameters` names by hand what the tree lays out: both must mean the same number."""
    made = bench()
    joint = Joint(made.model(effects), readings_of(made.case))
    assert [p.name for p in joint.parameters[:9]] == list(BASE)
    leaves = [path.split("[")[0] for path in names(joint.model, joint.spec)]
    assert len(leaves) == len(joint.parameters) == joint.start.size
    assert leaves[:9] == ["device.stiffness"] * 3 + ["device.damping"] * 3 + ["device.mobility"] + ["offset"] * 2
    for k, parameter in enumerate(joint.parameters):
        moved = np.zeros(joint.start.size)
        moved[k] = 1.0
        model = joint.at(moved)
        if parameter.effect is None:
            leaves = [*model.device.stiffness, *model.device.damping, model.device.mobility, *model.offset]
            assert [float(v) for v in leaves].index(1.0) == BASE.index(parameter.name)
        else:
            assert float(np.sum(model.effects[parameter.effect].strength)) == 1.0
            assert parameter.name.startswith(model.effects[parameter.effect].label)
            assert parameter.unit == model.effects[parameter.effect].unit


def test_a_resonator_has_four_base_parameters():
    model = Model(Resonator(resonance=400.0, quality_factor=10.0))
    assert [p.name for p in parameters(model)] == ["k/m", "d/m", "1/m", "offset x"]


def test_places_of_effects_and_base_share_the_vector(joint):
    every = np.concatenate([joint.base(), *(joint.of_effect(i) for i in range(len(OF_X)))])
    np.testing.assert_array_equal(np.sort(every), np.arange(joint.start.size))


def test_float32_is_refused():
    with (
        jax.enable_x64(False),
        pytest.raises(InputError, match="Comparing a model with measurements must run in"),
    ):
        Joint(None, ())


# ---- sensitivities


def scales(joint: Joint) -> np.ndarray:
    """A change of each parameter that matters: a part of it, or of a strength well above the noise."""
    labels = {e.label: VISIBLE.get(e.label.replace(" ", "_"), 0.02) for e in OF_X}
    base = 1e-5 * np.abs(joint.start)
    return np.array(
        [b if p.effect is None else 0.01 * abs(labels[OF_X[p.effect].label])
         for b, p in zip(base, joint.parameters, strict=True)]
    )  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_sensitivities_are_those_of_finite_differences(joint, kind):
    """Every parameter at once along random directions, of fourth order in the step."""
    chosen = [r for r in joint.readings if type(r.experiment).__name__ == kind]
    rng, scale = np.random.default_rng(0), scales(joint)
    directions = rng.uniform(-1, 1, (2, joint.start.size)) * scale
    value, slopes = joint.linearise(joint.start, directions, chosen)
    assert np.all(np.isfinite(slopes))
    np.testing.assert_allclose(value, np.concatenate(joint.residual(joint.start, chosen)), rtol=1e-12, atol=1e-9)
    for direction, slope in zip(directions, slopes.T, strict=True):
        at = {h: np.concatenate(joint.residual(joint.start + h * direction, chosen)) for h in (-2, -1, 1, 2)}
        difference = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / 12
        assert np.max(np.abs(slope)) > 1e-3
        np.testing.assert_allclose(slope, difference, atol=3e-6 * np.max(np.abs(slope)))


class Rows(NamedTuple):
    measured: np.ndarray
    slow: bool = False


def test_a_program_for_few_rows_says_the_same_as_one_for_many():
    def readings(times, experiment):
        return jnp.sin(times) * experiment.measured

    program = linearised.compiled(readings)
    for rows in (3, linearised.SHORT, linearised.SHORT + 1):
        here = Rows(np.linspace(1.0, 2.0, rows))
        np.testing.assert_allclose(program(here.measured, here), np.sin(here.measured) * here.measured, rtol=1e-14)


def test_a_number_written_in_python_runs_through_the_program_of_a_computed_one():
    traced = []

    def readings(experiment):
        traced.append(experiment.measured.weak_type)
        return 2.0 * experiment.measured

    program = linearised.compiled(readings)
    for measured in (jnp.full(3, 1.5), jnp.ones(3), jnp.asarray(np.ones(3))):
        program(Rows(measured))
    assert jnp.full(3, 1.5).weak_type, "it was no case"
    assert traced == [False]


def test_sensitivities_add_up(joint):
    """Blocks of directions are padded to the width of the program; none may be lost or counted twice."""
    chosen = joint.readings[:1]
    directions = np.eye(joint.start.size) * scales(joint)
    mix = np.random.default_rng(1).standard_normal(joint.start.size)
    _, each = joint.linearise(joint.start, directions, chosen)
    _, one = joint.linearise(joint.start, (mix @ directions)[None], chosen)
    assert each.shape[1] == joint.start.size
    np.testing.assert_allclose(each @ mix, one[:, 0], atol=1e-9 * np.max(np.abs(one)))


# ---- optimum


@pytest.fixture(scope="module")
def fitted():
    """Nothing hidden: base parameters fitted to fit records, from a start found in the data."""
    case = bench().case
    joint = Joint(truth(case, DIE, Hidden()), readings_of(case))
    start = joint.start.copy()
    start[joint.base()] = Joint(model_of(case, starting_device(case)), joint.readings).start
    return joint, optimise(joint, start, joint.base(), joint.fitted)


def test_a_fit_ends_at_the_truth(fitted):
    joint, optimum = fitted
    assert optimum.converged
    assert optimum.frozen.shape == (0, 9)
    pulls = (optimum.vector - joint.start)[optimum.free] / optimum.std
    assert np.max(np.abs(pulls)) < 4.5
    assert np.max(np.abs(pulls)) > 0.1, "not the truth itself"
    count = optimum.residual.size
    assert abs(optimum.chi2 - (count - 9)) < 5 * np.sqrt(2 * count)
    np.testing.assert_array_equal(optimum.vector[9:], 0.0)


def test_an_optimum_is_stationary_and_says_its_residual(fitted):
    joint, optimum = fitted
    chosen = joint.fitted
    value, slope = joint.linearise(optimum.vector, np.eye(joint.start.size)[optimum.free], chosen)
    np.testing.assert_allclose(optimum.residual, value, atol=1e-6)
    size = np.linalg.norm(slope, axis=0)
    np.testing.assert_allclose(optimum.jacobian / size, slope / size, atol=1e-5)
    step = np.linalg.lstsq(slope / size, value, rcond=None)[0] / size
    assert np.max(np.abs(step) / optimum.std) < 0.05, "a Newton step from the optimum in standard deviations"


def test_chi_square_rises_by_one_at_one_standard_deviation(fitted):
    """Along an eigenvector of the covariance, by definition of the covariance."""
    joint, optimum = fitted
    values, vectors = np.linalg.eigh(optimum.covariance / np.outer(optimum.std, optimum.std))
    chosen = joint.fitted
    for value, vector in zip(values[[0, -1]], vectors.T[[0, -1]], strict=True):
        moved = optimum.vector.copy()
        moved[optimum.free] += np.sqrt(value) * vector * optimum.std
        there = np.concatenate(joint.residual(moved, chosen))
        assert there @ there - optimum.chi2 == pytest.approx(1.0, abs=0.1)


# ---- what the records do not hold


def test_offsets_that_no_record_reads_are_no_part_of_a_fit():
    """A lock-in is blind to a constant: rounding must not pass for a sensitivity, nor a table list what nobody asks."""
    fit = fit_case(only(bench().case, "sweep_x", "sweep_y"))
    names = [p.name for p in fit.joint.parameters]
    assert fit.null_directions == ()
    assert "offset" not in str(fit)
    offsets = [names.index("offset x"), names.index("offset y")]
    np.testing.assert_array_equal(fit.optimum.vector[offsets], 0.0)
    assert not np.isin(offsets, fit.optimum.free).any()
    assert np.isfinite(fit.optimum.std).all()
    assert 0.8 < fit.chi2_per_dof < 1.3


def test_offsets_are_a_part_of_a_fit_of_waveforms():
    fit = fit_case(only(bench().case, "sweep_x", "sweep_y", "raw"))
    offsets = {e.name: e for e in fit.estimates if e.name.startswith("offset")}
    assert [*offsets] == ["offset x", "offset y"]
    assert np.isfinite([e.std for e in offsets.values()]).all()


def test_rounding_is_told_by_sums_before_one_by_one():
    """What is rounding comes out differently each time; sums ask for all that is true at once."""
    random, asked, loose = np.random.default_rng(0), [], [3, 20]
    true = random.normal(size=(50, 30)) * np.geomspace(1e-12, 1e6, 30)
    true[:, 5] = 0.0

    def linearise(vector, directions, chosen):
        asked.append(len(directions))
        seen = true.copy()
        seen[:, loose] = true[:, loose] * random.normal(size=(50, 2))
        return None, seen @ directions.T

    joint = SimpleNamespace(base=lambda: [0], fitted=(), linearise=linearise)
    slopes = linearise(None, np.eye(30), ())[1]
    assert np.flatnonzero(Joint.rounding(joint, np.ones(30), np.eye(30), slopes)).tolist() == loose
    assert asked == [30, linearised.WIDTH, 5], "all, sums of two or three, and the members of two sums"


@pytest.fixture(scope="module")
def standing():
    """A table that stands still, beside a model that is a little wrong."""
    case = only(bench().case, "rate")
    case = replace(case, records=(replace(case.records[0], rate=np.zeros(80)),))
    return fit_case(case, model=truth(case, replace(DIE, dxx=1.01 * DIE.dxx), Hidden(), ()))


def test_one_operating_point_holds_few_combinations(standing):
    """Two phasors are four numbers for seven parameters."""
    assert len(standing.null_directions) == 7 - 4
    assert np.sum(np.isinf(standing.optimum.std)) >= 5
    assert f"{standing.null_directions[0]} is not determined by these records" in standing.status
    assert "not determined by these records" in str(standing)
    assert " inf " not in str(standing)


def test_a_fit_moves_only_what_the_records_hold(standing):
    """The frozen directions are in units in which every parameter has the same sensitivity."""
    joint = standing.joint
    free = standing.optimum.free
    _, slope = joint.linearise(joint.start, np.eye(9), joint.readings)
    moved = ((standing.optimum.vector - joint.start) * np.linalg.norm(slope, axis=0))[free]
    assert np.linalg.norm(moved) > 1.0, "standard deviations"
    assert np.max(np.abs(standing.optimum.frozen @ moved)) < 1e-6 * np.linalg.norm(moved)


def test_what_is_not_resolved_is_said(standing):
    """In words that agree with what is said of the records: what is not resolved to the noise explains nothing."""
    assert "harmonics" not in standing.status
    fine, unsure = replace(standing, apart=0.4), replace(standing, apart=12.0)
    assert "still more would move a reading by up to about 0.4 × noise" in fine.status
    assert "not resolved" not in fine.status
    assert "not resolved: they have the most harmonics" in unsure.status
    assert 'about 12 × noise, less without the records that are driven hardest (`role = "validation"`)' in unsure.status
    assert "hardest" not in fine.status
    right = judged(standing)
    assert right.explained
    assert judged(fine).explained
    assert judged(fine).verdict == right.verdict
    assert not judged(unsure).explained
    assert "is not sure: none of" in judged(unsure).verdict
    assert "about 12 × noise" in judged(unsure).verdict


def test_how_far_it_is_resolved_is_told_of_the_model_that_was_fitted(monkeypatch):
    """Not of the one before the last fit, which swings otherwise."""
    monkeypatch.setattr("memsgyro_jax.diagnosis.fit.sharpened", lambda model, readings, residual: ((*readings,), 12.0))
    assert fit_case(bench().case).apart == 0.0


@pytest.mark.slow
def test_an_effect_without_a_trace_is_named():
    """No record of a sweep at one bias knows the softening."""
    case = only(bench().case, "sweep_x", "sweep_y")
    softening = next(e for e in OF_X if e.name == "electrostatic_softening")
    fit = fit_case(case, [softening, CubicStiffness("x")], model=truth(case, DIE, Hidden(), ()))
    assert "electrostatic_softening x" in " ".join(fit.null_directions)
    estimates = {e.name: e for e in fit.estimates}
    assert estimates["electrostatic_softening x"].std == np.inf
    assert np.isfinite(estimates["cubic_stiffness x"].std)
    assert abs(estimates["cubic_stiffness x"].value) < 4.5 * estimates["cubic_stiffness x"].std


# ---- programs


def test_a_program_serves_models_with_fewer_effects():
    """That of a round for each of its candidates; none with more than a few others, nor with one that costs more."""
    programs, idle = Programs(), "abcdef".__contains__
    programs.announced = ("a", "b", "c")
    assert programs.chosen(frozenset("ab"), idle) == frozenset("abc")
    programs.announced = ("a", "c")
    assert programs.chosen(frozenset("ac"), idle) == frozenset("abc")  # it is there
    assert programs.chosen(frozenset(), idle) == frozenset()  # the base model is linear
    assert programs.chosen(frozenset("d"), idle) == frozenset("d")
    assert programs.chosen(frozenset("b"), "a".__contains__) == frozenset("b")
    letters = "abcdefghijklm"
    programs.made, programs.announced = {frozenset(letters): ()}, tuple("bmlkjihgfedca")
    likeliest = frozenset("ab" + "mlkjihgf")  # and few
    assert programs.chosen(frozenset("ab"), letters.__contains__) == likeliest


def test_a_model_that_lacks_an_effect_goes_through_a_program_that_has_it():
    """Which is no other program, and tells the same numbers."""
    case = bench().case
    wanted = "rate_offset", "centrifugal", "rate_scale_error"
    one, two, three = (effect for name in wanted for effect in OF_X if effect.label == name)
    model = model_of(case, starting_device(case))
    readings = [r for r in readings_of(case) if type(r.experiment).__name__ == "HarmonicSweep"]
    whole = Joint(model.with_effect(three, two, one), readings)
    whole.together(range(3))
    units = np.eye(whole.start.size)
    whole.linearise(whole.start, units[whole.of_effect(1)], whole.fitted)
    fewer = Joint(model.with_effect(two, one), readings, whole.programs)
    vector = fewer.start.copy()
    vector[fewer.of_effect(0)] = 1e-3
    ways = np.eye(vector.size)[[0, int(fewer.of_effect(1)[0]), int(fewer.of_effect(0)[0])]]
    part = fewer._part(vector, ways)
    assert [effect.label for effect in part.model.effects] == [e.label for e in (three, two, one)]
    alone = Joint(fewer.model, readings)
    for found, expected in zip(*(j.linearise(vector, ways, j.fitted) for j in (fewer, alone)), strict=True):
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


def test_a_linear_model_is_not_given_a_program_that_is_not():
    case = bench().case
    joint = Joint(model_of(case, starting_device(case)).with_effect(*OF_X), readings_of(case))
    places = {effect.label: i for i, effect in enumerate(joint.model.effects)}
    cubic, linear, other = (places[name] for name in ("cubic_stiffness x", "rate_offset", "centrifugal"))

    def program(*effects):
        vector = np.zeros_like(joint.start)
        for i in effects:
            vector[joint.of_effect(i)] = 1.0
        return set(joint._part(vector, np.zeros((0, vector.size))).effects)

    joint.together((linear, cubic, other))
    assert program(linear) == {linear, other}
    assert program(cubic) == {linear, cubic, other}
