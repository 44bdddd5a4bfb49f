"""A search that comes near nothing ends by what it has taken, and says so; one that is near, or told to, goes on."""

from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden, Outside

from memsgyro_jax.diagnosis import diagnose as room
from memsgyro_jax.diagnosis.effort import exhausted, far_from_noise, of_effort
from memsgyro_jax.diagnosis.programs import Effort


K = RESONATOR.kxx
STRANGE = Hidden(outside=Outside(bouc_wen_x=0.3 * K, bouc_wen_yield=0.02))
KNOWN = Hidden(cubic_stiffness_x=0.5 * K)


def _optimum(chi2_per_dof):
    return SimpleNamespace(chi2=1e4 * chi2_per_dof, dof=10_000, leaves_noise=chi2_per_dof < 1.05)


@pytest.mark.parametrize(
    ("left", "before", "far"), [(500.0, 1000.0, True), (90.0, 1000.0, False), (15.0, 30.0, False), (25.0, 30.0, True)]
)
def test_far_from_noise_is_what_leaves_most_of_much(left, before, far):
    assert far_from_noise(_optimum(left), _optimum(before)) == far


@pytest.mark.parametrize(("left", "spent", "most", "ends"), [
    (500.0, 11, 10, True), (500.0, 10, 10, False), (500.0, 11, np.inf, False), (1.0, 99, 10, False),
    (15.0, 16, 10, True), (15.0, 15, 10, False),
])  # fmt: skip
def test_a_search_ends_once_it_has_taken_its_share_and_says_so_once(left, spent, most, ends):
    effort, told = Effort(most=most, spent=spent), []
    search = SimpleNamespace(
        joint=SimpleNamespace(programs=SimpleNamespace(effort=effort)),
        optimum=_optimum(left),
        base=SimpleNamespace(optimum=_optimum(1000.0)),
        tell=told.append,
    )
    assert exhausted(search) == exhausted(search) == effort.ended == ends
    assert len(told) == ends
    assert ("--thorough" in of_effort(effort.ended)) == ends


def _diagnosed(hidden, monkeypatch, **options):
    monkeypatch.setattr(room, "MOST", 1)
    told = []
    found = room.diagnose(None, bench(hidden, protocol=ONE_AXIS, die=RESONATOR).case, tell=told.append, **options)
    return found, told


@pytest.mark.slow  # two whole diagnoses
def test_what_is_unknown_ends_a_search_that_has_had_its_share_unless_it_is_told_to_go_on(monkeypatch):
    (short, said), (whole, more) = (_diagnosed(STRANGE, monkeypatch, thorough=one) for one in (False, True))
    assert short.verdict == whole.verdict == "unknown_effect"
    assert "`--thorough`" in short.sentence
    assert "`--thorough`" not in whole.sentence
    assert any("look no further" in text for text in said)
    assert len(more) > len(said)
    # A whole round came before, with everything that is known: what needs a scan too.
    assert {t.split(",")[0] for t in more if t.startswith("scan")} == {
        t.split(",")[0] for t in said if t.startswith("scan")
    }


def test_what_is_known_is_found_however_little_a_search_may_take(monkeypatch):
    found, said = _diagnosed(KNOWN, monkeypatch)
    assert found.verdict == "found"
    assert found.accepted[0].label == "cubic_stiffness x"
    assert not any("look no further" in text for text in said)
