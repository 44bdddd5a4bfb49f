"""Text for people."""

import difflib
from collections.abc import Iterable


def aligned(rows: list[tuple[str, ...]]) -> str:
    """Rows of text with their columns below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def suggestion(name: str, known: Iterable[str]) -> str:
    """What a name that is not known may have meant: "did you mean `kxy`?", or all that are known."""
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean `{near[0]}`?" if near else f"known are {', '.join(known)}"
