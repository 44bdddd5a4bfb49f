"""By how much the temperatures of an experiment may be off: how a case says it, and what is told of it."""

from dataclasses import replace

import numpy as np
import pytest
from lab.oven import oven

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.instrument import declared_terms, instrument_terms, temperatures_of
from memsgyro_jax.measurement.case import load_case, write_case
from memsgyro_jax.measurement.one_place import set_points


HOT_AND_COLD = "f [Hz],T [degC],Vx_I [V],Vx_Q [V]"


def test_it_is_read_in_kelvin_and_comes_back(tmp_path):
    case = load_case(oven(tmp_path / "oven", declared=0.1))
    assert [record.temperature_std for record in case.records] == [0.1] * 5
    write_case(case, tmp_path / "again")
    again = load_case(tmp_path / "again")
    assert [record.temperature_std for record in again.records] == [0.1] * 5
    text = (tmp_path / "oven" / "case.toml").read_text().replace('{ value = 0.1, unit = "K" }', '"50 mK"')
    (tmp_path / "oven" / "case.toml").write_text(text)
    assert load_case(tmp_path / "oven").records[0].temperature_std == pytest.approx(0.05)


def test_left_out_it_is_zero_and_not_written(tmp_path):
    case = load_case(oven(tmp_path / "oven", declared=None))
    assert [record.temperature_std for record in case.records] == [0.0] * 5
    assert "temperature_std" not in write_case(case, tmp_path / "again").read_text()
    assert declared_terms(case) == ()
    assert "record_temperature" not in {term.label for term in instrument_terms(case)}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ('{ value = 0.1, unit = "degC" }', r"must be a difference of temperatures up to 30 K.* but is 0.1 degC"),
        ('"0 K"', r"must be a difference.* but is 0 K; leave it out where the temperature is exact"),
        ('"-0.1 K"', r"must be a difference.* but is -0.1 K"),
        ('"298.15 K"', r"must be a difference.* but is 298.15 K"),
        ("0.1", r"must carry a unit"),
        ('"0.1 V"', r"V.*K|K.*V"),
    ],
)
def test_what_it_cannot_be_is_refused_in_a_sentence(tmp_path, given, said):
    path = oven(tmp_path, rows=11) / "case.toml"
    path.write_text(path.read_text().replace('{ value = 0.1, unit = "K" }', given, 1))
    with pytest.raises(InputError, match=r"line \d+, `experiment.0.temperature_std`: " + said) as refused:
        load_case(tmp_path)
    assert "\n" not in str(refused.value)


def test_a_case_says_which_temperatures_may_be_off(tmp_path):
    case = load_case(oven(tmp_path))
    assert "The temperatures may be off, of at_-30, at_0, at_25, at_55, at_85 by 0.1 K (1σ)" in str(case)
    exact, *others = case.records
    mixed = replace(
        case, records=(replace(exact, temperature_std=0.0), *others[:-1], replace(others[-1], temperature_std=0.5))
    )
    assert "off, of at_0, at_25, at_55 by 0.1 K; of at_85 by 0.5 K (1σ)" in str(mixed)
    assert "may be off" not in str(load_case(oven(tmp_path / "exact", declared=None)))


def test_temperatures_within_a_kelvin_are_one_set_point():
    warm = np.array([298.1, 297.6, 358.0, 298.59, 299.2, 358.9])
    np.testing.assert_array_equal(set_points(warm), [0, 0, 2, 0, 1, 2])
    np.testing.assert_array_equal(set_points(np.array([])), [])


def test_each_set_point_of_a_record_has_a_number(tmp_path):
    """Sweeps of one record at one temperature share it, those of another record do not."""
    folder, other = oven(tmp_path / "one", set_points=(0.0, 25.0, 85.0)), oven(tmp_path / "two", seed=1)
    parts = [
        (of / f"at_{point}.csv").read_text().splitlines()[1:] for of, point in ((folder, 0), (other, 85), (other, 0))
    ]
    (folder / "at_0.csv").write_text("\n".join([HOT_AND_COLD, *(row for part in parts for row in part)]))
    case = load_case(folder)
    (term,) = declared_terms(case)
    np.testing.assert_array_equal(term.known_to, [0.1] * 4)
    np.testing.assert_array_equal(np.argmax(term.entry[0], axis=-1), [0, 1, 0])
    np.testing.assert_array_equal(np.argmax(term.entry[1:, 0], axis=-1), [2, 3])
    assert np.asarray(term.entry).sum() == 3 + 2


def test_operating_points_have_a_number_for_each_set_point(tmp_path):
    path = oven(tmp_path, set_points=(25.0,)) / "case.toml"
    rows = [
        f"{point},{volts},{0.1 * volts}" for point, volts in zip((0, 0.2, 25, 25.1, 0.1), (1, 1, 2, 2, 1), strict=True)
    ]
    (tmp_path / "points.csv").write_text("\n".join(["T [degC],Vx_I [V],Vx_Q [V]", *rows]))
    path.write_text(
        path.read_text() + '[[experiment]]\nname = "points"\nkind = "operating_points"\nfile = "points.csv"\n'
        'drive_axis = "x"\ndrive_frequency = "32.768 kHz"\nnoise_std = "1 mV"\ntemperature_std = "0.2 K"\n'
    )
    case = load_case(tmp_path)
    (term,) = declared_terms(case)
    np.testing.assert_array_equal(term.known_to, [0.1, 0.2, 0.2])
    assert case.records[1].sweeps == (slice(0, 2), slice(2, 4), slice(4, 5))
    np.testing.assert_array_equal(np.argmax(term.entry[1], axis=-1), [1, 2, 1])
    exact = replace(case.records[1], temperature_std=0.0)
    assert exact.sweeps == (slice(0, 5),)


def test_a_ring_down_has_a_number_with_or_without_a_column_of_temperatures(tmp_path):
    path = oven(tmp_path, set_points=(25.0,)) / "case.toml"
    time, text = np.arange(40) * 1e-5, path.read_text()
    for name, warm in (("told", "85"), ("untold", "")):
        rows = [f"{','.join(filter(None, (f'{t:.6g}', warm)))},{np.cos(2e5 * t)}" for t in time]
        head = ",".join(filter(None, ("t [s]", "T [degC]" if warm else "", "Vx [V]")))
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *rows]))
        text += (
            f'[[experiment]]\nname = "{name}"\nkind = "free_decay"\nfile = "{name}.csv"\nnoise_std = "1 mV"\n'
            'temperature_std = "0.2 K"\n'
        )
    path.write_text(text)
    case = load_case(tmp_path)
    (term,) = declared_terms(case)
    np.testing.assert_allclose(temperatures_of(case, term) - 273.15, [25.0, 85.0, 25.0])
    np.testing.assert_array_equal(term.known_to, [0.1, 0.2, 0.2])
