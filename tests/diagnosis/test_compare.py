"""A comparison says where a model fails, and is content with the right one."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from bench_case import demonstration
from kept import kept
from lab.die import Die
from lab.laboratory import make_case

import memsgyro_jax
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.diagnosis.compare import compare, judged
from memsgyro_jax.measurement.case import load_case


@pytest.fixture(scope="module")
def case():
    return load_case(Path(memsgyro_jax.__file__).parent / "demo")


@pytest.fixture(scope="module")
def base(case):
    return compare(None, case)


@pytest.fixture(scope="module")
def right():
    """The demonstration hides one cubic stiffness."""
    return judged(demonstration())


def test_the_base_model_fails_where_it_should(base):
    assert not base.explained
    worst = base.failures[0]
    assert worst.startswith("sweep_x fails at drive 150 nN, near 3.0")
    assert "channel x" in worst
    assert "not white (p < 1e-12)" in worst
    assert "drive" in worst.split("depends on")[1]
    assert not any(text.startswith("raw") for text in base.failures)


def test_the_right_model_explains_everything(right):
    assert right.explained, right.failures
    assert right.failures == ()
    assert "explains the records" in str(right)


def test_a_better_model_is_better_on_records_that_were_not_fitted(base, right):
    for before, after in zip(base.errors, right.errors, strict=True):
        if before.name == "ringdown_x":
            assert before.role == "validation"
            assert after.rms < 1.1 < before.rms


def test_it_prints_a_table(base):
    text = str(base)
    for word in ("sweep_x", "validation", "rms/noise", "kxx/m", "does not explain", "tests fail"):
        assert word in text


def test_numbers_of_a_model_that_fails_are_told_without_errors(base, right):
    """The base model's were told to 0.1 %, and are off by much more."""
    assert base.fit.optimum.converged
    assert "±" not in str(base).replace("without ±", "")
    assert "  lower undamped frequency about " in str(base)
    assert "(without ±: the model leaves more than the noise" in str(base)
    assert {p["std"] for p in base.to_dict()["parameters"]} == {None}
    assert "±" in str(right)
    assert "without ±" not in str(right)
    assert all(p["std"] > 0 for p in right.to_dict()["parameters"])
    stopped = replace(right, fit=replace(right.fit, optimum=replace(right.fit.optimum, converged=False)))
    assert "not converged after" in str(stopped)
    assert "±" not in str(stopped).replace("without ±", "")


def test_a_held_model_is_not_fitted(case, right):
    held = compare(right.model, case, fitted=False)
    assert held.explained
    assert all(bool((a == b).all()) for a, b in zip(*map(jax.tree.leaves, (held.model, right.model)), strict=True))
    assert "taken as it is" in str(held)
    device = compare(right.model.device.physical(), case, fitted=False)
    assert not device.explained, "without offset and effect"
    kinds = [[leaf.aval for leaf in jax.tree.leaves(c.joint.model.device)] for c in (right.fit, held.fit, device.fit)]
    assert kinds[0] == kinds[1] == kinds[2], "one program for what was fitted and what was given"
    assert device.to_dict()["chi2_per_dof"] is None


def test_json_holds_every_test(base):
    data = json.loads(base.to_json())
    assert data["schema"] == "memsgyro-comparison/1"
    assert [e["name"] for e in data["experiments"]][:2] == ["sweep_x", "sweep_x"]
    assert {e["role"] for e in data["experiments"]} == {"fit", "validation"}
    assert len(data["tests"]) == len(base.checks)
    assert sum(t["failed"] for t in data["tests"]) == sum(c.failed for c in base.checks)
    assert data["failures"] == list(base.failures)


def test_xarray_has_units_and_adds_up(base):
    tree = base.to_xarray()
    node = tree["sweep_x"]
    assert node["measured"].attrs["unit"] == "V"
    assert node["frequency"].attrs["unit"] == "rad/s"
    error = (node["measured"] - node["predicted"]) / node.attrs["noise_std"]
    np.testing.assert_allclose(error.values.real, node["whitened"].values[..., 0], rtol=1e-6, atol=1e-9)
    fitted = node["whitened"].values[node["fitted"].values]
    assert np.sqrt(np.mean(fitted**2)) == pytest.approx(base.errors[0].rms)


def test_a_fit_is_a_table_of_all_readings(base, tmp_path):
    data = kept(base.fit, tmp_path)
    assert set(data["record"].values) == {record.name for record in base.case.records}
    left = ((data["measured"] - data["predicted"]) / data["noise"] - data["whitened"])[data["whitened"].notnull()]
    assert np.max(np.abs(left)) < 1e-6
    table = base.fit.to_pandas()
    fitted = table[table["fitted"] & (table["record"] == "sweep_x")]["whitened"].dropna()
    assert np.sqrt(np.mean(fitted**2)) == pytest.approx(base.errors[0].rms)
    assert list(data["parameter"].values) == [p.name for p in base.fit.estimates]


def test_plot_shows_every_record(base):
    from matplotlib.figure import Figure

    ax = base.plot(Figure().subplots())
    assert [t.get_text() for t in ax.get_yticklabels()] == [r.name for r in base.case.records]


def test_bad_arguments(case):
    with pytest.raises(InputError, match="as many axes"):
        compare(Resonator(1e4, 100.0, 1.0), case)
    with pytest.raises(InputError, match="`level` must lie between"):
        compare(None, case, level=0.0)
    with pytest.raises(InputError, match="`model` must be given"):
        compare(None, case, fitted=False)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_device_without_hidden_effects_is_explained(tmp_path, seed):
    """Measured by the independent laboratory."""
    made = make_case(tmp_path / "case", Die.drawn(np.random.default_rng(seed)), seed=seed)
    result = compare(None, load_case(made.folder), level=0.001)
    assert result.explained, result.failures
