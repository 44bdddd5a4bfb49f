"""Cases of the lowest drives alone: whole files, and rows of one file."""

import math

import numpy as np
import pytest
from lab import bent

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.drive_levels import clear_drives


def in_one_file(folder, levels):
    """The sweeps of several files one below the other in one, whose column says the drive."""
    lines = ["F [mV],f [Hz],Vx_I [V],Vx_Q [V]"]
    for level in levels:
        lines += [f"{level},{line}" for line in (folder / f"at_{level}mV.csv").read_text().splitlines()[1:]]
    (folder / "all.csv").write_text("\n".join(lines))
    record = bent.RECORD.format(level=5).replace("at_5mV", "all").split("drive_force")[0] + 'drive_axis = "x"\n'
    (folder / "case.toml").write_text(bent.CASE + record)
    return folder


@pytest.mark.parametrize("joined", [False, True])
def test_the_lowest_drives_are_kept_and_no_row_above(tmp_path, joined):
    folder = bent.bent_sweeps(tmp_path / "case", (5, 20, 60), rows=41)
    case = mg.load_case(in_one_file(folder, (20, 5, 60)) if joined else folder)
    assert clear_drives(case) == pytest.approx(bent.FORCE * np.array([5e-3, 20e-3, 60e-3]))
    fewer = mg.lowest_drives(case, 2)
    assert clear_drives(fewer) == pytest.approx(bent.FORCE * np.array([5e-3, 20e-3]))
    drives = np.concatenate([record.setting for record in fewer.records])
    assert np.max(drives) == pytest.approx(bent.FORCE * 20e-3)
    assert len(drives) == 2 * 41
    whole = {tuple(row) for r in case.records for row in np.c_[r.lines, r.frequency, r.setting, r.phasors.real]}
    assert {tuple(row) for r in fewer.records for row in np.c_[r.lines, r.frequency, r.setting, r.phasors.real]} < whole
    assert len(case.records) == (1 if joined else 3)


@pytest.mark.parametrize("count", [0, 3, 7])
def test_as_many_as_there_are_is_refused(tmp_path, count):
    case = mg.load_case(bent.bent_sweeps(tmp_path / "case", (5, 20, 60), rows=41))
    with pytest.raises(InputError, match=f"The {count} lowest drives .* have 3 clear drive levels; choose 1 to 2"):
        mg.lowest_drives(case, count)


def test_a_record_that_is_driven_harder_is_left_out_whole(tmp_path):
    """A sweep below its noise has no level, and another kind of record goes by its own drive."""
    folder = bent.bent_sweeps(tmp_path / "case", (5, 20), rows=41)
    decay = ["t [s],Vx [V]", *(f"{k * 5e-6!r},{math.cos(0.7 * k)!r}" for k in range(400))]
    for level in (4, 40):
        (folder / f"decay_{level}.csv").write_text("\n".join(decay))
        record = f"""[[experiment]]
name = "decay_{level}"
kind = "ring_down"
file = "decay_{level}.csv"
drive_axis = "x"
drive_force = {{ value = {level}, unit = "mV" }}
drive_frequency = {{ value = 23417, unit = "Hz" }}
drive_duration = {{ value = 0.1, unit = "s" }}
"""
        (folder / "case.toml").write_text((folder / "case.toml").read_text() + record)
    fewer = mg.lowest_drives(mg.load_case(folder), 1)
    assert [record.name for record in fewer.records] == ["at_5mV", "decay_4"]


@pytest.mark.parametrize(("times", "rows"), [(0.5, 400), (3.0, 250), (1e3, 0)])
def test_a_decay_counts_from_where_it_is_no_louder_than_the_sweeps(tmp_path, times, rows):
    folder = bent.bent_sweeps(tmp_path / "case", (5, 20), rows=41)
    loudest = float(np.max(np.abs(mg.load_case(folder).record("at_5mV").phasors)))
    fall = np.log(3.0) / 149.5  # behind 150 rows a third is left
    decay = [f"{k * 1e-4!r},{times * loudest * math.exp(-fall * k)!r},0.0" for k in range(400)]
    (folder / "decay.csv").write_text("\n".join(["t [s],Vx_I [V],Vx_Q [V]", *decay]))
    record = """[[experiment]]
name = "decay"
kind = "free_decay"
file = "decay.csv"
reference_frequency = { value = 23417, unit = "Hz" }
"""
    case = folder / "case.toml"
    case.write_text(case.read_text() + record)
    fewer = {one.name: one for one in mg.lowest_drives(mg.load_case(folder), 1).records}
    assert set(fewer) == {"at_5mV", *(["decay"] if rows else [])}
    if rows:
        assert fewer["decay"].rows == rows
        assert np.max(np.abs(fewer["decay"].readings)) <= loudest
