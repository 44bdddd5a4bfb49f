"""Progress: a bar on a terminal, few plain lines elsewhere."""

import contextlib
import os
import pty
import sys
import threading

import pytest

from memsgyro_jax.app.commands import progress as module
from memsgyro_jax.app.commands.progress import progress, told


def test_plain_lines_are_few_and_tell_the_time_left(capsys, monkeypatch):
    clock = iter(range(0, 10_000, 2))
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with progress("dies", "compiling") as show:
        for done in range(201):
            show(done, 200)
    out, said = capsys.readouterr()
    lines = said.splitlines()
    assert out == ""
    assert len(lines) <= 14
    assert lines[:2] == ["0 of 200 dies: compiling, some seconds", "1 of 200 dies"]
    assert lines[2].startswith("2 of 200 dies, about "), "how long it takes is told as soon as it is known"
    assert "100 of 200 dies, about 200 s left" in lines
    assert lines[-1] == "200 of 200 dies"


def shown_on_a_terminal(monkeypatch, action):
    """What an action writes to standard error where that is a terminal."""
    ours, theirs = pty.openpty()
    with open(theirs, "w") as terminal:  # noqa: PTH123 (a file descriptor)
        monkeypatch.setattr(sys, "stderr", terminal)
        action()
        monkeypatch.undo()
    written = b""
    with contextlib.suppress(OSError):  # the other end is closed: everything has been read
        while part := os.read(ours, 65536):
            written += part
    os.close(ours)
    return written.decode()


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_a_terminal_gets_a_bar(monkeypatch):
    def show_half():
        with progress("dies", "compiling") as show:
            show(0, 100)
            show(50, 100)

    written = shown_on_a_terminal(monkeypatch, show_half)
    assert "compiling" in written
    assert "━" in written
    assert "left" in written


def test_a_long_silence_is_broken_by_the_last_sentence(monkeypatch):
    assert module._SILENCE >= 60.0, "a log shall hold what happens, not how long it takes"
    monkeypatch.setattr(module, "_SILENCE", 0.001)
    said, again = [], threading.Event()

    def say(text: str) -> None:
        said.append(text)
        if text.startswith("still: fit"):
            again.set()

    with module._repeated(say) as tell:
        tell("fit the base model")
        assert again.wait(60.0)
    assert said[-1] == "still: fit the base model"


def test_sentences_are_lines_with_the_time_passed(capsys, monkeypatch):
    clock = iter((100.0, 103.0, 217.0))
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with told() as tell:
        tell("fit the base model")
        tell("added [cubic] x")
    assert capsys.readouterr() == ("", "    3 s  fit the base model\n  117 s  added [cubic] x\n")


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_sentences_stay_on_a_terminal(monkeypatch):
    def tell_two():
        with told() as tell:
            tell("fit the base model")
            tell("added [cubic] x")

    written = shown_on_a_terminal(monkeypatch, tell_two)
    assert "s  fit the base model\r\n" in written.replace("\x1b[0m", "")
    assert "s  added [cubic] x" in written
