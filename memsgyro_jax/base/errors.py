"""The one exception a user meets for bad input."""

from collections.abc import Sequence

from .text import printable


class InputError(ValueError):
    """An argument, file or setting that cannot be used.

    The message is one sentence that names the argument, file, line or column and the remedy;
    the command line prints it alone and exits with status 2. What a file holds and cannot be printed stands in it as
    its escape, so that no text of a stranger commands a terminal. Where several things are wrong, `each` has a line for
    every one of them.
    """

    def __init__(self, message: str = "", each: Sequence[str] = ()) -> None:
        super().__init__(printable(" ".join(str(message).split("\n"))))
        self.each = tuple(printable(" ".join(line.split("\n"))) for line in each)
