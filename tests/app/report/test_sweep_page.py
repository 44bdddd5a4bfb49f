"""The pages of a sweep and of a run: complete, self-contained, and safe with hostile names."""

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app.report import figures
from memsgyro_jax.app.report.sweep_page import settings, sweep_page
from memsgyro_jax.app.report.trace_page import trace_page


HOSTILE = "<script>alert(1)</script>.toml"


@pytest.fixture(scope="module")
def study():
    changes = {"sweep.dies": 12, "sweep.chunk": 2, "sweep.sample_rate": "20 kHz", "sweep.duration": "10 ms"}
    made = mg.default_study().changed(changes)
    return replace(made, source=replace(made.source, name=HOSTILE))


@pytest.fixture(scope="module")
def lot(study):
    return mg.sweep(**study.sweep_arguments)


@pytest.fixture(scope="module")
def page(lot, study):
    return sweep_page(lot, study).html()


@pytest.fixture(scope="module")
def run_page(study):
    trace = mg.simulate(study.loop, study.scenario, sample_rate=50e3, duration=0.01)
    return trace_page(trace, study, [("rate error", "1 deg/s")]).html()


def test_the_page_says_what_the_summary_says(page, lot):
    for name, value in lot.summary.rows():
        assert f"<td>{name}</td>" in page.replace(' class="number"', "")
        assert value in page
    assert f"{100 * lot.summary.good.value:.1f} %" in page
    assert lot.settings.fingerprint in page
    assert page.count("<svg") == 3


def test_the_page_names_every_setting(page, study):
    entries = dict(settings(study.file.model_dump(by_alias=True, exclude_none=True)))
    assert entries["device.mass"] == "1.8e-07 kg"
    assert entries["controller.tones.amplitude"] == "53.95 m/s^2"
    assert entries["readout.mismatch"] == "1e-07 m, 8.5e-08 m"
    for name, value in entries.items():
        assert name in page
        assert value in page


def test_the_worst_dies_come_first(page, lot):
    error = np.degrees(lot.data["rate_error_end"].values)
    shown = re.findall(r'<td class="number">(\d+)</td><td class="number">([+-][\d.e+-]+)</td>', page)
    worst = np.argsort(-np.abs(error))[:10]
    assert [int(die) for die, _ in shown] == list(worst)
    assert [value for _, value in shown] == [f"{error[die]:+.3g}" for die in worst]


@pytest.mark.parametrize("which", ["page", "run_page"])
def test_the_page_loads_and_runs_nothing(which, request):
    text = request.getfixturevalue(which)
    assert "default-src 'none'" in text
    assert "<script" not in text
    assert not re.search(r"\b(?:src|href)\s*=\s*[\"'](?!#)", text)
    assert not re.search(r"url\((?!#)", text)
    assert HOSTILE.replace("<", "&lt;").replace(">", "&gt;") in text


def test_correlations_are_those_of_the_dies(lot):
    names, values, error = figures.drawn(lot)
    assert len(names) == values.shape[1] == 7
    order = np.argsort(np.argsort(error))
    by_hand = [np.corrcoef(np.argsort(np.argsort(column)), order)[0, 1] for column in values.T]
    np.testing.assert_allclose(figures.ranks(values, error), by_hand, rtol=1e-12)


def test_one_die_far_off_does_not_flatten_the_picture(lot):
    errors = lot._rows["rate_error_end"].copy()
    errors[0] = 1e3
    ax = replace(lot, _rows={**lot._rows, "rate_error_end": errors}).plot()
    assert ax.get_xlim()[1] < np.degrees(10.0 * np.nanmax(np.abs(lot._rows["rate_error_end"])))
    assert f"{len(errors)} dies, 1 of them further off" in [text.get_text() for text in ax.get_legend().get_texts()]


@pytest.mark.slow
def test_a_sweep_without_spread_and_one_without_survivors(study):
    known = ["kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma"]  # a smaller filter compiles faster
    alike = study.changed({"spread.relative": 0.0, "sweep.dies": 4, "observer.known": known})
    assert "No parameter was varied." in sweep_page(mg.sweep(**alike.sweep_arguments), alike).html()
    tight = study.changed({"loop.travel": "1.001 um", "loop.displacement": ["1.1 um", "0 m"]})
    text = sweep_page(mg.sweep(**tight.sweep_arguments), tight).html()
    assert "12 were lost" in text
    assert "no die survived" in text
    assert "lost at" in text


@pytest.mark.parametrize("which", ["page", "run_page"])
def test_a_browser_has_nothing_to_complain_about(which, request, tmp_path):
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("no Chromium on this machine")
    (tmp_path / "page.html").write_text(request.getfixturevalue(which))
    flags = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        "--enable-logging=stderr",
    ]
    command = [browser, *flags, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", f"{tmp_path / 'page.html'}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert "<svg" in done.stdout
    assert "CONSOLE" not in done.stderr, done.stderr
