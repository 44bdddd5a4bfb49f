"""A malformed case is one sentence that names the place; nothing is silently wrong."""

import re

import numpy as np
import pytest
from measurement.case.bench import write_bench

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.case import load_case


@pytest.fixture
def bench(tmp_path):
    return write_bench(tmp_path / "bench")


def swap(path, old, new, count=1):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


def edit(path, line, change):
    """Replaces one line (from 1) by what `change` makes of it: text, or `None` to delete it."""
    lines = path.read_text().splitlines()
    new = change(lines[line - 1])
    lines[line - 1 : line] = [] if new is None else new.split("\n")
    path.write_text("\n".join(lines) + "\n")


def field(place, text):
    def change(line):
        fields = line.split(",")
        fields[place] = text
        return ",".join(fields)

    return change


def assert_refused(folder, *words):
    with pytest.raises(InputError, match=re.escape(words[0])) as caught:
        load_case(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith((".", "?")), message
    assert "?." not in message
    for word in words:
        assert word in message, f"{word!r} is not in: {message}"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "bench"\n', "", ("`name`", "missing")),
        ('device = "single_mass"', 'device = "dual_mass"', ("line 3", "`device`", "dual_mass")),
        ("memsgyro-case/1", "memsgyro-case/9", ("line 1", "schema")),
        ("dxy = {", "dyx = {", ("line 12", "design.dyx", "did you mean")),
        ("kxy = { low = 0.0, high = 1.0", "kxy = { low = 0.0", ("line 9", "design.kxy", "`low` and `high`")),
        ("kxy = { low = 0.0, high = 1.0", "kxy = { low = 2.0, high = 1.0", ("design.kxy", "between low and high")),
        ("kxy = { low = 0.0, high = 1.0", "kxy = { low = 90.0, high = 91.0", ("design.kxy", "geometric mean")),
        ("value = 1.8e-7, ", "value = -1.8e-7, ", ("line 6", "design.mass", "positive")),
        ("value = 1.8e-7, ", 'value = "1,8e-7", ', ("line 6", "design.mass.value", "valid number")),
        ("value = 1.8e-7, ", "value = 1" + 400 * "0" + ", ", ("line 6", "design.mass.value")),
        ("value = 1.8e-7, ", "value = nan, ", ("line 6", "design.mass.value", "finite")),
        ("tolerance = 0.10 }", "tolerance = 1.10 }", ("line 6", "design.mass.tolerance", "less than 1")),
        ('unit = "kg", ', "", ("line 6", "design.mass.unit", "missing")),
        ('unit = "kg"', 'unit = "V"', ("line 6", "design.mass", '"kg"')),
        ('unit = "kg"', 'unit = "k g("', ("line 6", "design.mass", "Unit")),
        ('unit = "V/um"', 'unit = "um/V"', ("readout.scale", '"V/m"')),
        ("value = 0.5, ", "value = 0.0, ", ("readout.scale", "zero")),
        ('unit = "degC"', 'unit = "V"', ("environment.temperature",)),
        ("value = 25.0", "value = -300.0", ("environment.temperature", "positive")),
        ('kind = "frequency_sweep"', 'kind = "frequency_swep"', ("must have a kind", "frequency_swep")),
        ('kind = "frequency_sweep"\n', "", ("must have a kind", "has none")),
        ("settled = true", "setled = true", ("setled", "did you mean `settled`")),
        ("settled = true", 'settled = "yes"', ("settled", "must be true or false")),
        ('drive_axis = "x"', 'drive_axis = "z"', ("drive_axis", "'x' or 'y'")),
        ('drive_axis = "x"\n', "", ("experiment.0.drive_axis", "missing")),
        ('drive_axis = "x"', 'drive_axis = "y"', ("sweep_x.csv", "`F_x`", "one electrode")),
        ("settled = true", 'settled = true\ndrive_force = "20 nN"', ("drive_force", "left out")),
        ("settled = true", "settled = true\ndrive_force = 20", ("drive_force", "must carry a unit")),
        ('noise_std = { value = 1e-5, unit = "V" }', "noise_std = '-1e-5 V'", ("noise_std", "positive", "estimated")),
        ('noise_std = { value = 1e-5, unit = "V" }', "noise_std = '1e-5 N'", ("noise_std", '"V"')),
        ('noise_std = { value = 1e-5, unit = "V" }', "noise_std = '1e-5'", ("noise_std", "must carry a unit")),
        ("lock_in_cycles = 3", "lock_in_cycles = 3.0", ("lock_in_cycles", "whole number")),
        ("lock_in_cycles = 3", "lock_in_cycles = 0", ("lock_in_cycles", "greater than 0")),
        ("lock_in_cycles = 3", "lock_in_cycles = 4", ("rate.csv", "column `t`", "lock-in block")),
        ("lock_in_cycles = 3", 'lock_in_cycles = 3\nrate_reference = "gps"', ("rate_reference",)),
        ('{ value = 3000.0, unit = "Hz" }', '"3000 kHz"', ("drive_frequency", "resonance", "unit")),
        ('{ value = 3000.0, unit = "Hz" }', '"3000 rad/s"', ("drive_frequency", "resonance", "unit")),
        ('{ value = 3000.0, unit = "Hz" }', '"3000 nN"', ("drive_frequency", '"rad/s"')),
        ('drive_duration = { value = 0.1, unit = "s" }\n', "", ("drive_duration", "missing")),
        ('file = "raw.csv"', 'file = "../raw.csv"', ("experiment.3.file", "below the folder")),
        ('file = "raw.csv"', 'file = "/raw.csv"', ("experiment.3.file", "below the folder")),
        ('file = "raw.csv"', 'file = "row.csv"', ("experiment.3.file", "exists", "row.csv")),
        ('file = "raw.csv"', 'file = "."', ("experiment.3.file",)),
        ('file = "raw.csv"', 'file = "raw\\u0000.csv"', ("experiment.3.file", "printable")),
        ('file = "raw.csv"', 'file = "rate.csv"', ("experiment.3.file", "number 3")),
        ('name = "raw"', 'name = "rate"', ("experiment.3.name", "number 3")),
        ('hold = "zero_order"', 'hold = "first"', ("hold", "zero_order")),
        ('role = "validation"', 'role = "test"', ("role", "validation")),
        ('role = "validation"', f'sha256 = "{64 * "0"}"', ("experiment.3.sha256", "checksum")),
        ('role = "validation"', 'sha256 = "0"', ("experiment.3.sha256", "pattern")),
        ("[readout]", "[readout", ("case.toml", "line 14")),
        ("[readout]", "[read\\out]", ("case.toml", "line 14")),
        ('name = "bench"', "name = " + 5000 * "[", ("case.toml",)),
        ('name = "bench"', "name = " + 5000 * "1", ("case.toml",)),
    ],
)
def test_a_wrong_entry_names_its_line_and_key(bench, old, new, words):
    swap(bench / "case.toml", old, new)
    assert_refused(bench, *words)


HEAD = 'schema = "memsgyro-case/1"\nname = "a"\ndevice = "resonator"\n'
SWEEP = '[[experiment]]\nname = "a"\nkind = "frequency_sweep"\nfile = "a.csv"\n'
KINDS = '"frequency_sweep" or "ring_down" or "free_decay" or "rate_table" or "operating_points" or "time_record"'
LIKE = "must be a table, like `quality_factor ="
USUAL = LIKE + " { value = 100, tolerance = 0.1 }`"


@pytest.mark.parametrize(
    ("text", "place", "sentence"),
    [
        (SWEEP.replace("_sweep", "_swep"), "experiment.0", f'must have a kind, {KINDS}, but has "frequency_swep"'),
        (SWEEP + "setled = true", "experiment.0.setled", "is not known (did you mean `settled`?)"),
        ("experiment = []", "experiment", "must have at least 1 entry, but has 0"),
        ("experiment = 3", "experiment", "must be a list of tables, each under `[[experiment]]`, but is 3"),
        ("experiment = [3]", "experiment.0", "must be a table, as under `[[experiment]]`, but is 3"),
        ("design.quality_factor = 100", "design.quality_factor", USUAL + ", but is 100"),
        ("design.quality_factor = true", "design.quality_factor", USUAL + ", but is True"),
        ("design.quality_factor = [9, 11]", "design.quality_factor", LIKE + " { low = 9, high = 11 }`, but is [9, 11]"),
        (
            'design.quality_factor = "3 kHz"',
            "design.quality_factor",
            LIKE + ' { value = 3, unit = "kHz", tolerance = 0.1 }`, but is "3 kHz"',
        ),
        ("design = 3", "design", "must be a table, as under `[design]`, but is 3"),
        ("readout = 3", "readout", "must be a table, as under `[readout]`, but is 3"),
        (SWEEP.replace('"a.csv"', "3"), "experiment.0.file", "must be text in quotes, but is 3"),
        (SWEEP + 'carried = "p"', "experiment.0.carried", 'must be a list, like `["p"]`, but is "p"'),
        (SWEEP + "settled = 3", "experiment.0.settled", "must be true or false, but is 3"),
        (SWEEP + 'sha256 = "0"', "experiment.0.sha256", "must match pattern '^[0-9a-f]{64}$', but is \"0\""),
    ],
)
def test_what_is_of_another_form_is_told_in_plain_words(tmp_path, text, place, sentence):
    path = tmp_path / "case.toml"
    path.write_text(HEAD + text + "\n" + ("" if "experiment" in text else SWEEP))
    with pytest.raises(InputError) as caught:
        load_case(tmp_path)
    assert re.sub(r"line \d+, ", "", str(caught.value)) == f"{path}: `{place}`: {sentence}."


def test_a_question_ends_its_sentence(tmp_path):
    (tmp_path / "case.toml").write_text(HEAD + SWEEP + "settled = true\n")
    rows = [f"{1000 + k},1,{10 * k}" for k in range(9)]
    (tmp_path / "a.csv").write_text("\n".join(["f [Hz],Vx_amp [V],Vx_phase [rad]", *rows]) + "\n")
    assert_refused(tmp_path, "a.csv, column `Vx_phase`: must turn by a few half turns", "is it in degrees?")


@pytest.mark.parametrize("seed", range(4))
def test_rows_in_no_order_are_told_so(bench, seed):
    header, *rows = (bench / "sweep_x.csv").read_text().splitlines()
    np.random.default_rng(seed).shuffle(rows)
    (bench / "sweep_x.csv").write_text("\n".join([header, *rows]) + "\n")
    assert_refused(
        bench,
        "sweep_x.csv, column `f`: the rows must run up or down in frequency",
        "sort them by setting and then by `f`",
    )


def test_no_experiment_is_no_case(bench):
    path = bench / "case.toml"
    path.write_text(path.read_text().split("[[experiment]]")[0])
    assert_refused(bench, "`experiment`", "missing")


def test_a_folder_without_case_is_named(tmp_path):
    assert_refused(tmp_path, "case.toml", "no such file")


def test_bytes_that_are_no_text_are_named(bench):
    path = bench / "case.toml"
    path.write_bytes(path.read_bytes().replace(b"mass = {", b"mass\xff = {"))
    assert_refused(bench, "line 6", "UTF-8")


def test_a_link_out_of_the_folder_is_refused(bench, tmp_path):
    (bench / "raw.csv").replace(tmp_path / "raw.csv")
    (bench / "raw.csv").symlink_to(tmp_path / "raw.csv")
    assert_refused(bench, "experiment.3.file", "below the folder")


@pytest.mark.parametrize(
    ("file", "line", "change", "words"),
    [
        ("sweep_x.csv", 1, lambda h: h.replace("f [Hz]", "f"), ("line 1", "name [unit]")),
        ("sweep_x.csv", 1, lambda h: h.replace("f [Hz]", "f [mm]"), ("column `f`", "frequency")),
        ("sweep_x.csv", 1, lambda h: h.replace("f [Hz]", "f [rad/s]"), ("column `f`", "resonance", "unit right")),
        ("sweep_x.csv", 1, lambda h: h.replace("f [Hz]", "f [kHz]"), ("column `f`", "resonance", "unit right")),
        ("sweep_x.csv", 1, lambda h: h.replace("Vy_Q [V]", "Vy_Q [A]"), ("Vy_Q", '"V"')),
        ("sweep_x.csv", 1, lambda h: h.replace("Vy_Q [V]", "Vy_Q [dB]"), ("Vy_Q", "linear")),
        ("sweep_x.csv", 1, lambda h: h.replace("Vy_Q [V]", "Vy_P [V]"), ("Vy_P", "did you mean")),
        ("sweep_x.csv", 1, lambda h: h.replace("Vy_Q [V]", "Vy_amp [V]"), ("header", "either I and Q")),
        ("sweep_x.csv", 1, lambda h: h.replace("F_x [nN]", "F_z [nN]"), ("F_z", "did you mean")),
        ("sweep_x.csv", 1, lambda h: h.replace("Vx_I [V],Vx_Q", "Vx_Q [V],Vx_I"), ("phase", "fall")),
        ("sweep_x.csv", 1, lambda h: h.replace("Vx_I [V]", "Vx_I [kV]"), ("adc_range", "line")),
        ("sweep_x.csv", 5, lambda r: r + "\n" + r, ("line 6", "repeat line 5")),
        ("sweep_x.csv", 5, field(1, "2800"), ("line 5", "`f`", "turns back")),
        ("sweep_x.csv", 5, field(0, "21"), ("line 5", "at least 3 rows")),
        ("sweep_x.csv", 20, field(0, "21"), ("line 20", "at least 3 rows")),
        ("sweep_x.csv", 20, field(0, "-20"), ("line 20", "`F_x`", "positive")),
        ("sweep_x.csv", 20, field(2, "nan"), ("line 20", "`Vx_I`", "finite")),
        ("sweep_x.csv", 20, field(2, "0,012"), ("line 20", "decimal mark")),
        ("sweep_x.csv", 20, lambda r: r.rsplit(",", 1)[0], ("line 20", "cut short")),
        ("ringdown.csv", 100, lambda r: None, ("line 100", "`t`", "row missing")),
        ("ringdown.csv", 100, lambda r: r + "\n" + r, ("line 101", "`t`", "later")),
        ("ringdown.csv", 100, field(0, "0.00491"), ("line 100", "`t`", "clock")),
        ("ringdown.csv", 1, lambda h: h.replace("t [s]", "t [ms]"), ("`t`", "cycle", "unit right")),
        ("ringdown.csv", 1, lambda h: h.replace("t [s]", "t [min]"), ("`t`", "sampling", "unit right")),
        ("ringdown.csv", 1, lambda h: h.replace("t [s]", "t [Hz]"), ("`t`", '"s"')),
        ("ringdown.csv", 1, lambda h: h.replace("Vx [V],Vy", "Vx [V],Vx"), ("`Vx`", "twice")),
        ("ringdown.csv", 2, field(0, "-5e-5"), ("line 2", "`t`", "removed")),
        ("rate.csv", 50, lambda r: None, ("line 50", "`t`", "row missing")),
        ("rate.csv", 1, lambda h: h.replace("deg/s", "deg"), ("`rate`", '"rad/s"')),
        ("rate.csv", 1, lambda h: h.replace("t [s]", "t [ms]"), ("`t`", "lock-in block")),
        ("raw.csv", 2, lambda r: None, ("line 2", "`t`", "must be 0")),
        ("raw.csv", 30, lambda r: "#" + r, ("line 31", "`t`", "row missing")),
        ("raw.csv", 1, lambda h: h.replace("u_x [nN],u_y", "u_x [nN],uy"), ("`uy`", "did you mean `u_y`")),
        ("raw.csv", 1, lambda h: h.replace("u_x [nN]", "u_x [V]"), ("`u_x`", '"N"')),
        ("raw.csv", 1, lambda h: h.replace("Vx [V],Vy [V]", "rate [deg/s],T [degC]"), ("header", "`Vx`")),
    ],
)
def test_a_wrong_row_or_header_names_its_line_or_column(bench, file, line, change, words):
    edit(bench / file, line, change)
    assert_refused(bench, file, *words)


def test_a_sweep_taken_twice_is_refused(bench):
    path = bench / "sweep_x.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, *lines[1:42]]) + "\n")
    assert_refused(bench, "line 84", "line 2", "same conditions")


def test_a_file_without_rows_is_refused(bench):
    (bench / "raw.csv").write_text("")
    assert_refused(bench, "raw.csv", "at least two rows")
