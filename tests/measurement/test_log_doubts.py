"""What a log of rates shows beside its noises, as loggers of small boards write it: coarse steps, knocks, times and
columns whose unit nobody wrote.
"""

import re

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError


def rates(rows=400, std=0.3, seed=0):
    """[deg/s]"""
    return std * np.random.default_rng(seed).standard_normal(rows)


def notes(degrees):
    return " ".join(mg.allan(np.radians(degrees), sample_rate=100.0).notes)


@pytest.mark.parametrize(("step", "told"), [(0.061, False), (0.25, False), (0.4, True), (0.6, True)])
def test_steps_as_coarse_as_the_noise_are_told(step, told):
    """Of two values 0.57 deg/s apart an angle random walk of 5.5 deg/√h was told without a word."""
    said = notes(step * np.round((rates() + 0.11) / step))
    assert (f"steps of {step:g} deg/s" in said) is told


def test_smooth_rates_have_no_steps():
    assert "steps" not in notes(rates())
    assert "steps" not in notes(np.cumsum(rates(std=1e-3)) + 1e3)


def test_knocks_are_told_and_where_the_first_is():
    quiet = rates()
    assert "jump" not in notes(quiet)
    assert "jump" not in notes(0.6 * np.round(quiet / 0.6))
    knocked = quiet.copy()
    knocked[[120, 250]] += 8.0
    assert re.search(r"4 of 399 steps .*the first at 1\.2 s", notes(knocked))


def written(path, head, rows):
    path.write_text("\n".join([*head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


@pytest.mark.parametrize(
    ("step", "said"),
    [(0.05624, ["`--rate 17.7809` if it is in s"]), (13000, ["`--rate 76.9231` if it is in us"])],
    ids=["seconds", "microseconds"],
)
def test_a_time_without_a_unit_is_no_missing_one(tmp_path, step, said):
    rows = [(788201245 + k * step, f"{one:.3f}") for k, one in enumerate(rates())]
    path = written(tmp_path / "log.csv", ["t,gx"], rows)
    with pytest.raises(InputError) as refused:
        mg.allan(path, column="gx [deg/s]")
    assert all(one in str(refused.value) for one in ["`t` has no unit", *said])
    rate = re.search(r"--rate ([\d.]+)", str(refused.value))[1]
    assert mg.allan(path, column="gx [deg/s]", sample_rate=float(rate)).samples == 400


@pytest.mark.parametrize(
    ("head", "wanted"),
    [(["t,ax,gx"], "gx [deg/s]"), (["Xa,Ya,Xr"], "Xr [deg/s]"), ([], "column 3 [deg/s]"), (["t,w_x,a"], "w_x [deg/s]")],
)
def test_a_column_to_copy_stands_in_the_refusal(tmp_path, head, wanted):
    rows = [(0.1 * k, 0.98, f"{one:.3f}") for k, one in enumerate(rates())]
    path = written(tmp_path / "log.csv", head, rows)
    with pytest.raises(InputError, match=re.escape(f'`--column "{wanted}"`')) as refused:
        mg.allan(path)
    assert "[1]" not in str(refused.value)


@pytest.mark.parametrize("jitter", [2000, 1_500_000])
def test_stamps_that_jitter_are_those_of_an_even_clock(tmp_path, jitter):
    """Of a board that stamps its packets in nanoseconds, and of a host that does so as it can: they were refused."""
    rng = np.random.default_rng(1)
    stamps = 1691674088430198800 + 10_000_000 * np.arange(400) + rng.integers(-jitter, jitter, 400)
    path = written(tmp_path / "log.csv", ["timestamp [ns],w [rad/s]"], zip(stamps, rates(), strict=True))
    found = mg.allan(path)
    assert found.period == pytest.approx(0.01, rel=1e-3)
    (said,) = [note for note in found.notes if "jitter" in note]
    assert float(re.search(r"up to ([\d.e-]+) s", said)[1]) == pytest.approx(1e-9 * jitter, rel=0.2)
    np.testing.assert_allclose(found.deviation, mg.allan(path, sample_rate=1.0 / found.period).deviation)


def test_stamps_off_any_even_clock_come_with_the_rate_to_say(tmp_path):
    stamps = 10_000_000 * np.arange(400) + 4_000_000 * (np.arange(400) % 3 == 0)
    path = written(tmp_path / "log.csv", ["timestamp [ns],w [rad/s]"], zip(stamps, rates(), strict=True))
    with pytest.raises(InputError, match=r"`--rate 100"):
        mg.allan(path)


def test_the_rate_that_stands_still_is_named(tmp_path):
    rows = [(f"{0.01 * k:.2f}", f"{one:.3f}", 0.01) for k, one in enumerate(rates())]
    path = written(tmp_path / "log.csv", ["t [s],x [deg/s],z [deg/s]"], rows)
    with pytest.raises(InputError, match=r"those of `z` do not.*`--column`"):
        mg.allan(path)
    assert mg.allan(path, column="x").series == ("x",)
