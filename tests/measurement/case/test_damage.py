"""A damaged case is one sentence with its place, or a case; under a checksum no number changes."""

import re

import numpy as np
import pytest
from measurement.case.bench import write_bench
from measurement.case.test_case import assert_same_case

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.case import load_case, write_case


FILES = ("case.toml", "sweep_x.csv", "ringdown.csv", "rate.csv", "raw.csv")
UNITS = ("V", "mV", "Hz", "kHz", "rad/s", "s", "ms", "nN", "um", "deg/s", "deg", "degC", "1", "", "V/um", "m/V", "dBm")


def flip_byte(data, rng):
    place = rng.integers(len(data))
    return data[:place] + bytes([data[place] ^ (1 << rng.integers(8))]) + data[place + 1 :]


def change_digit(data, rng):
    places = [m.start() for m in re.finditer(rb"\d", data)]
    place = places[rng.integers(len(places))]
    return data[:place] + str(rng.integers(10)).encode() + data[place + 1 :]


def cut(data, rng):
    return data[: rng.integers(len(data))]


def by_lines(change):
    def mutate(data, rng):
        lines = data.split(b"\n")
        return b"\n".join(change(lines, rng.integers(len(lines)), rng))

    return mutate


def swap_columns(data, rng):
    """Columns of a CSV, words of a TOML."""
    rows = [line.split(b",") for line in data.split(b"\n")]
    a, b = rng.integers(len(rows[0]), size=2)
    header_only = rng.random() < 0.5
    for row in rows[:1] if header_only else rows:
        if max(a, b) < len(row):
            row[a], row[b] = row[b], row[a]
    return b"\n".join(map(b",".join, rows))


def change_unit(data, rng):
    places = list(re.finditer(rb'(?<=\[)[^\[\]"]+(?=\])|(?<=unit = ")[^"]*', data))
    place = places[rng.integers(len(places))]
    return data[: place.start()] + str(rng.choice(UNITS)).encode() + data[place.end() :]


MUTATIONS = (
    flip_byte,
    change_digit,
    cut,
    change_unit,
    swap_columns,
    by_lines(lambda lines, n, rng: lines[:n] + lines[n + 1 :]),
    by_lines(lambda lines, n, rng: lines[: n + 1] + lines[n:]),
    by_lines(lambda lines, n, rng: [*lines[:n], lines[rng.integers(len(lines))], *lines[n + 1 :]]),
    by_lines(lambda lines, n, rng: [*lines[:n], lines[n].replace(b".", b","), *lines[n + 1 :]]),
)


def damaged(folder, file, intact, rng):
    """Damages one file in place and returns what reading the case then gives: the case, or the sentence."""
    mutate = MUTATIONS[rng.integers(len(MUTATIONS))]
    (folder / file).write_bytes(mutate(intact, rng))
    try:
        return load_case(folder)
    except InputError as error:
        return str(error)


def assert_names_its_place(sentence):
    assert "\n" not in sentence
    assert re.search(r"\.(toml|csv)", sentence), sentence
    assert re.search(r"lines? \d|byte \d|column|header|`[\w.]+`", sentence), sentence
    assert sentence.rstrip().endswith((".", "?")), sentence


def storm(folder, file, count, seed):
    rng = np.random.default_rng(seed)
    intact = (folder / file).read_bytes()
    outcomes = [damaged(folder, file, intact, rng) for _ in range(count)]
    (folder / file).write_bytes(intact)
    return outcomes


def assert_storm_is_weathered(folder, file, count, seed):
    outcomes = storm(folder, file, count, seed)
    refused = [outcome for outcome in outcomes if isinstance(outcome, str)]
    for sentence in refused:
        assert_names_its_place(sentence)
    assert len(refused) > 0.3 * count


@pytest.mark.parametrize("file", FILES)
def test_damage_is_refused_with_its_place_or_is_a_case(tmp_path, file):
    assert_storm_is_weathered(write_bench(tmp_path / "bench"), file, 40, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("file", FILES)
def test_much_damage_is_refused_with_its_place_or_is_a_case(tmp_path, file):
    assert_storm_is_weathered(write_bench(tmp_path / "bench"), file, 1500, seed=2)


@pytest.mark.parametrize("file", FILES[1:])
def test_under_a_checksum_no_number_changes(tmp_path, file):
    intact = load_case(write_bench(tmp_path / "bench"))
    folder = tmp_path / "written"
    write_case(intact, folder)
    for outcome in storm(folder, file, 30, seed=3):
        if isinstance(outcome, str):
            assert_names_its_place(outcome)
        else:
            assert_same_case(intact, outcome)
