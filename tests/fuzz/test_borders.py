"""Whatever a file holds, reading it gives what the text says, or one sentence about it, at once.

Each border is given hundreds of damaged texts (thousands as a slow test), all drawn from a seed. Three things are
asked: damage is refused in one sentence with the file and the place, or read as numbers that are finite; what means
nothing (comments, blanks, ends of lines, a byte order mark) changes no bit; another number changes the content or is
refused.
"""

import json
import re
import signal
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from app.study.test_study import FULL
from effects.test_user_file import GOOD
from fuzz.mutators import DAMAGE, NEUTRAL, other_number
from lab import two_modes
from measurement.case.bench import write_bench
from measurement.test_model_file import model

from memsgyro_jax.app.study.file import StudyFile
from memsgyro_jax.app.study.record import read_rate_record
from memsgyro_jax.base.arguments import quantity, whole
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import read_table
from memsgyro_jax.base.toml import checked, read_toml
from memsgyro_jax.base.user_file import run_user_file
from memsgyro_jax.couplings.record import read_sweep
from memsgyro_jax.effects import CubicStiffness, ParasiticMode
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.model_file import model_text, read_model


LIMIT = 10.0  # s, beyond which a reader hangs
COUNTS = [200, pytest.param(5000, marks=pytest.mark.slow)]


@dataclass(frozen=True)
class Border:
    """A file that users write: its name, what it holds intact, how it is read, and what of it counts."""

    name: str
    intact: bytes
    read: Callable[[Path], Any]


def study(path: Path) -> Any:
    data, source = read_toml(path, "study file")
    return checked(StudyFile, data, source, {"folder": source.folder}).model_dump()


def sweep(path: Path) -> Any:
    record = read_sweep(path)
    says_what_it_says(path)
    return [record.frequency, record.phasors, record.drive, record.rate, record.axis]


def rate(path: Path) -> Any:
    profile = read_rate_record(path)
    says_what_it_says(path)
    return [profile.times, profile.values]


def says_what_it_says(path: Path) -> None:
    """A second reading of the table, by nothing but `split` and `float`."""
    text = path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    head, *rows = [line for line in text.split("\n") if line.strip() and not line.startswith("#")]
    if '"' in text:  # quoted fields are left to the reader
        return
    table = read_table(path)
    names = [field.split("[")[0].strip() for field in head.split(",")]
    expected = np.array([[float(field) for field in row.split(",")] for row in rows])
    np.testing.assert_array_equal(np.stack([table.columns[name] for name in names], axis=1), expected)


def effects(path: Path) -> Any:
    return sorted(run_user_file(path).lines.items())


@pytest.fixture(scope="module")
def borders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    bench = write_bench(folder / "bench")
    for table in bench.glob("*.csv"):  # the case file is what changes here
        table.write_text("".join(table.read_text().splitlines(keepends=True)[:60]))
    frequency = two_modes.WIDE[150:350:8]
    swept = two_modes.record(two_modes.Gyro(), two_modes.Instrument(), frequency)
    two_modes.write_cartesian(folder / "s.csv", frequency, swept)
    mode = ParasiticMode(axis=0, strength=1e-4, omega=2e4, quality=300.0)
    fitted = model_text(model(CubicStiffness(strength=8e8), mode))
    record = "t [s],rate [deg/s]\n" + "".join(f"{0.01 * n:.2f},{10.5 - n}\n" for n in range(12))
    return {
        "study": Border("study.toml", FULL.encode(), study),
        "case": Border("bench/case.toml", (bench / "case.toml").read_bytes(), lambda path: case_of(load_case(path))),
        "sweep": Border("s.csv", (folder / "s.csv").read_bytes(), sweep),
        "rate": Border("rate.csv", record.encode(), rate),
        "model": Border("model.toml", fitted.encode(), lambda path: jax.tree.leaves(read_model(path))),
        "effects": Border("own.py", GOOD.encode(), effects),
    }, folder


def case_of(case: Any) -> Any:
    records = [(r.name, r.role, r.note, r.noise_std, r.readings) for r in case.records]
    keys = [r.keys(case) for r in case.records]
    return [case.name, case.description, case.design, case.readout, case.environment, case.conventions, records, keys]


def outcome(border: Border, folder: Path, data: bytes) -> Any:
    """The content as text with every digit, or the `InputError`; anything else is raised, and so is a hang."""
    path = folder / border.name
    path.write_bytes(data)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        with np.printoptions(threshold=10**9, floatmode="unique"):
            return repr(plain(border.read(path)))
    except InputError as error:
        return error
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def plain(content: Any) -> Any:
    """Content as lists of bytes and text; a number that is not finite is a fault."""
    if isinstance(content, dict):
        return sorted((key, plain(value)) for key, value in content.items())
    if isinstance(content, list | tuple):
        return [plain(value) for value in content]
    if isinstance(content, float | np.ndarray | jax.Array):
        numbers = np.asarray(content)
        assert np.all(np.isfinite(numbers))
        return numbers.shape, numbers.tobytes()
    return repr(content)


@pytest.fixture(autouse=True)
def alarm():
    def ring(number, frame):
        raise TimeoutError(f"reading took more than {LIMIT} s")

    before = signal.signal(signal.SIGALRM, ring)
    yield
    signal.signal(signal.SIGALRM, before)


def assert_one_sentence(error: InputError, folder: Path) -> None:
    sentence = str(error)
    assert sentence.isprintable(), repr(sentence)
    assert sentence.endswith((".", "?")), sentence
    assert str(folder) in sentence, sentence
    assert len(sentence) < 4000
    inside = sentence.replace(str(folder), "")
    assert re.search(r"lines? \d|column|header|`[^`]+`|must hold|byte|end of the file|whole row", inside), sentence


BORDERS = ("study", "case", "sweep", "rate", "model", "effects")


def parsed(data: bytes) -> str:
    """What TOML says, whatever the order; -0.0 is not 0.0."""
    return json.dumps(tomllib.loads(data.decode("utf-8-sig")), sort_keys=True, default=str)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("name", BORDERS)
def test_damage_is_one_sentence_or_what_the_text_says(borders, name, count):
    border, folder = borders[0][name], borders[1]
    rng = np.random.default_rng([count, BORDERS.index(name)])
    intact = outcome(border, folder, border.intact)
    assert not isinstance(intact, InputError), intact
    refused = 0
    for _ in range(count):
        data = border.intact
        for _ in range(int(rng.integers(1, 4))):
            data = DAMAGE[int(rng.integers(len(DAMAGE)))](data, rng)
        found = outcome(border, folder, data)
        if isinstance(found, InputError):
            refused += 1
            assert_one_sentence(found, folder)
        elif border.name.endswith(".toml") and parsed(data) == parsed(border.intact):
            assert found == intact
    assert 0.3 * count < refused < count


@pytest.mark.parametrize("count", [40, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", BORDERS[:-1])
def test_what_means_nothing_changes_no_bit(borders, name, count):
    border, folder = borders[0][name], borders[1]
    rng = np.random.default_rng([count, 7, BORDERS.index(name)])
    intact = outcome(border, folder, border.intact)
    for _ in range(count):
        data = border.intact
        for number in rng.permutation(len(NEUTRAL))[: int(rng.integers(1, 4))]:
            data = NEUTRAL[number](data, rng) if data[:3] != b"\xef\xbb\xbf" else data
        assert outcome(border, folder, data) == intact, data


@pytest.mark.parametrize("count", [100, pytest.param(3000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", BORDERS[:-1])
def test_another_number_is_another_content_or_refused(borders, name, count):
    border, folder = borders[0][name], borders[1]
    rng = np.random.default_rng([count, 11, BORDERS.index(name)])
    intact = outcome(border, folder, border.intact)
    for _ in range(count):
        data = other_number(border.intact, rng)
        found = outcome(border, folder, data)
        if isinstance(found, InputError):
            assert_one_sentence(found, folder)
        else:
            assert (found == intact) == (data == border.intact), data


@pytest.mark.parametrize("count", COUNTS)
def test_arguments_are_taken_or_refused_in_one_sentence(count):
    rng = np.random.default_rng(count)
    texts = (b"100 kHz", b"1e5 Hz", b"30 deg/s", b"0.1 ms", b"2 rad/s")
    for number in range(count):
        text = texts[number % len(texts)]
        for _ in range(int(rng.integers(0, 3))):
            text = DAMAGE[int(rng.integers(len(DAMAGE)))](text, rng)
        given, unit = text.decode(errors="surrogateescape"), ("Hz", "rad/s", "s")[number % 3]
        value = taken(quantity, "rate", given, unit)
        assert value is None or np.isfinite(value)
        huge = 4 * int(rng.integers(-(2**62), 2**62))
        counts = (rng.normal(0, 10.0 ** rng.integers(0, 25)), huge, np.nan, given, None)
        drawn = counts[int(rng.integers(len(counts)))]
        assert taken(whole, "dies", drawn, 1) in (None, drawn)


def taken(function: Callable[..., Any], name: str, *given: Any) -> Any:
    """What an argument is taken for, or `None` where it is refused in one sentence."""
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        return function(name, *given)
    except InputError as error:
        sentence = str(error)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    assert sentence.startswith(f"Argument `{name}`")
    assert sentence.isprintable()
    return None
