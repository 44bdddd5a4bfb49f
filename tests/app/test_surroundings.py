"""Surroundings that are not what one hopes for: a sentence and the documented exit status, or the same result."""

import gc
import os
import signal
import subprocess
import sys
import time
import weakref

import pytest

from memsgyro_jax.app import cli, ending
from memsgyro_jax.base import runtime
from memsgyro_jax.montecarlo.store import Store


SMALL = ["--dies", "5", "--sample-rate", "20e3", "--duration", "0.01", "--chunk", "2"]  # as app/test_commands.py
PROGRAM = """
from memsgyro_jax import cli
@cli.app.command
def figures() -> None:
    print("1 ± 2")
cli.main()
"""
SURROUNDINGS = [
    # (options of Python, environment, what is printed)
    ([], {"PYTHONIOENCODING": "ascii"}, "1 ? 2\n"),
    ([], {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}, "1 ? 2\n"),
    (["-O"], {"HOME": "/nowhere", "PYTHONIOENCODING": "utf-8"}, "1 ± 2\n"),
]


@pytest.mark.parametrize(("python", "environment", "printed"), SURROUNDINGS)
def test_figures_are_printed_in_any_surroundings(fresh_python, tmp_path, python, environment, printed):
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    done = fresh_python(*python, "program.py", "figures", **environment)
    assert (done.returncode, done.stdout, done.stderr) == (0, printed, "")


def test_output_that_finds_no_room_is_one_sentence(fresh_python):
    code = """
import subprocess, sys
with open("/dev/full", "w") as full:
    command = [sys.executable, "-m", "memsgyro_jax.app.cli", "--version"]
    done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
print(done.returncode, done.stderr, end="")
"""
    assert fresh_python("-c", code).stdout == "2 No space left on device.\n"


@pytest.mark.parametrize(
    ("number", "status", "sentence"), [(signal.SIGINT, 130, "Interrupted.\n"), (signal.SIGTERM, 143, "Terminated.\n")]
)
def test_a_sweep_that_is_told_to_end_tidies_up(tmp_path, capsys, monkeypatch, number, status, sentence):
    def asked(store):
        os.kill(os.getpid(), number)
        time.sleep(10.0)
        yield 0

    monkeypatch.setattr(Store, "unfinished", asked)
    with pytest.raises(SystemExit) as end:
        cli.main(["sweep", *SMALL, "--out", str(tmp_path / "out")])
    assert end.value.code == status
    assert capsys.readouterr().err == "0 of 5 dies: compiling, some seconds\n" + sentence
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["dies.zarr"]
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_what_is_not_interrupted_ends_where_it_stands():
    """As a program of XLA's that runs for minutes, in the main thread, or in one that is waited for at the end."""
    code = """
import hashlib, os, signal, sys, threading
from memsgyro_jax.app import cli, ending
ending.GRACE = 0.5
def long(*_):
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**30)
if sys.argv[1] == "beside":
    threading.Thread(target=long).start()
    cli._run = lambda *_: threading.Event().wait(60)
else:
    cli._run = long
threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()
cli.main()
"""
    for where in ("main", "beside"):
        done = subprocess.run([sys.executable, "-c", code, where], capture_output=True, text=True, timeout=60)
        assert done.returncode == 143, done.stderr
        assert where == "beside" or done.stderr == "Terminated.\n"


def test_a_second_wish_to_end_changes_nothing():
    """`timeout` asks its child and then the group that the child is in: while the first is answered, and at the end."""
    code = """
import os, signal, time
from memsgyro_jax.app import cli
@cli.app.command
def patient() -> None:
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(10.0)
    finally:
        os.kill(os.getpid(), signal.SIGTERM)
        print("tidied up")
said = cli._say
def say(*words):
    os.kill(os.getpid(), signal.SIGTERM)
    return said(*words)
cli._say = say
try:
    cli.main(None if LAST else ["patient"])
finally:
    if LAST:
        os.kill(os.getpid(), signal.SIGTERM)
"""
    for last in (True, False):
        command = [sys.executable, "-c", code.replace("LAST", str(last)), "patient"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stdout, done.stderr) == (143, "tidied up\n", "Terminated.\n")


@pytest.mark.parametrize("callback", ["of the collector", "of a weak reference"])
def test_an_end_asked_for_in_a_callback_comes_after_it(callback):
    """What a signal raises in a callback is reported and passed over."""

    def asked(*_):
        gc.callbacks[:] = kept
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(3):
            pass

    def ended():
        if callback == "of the collector":
            gc.callbacks.append(asked)
            gc.collect()
        else:
            thing = type("Thing", (), {})()
            reference = weakref.ref(thing, asked)
            del thing
            assert reference() is None
        time.sleep(5.0)

    kept, hook = list(gc.callbacks), sys.unraisablehook
    with pytest.raises(ending.Terminated), ending.told_to_end(at_last=False):
        ended()
    assert sys.unraisablehook is hook


def test_who_has_no_home_keeps_no_cache(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert runtime.cache_directory() is not None
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # neither HOME nor an entry in the list of users
    assert runtime.cache_directory() is None
