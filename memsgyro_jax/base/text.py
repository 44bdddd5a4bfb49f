"""Text for people."""

import difflib
from collections.abc import Iterable, Sequence


def aligned(rows: list[tuple[str, ...]]) -> str:
    """Rows of text with their columns below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def suggestion(name: str, known: Iterable[str]) -> str:
    """What a name that is not known may have meant: "did you mean `kxy`?", or all that are known."""
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean `{near[0]}`?" if near else f"known are {', '.join(known)}"


def combination(weights: Sequence[float], names: Sequence[str], least: float = 0.1, most: int = 4) -> str:
    """The largest parts of a combination of named numbers, `+0.71·a -0.71·b`; those up to `least` are left out."""
    pairs = sorted(zip(weights, names, strict=True), key=lambda pair: -round(abs(pair[0]), 6))[:most]
    return " ".join(f"{weight:+.2f}·{name}" for weight, name in pairs if abs(weight) > least)
