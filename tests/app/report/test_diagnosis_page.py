"""The page of a diagnosis: everything a colleague looks for, and nothing that a hostile case could smuggle in."""

from dataclasses import replace
from html.parser import HTMLParser

import browser
import numpy as np
import pytest
from bench_case import demonstration

from memsgyro_jax.app.report import diagnosis_page as page_of_diagnosis
from memsgyro_jax.app.report.diagnosis_figures import steps_figure
from memsgyro_jax.app.report.diagnosis_page import diagnosis_page
from memsgyro_jax.app.report.record_settings import settings_in_words
from memsgyro_jax.base.text import beside, spoken
from memsgyro_jax.diagnosis.compare import judged
from memsgyro_jax.diagnosis.findings import Accepted, Candidate, Stage
from memsgyro_jax.diagnosis.fit import beside_case
from memsgyro_jax.diagnosis.instrument_told import of_instrument
from memsgyro_jax.diagnosis.optimum import optimise
from memsgyro_jax.diagnosis.result import ONLY_IF, Diagnosis, validation_error
from memsgyro_jax.measurement.experiments import FrequencySweepRecord


HOSTILE = '<script>alert("$x_1$")</script> & "quoted" 漢字 $\\frac$'


@pytest.fixture(scope="module")
def diagnosis():
    """Of the demonstration, put together by hand from two fits with one program."""
    final = demonstration()
    case = final.case
    fitted = final.joint.fitted
    vector = np.where([p.effect is None for p in final.joint.parameters], final.optimum.vector, 0.0)
    base = beside_case(case, final.joint, optimise(final.joint, vector, final.joint.base(), fitted))
    strength = final.estimates[-1]
    errors = [validation_error(fit) for fit in (base, final)]
    twin = Candidate("cross_stiffness", "N/m³", 1.3e6, 1e-300, 0.91, 0.22, 1.1e9, True)
    unseen = Candidate("thermal_drift damping", "1/K", 0.0, 1.0, 0.0, 0.0, np.inf, False)
    return Diagnosis(
        case=case,
        base=base,
        final=final,
        verdict="found",
        sentence="Missing was cubic_stiffness x.",
        accepted=(
            Accepted("cubic_stiffness", "x", (strength.value,), (strength.std,), "N/m³", 0.0, *errors, ("twin_of_it",)),
        ),
        first=(twin, unseen),
        candidates=(replace(twin, p_value=0.4), unseen),
        groups=(("cubic_stiffness x", "twin_of_it"),),
        next_experiment="repeat the sweep at 3 times the drive",
        steps=(Stage("", base.chi2_per_dof, errors[0]), Stage("cubic_stiffness x", final.chi2_per_dof, errors[1])),
        level=0.05,
    )


class Outline(HTMLParser):
    """Tags and text of a page."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes, self.words = [], [], []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def found(diagnosis):
    return diagnosis_page(diagnosis).html()


def test_it_says_what_a_colleague_looks_for(found, diagnosis):
    words = " ".join(Outline(found).words)
    for text in (
        "the missing effect was found",
        diagnosis.sentence,
        "What to measure next: repeat the sweep at 3 times the drive",
        "twin_of_it",
        "Cannot be told apart: cubic_stiffness x, twin_of_it",
        "Cannot be seen at all, because nothing that was varied excites them: thermal_drift damping",
        "Of the linear device: ",
        "1.1e+09",
        "< 1e-12",
        "The model explains the records",
        "Each would have been found with a probability of 90 % if it were this strong.",
    ):
        assert text in words
    estimate, half = diagnosis.accepted[0].estimate[0], 1.96 * diagnosis.accepted[0].std[0]
    assert f"{beside(estimate - half, half, 4)} to {beside(estimate + half, half, 4)}" in words
    assert "The force that is missing" not in words


def test_every_experiment_has_its_error_and_its_picture(found, diagnosis):
    words = Outline(found).words
    for before, after in zip(diagnosis.base.errors, diagnosis.final.errors, strict=True):
        place = words.index(before.name)
        assert place
        assert f"{before.rms:#.3g}" in words
        assert f"{after.rms:#.3g}" in words
    assert found.count("<svg") == len(diagnosis.case.records) + 3  # the law, all drives of each axis
    parts = (diagnosis.sentence, "the law that was found, 95 % band", "What to measure next")
    places = [found.index(part) for part in parts]
    assert places == sorted(places)
    assert len(found) < 2_000_000


def test_finer_tests_do_not_contradict_the_verdict(diagnosis, monkeypatch):
    """A final model whose errors have the size of the noise is not said to fail, nor what is left to be noise alone: on
    the page and in the terminal.
    """
    right = judged(diagnosis.final)
    wrong = replace(right, checks=tuple(replace(c, p_value=0.0, threshold=0.1) for c in right.checks[:2]))
    assert right.beside_size == replace(wrong, fit=diagnosis.base).beside_size == ""
    said = wrong.beside_size
    assert said.startswith("What is left has the size of the noise")
    assert "2 of 2 finer tests fail" in said
    assert said not in str(diagnosis)
    monkeypatch.setattr("memsgyro_jax.diagnosis.result.judged", lambda fit: wrong)
    assert said in str(diagnosis)
    slow = dict.fromkeys((check.record for check in wrong.checks), "its noise is slow")
    assert "finer tests" not in str(replace(diagnosis, noise=slow))  # these tests fail as the noise is not white


def test_a_fall_to_half_is_labelled():
    """On a logarithmic axis from 1.8 to 1 one decade alone would be a label."""
    figure = steps_figure([Stage("", 1.77**2, 1.16), Stage("a", 0.98**2, 0.99)])
    figure.draw_without_rendering()
    (ax,) = figure.axes
    low, high = ax.get_ylim()
    assert [f"{y:g}" for y in ax.get_yticks() if low <= y <= high] == ["1", "1.2", "1.5"]


@pytest.mark.usefixtures("no_pictures")
def test_what_is_unknown_is_shown_as_a_force(diagnosis):
    first, then = diagnosis.steps[:1], diagnosis.steps[1:]
    unknown = replace(diagnosis, verdict="unknown_effect", final=diagnosis.base, accepted=(), steps=first, tried=then)
    html = diagnosis_page(unknown).html()
    words = " ".join(Outline(html).words)
    assert "an unknown law is missing" in words
    places = [words.index(text) for text in ("The force that is missing", "What was tried", "with cubic_stiffness x")]
    assert places == sorted(places)
    assert "sweep_x: force on x as stiffness and damping" in words
    assert "ringdown_x: force on x near the resonances" in words
    assert "rate: what is left" in words
    assert "sweep_x fails at drive 150 nN" in words
    assert "must be to be found is not told" in words
    assert "with a probability of 90 %" not in words


@pytest.mark.usefixtures("no_pictures")
def test_a_strength_beside_something_unknown_is_told_without_its_error(diagnosis):
    """On the page, in the terminal and in the files: it would hold only if the model did."""
    (found,) = diagnosis.accepted
    assert ONLY_IF not in str(diagnosis)
    term = Accepted("drive_level", "", (0.0624, -0.0637), (0.001, 0.002), "1", 0.0, 9.0, 1.0)
    held, shown = found.scaled(np.nan), term.scaled(np.nan)
    partly = replace(diagnosis, verdict="partly_explained", accepted=(held,), instrument=(shown,), scale=2.45)
    words = " ".join(Outline(diagnosis_page(partly).html()).words)
    for text in (words, str(partly)):
        assert ONLY_IF in text
        assert " nan" not in text
        assert " times, as" not in text
    assert f"{found.label}: {found.estimate[0]:.3g} N/m³" in str(partly)
    assert "standard deviations times" not in str(partly)
    assert of_instrument((shown,), "", 1) == " Beside it stands what an instrument may do, without proof: drive_level."
    assert "drive_level: 0.0624, -0.0637" in str(partly)
    assert "± 0.001, -0.0637 ± 0.002" in of_instrument((term,), "", 1)
    answer = partly.to_dict()
    assert {p["std"] for p in answer["final"]["parameters"]} == {None}
    assert [a["std"] for a in answer["effects"]] == [None]
    assert np.isnan(partly.to_xarray()["estimate_std"]).all()
    assert np.isnan(partly.to_xarray()["parameter_std"]).all()
    scaled = replace(diagnosis, scale=2.0).to_xarray()["estimate_std"].values
    assert scaled == pytest.approx([found.std[0]]), "they are scaled already"


@pytest.mark.slow
@pytest.mark.usefixtures("quick_pictures")
def test_a_hostile_case_is_harmless(diagnosis):
    records = tuple(replace(r, name=f"{HOSTILE}{k}", note=HOSTILE) for k, r in enumerate(diagnosis.case.records))
    case = replace(diagnosis.case, name=HOSTILE, description=HOSTILE, records=records)
    base, final = (replace(fit, case=case) for fit in (diagnosis.base, diagnosis.final))
    bad = replace(diagnosis.accepted[0], name=HOSTILE, unit=HOSTILE, confused_with=(HOSTILE,))
    hostile = replace(
        diagnosis, case=case, base=base, final=final, sentence=HOSTILE, accepted=(bad,), next_experiment=HOSTILE,
        first=tuple(replace(c, label=HOSTILE) for c in diagnosis.first), groups=((HOSTILE,),),
        candidates=tuple(replace(c, label=HOSTILE) for c in diagnosis.candidates), verdict="partly_explained",
        steps=(diagnosis.steps[0], replace(diagnosis.steps[1], added=HOSTILE)),
    )  # fmt: skip
    outline = Outline(diagnosis_page(hostile).html())
    plain = Outline(diagnosis_page(replace(diagnosis, verdict="partly_explained")).html())
    assert set(outline.tags) == set(plain.tags), "no element that the plain page has not"
    assert "script" not in outline.tags
    assert HOSTILE in "".join(outline.words)
    assert not [value for name, value in outline.attributes if name.startswith("on")]


def test_a_browser_finds_nothing_wrong(found, tmp_path):
    assert browser.check(tmp_path, {"found": found})


def test_nothing_is_loaded_from_anywhere(found):
    outline = Outline(found)
    links = [v for n, v in outline.attributes if n in ("src", "href", "xlink:href")]
    assert all(link.startswith("#") for link in links)
    assert not {"img", "link", "iframe", "script", "object"} & set(outline.tags)


@pytest.mark.usefixtures("no_pictures")
def test_pictures_of_records_say_at_what_settings_they_were_taken(diagnosis, monkeypatch):
    first, second, *_ = (one for one in diagnosis.case.records if isinstance(one, FrequencySweepRecord))
    assert settings_in_words([first, first], diagnosis.case) == ("", "")  # all agree
    warm = replace(first, temperature=first.temperature + 40.0)
    second_half = np.arange(second.rows) >= second.rows // 2
    stepped = replace(second, bias_voltage=np.where(second_half, 12.0, 0.0), drive=0.5 * second.drive)
    told = settings_in_words([warm, stepped], diagnosis.case)
    for one, words in zip((warm, stepped), told, strict=True):
        assert f"temperature {float(one.temperature[0]) - 273.15:.4g} °C" in words
        assert words.startswith(f"drive {spoken(float(one.setting[0]), diagnosis.case.words.force)}")
    assert "bias voltage 0 V to 12 V" in told[1]
    monkeypatch.setattr(page_of_diagnosis, "settings_in_words", lambda records, _: ("bias voltage 7 V",) * len(records))
    shown = diagnosis_page(diagnosis).html()
    assert shown.count("; bias voltage 7 V.") + shown.count(": bias voltage 7 V.") == 2 * len(diagnosis.case.records)
