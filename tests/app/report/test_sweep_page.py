"""The pages of a sweep and of a run: complete, self-contained, and safe with hostile names."""

import re
from dataclasses import replace

import browser
import equinox as eqx
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app.report import figures, moving
from memsgyro_jax.app.report.diff_page import diff_page
from memsgyro_jax.app.report.loop_pages import loop_page, tornado_page
from memsgyro_jax.app.report.moving import mode_shapes
from memsgyro_jax.app.report.run_summary import run_figures
from memsgyro_jax.app.report.sweep_page import settings, sweep_page
from memsgyro_jax.app.report.trace_page import trace_page
from memsgyro_jax.device.gyro import Inertial
from memsgyro_jax.loop.frequency_response import FrequencyResponse
from memsgyro_jax.loop.stability import LoopMargins


HOSTILE = "<script>alert(1)</script>.toml"


@pytest.fixture(scope="module")
def study():
    # As many places as the sweeps of app/test_commands.py, and so their program.
    changes = {"sweep.dies": 12, "sweep.chunk": 4, "sweep.sample_rate": "20 kHz", "sweep.duration": "10 ms"}
    made = mg.default_study().changed(changes)
    return replace(made, source=replace(made.source, name=HOSTILE))


@pytest.fixture(scope="module")
def lot(study):
    return mg.sweep(**study.sweep_arguments)


@pytest.fixture(scope="module")
def page(lot, study):
    return sweep_page(lot, study).html()


@pytest.fixture(scope="module")
def run(study):
    return mg.simulate(study.loop, study.scenario, sample_rate=50e3, duration=0.01)


@pytest.fixture(scope="module")
def run_page(run, study):
    return trace_page(run, study, [("rate error", "1 deg/s")]).html()


def test_the_page_says_what_the_summary_says(page, lot):
    for name, value in lot.summary.rows():
        shown = re.sub("</?code>", "`", page).replace(' class="number"', "")
        assert f"<td>{name}</td>" in shown
        assert value in shown
    assert f"{100 * lot.summary.good.value:.1f} %" in page
    assert lot.settings.fingerprint in page
    assert page.count("<svg") == 4


def test_the_page_names_every_setting_that_counts(page, run_page, study):
    entries = dict(settings(study.file.model_dump(by_alias=True, exclude_none=True)))
    assert entries["device.mass"] == "1.8e-07 kg"
    assert entries["controller.tones.amplitude"] == "53.95 m/s^2"
    assert entries["readout.mismatch"] == "1e-07 m, 8.5e-08 m"
    assert entries["sweep.tolerance"] == "0.349066 rad/s"
    for name, value in entries.items():
        assert (name in page) == (not name.startswith("tune."))
        assert value in page or name.startswith("tune.")
    assert "sweep.sample_rate" in run_page
    assert "sweep.tolerance" not in run_page, "one run has no yield"


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


def test_a_browser_has_nothing_to_complain_about(page, run_page, lot, study, tmp_path):
    for name, errors in (("a", 1.0), ("b", 2.0)):
        (tmp_path / name).mkdir()
        moved = {**lot._rows, "rate_error_end": errors * lot._rows["rate_error_end"]}
        replace(lot, _rows=moved).save(tmp_path / name / "dies.zarr")
    tables = {"figure": [("figure", "A", "B", ""), ("bias", "1", "2", "intervals apart")]}
    compared = diff_page((tmp_path / "a", tmp_path / "b"), ("a", "b"), tables).html()
    assert compared.count("<svg") == 1
    assert "intervals apart" in compared
    browser.check(tmp_path, {"page": page, "run": run_page, "diff": compared, **of_a_loop(study, lot.settings)})


def of_a_loop(study, made):
    """The pages of a loop over frequency and of a tornado, of figures that nothing computed."""
    at, two, none = np.array([1.0, 10.0]), np.array([[1.0, -0.2], [0.0, 0.0]]), np.zeros((2, 2))
    answer = FrequencyResponse("force y", at, np.array([1.0, 0.5j]), 0.01 * at, 0.0, 1.0, 3e3)
    margins = mg.GainPhaseMargins(
        LoopMargins(*(0.5 * np.ones(4))), *(np.full(5, value) for value in (9.0, 60.0, 12.0, -9.0, 25.0))
    )
    bars = mg.Tornado(
        ("rate error", "lost"), ("deg/s", "share"), ("device.kxx", "device.dxy"), made, np.zeros(2), -two, two,
        0.1 * abs(two), two * [1.0, 9.0], none, 1.0, 8, notes=("The loops come to rest later.",),
    )  # fmt: skip
    assert repr(bars).endswith("note: The loops come to rest later.")
    assert bars.as_dict()["notes"] == ["The loops come to rest later."]
    assert bars.to_xarray().attrs["notes"] == "The loops come to rest later."
    pages = {
        "loop": loop_page(study, [answer], margins, mg.noise_budget(study.loop)).html(),
        "tornado": tornado_page(bars, study).html(),
    }
    assert (pages["loop"].count("<svg"), pages["tornado"].count("<svg")) == (2, 1)
    assert "force y at 3000 Hz, by its amplitude" in pages["loop"]
    assert "0 share, whatever parameter moves" in pages["tornado"]
    assert "device.dxy *" in pages["tornado"]
    assert "The loops come to rest later." in pages["tornado"]
    assert "the step does not follow the gradient" in pages["tornado"]
    return pages


def test_a_run_that_estimates_no_coefficient_has_no_picture_of_them(run, run_page, study):
    assert "<h2>Coefficients</h2>" in run_page
    idle = mg.NoObserver.for_device(study.loop.device, study.loop.readout)
    held = eqx.tree_at(lambda made: made.loop.observer, run, idle, is_leaf=lambda part: part is run.loop.observer)
    text = trace_page(held, study, []).html()
    assert "Coefficients" not in text
    assert "<h2>Rate</h2>" in text
    assert run_figures(held, None)["coefficient_error"] == {}
    assert run_figures(run, None)["coefficient_error"] != {}


def test_the_mass_and_its_modes_move(run, run_page):
    assert run_page.count("<animateMotion") == 3
    path = run.last_vibrations()[:, :2]
    first = re.search(r'<path d="(M[^"]+)" fill="none"', run_page)[1]
    drawn = np.array([list(map(float, point.split(","))) for point in first[1:].split("L")])
    across = np.ptp(drawn, axis=0) / np.ptp(path, axis=0)
    np.testing.assert_allclose(across, across[0], rtol=0.02)  # both axes to one scale, rounded to a tenth of a unit
    stiffness = [[float(k) for k in row] for row in run.loop.device.dynamics(Inertial()).stiffness]
    for shape, frequency in zip(mode_shapes(run), mg.mode_frequencies(run.loop.device), strict=True):
        np.testing.assert_allclose(stiffness @ shape, (2.0 * np.pi * frequency) ** 2 * shape, rtol=1e-6, atol=1.0)
    assert "going on" not in run_page
    assert "the die was lost" in moving.orbit_of(replace(run, intact_until=np.array(0.001)))


def test_a_run_of_which_few_rows_were_kept_swings_on_from_the_last(run):
    few, dynamics = replace(run, time=10.0 * run.time), run.loop.device.dynamics(Inertial())
    assert "orbit, going on from the last row" in moving.orbit_of(few)
    path = moving._going_on(few, 1e-5, 40)
    np.testing.assert_array_equal(path[0], run.motion[-1, :2])
    at = mg.Exact().advance(tuple(run.motion[-1]), (0.0, 0.0), dynamics.stiffness, dynamics.velocity, 1e-5)
    np.testing.assert_allclose(path[1], at[:2], rtol=1e-9)


def test_a_line_for_every_die_whose_worst_tenth_is_told_apart(lot):
    ax = figures.parallel_figure(lot).axes[0]
    lines = [line.get_ydata() for line in ax.lines if len(line.get_ydata())]
    assert len(lines) == lot.summary.dies
    error = np.abs(lot.data["rate_error_end"].values)
    ends = sorted(line[-1] for line in lines)
    np.testing.assert_allclose(ends, np.sort(error / np.percentile(error, 99.0)).clip(max=1.0), rtol=1e-12)
    assert len({*np.round([line[0] for line in lines], 9)}) == len(lines), "ranks, each once"
