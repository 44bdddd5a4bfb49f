"""Progress: a bar on a terminal, few plain lines elsewhere."""

import contextlib
import os
import pty
import sys

import pytest

from memsgyro_jax import progress as module
from memsgyro_jax.progress import progress


def test_plain_lines_are_few_and_tell_the_time_left(capsys, monkeypatch):
    clock = iter(range(0, 10_000, 2))
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with progress("dies", "compiling") as show:
        for done in range(1, 201):
            show(done, 200)
    out, said = capsys.readouterr()
    lines = said.splitlines()
    assert out == ""
    assert len(lines) <= 12
    assert lines[0] == "1 of 200 dies"
    assert "100 of 200 dies, about 200 s left" in lines
    assert lines[-1] == "200 of 200 dies"


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_a_terminal_gets_a_bar(monkeypatch):
    ours, theirs = pty.openpty()
    with open(theirs, "w") as terminal:  # noqa: PTH123 (a file descriptor)
        monkeypatch.setattr(sys, "stderr", terminal)
        with progress("dies", "compiling") as show:
            show(50, 100)
        monkeypatch.undo()
    written = b""
    with contextlib.suppress(OSError):  # the other end is closed: everything has been read
        while part := os.read(ours, 65536):
            written += part
    os.close(ours)
    written = written.decode()
    assert "compiling" in written
    assert "━" in written
    assert "left" in written
