"""The user's story, by the command line alone: record a loop, name what is missing, fit it, run it, cope with it."""

import importlib.util

import pytest


@pytest.fixture(scope="module")
def bench_to_loop(root):
    spec = importlib.util.spec_from_file_location("bench_to_loop", root / "studies" / "bench_to_loop.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def assert_same(found, wanted, name, key):
    """Equal within four standard deviations of either."""
    values, stds = ([figures[name][part] for figures in (found, wanted)] for part in ("value", "std"))
    assert abs(values[0] - values[1]) < 4.0 * max(stds), key


def assert_story(story):
    """The effect is named, and the fitted device errs in the loop as the true one does; gives its figures."""
    found = story.diagnosed()
    assert found["verdict"] == "found"
    assert [(effect["name"], effect["axis"]) for effect in found["effects"]] == [(story.name, "x")]
    assert story.fitted()["explained"]
    true, fitted = (story.swept(study) for study in ("true", "fitted"))
    for name in ("bias_dps", "scale_factor_error"):
        assert_same(fitted, true, name, story.name)
    assert fitted["nis"] == pytest.approx(true["nis"], rel=0.05)
    return fitted


def rms(figures):
    return figures["rate_error_dps"]["end"]["rms"]


@pytest.mark.slow
def test_quadratic_damping(bench_to_loop, tmp_path):
    story = bench_to_loop.Story("quadratic_damping", tmp_path, duration=10, dies=16, run=50)
    fitted = assert_story(story)
    assert fitted["bias_dps"]["value"] < -10.0
    assert rms(story.swept("wary")) < 0.5 * rms(fitted)


@pytest.mark.slow
def test_cubic_stiffness(bench_to_loop, tmp_path):
    story = bench_to_loop.Story("cubic_stiffness", tmp_path)
    fitted, linear = assert_story(story), story.swept("linear")
    assert linear["nis"] == pytest.approx(2.0, rel=0.05)
    assert fitted["nis"] > 2.5
    assert rms(story.tuned()) < 0.8 * rms(fitted)


@pytest.mark.slow
def test_pickoff_nonlinearity(bench_to_loop, tmp_path):
    story = bench_to_loop.Story("pickoff_nonlinearity", tmp_path, duration=10, dies=16, run=50)
    fitted, aware = assert_story(story), story.swept("aware")
    assert fitted["nis"] > 100.0
    assert rms(aware) < 0.5 * rms(fitted)
    assert aware["nis"] == pytest.approx(2.0, rel=0.05)
