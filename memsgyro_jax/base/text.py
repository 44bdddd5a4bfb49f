"""Text for people."""

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any


_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))
FIRST = 10  # complaints that a sentence spells out
_MANY = 20  # names in a sentence
_LONG = 60  # characters of a name in a sentence
_NEAR = 0.6  # likeness from which on a name may be another mistyped
_ALL_DIGITS = re.compile(r"\d+\.\d{4,}(e[+-]?\d+)?")  # a number with all its digits


def aligned(rows: list[tuple[str, ...]]) -> str:
    """Rows of text with their columns below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def printable(text: str, most: int | None = None) -> str:
    """Text for one line of a message: what cannot be printed as its escape, and not more than `most` characters."""
    if most is not None and len(text) > most:
        text = f"{text[: most - 3]}..."
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def ended(text: str) -> str:
    """The text as a sentence; some end in a question."""
    return text if text.endswith(("?", ".")) else f"{text}."


def rounded(text: str, digits: int) -> str:
    """The text, its numbers with four decimals or more cut to so many significant `digits`."""
    return _ALL_DIGITS.sub(lambda found: f"{float(found[0]):.{digits}g}", text)


def excerpt(value: Any) -> str:
    """What was found, for a message: at most 40 characters of it."""
    if isinstance(value, int) and abs(value) > 10**40:  # Python itself refuses to spell thousands of digits out
        return "a number of more than 40 digits"
    return printable(f'"{value}"' if isinstance(value, str) else str(value), 40)


def listed(names: Iterable[str], quote: str = "") -> str:
    """Names after each other, the first twenty and how many more."""
    names = list(names)
    more = f" and {len(names) - _MANY} more" if len(names) > _MANY else ""
    return ", ".join(f"{quote}{printable(name, _LONG)}{quote}" for name in names[:_MANY]) + more


def first_of(complaints: Sequence[str], what: str, count: int | None = None) -> str:
    """Complaints in one sentence: the first ten, and how many more of `count`, which are all without it."""
    count = len(complaints) if count is None else count
    head = f"{count} {what} must be mended: " if count > 1 else ""
    shown = complaints[:FIRST]
    return f"{head}{'; '.join(shown)}{f'; and {count - len(shown)} more' if count > len(shown) else ''}"


def suggestion(name: str, known: Iterable[str], *, every: bool = False) -> str:
    """What a name that is not known may have meant: "did you mean `kxy`?", or `every` one that is known."""
    known = list(known)
    alike = {one: _likeness(name, one) for one in known} if len(name) <= _LONG else {}
    near = max(alike, key=lambda one: (alike[one], one), default="")
    asked = f"did you mean `{near}`?" if alike.get(near, 0.0) >= _NEAR else ""
    return asked if asked and not every else f"{asked} known are {listed(known)}".strip()


def _likeness(name: str, other: str) -> float:
    """From 0 to 1, of dotted names by what stands behind the parts that they begin with alike: these name no number."""
    parts, others = name.split("."), other.split(".")
    while len(parts) > 1 and len(others) > 1 and parts[0] == others[0]:
        parts, others = parts[1:], others[1:]
    return difflib.SequenceMatcher(None, ".".join(others), ".".join(parts)).ratio()


def combination(weights: Sequence[float], names: Sequence[str], least: float = 0.1, most: int = 4) -> str:
    """The largest parts of a combination of named numbers, `+0.71·a -0.71·b`; those up to `least` are left out."""
    pairs = sorted(zip(weights, names, strict=True), key=lambda pair: -round(abs(pair[0]), 6))[:most]
    return " ".join(f"{weight:+.2f}·{name}" for weight, name in pairs if abs(weight) > least)


def beside(value: float, std: float, digits: int = 5) -> str:
    """A value with the digits that its standard deviation leaves it, `digits` at least, and twelve at most."""
    told = 0.0 < std < math.inf and math.isfinite(value) and value
    places = math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 2 if told else 0
    if told and digits <= places <= 12:  # all digits stand, zeros at the end too
        return f"{value:#.{places}g}".rstrip(".")
    return f"{value:.{min(12, max(digits, places))}g}"


def said_in(number: str, unit: str) -> str:
    """A number with its unit; a pure one has none."""
    return number if unit in ("", "1") else f"{number} {unit}"


def spoken(value: float, unit: str, digits: int = 4) -> str:
    """A quantity in SI for people: `spoken(1.5e-7, "N")` is "150 nN"; kelvin become °C, rad/s of rate deg/s."""
    if unit == "K":
        return f"{round(value - 273.15, 6):.{digits}g} °C"  # 273.15 itself is not exact in binary
    if unit == "rad/s":
        return f"{math.degrees(value):.{digits}g} deg/s"
    factor, prefix = next(((f, p) for f, p in _PREFIXES if abs(value) >= 0.9995 * f), (1.0, ""))
    return f"{value / factor:.{digits}g} {prefix}{unit}".rstrip()
