"""A malformed sweep is read rightly or refused with file, line and column; nothing is silently wrong."""

import numpy as np
import pytest
from lab import two_modes as lab

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.couplings.record import read_sweep


FREQUENCY = np.linspace(8010.0, 8040.0, 61)
GYRO = lab.Gyro(qx=5000.0, qy=4000.0)
PHASORS = lab.record(GYRO, lab.Instrument(), FREQUENCY)


@pytest.fixture
def polar(tmp_path):
    path = tmp_path / "sweep.csv"
    lab.write_polar(path, FREQUENCY, PHASORS)
    return path


@pytest.fixture
def cartesian(tmp_path):
    path = tmp_path / "iq.csv"
    lab.write_cartesian(path, FREQUENCY, PHASORS, {"F_x [nN]": 20.0})
    return path


def rewritten(path, change):
    lines = path.read_text().splitlines()
    path.write_text("\n".join(change(lines)) + "\n")
    return path


def cell(line, column, text):
    """A change that puts `text` into one cell (line as in the file, column from 0)."""

    def change(lines):
        fields = lines[line - 1].split(",")
        fields[column] = text
        return [*lines[: line - 1], ",".join(fields), *lines[line:]]

    return change


def column(index, header, function):
    """A change that replaces a whole column."""

    def change(lines):
        rows = [line.split(",") for line in lines]
        rows[0][index] = header
        for row in rows[1:]:
            row[index] = repr(float(function(float(row[index]))))
        return [",".join(row) for row in rows]

    return change


def test_polar_file_is_read(polar):
    record = read_sweep(polar)
    np.testing.assert_allclose(record.frequency, 2 * np.pi * FREQUENCY)
    np.testing.assert_allclose(record.phasors, PHASORS, rtol=1e-12)
    assert record.axis == 0
    assert record.polar
    assert "taken as the x electrode" in record.notes[0]


def test_cartesian_file_with_drive_is_read(cartesian):
    record = read_sweep(cartesian)
    np.testing.assert_allclose(record.phasors, PHASORS, rtol=1e-12)
    np.testing.assert_allclose(record.drive, 20e-9)
    assert not record.polar
    assert record.notes == ()


@pytest.mark.parametrize(
    ("change", "factor"),
    [
        (column(0, "f [kHz]", lambda f: f / 1e3), 1.0),
        (column(0, "omega [rad/s]", lambda f: f), None),
        (column(0, "f [rad/s]", lambda f: 2 * np.pi * f), 1.0),
        (column(2, "Vx_phase [rad]", np.radians), 1.0),
        (column(2, "Vx_phase [deg]", lambda p: p + 360.0), 1.0),
        (column(2, "Vx_phase [deg]", lambda p: p % 360.0), 1.0),
    ],
)
def test_units_and_wraps_are_read_rightly(polar, change, factor):
    rewritten(polar, change)
    if factor is None:
        with pytest.raises(InputError, match="`omega` is not known"):
            read_sweep(polar)
        return
    record = read_sweep(polar)
    np.testing.assert_allclose(record.frequency, 2 * np.pi * FREQUENCY, rtol=1e-12)
    np.testing.assert_allclose(record.phasors, PHASORS, rtol=1e-9)


def test_unwrapped_phase_is_read_rightly(polar):
    unwrapped = np.degrees(np.unwrap(np.angle(PHASORS[:, 1])))
    values = iter(unwrapped)
    rewritten(polar, column(4, "Vy_phase [deg]", lambda _: next(values)))
    np.testing.assert_allclose(read_sweep(polar).phasors, PHASORS, rtol=1e-9)


def test_a_downward_sweep_is_read_in_its_own_order(polar):
    record = read_sweep(rewritten(polar, lambda lines: [lines[0], *lines[:0:-1]]))
    np.testing.assert_allclose(record.frequency, 2 * np.pi * FREQUENCY[::-1])
    np.testing.assert_allclose(record.phasors, PHASORS[::-1], rtol=1e-12)
    assert record.start[0] == record.frequency[0]


def test_blank_lines_comments_and_byte_order_mark_are_skipped(polar):
    polar.write_bytes(b"\xef\xbb\xbf# bench 3\n\n" + polar.read_bytes() + b"\n\n")
    np.testing.assert_allclose(read_sweep(polar).phasors, PHASORS, rtol=1e-12)


def test_conjugated_file_is_read_when_told(polar):
    rewritten(polar, column(2, "Vx_phase [deg]", lambda p: -p))
    rewritten(polar, column(4, "Vy_phase [deg]", lambda p: -p))
    np.testing.assert_allclose(read_sweep(polar, conjugated=True).phasors, PHASORS, rtol=1e-9)


def comma_decimals(lines):
    return [lines[0], *(line.replace(".", ",") for line in lines[1:])]


def semicolons(lines):
    return [line.replace(".", "@").replace(",", ";").replace("@", ",") for line in lines]


MALFORMED = {
    "missing value": (cell(7, 3, ""), r"line 7, column `Vy_amp`: .* is missing"),
    "nan": (cell(7, 3, "nan"), r"line 7, column `Vy_amp`"),
    "infinite": (cell(7, 1, "1e999"), r"line 7, column `Vx_amp`"),
    "text": (cell(9, 0, "overload"), r"line 9, column `f`: .* is `overload`"),
    "underscore": (cell(9, 0, "8_014"), r"line 9, column `f`"),
    "decimal comma in a cell": (cell(5, 1, "12,5"), r"line 5: .* 5 fields .* has 6; is the decimal mark a comma"),
    "decimal commas everywhere": (comma_decimals, r"line 2: .*decimal mark a comma"),
    "semicolons": (semicolons, r"line 1: columns must be separated by commas"),
    "short row": (lambda lines: [*lines[:-1], ",".join(lines[-1].split(",")[:3])], r"line 62: .*cut short"),
    "duplicate frequency": (
        lambda lines: [*lines[:10], lines[9], *lines[10:]],
        r"line 11, column `f`: .* repeats the one before",
    ),
    "unordered frequency": (
        lambda lines: [*lines[:20], lines[21], lines[20], *lines[22:]],
        r"line 22, column `f`: .* goes back",
    ),
    "missing unit": (cell(1, 1, "Vx_amp"), r"line 1, column 2: Column header must read"),
    "unknown unit": (cell(1, 1, "Vx_amp [furlong2x]"), r"line 1: the channels must share one linear unit"),
    "wrong unit": (cell(1, 0, "f [V]"), "must measure the same"),
    "decibel": (cell(1, 1, "Vx_amp [dB]"), "must share one linear unit"),
    "unknown column": (cell(1, 1, "Vx_magnitude [1]"), "`Vx_magnitude` is not known"),
    "column twice": (cell(1, 3, "Vx_amp [1]"), "`Vx_amp` stands twice"),
    "mixed units": (cell(1, 1, "Vx_amp [V]"), "must share one linear unit"),
    "negative amplitude": (
        cell(8, 1, "-3.0"),
        r"line 8, column `Vx_amp`: the value must be a positive amplitude, but is -3",
    ),
    "negative frequency": (cell(2, 0, "-8010"), r"line 2, column `f`: the value must be positive, but is -8010"),
    "radians called degrees": (column(2, "Vx_phase [deg]", np.radians), "is the phase in radians"),
    "degrees called radians": (column(2, "Vx_phase [rad]", lambda p: p), "is it in degrees"),
    "other phase convention": (column(2, "Vx_phase [deg]", lambda p: -p), "--conjugated"),
    "header only": (lambda lines: lines[:1], "at least two rows"),
    "sense channel missing": (lambda lines: [",".join(line.split(",")[:3]) for line in lines], "`Vy_amp` is missing"),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_a_malformed_file_is_refused(polar, name):
    change, message = MALFORMED[name]
    with pytest.raises(InputError, match=message) as caught:
        read_sweep(rewritten(polar, change))
    assert polar.name in str(caught.value) or "column `f`" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_breaks_off_within_a_number_is_refused(polar):
    polar.write_text(polar.read_text()[:-6])
    with pytest.raises(InputError, match=r"line 62: the file must end with a whole row"):
        read_sweep(polar)


def test_drive_of_both_electrodes_is_refused(tmp_path):
    path = tmp_path / "both.csv"
    lab.write_cartesian(path, FREQUENCY, PHASORS, {"F_x [nN]": 20.0, "F_y [nN]": 5.0})
    with pytest.raises(InputError, match="one electrode must be driven at a time"):
        read_sweep(path)


def test_changing_temperature_is_refused(tmp_path):
    path = tmp_path / "soak.csv"
    lab.write_cartesian(path, FREQUENCY, PHASORS, {"T [degC]": np.linspace(20, 30, 61)})
    with pytest.raises(InputError, match="column `T`"):
        read_sweep(path)


def test_several_drive_levels_are_several_sweeps(tmp_path):
    path = tmp_path / "levels.csv"
    both = np.concatenate([FREQUENCY, FREQUENCY])
    levels = {"F_x [nN]": np.repeat([20.0, 40.0], 61)}
    lab.write_cartesian(path, both, np.concatenate([PHASORS, 2 * PHASORS]), levels)
    record = read_sweep(path)
    np.testing.assert_allclose(record.start, 2 * np.pi * 8010.0)
    np.testing.assert_allclose(record.drive[[0, 61]], [20e-9, 40e-9])


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_sweep(tmp_path / "absent.csv")


def test_not_text(tmp_path):
    path = tmp_path / "binary.csv"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match="UTF-8"):
        read_sweep(path)
