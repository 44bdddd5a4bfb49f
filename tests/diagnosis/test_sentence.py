"""What the sentence of a verdict says of effects of unlike weight."""

from types import SimpleNamespace

import pytest

from memsgyro_jax.diagnosis.findings import Accepted
from memsgyro_jax.diagnosis.fitted import ParameterEstimate, RecordError
from memsgyro_jax.diagnosis.sentence import denied, sentence, unseen_by_rest


FINAL = SimpleNamespace(errors=[SimpleNamespace(role="fit", count=100, name="a", rms=1.0)], modes=())


def effect(name, chi2):
    return Accepted(name, "x", (1.0,), (0.1,), "1", 0.0, 9.0, 1.0, chi2=chi2)


@pytest.mark.parametrize(
    ("weights", "names"),
    [
        ((1e6,), "spring x; with it"),
        ((1e6, 4e5), "spring x, damper x; with them"),
        ((1e6, 900.0), "spring x, and far weaker, within 5 times the noise, damper x; with them"),
        ((1e9, 1e5), "spring x, damper x; with them"),  # of a delay, say, that dwarfs a spring of 30 times the noise
    ],
)
def test_effects_of_little_weight_stand_apart(weights, names):
    accepted = tuple(map(effect, ("spring", "damper"), weights))
    assert sentence("found", accepted, FINAL, [True]).startswith(f"Missing was {names} the model")


@pytest.mark.parametrize(
    ("roles", "words"),
    [
        ((("sweep", "fit", True), ("decay", "validation", False)), ' It was judged only: where it has role = "fit" in'),
        ((("sweep", "fit", False), ("decay", "validation", False)), ""),
        ((("sweep", "fit", True), ("sweep", "validation", False)), ""),
    ],
)
def test_a_record_that_was_only_judged_is_said_to_help_where_all_that_is_left_lies_there(roles, words):
    errors = [SimpleNamespace(role=role, count=100, name=name, rms=1.0) for name, role, _ in roles]
    said = sentence("unknown_effect", (), SimpleNamespace(errors=errors), [fine for *_, fine in roles])
    assert words in said
    assert ("judged only" in said) == bool(words)


@pytest.mark.parametrize(
    ("roles", "leaves_noise", "tried", "said"),
    [
        ([("sweep", "fit", 1.0), ("sweep", "validation", 1.0), ("decay", "validation", 246.0)], True, ["s"], True),
        ([("sweep", "fit", 1.0), ("sweep", "validation", 3.0), ("decay", "validation", 246.0)], True, ["s"], False),
        ([("sweep", "fit", 9.0), ("decay", "validation", 246.0)], False, ["s"], False),
        ([("sweep", "fit", 1.0), ("decay", "validation", 246.0)], True, [], False),
        ([("sweep", "fit", 1.0), ("decay", "validation", 1.0)], True, ["s"], False),
    ],
)
def test_what_explains_all_that_was_fitted_is_told_with_what_denies_it(roles, leaves_noise, tried, said):
    """A newcomer read that something unknown shows in sweeps that the spring which was tried explains."""
    errors = [RecordError(name, role, 1000, 1000 * rms**2) for name, role, rms in roles]
    told = denied(SimpleNamespace(errors=errors, leaves_noise=leaves_noise), tried)
    assert ("s explains all records that were fitted; it is denied by decay (246 × noise) alone" in told) == said
    assert bool(told) == said


@pytest.mark.parametrize(("off", "said"), [(8.6, True), (1.6, False)])
@pytest.mark.parametrize("verdict", ["nothing_missing", "unknown_effect"])
def test_what_was_not_fitted_and_lies_far_off_is_told(verdict, off, said):
    """Six rows beside a resonance of six that were fitted: "explains every record to its noise" at 8.6 × noise, as the
    fit held no damping.
    """
    errors = [RecordError("a", "fit", 6, 6.0, 2.25), RecordError("a", "validation", 6, 6 * off**2, 2.25)]
    text = sentence(verdict, (), SimpleNamespace(errors=errors, modes=()), [True, verdict == "nothing_missing"])
    assert ("What was not fitted of a (8.6 × noise) is no part of that" in text) == (
        said and verdict == "nothing_missing"
    )


@pytest.mark.parametrize(("std", "said"), [(93.0, True), (0.1, False), (float("inf"), False)])
def test_that_nothing_is_missing_says_little_where_nothing_is_held(std, said):
    """Of a pendulum's decay of two swings, beside 6.02 ± 93 Hz."""
    mode = ParameterEstimate("resonance frequency", 6.02, std, "Hz")
    text = sentence("nothing_missing", (), SimpleNamespace(errors=FINAL.errors, modes=(mode,)), [True])
    assert ("these records hold no resonance (6.02 ± 93 Hz)" in text) == said


@pytest.mark.parametrize(
    ("verdict", "before", "after", "said"),
    [
        ("found", 1.086, 1.09, True),
        ("found", 3.0, 1.0, False),
        ("nothing_missing", 1.0, 1.1, False),
        ("found", 0, 0, False),
    ],
)
def test_an_effect_that_only_fitted_rows_show_is_said_to_be_one(verdict, before, after, said):
    """The later half of a ring-down, too small for a cubic pick-off of 3 sigma, left it "found" without a word."""
    fits = []
    for rms in (before, after):
        rest = [RecordError("decay", "validation", 400, 400 * rms**2)] if rms else []
        fits.append(SimpleNamespace(errors=[RecordError("decay", "fit", 400, 400.0), *rest]))
    words = unseen_by_rest(*fits, verdict)
    assert bool(words) == said
    assert not said or "at 1.09 and 1.09 times its noise" in words
