"""Numbers as people read them."""

import math

import pytest

from memsgyro_jax.base.text import beside, said_in, suggestion


@pytest.mark.parametrize(
    ("value", "std", "told"),
    [
        (1.498234e9, 1.2e6, "1.4982e+09"),
        (1041200.00061, 0.0019, "1041200.0006"),
        (-9.987654, 0.1, "-9.9877"),
        (2.0 / 3.0, math.inf, "0.66667"),
        (0.0, 1.0, "0"),
        (math.pi, 0.0, "3.1416"),
    ],
)
def test_a_value_has_the_digits_that_its_uncertainty_leaves_it(value, std, told):
    assert beside(value, std) == told


@pytest.mark.parametrize(("unit", "told"), [("Hz", "3 ± 1 Hz"), ("1", "3 ± 1"), ("", "3 ± 1"), ("1/s", "3 ± 1 1/s")])
def test_a_pure_number_has_no_unit(unit, told):
    assert said_in("3 ± 1", unit) == told


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("controller.gians", "known are controller.drive.haste, observer.length"),
        ("controller.drive.hate", "did you mean `controller.drive.haste`?"),
        ("controller.haste", "did you mean `controller.drive.haste`?"),
        ("obsrver.length", "did you mean `observer.length`?"),
    ],
)
def test_a_suggestion_is_like_what_is_behind_the_parts_that_agree(name, told):
    assert suggestion(name, ["controller.drive.haste", "observer.length"]) == told


@pytest.mark.parametrize("std", [0.0, 1e-320, 0.3, math.inf, math.nan])
@pytest.mark.parametrize(("value", "said"), [(math.inf, "inf"), (-math.inf, "-inf"), (math.nan, "nan"), (0.0, "0")])
def test_what_is_no_number_is_said_beside_any_uncertainty(value, std, said):
    """An infinite quality factor beside its ± ended a diagnosis."""
    assert beside(value, std) == said
    assert float(beside(2.5, std)) == 2.5
