"""The command line's frame: fast help, exit status, one sentence instead of a traceback."""

import errno

import pytest

from memsgyro_jax import InputError, __version__
from memsgyro_jax.app import cli


pytestmark = pytest.mark.smoke

HEAVY = ("jax", "jaxlib", "numpy", "scipy", "matplotlib", "equinox", "xarray", "zarr", "pint", "pydantic", "diffrax")


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_answers_without_importing_anything_heavy(fresh_python, option):
    code = f"""
import sys
from memsgyro_jax import cli
try:
    cli.main(["{option}"])
except SystemExit as end:
    print("STATUS", end.code, [name for name in {HEAVY} if name in sys.modules])
"""
    done = fresh_python("-c", code)
    assert done.stdout.endswith("STATUS 0 []\n"), done.stdout + done.stderr


def test_a_case_that_is_not_there_is_missed_before_anything_heavy(fresh_python):
    code = f"""
import sys
from memsgyro_jax import cli
for name in ("check", "compare", "fit", "diagnose"):
    try:
        cli.main([name, "nowhere"])
    except SystemExit as end:
        print(end.code, [name for name in {HEAVY} if name in sys.modules])
"""
    done = fresh_python("-c", code)
    assert done.stdout == "2 []\n" * 4, done.stdout + done.stderr
    remedy = "`memsgyro import FILE... --out CASE` makes a case of what instruments save"
    assert done.stderr == f"nowhere/case.toml: No such file or directory; {remedy}.\n" * 4


def test_version(fresh_python):
    assert fresh_python("-m", "memsgyro_jax.app.cli", "--version").stdout.strip() == __version__


@pytest.mark.parametrize("tokens", [["swep"], ["--no-such-option"]])
def test_a_wrong_word_is_one_sentence(fresh_python, tokens):
    done = fresh_python("-m", "memsgyro_jax.app.cli", *tokens)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert tokens[0] in done.stderr


@pytest.fixture
def status():
    """Runs a function as the command `try` of the real application and returns the exit status."""

    def run(function, *tokens):
        cli.app.command(function, name="try")
        try:
            with pytest.raises(SystemExit) as end:
                cli.main(["try", *tokens])
        finally:
            del cli.app["try"]
        return end.value.code

    return run


@pytest.mark.parametrize(
    ("error", "expected", "sentence"),
    [
        (
            InputError("Argument `mass` must be\n  positive, but is -1."),
            2,
            "Argument `mass` must be positive, but is -1.",
        ),
        (KeyboardInterrupt(), 130, "Interrupted."),
        (OSError(errno.ENOSPC, "No space left on device", "dies.zarr"), 2, "dies.zarr: No space left on device."),
        (PermissionError(errno.EACCES, "Permission denied", "out"), 2, "out: Permission denied."),
        (FileNotFoundError("no such study"), 2, "no such study."),
    ],
)
def test_errors_become_one_sentence_and_a_status(status, capsys, error, expected, sentence):
    def fail() -> None:
        raise error

    assert status(fail) == expected
    assert capsys.readouterr() == ("", f"{sentence}\n")


def test_a_defect_of_the_program_is_not_hidden(status):
    def fail() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        status(fail)


def test_a_command_gets_its_arguments(status, capsys):
    def add(left: int, *, right: int = 0) -> None:
        print(left + right)

    assert status(add, "2", "--right", "3") == 0
    assert capsys.readouterr().out == "5\n"
    assert status(add, "two") == 2
    assert "two" in capsys.readouterr().err


@pytest.mark.parametrize("prints", ["--help", "lines"])
def test_a_reader_that_leaves_early_gets_no_traceback(fresh_python, tmp_path, prints):
    (tmp_path / "program.py").write_text("""
from memsgyro_jax import cli
@cli.app.command
def lines() -> None:
    print("many lines")
cli.main()
""")
    code = f"""
import subprocess, sys
program = [sys.executable, "program.py", "{prints}"]
child = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
child.stdout.close()
print(repr(child.stderr.read().decode()), child.wait())
"""
    assert fresh_python("-c", code).stdout == "'' 1\n"
