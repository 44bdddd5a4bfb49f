"""Recorded rates: what is read, and that nothing doubtful is read silently."""

import numpy as np
import pytest

from memsgyro_jax import InputError, read_rate_record


GOOD = "t [s],rate [deg/s]\n0,0\n0.1,10\n0.25,-5\n"


@pytest.fixture
def record(tmp_path):
    def record(content):
        path = tmp_path / "turn.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return record


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        GOOD.replace("\n", "\r\n"),
        "\ufeff" + GOOD,
        "# from the rate table\n\n" + GOOD + "\n",
        "rate [rpm], t [ms]\n0,1000\n1.6666666666666667,1100\n-0.83333333333333337,1250\n",
        '"t [s]","rate [deg/s]"\n0,0\n"0.1",10\n+.25,-5.0e0\n',
        GOOD.rstrip("\n") + ".00000",
    ],
)
def test_forms_that_mean_the_same(record, text):
    profile = read_rate_record(record(text))
    np.testing.assert_allclose(profile.times, [0.0, 0.1, 0.25], rtol=1e-12)
    np.testing.assert_allclose(profile.values, np.radians([0.0, 10.0, -5.0]), rtol=1e-12)
    np.testing.assert_allclose(profile.value(0.05), np.radians(5.0), rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD.replace("rate [deg/s]", "rate"), ["line 1, column 2", '"name [unit]"']),
        (GOOD.replace("deg/s", "deg"), ["column `rate`", '"rad/s"', '"deg"']),
        (GOOD.replace("deg/s", "1/s"), ["column `rate`", '"rad/s"']),
        (GOOD.replace("t [s]", "t [m]"), ["column `t`", '"s"']),
        (GOOD.replace("deg/s", "degz/s"), ["column `rate`", "degz/s"]),
        (GOOD.replace("rate", "omega"), ['"t [s],rate [deg/s]"', "`omega`"]),
        (GOOD.replace("t [s]", "rate [deg/s]"), ["line 1, column 2", "`rate` stands twice"]),
        (GOOD.replace("0.1,10", "0.1,NaN"), ["line 3, column `rate`", "finite number", "`NaN`"]),
        (GOOD.replace("0.1,10", "0.1,inf"), ["line 3, column `rate`", "`inf`"]),
        (GOOD.replace("0.1,10", "0.1,"), ["line 3, column `rate`", "is missing"]),
        (GOOD.replace("0.1,10", "0.1,1_0"), ["line 3, column `rate`", "`1_0`"]),
        (GOOD.replace("0.1,10", "0.1,1e999"), ["line 3, column `rate`"]),
        (GOOD.replace("0.1,10", "0.1"), ["line 3", "2 fields", "has 1", "cut short"]),
        (GOOD.replace("0.1,10", "0,1,10"), ["line 3", "2 fields", "has 3", "comma"]),
        (GOOD.replace("0.1,10", '"0,1",10'), ["line 3, column `t`", "decimal", "`0,1`"]),
        (GOOD.replace(",", ";"), ["line 1", "semicolons"]),
        (GOOD.replace("0.1,10", "0.3,10"), ["line 4, column `t`", "later", "0.25"]),
        (GOOD.replace("0.1,10", "0,10"), ["line 3, column `t`", "later"]),
        (GOOD.replace("0.1,10", '"0.1,10'), ["line 3", "comma-separated"]),
        ("t [s],rate [deg/s]\n0,0.000\n0.1,10.00\n0.2,1", ["line 4", "breaks off"]),
        ("t [s],rate [deg/s]\n0,0\n", ["at least two rows"]),
        ("", ["at least two rows"]),
        (b"t [s],rate [\xb0/s]\n0,0\n1,1\n", ["UTF-8"]),
    ],
)
def test_what_is_refused_names_its_place(record, text, words):
    path = record(text)
    with pytest.raises(InputError) as error:
        read_rate_record(path)
    said = str(error.value)
    assert said.startswith(str(path))
    assert "\n" not in said
    for word in words:
        assert word in said, said


def test_a_missing_record(tmp_path):
    with pytest.raises(InputError, match=r"turn.csv: no such file"):
        read_rate_record(tmp_path / "turn.csv")
