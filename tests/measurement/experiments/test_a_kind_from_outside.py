"""A kind of measurement written outside the package goes from CSV to verdict."""

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench, truth
from lab.die import Hidden
from measurement.experiments import static_deflection
from measurement.experiments.static_deflection import StaticDeflectionRecord

import memsgyro_jax
from memsgyro_jax.app.cli import main
from memsgyro_jax.app.report.diagnosis_page import diagnosis_page
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.compare import compare
from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import fit
from memsgyro_jax.effects import ElectrostaticSoftening
from memsgyro_jax.measurement.case import assess, load_case, write_case
from memsgyro_jax.measurement.experiments import KINDS, HarmonicSweep, RateTable, RawCapture, RingDown
from memsgyro_jax.measurement.user_kinds import load_kinds


SOFTENING = 2e-5 * RESONATOR.kxx  # N/(m·V²): two parts in a thousand at 10 V, where the sweeps have none
NOISE = 1e-4


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Sweeps of a resonator without bias, and its deflection under held forces with and without."""
    case = bench(Hidden(), 1, ONE_AXIS, RESONATOR).case
    force, bias = (part.ravel() for part in np.meshgrid(3 * [-0.6, -0.3, 0.3, 0.6], [0.0, 5.0, 10.0]))
    record = StaticDeflectionRecord(
        name="held", file="held.csv", lines=np.arange(36) + 2, noise_std=NOISE, forces=force[:, None],
        bias=bias, signals=np.zeros((36, 1)),
    )  # fmt: skip
    model = truth(case, RESONATOR, Hidden(), ()).with_effect(ElectrostaticSoftening("x", SOFTENING))
    clean = np.asarray(record.experiment(case, len(case.records)).predict(model))
    stiffness = RESONATOR.kxx - SOFTENING * (bias**2 - case.environment.bias_voltage**2)
    np.testing.assert_allclose(clean[:, 0], case.readout.scale * force / stiffness, rtol=1e-9, err_msg="Hooke's law")
    record = replace(record, signals=clean + np.random.default_rng(0).normal(0, NOISE, clean.shape))
    path = tmp_path_factory.mktemp("static") / "case"
    write_case(replace(case, records=(*case.records, record)), path)
    return path


@pytest.fixture(scope="module")
def case(folder):
    return load_case(folder, kinds=[StaticDeflectionRecord])


def test_it_is_one_short_file():
    assert len(Path(static_deflection.__file__).read_text().splitlines()) < 60


def test_the_package_itself_does_not_know_it(folder):
    with pytest.raises(InputError, match=r'must have a kind, "frequency_sweep" .*, but has "static_deflection"'):
        load_case(folder)


def test_two_kinds_of_one_name_are_refused(folder):
    with pytest.raises(InputError, match="`static_deflection` is there already"):
        load_case(folder, kinds=[StaticDeflectionRecord, StaticDeflectionRecord])


def test_nothing_false_is_said_of_its_quality(case):
    quality = assess(case)
    assert quality.warnings == ()
    assert (quality.records[-1].noise, quality.records[-1].ratio) == (None, quality.records[-1].peak / NOISE)
    assert "held" in str(quality)


def test_without_declared_noise_it_cannot_be_judged(case):
    with pytest.raises(InputError, match="Experiment `held` must declare its `noise_std`"):
        _ = replace(case.record("held"), noise_std=None).noise_level


@pytest.mark.slow
def test_it_alone_shows_what_is_missing(case):
    comparison = compare(None, case)
    assert not comparison.explained
    (failure,) = comparison.failures
    assert failure.startswith("held fails at bias voltage 10 V: ")
    assert comparison.to_xarray()["held"].coords["bias_voltage"].attrs["unit"] == "V"
    fitted = fit(None, case, effects=[ElectrostaticSoftening("x")])
    assert all(error.explained for error in fitted.errors)
    assert abs(fitted.estimates[-1].value - SOFTENING) < 4 * fitted.estimates[-1].std < 0.2 * SOFTENING


@pytest.mark.slow
def test_it_is_diagnosed_and_drawn(case):
    diagnosis = diagnose(None, case)
    assert diagnosis.verdict == "found"
    assert [effect.label for effect in diagnosis.accepted] == ["electrostatic_softening x"]
    assert diagnosis_page(diagnosis).html().count("<svg") == len(case.records) + 1


def test_the_command_line_takes_its_file(folder, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["check", str(folder), "--kinds", static_deflection.__file__])
    assert stop.value.code == 0
    printed = capsys.readouterr().out
    assert "Warning" not in printed
    assert "held forces" in printed
    nulls = r"not held: (d/m, \+0.71·k/m \+0.71·1/m|\+0.71·k/m \+0.71·1/m, d/m)\n"  # in the order of rounding
    assert re.search(rf"\n  held: offset x to .*; {nulls}", printed)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("x = 1", "must define a kind of measurement, a subclass of `memsgyro_jax.measurement.experiments.Abstract"),
        (
            "class A(AbstractRecord): pass",
            "line 2: record `A` must have `columns`, `experiment`, `extent`, `read`",
        ),
        ("class A(TimeRecord): kind = None", "line 2: record `A` must have the word that `case.toml` has for it"),
        (
            "class A(TimeRecord): kind = 'a'\nclass B(Experiment): pass",
            "line 3: experiment `B` must have `measured`, `name`, `noise`, `predict`, but has not",
        ),
        ("1 / 0", "line 2: must run, but: ZeroDivisionError: division by zero"),
    ],
)
def test_a_file_without_a_kind_is_one_sentence(tmp_path, text, sentence):
    path = tmp_path / "own.py"
    path.write_text(
        f"from memsgyro_jax.measurement.experiments import AbstractRecord, Experiment, TimeRecord\n{text}\n"
    )
    with pytest.raises(InputError, match=re.escape(sentence)):
        load_kinds(path)


def test_nothing_generic_tells_kinds_apart():
    """Outside the members no `isinstance`, comparison, pattern or dispatch asks for a kind of record or experiment."""
    kinds = {c.__name__ for c in (*KINDS, HarmonicSweep, RingDown, RateTable, RawCapture)}
    assert len(kinds) == 10

    def asks(node):
        if isinstance(node, ast.Call):
            return getattr(node.func, "id", "") in ("isinstance", "issubclass")
        dispatched = isinstance(node, ast.FunctionDef) and any(
            "register" in ast.unparse(d) for d in node.decorator_list
        )
        return dispatched or isinstance(node, ast.Compare | ast.MatchClass)

    package = Path(memsgyro_jax.__file__).parent
    told = [
        f"{path.relative_to(package)}:{node.lineno}"
        for path in package.rglob("*.py")
        if path.parent.name != "experiments"
        for node in ast.walk(ast.parse(path.read_text()))
        if asks(node) and kinds & {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name)}
    ]
    assert told == []
