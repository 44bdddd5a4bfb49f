"""What made a result, when, and by which command."""

import shlex
from collections.abc import Sequence
from contextvars import ContextVar
from datetime import UTC, datetime

from memsgyro_jax import __version__


_COMMAND: ContextVar[str] = ContextVar("command", default="")


def called(tokens: Sequence[str]) -> None:
    """Remember the command line of this process, without the name of the program."""
    _COMMAND.set(shlex.join(["memsgyro", *tokens]))


def made_by() -> str:
    """Version, date and time (UTC), and the command line where there is one."""
    command, now = _COMMAND.get(), datetime.now(UTC)
    return f"memsgyro_jax {__version__}, {now:%Y-%m-%d %H:%M} UTC{f', by {command}' if command else ''}"
