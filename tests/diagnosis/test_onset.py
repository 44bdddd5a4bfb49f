"""From which drive on something unknown shows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden, Outside
from lab.faults import Faults

from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.onset import onset_of
from memsgyro_jax.diagnosis.sentence import sentence


LOSS = RESONATOR.damping[0] * np.sqrt(RESONATOR.kxx / RESONATOR.mass)  # N/m
STOP = Hidden(outside=Outside(stop_x=2.0 * LOSS, stop_gap=0.8 * 0.012 / LOSS))


def case_of(hidden=Hidden(), **faults):  # noqa: B008
    return bench(hidden, protocol=replace(ONE_AXIS, faults=Faults(**faults)), die=RESONATOR).case


def test_a_stop_shows_from_the_drive_on_that_reaches_it():
    """A fit to all drives misses those that do not reach it, too."""
    everywhere = fit_case(case_of(STOP))
    assert not everywhere.leaves_noise
    onset = onset_of(everywhere)
    assert (onset.upto, onset.since) == ("6 mV", "12 mV")
    case = onset.fit.case
    (sweep,) = [k for k, record in enumerate(case.records) if record.name == "sweep"]
    below = case.records[sweep].setting < 0.007
    rms = [np.sqrt(np.nanmean(fit.whitened[sweep][below] ** 2)) for fit in (everywhere, onset.fit)]
    assert rms[0] > 2.0
    assert rms[1] < 1.3


def test_what_the_lowest_drive_shows_has_no_onset():
    assert onset_of(fit_case(case_of(feedthrough=0.2j))) is None


@pytest.mark.parametrize(("verdict", "words"), [("unknown_effect", "alone: what is"), ("partly_explained", "left in")])
def test_the_sentence_says_from_which_drive_on(verdict, words):
    final = SimpleNamespace(errors=[SimpleNamespace(role="fit", count=100, name="loud", rms=900.0)])
    said = sentence(verdict, (), final, [False], SimpleNamespace(upto="500 mV", since="1 V"))
    assert "drives up to 500 mV are explained" in said
    assert "shows from 1 V on" in said
    assert "loud (fit, 900 × noise)" in said
    assert words in said


@pytest.mark.slow
def test_a_diagnosis_tells_a_stop_against_the_drives_below_it():
    found = diagnose(None, case_of(STOP))
    assert found.verdict in ("unknown_effect", "partly_explained")
    assert "what is unknown shows from 12 mV on" in found.sentence
    assert "explained to their noise" in str(found)
