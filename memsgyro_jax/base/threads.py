"""Calls side by side on the cores, which end where they are told to.

A pool of threads waits for its calls before it passes on an exception, and a call may be a loop over programs that
takes minutes: a process that was told to end seemed deaf. Here such a loop ends before its next program.
"""

import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any


_OF_THREAD = threading.local()


class Ended(Exception):
    """The work that a call was a part of has ended."""


@contextmanager
def in_threads(workers: int) -> Iterator[Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]]:
    """Gives a `map` over so many threads. An exception is passed on at once: calls that have not begun never do, and
    those that run end where they next ask whether to `go_on`, also in threads of their own.
    """
    ended, above = threading.Event(), getattr(_OF_THREAD, "ended", ())

    def over(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        def one(item: Any) -> Any:
            _OF_THREAD.ended = (*above, ended)
            go_on()
            return function(item)

        return pool.map(one, items)

    pool = ThreadPoolExecutor(max(1, workers))
    try:
        yield over
    except BaseException:
        ended.set()
        raise
    finally:
        pool.shutdown(wait=not ended.is_set(), cancel_futures=True)


def go_on() -> None:
    """Asked before each program that a call runs: raises `Ended` where the work it is a part of has ended."""
    if any(event.is_set() for event in getattr(_OF_THREAD, "ended", ())):
        raise Ended
