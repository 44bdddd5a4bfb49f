"""How far a long computation is: a bar with the remaining time on a terminal, plain lines elsewhere."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


_SILENCE = 60.0  # s without a line in a log, after which the last one is said again
_LINES = 10  # plain lines for a whole run, so that a log stays readable


@contextmanager
def progress(what: str, first: str) -> Iterator[Callable[[int, int], None]]:
    """Gives a function of (done, total) that shows how far `what` is, on standard error; the first call is before any
    is done.

    Args:
        what: counted things, for example "dies".
        first: what happens before the first of them is done, for example "compiling".
    """
    if sys.stderr.isatty():
        yield from _bar(what, first)
    else:
        yield _Lines(what, first)


def _bar(what: str, first: str) -> Iterator[Callable[[int, int], None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("elapsed"), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(first, total=None)
        said = iter((first,))

        def show(done: int, total: int) -> None:
            bar.update(task, description=next(said, what), completed=done, total=total)

        yield show


class _Lines:
    """About ten lines per run: one at once, and the remaining time from the third call on, as the second has waited for
    the compiler.
    """

    def __init__(self, what: str, first: str):
        self.what, self.first, self.shown, self.calls = what, first, -1, 0
        self.start: tuple[float, int] | None = None

    def __call__(self, done: int, total: int) -> None:
        now, self.calls = time.monotonic(), self.calls + 1
        if self.calls == 1:
            print(f"{done} of {total} {self.what}: {self.first}, some seconds", file=sys.stderr, flush=True)
            return
        if self.start is None:
            self.start = now, done
        tenth = _LINES * done // total
        if tenth == self.shown and done < total and self.calls != 3:  # the first that tells how long it takes
            return
        self.shown = tenth
        passed, since = now - self.start[0], done - self.start[1]
        left = f", about {passed * (total - done) / since:.0f} s left" if since > 0 and done < total else ""
        print(f"{done} of {total} {self.what}{left}", file=sys.stderr, flush=True)


@contextmanager
def told() -> Iterator[Callable[[str], None]]:
    """Gives a function of a sentence that says, on standard error, what happens now: a line each, with the time passed.

    On a terminal the last line turns until the next one comes; elsewhere it is said again after `_SILENCE`.
    """
    start = time.monotonic()
    if not sys.stderr.isatty():
        with _repeated(lambda text: print(_timed(start, text), file=sys.stderr, flush=True)) as tell:
            yield tell
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True)
    with console.status("reading") as status:

        def tell(text: str) -> None:
            console.print(Text(_timed(start, text), style="dim"))
            status.update(Text(text))

        yield tell


@contextmanager
def _repeated(say: Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    """Gives a function that says a sentence, and says it again as long as no other comes."""
    last, news, over = ["reading"], threading.Event(), threading.Event()

    def watch() -> None:
        while not over.is_set():
            if news.wait(_SILENCE):
                news.clear()
            else:
                say(f"still: {last[0]}")

    def tell(text: str) -> None:
        last[0] = text
        news.set()
        say(text)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield tell
    finally:
        over.set()
        news.set()
        watcher.join()


def _timed(start: float, text: str) -> str:
    return f"{time.monotonic() - start:5.0f} s  {text}"
