"""Calls side by side give what they give one by one, and end where they are told to."""

import threading
import time

import pytest

from memsgyro_jax.base.threads import Ended, go_on, in_threads


def test_they_give_what_they_give_one_by_one():
    with in_threads(3) as over:
        assert list(over(lambda k: k**2, range(7))) == [k**2 for k in range(7)]
    go_on()


@pytest.mark.parametrize("deep", [False, True])
def test_an_end_is_passed_on_at_once_and_ends_what_runs(deep):
    """A pool of threads alone waited for calls that took minutes before it passed on that somebody asked for an end."""
    begun, ended, calls = threading.Event(), threading.Event(), []

    def endless(item):
        calls.append(item)
        begun.set()
        try:
            while True:
                go_on()
                time.sleep(1e-3)
        except Ended:
            ended.set()
            raise

    def nested(item):
        with in_threads(1) as over:
            return list(over(endless, [item]))

    def interrupted():
        with in_threads(1) as over:
            over(nested if deep else endless, range(3))
            begun.wait()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert ended.wait(60.0)
    assert calls == [0]
    go_on()
