"""Time stamps that count the ticks of a clock, as lock-in amplifiers write them."""

import instrument_files as w
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.measurement.formats import read_instrument_file


HEAD, START, STEP = "chunk;timestamp;frequency;r;phase", 8_123_456_789_012, 18_000_000  # of 60 MHz: 0.3 s


def sweeps(path, above=(), levels=(1.0,)):
    lines = [*above, HEAD]
    for chunk, level in enumerate(levels):
        for n, (f, z) in enumerate(zip(w.FREQUENCY, w.RESPONSE, strict=True)):
            lines.append(f"{chunk};{START + STEP * n};{float(f)!r};{level * float(np.abs(z))!r};{float(np.angle(z))!r}")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("above", "unit"),
    [((), "ticks"), (("% Zurich Instruments", "% clockbase: 60000000"), "s"), (("# Serial: 1",), "ticks")],
)
def test_comments_above_may_name_the_clock(tmp_path, above, unit):
    """Below a comment the same columns were taken for peak amplitudes and a time of thousands of centuries."""
    name, (table,) = read_instrument_file(sweeps(tmp_path / "sweep.csv", above))
    assert name == "LabOne CSV"
    found = {column.name: column for column in table.columns}
    assert found["r"].unit == "Vrms"
    time = found["time" if unit == "s" else "timestamp"]
    assert time.unit == unit
    np.testing.assert_allclose(time.values[:3], np.arange(3) * (0.3 if unit == "s" else STEP))


@pytest.mark.parametrize(
    ("first", "step", "unit"), [(START, 36000, "ticks"), (1_700_000_000_000, 100, "ticks"), (0, 2, "")]
)
def test_stamps_that_can_be_no_seconds_are_ticks(tmp_path, first, step, unit):
    path = tmp_path / "decay.csv"
    path.write_text(
        "timestamp;x;y\n" + "\n".join(f"{first + step * n};{0.1 - 0.001 * n};{0.001 * n}" for n in range(9))
    )
    (table,) = read_instrument_file(path)[1]
    assert table.columns[0].unit == unit
    if unit:
        with pytest.raises(mg.InputError, match="counts ticks of a clock that is not named"):
            mg.import_case([path], tmp_path / "case")


def test_two_sweeps_of_a_file_are_said_to_be_taken_for_one_volt(tmp_path):
    found = mg.import_case([sweeps(tmp_path / "two.csv", levels=(1.0, 3.0))], tmp_path / "case")
    assert (
        "The 2 sweeps of two.csv do not say at which level they were driven, and each was taken for 1 V"
        in found.warning
    )
