"""What is no file of ours is refused in one sentence, at once, whoever reads it."""

import os
import re
import time

import pytest

from memsgyro_jax.app import cli
from memsgyro_jax.app.study import load_study, read_rate_record
from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import LARGEST_TEXT, read_whole, write_json, write_whole
from memsgyro_jax.base.table import read_table
from memsgyro_jax.base.units import decimal, to_si
from memsgyro_jax.base.user_file import run_user_file
from memsgyro_jax.couplings.record import read_sweep
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.model_file import read_model


READERS = [load_study, read_model, read_rate_record, read_sweep, read_table, run_user_file]


def refusal(read, *arguments):
    started = time.monotonic()
    with pytest.raises(InputError) as caught:
        read(*arguments)
    sentence = str(caught.value)
    assert sentence.isprintable(), "one line"
    assert sentence.endswith(".")
    assert len(sentence) < 3000
    assert time.monotonic() - started < 10.0
    return sentence


@pytest.fixture
def kept(tmp_path):
    def kept(content, name="study.toml"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return kept


@pytest.mark.parametrize("read", READERS)
def test_only_regular_files_of_a_bounded_size_are_read(read, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert "but is a device or a pipe" in refusal(read, tmp_path / "pipe")
    assert "but is a device or a pipe" in refusal(read, "/dev/zero")
    assert "but is a folder" in refusal(read, tmp_path)
    assert "no such" in refusal(read, tmp_path / "none")
    assert "no such" in refusal(read, tmp_path / "\udcff\n")
    assert "NUL" in refusal(read, "a\0b")
    (tmp_path / "binary").write_bytes(bytes(range(256)) * 4)
    assert "line 2: " in refusal(read, tmp_path / "binary")


def test_the_size_limit_is_told(kept):
    path = kept(b"#" * (LARGEST_TEXT + 1))
    assert "must have at most 4 MiB, but has 4 MiB" in refusal(load_study, path)
    assert "must have at most 4 MiB" in refusal(load_case, path)
    with path.open("ab") as file:
        file.truncate(2**40)  # a hole: nothing is stored
    assert "but has 1.049e+06 MiB" in refusal(run_user_file, path)
    assert "must have at most 512 MiB" in refusal(read_table, path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("\nx = " + "1" * 5000, "line 2: a number must have at most 400 digits"),
        ("a = 1\nb = 1e400", "line 2: a number must be finite, but `1e400` is larger"),
        ("b = -0.1e-400", "line 1: a number must be zero or not, but `-0.1e-400` is smaller"),
        ("[sweep]\ndies = " + "1" * 400, "line 2, `sweep.dies`: must be a whole number, at most 2147483647"),
        ("[sweep]\nseed = 9223372036854775808", "line 2, `sweep.seed`: must be a whole number"),
        ("[loop]\ntravel = " + "1" * 400, "line 2, `loop.travel`: must be a finite number"),
        ('[loop]\ntravel = "1e-400 m"', "line 2, `loop.travel`: must be a finite number, but `1e-400` is too small"),
        ('[loop]\ntravel = "1e-320 fm"', "line 2, `loop.travel`: Unit of the value must leave a finite number"),
        ('[loop]\ntravel = "1 m^1e15"', "line 2, `loop.travel`: Unit"),
        ('[loop]\ntravel = "1 m**9**9**9"', "line 2, `loop.travel`: Unit"),
        (".".join("a" * 100000) + " = 1", "line 1: a key must have at most 32 parts"),
        ("[" + '."a"' * 40 + "]", "cannot be read"),
        ('"\\u001b[31m" = 1', "`\\x1b[31m`: is not known"),
        (f'"{"k" * 100000}" = 1', "is not known"),
        ("\x00", "cannot be read"),
        ("[scenario]\nrate = " + "[" * 300 + "]" * 300, "line 2, `scenario.rate.0`"),
        ('[device]\nfile = "/dev/zero"', "line 2, `device.file`: /dev/zero: the model file must be a regular file"),
        ('[scenario]\nrate = { kind = "record", file = "\\u0000" }', "line 2, `scenario.rate.file`"),
    ],
)
def test_a_study_that_no_editor_would_write(kept, text, words):
    assert words in refusal(load_study, kept(text))


@pytest.mark.parametrize("form", ["{} = 1", "[{}]", "[[{}]]", "[sweep.{}]", "sweep.{} = 1"])
def test_of_twenty_thousand_unknown_keys_ten_are_named_at_once(kept, form):
    text = "\n".join(form.format(f"key{n}") for n in range(20_000))
    sentence = refusal(load_study, kept(text))
    assert "20000 entries must be mended: line 1, " in sentence
    assert "key9`" in sentence
    assert "key10`" not in sentence
    assert sentence.endswith("; and 19990 more.")


def test_entries_of_one_list_are_told_apart_in_linear_time():
    started = time.monotonic()
    source = Source("s", None, "[[effects]]\na = 1\n" * 40_000)
    assert source._line(("effects", 39_999, "a")) == 80_000
    assert time.monotonic() - started < 5.0


def test_a_byte_order_mark_and_ends_of_lines_change_nothing(kept):
    text = '[sweep]\ndies = 7\n# é\n[loop]\ntravel = "30 um"\n'
    plain = load_study(kept(text)).file
    for other in ("\ufeff" + text, text.replace("\n", "\r\n"), "\ufeff" + text.replace("\n", "\r\n")):
        assert load_study(kept(other.encode())).file == plain
    table = "t [s],rate [deg/s]\n0,1\n1,2\n2,3\n"
    for other in ("\ufeff" + table, table.replace("\n", "\r\n"), table.replace("\n", "\r")):
        assert read_rate_record(kept(other.encode())).values.tolist() == read_rate_record(kept(table)).values.tolist()


def test_the_first_ten_rows_are_named_and_the_others_counted(kept):
    rows = "".join(f"{n},1\n" if n % 3 else f"{n},-\n" for n in range(60))
    sentence = refusal(read_table, kept("t [s],rate [deg/s]\n" + rows))
    assert "20 rows must be mended: line 2, column `rate`: the value must be a finite number, but is `-`" in sentence
    assert len(re.findall(r"line \d+", sentence)) == 10
    assert sentence.endswith("; and 10 more.")


def test_a_form_feed_does_not_end_a_row(kept):
    assert "line 3: the row must have 2 fields" in refusal(read_table, kept("t [s],x [V]\n0,1\n1,2\x0c2,3\n3,4\n"))


@pytest.mark.parametrize(
    "text", ["1e400", "-1e999", "1e-400", "0.00001e-330", "nan", "inf", "1_0", "٣", "", "1,5", "0x1"]
)
def test_text_that_is_no_number_of_a_computer(text):
    with pytest.raises(ValueError, match="must be a finite number, but"):
        decimal(text)


@pytest.mark.parametrize("text", ["0", "-0.0", "0e-999", "4.9e-324", "1.7e308", ".5", "5."])
def test_text_that_is_a_number(text):
    assert decimal(text) == float(text)


@pytest.mark.parametrize(
    "unit", ["V^1e15", "V**9**9**9", "V**(9**9**9)", "V**400", "V" * 2000, "V**2**-1", "V^^2", "(((V)"]
)
def test_a_unit_that_is_none_is_refused_at_once(unit):
    assert "must be one that can be read" in refusal(to_si, 1.0, unit, "V", "it")


def test_a_unit_may_have_any_power_that_units_have():
    assert to_si(2.0, "V**(1/2)*V**0.5", "V", "it") == 2.0
    assert to_si(4.0, "(uV)^2/V", "V", "it") == pytest.approx(4e-12)
    assert to_si(1.0, "N/m^3", "N/m^3", "it") == 1.0


def test_results_go_to_files_only(tmp_path):
    assert "must be a file, but is a folder" in refusal(write_json, "/", {})
    assert "must be a file, but is a folder" in refusal(write_whole, tmp_path, "")
    assert list(tmp_path.iterdir()) == []
    write_json(tmp_path / "a.json", {"name": "\udcff"})
    assert (tmp_path / "a.json").read_text() == '{\n  "name": "\\udcff"\n}\n'


@pytest.mark.parametrize("command", ["sweep", "simulate", "tune", "identify", "effects", "compare", "fit", "diagnose"])
@pytest.mark.parametrize("target", ["/", "/dev/full"])
def test_no_command_writes_into_a_folder_or_a_device(command, target, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    case = ["demo"] if command in ("compare", "fit", "diagnose") else []
    with pytest.raises(SystemExit) as end:
        cli.main([command, *case, "--json", target])
    out, err = capsys.readouterr()
    assert (end.value.code, out) == (2, "")
    assert err.startswith(f"{target} must be a file, but is ")
    assert err.count("\n") == 1


def test_a_name_that_is_nearly_right_is_answered_with_what_is_there(tmp_path):
    (tmp_path / "sweep_5mV.csv").write_text("1")
    with pytest.raises(InputError, match=r"sweep_5mv\.csv: no such file; beside it stands sweep_5mV\.csv\."):
        read_whole(tmp_path / "sweep_5mv.csv", "file")
    with pytest.raises(InputError, match=r"other\.csv: no such file\.$"):
        read_whole(tmp_path / "other.csv", "file")
    with pytest.raises(InputError, match=r"a\.csv: no such file\.$"):
        read_whole(tmp_path / "nowhere" / "a.csv", "file")
