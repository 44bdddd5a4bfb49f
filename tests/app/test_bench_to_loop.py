"""The user's story, by the command line alone: record a loop, name what is missing, fit it, run it, cope with it."""

import importlib.util

import numpy as np
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


def assert_story(story, retuned):
    found = story.diagnosed()
    assert found["verdict"] == "found"
    assert [(effect["name"], effect["axis"]) for effect in found["effects"]] == [(story.name, "x")]
    fit = story.fitted()
    assert fit["explained"]
    linear, true, fitted = (story.swept(study) for study in ("linear", "true", "fitted"))
    for name in ("bias_dps", "scale_factor_error"):
        assert_same(fitted, true, name, story.name)
    assert fitted["nis"] == pytest.approx(true["nis"], rel=0.05)
    assert linear["nis"] == pytest.approx(2.0, rel=0.05)
    errors = [figures["rate_error_dps"]["end"]["rms"] for figures in (linear, fitted, retuned(story))]
    return errors, fitted


def test_quadratic_damping(bench_to_loop, tmp_path):
    story = bench_to_loop.Story("quadratic_damping", tmp_path, duration=10, dies=16, run=50)
    (linear, fitted, wary), figures = assert_story(story, lambda story: story.swept("wary"))
    assert figures["bias_dps"]["value"] < -10.0
    assert fitted > 2.0 * linear
    assert wary < 0.5 * fitted


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cubic_stiffness", "pickoff_nonlinearity", "parasitic_mode"])
def test_every_other_effect(bench_to_loop, tmp_path, name):
    (linear, fitted, tuned), figures = assert_story(bench_to_loop.Story(name, tmp_path), lambda story: story.tuned())
    assert fitted > linear or figures["nis"] > 10.0
    assert tuned < 0.75 * fitted
    assert np.isfinite(tuned)
