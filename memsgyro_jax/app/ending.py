"""How a process ends that somebody asked to: it tidies up, or ends where it stands if that takes too long."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any


TERMINATED = 143  # as shells count: 128 and the number of the signal
GRACE = 20.0  # seconds to tidy up, fewer than most batch systems leave before they kill


class Terminated(BaseException):
    """Somebody asked this process to end."""


@contextlib.contextmanager
def told_to_end(*, at_last: bool) -> Iterator[None]:
    """SIGTERM ends this process as Ctrl-C does, so that it tidies up, and not where it stands.

    A program that XLA compiles or runs is not interrupted, and may take minutes: where `at_last` the process ends
    `GRACE` seconds after the signal, whatever it does then. What it has written is whole at any time. Asked again while
    it ends, as `timeout` does, it goes on ending, and where `at_last` until there is no more process.
    """
    heard, ending = threading.Event(), False

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal ending
        if ending:
            return
        ending = True  # before the event, whose lock a signal that comes within `set` would wait for
        heard.set()
        raise Terminated

    def passed_over(what: Any) -> None:
        """Python goes on where something is raised in a callback (of the collector, say): then it is asked again."""
        nonlocal ending
        number = {Terminated: signal.SIGTERM, KeyboardInterrupt: signal.SIGINT}.get(what.exc_type)
        if number is None:
            report(what)
        else:
            ending = ending and number != signal.SIGTERM
            threading.Timer(0.01, os.kill, (os.getpid(), number)).start()

    if threading.current_thread() is not threading.main_thread():  # only there Python takes signals
        yield
        return
    if at_last:
        _watch(heard)
    before, report = signal.signal(signal.SIGTERM, end), sys.unraisablehook
    sys.unraisablehook = passed_over
    try:
        yield
    finally:
        sys.unraisablehook = report
        if not (at_last and ending):
            signal.signal(signal.SIGTERM, before)


def _watch(heard: threading.Event) -> None:
    """A thread hears of signals when they come: Python's own handlers wait for what the main thread runs."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)

    def end_here() -> None:
        if not heard.is_set():
            os.write(2, b"Terminated.\n")
        os._exit(TERMINATED)

    def listen() -> None:
        while told := os.read(reading, 1):
            if told[0] == signal.SIGTERM:
                ending = threading.Timer(GRACE, end_here)
                ending.daemon = True
                ending.start()

    threading.Thread(target=listen, daemon=True).start()
