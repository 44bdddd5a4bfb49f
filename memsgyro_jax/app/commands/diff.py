"""`memsgyro diff`: what sets two studies or two results apart."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned, rounded


_WIDEST = 60  # letters of a setting or a sentence
_SILENT = ("versions", "fingerprint", "schema", "notes", "steps_per_s", "study")
_WHICH = "name", "axis", "variant"  # of a table of an effect: which it is
_TWO_SIDED = 1.96


class Figure(NamedTuple):
    """A number with its 95 % interval, where the result tells one."""

    value: float
    low: float | None = None
    high: float | None = None

    def __str__(self) -> str:
        between = "" if self.low is None or self.high is None else f" ({self.low:.4g} to {self.high:.4g})"
        return f"{self.value:.4g}{between}"

    @property
    def may_be_zero(self) -> bool:
        """Whether it is zero, or as good as that by its interval: a share of it means nothing."""
        return self.value == 0.0 or (self.low is not None and self.high is not None and self.low <= 0.0 <= self.high)

    def apart(self, other: "Figure") -> bool | None:
        """Whether the intervals of both lie apart; None where one has none."""
        if self.low is None or self.high is None or other.low is None or other.high is None:
            return None
        return self.high < other.low or other.high < self.low


def diff_command(a: Path, b: Path, /, *, report: Path | None = None) -> None:
    """What sets two studies, or two results, apart: configuration and figures.

    Of two figures with intervals of 95 % it is said whether these lie apart;
    figures that agree to four digits are left out.

    Args:
        a: a study (TOML), a folder of `memsgyro sweep` or `simulate`, or a result (JSON).
        b: another.
        report: an HTML page of it, with both lots or runs in one picture where A and B are their folders.
    """
    for path in (a, b):
        path.stat()
    (settings_a, figures_a), (settings_b, figures_b) = read(a), read(b)
    tables = {
        "setting": table("configuration", settings_a, settings_b),
        "figure": table("figure", figures_a, figures_b),
    }
    tables = {what: rows for what, rows in tables.items() if len(rows) > 1}
    lines = [aligned(rows) for rows in tables.values()]
    same = "no difference" if settings_a or settings_b or figures_a or figures_b else "nothing to compare"
    names = named(a, settings_a), named(b, settings_b)
    print("\n\n".join([f"A is {names[0]}\nB is {names[1]}", *lines]) if lines else f"{a} and {b}: {same}.")
    if report is not None:
        from ..report.diff_page import diff_page

        print(f"\n{diff_page((a, b), names, tables).save(report)} is the page of it.")


def read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings and figures, by dotted name; raises `InputError` for what is neither a study nor a result."""
    if path.suffix == ".toml":
        import tomllib

        from ..study import load_study

        return dict(flat_entries(tomllib.loads(load_study(path).to_toml()))), {}
    if path.is_dir():
        path = path / "summary.json"
        if not path.exists():
            raise InputError(f"{path.parent} must hold a summary.json, which a sweep or run writes at its end.")
    try:
        found = json.loads(path.read_bytes())
    except ValueError as error:
        raise InputError(
            f"{path} must be a study (.toml), a folder with a summary.json, or a result in JSON."
        ) from error
    if not isinstance(found, dict):
        raise InputError(f"{path} must hold a result, a JSON object, but holds a {type(found).__name__}.")
    told = {name: value for name, value in found.items() if name not in _SILENT}
    return dict(flat_entries(found.get("study", {}))), dict(figures(told))


def named(path: Path, settings: dict[str, Any]) -> str:
    """What was compared, by its path and by who measures and drives there."""
    who = [f"{part} {settings[key]}" for part in ("observer", "controller") if (key := f"{part}.kind") in settings]
    return f"{path} ({', '.join(who)})" if who else str(path)


def flat_entries(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """What a file says, by dotted name."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from flat_entries(entry, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value):
        labels = [" ".join(str(entry[key]) for key in _WHICH if key in entry) for entry in value]
        for number, entry in enumerate(value):  # tables of effects: each by what it is, not by its place
            same = labels[:number].count(labels[number])
            label = f"{labels[number]} {same + 1}".strip() if same or not labels[number] else labels[number]
            rest = {key: part for key, part in entry.items() if key not in _WHICH}
            yield from flat_entries(rest or "there", f"{name}.{label}" if name else label)
    else:
        yield name, value


def figures(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """The numbers of a result with their intervals, and its words, by dotted name."""
    if isinstance(value, dict):
        number = value.get("value", value.get("estimate"))
        if _is_number(number) and ("std" in value or "low" in value):
            yield name, _with_interval(number, value)
            return
        for key, entry in value.items():
            ends = [value.get(f"{key}_{end}") for end in ("low", "high")]
            ends = value.get(f"{key}_interval") or (ends if None not in ends else [None, None])
            if key.endswith(("_low", "_high", "_interval")):
                continue
            inner = f"{name}.{key}" if name else key
            if _is_number(entry):
                yield inner, Figure(entry, *ends)
            elif key == "dies" and isinstance(entry, list):  # which they are is another lot's anyway
                yield inner, Figure(len(entry))
            else:
                yield from figures(entry, inner)
    elif isinstance(value, list):
        for number, entry in enumerate(value):
            label = entry.get("name", entry.get("label", number)) if isinstance(entry, dict) else number
            yield from figures(entry, f"{name}.{label}" if name else str(label))
    elif _is_number(value):
        yield name, Figure(value)
    elif value is not None:
        yield name, value


def _with_interval(number: float, value: dict[str, Any]) -> Figure:
    if _is_number(value.get("low")) and _is_number(value.get("high")):
        return Figure(number, value["low"], value["high"])
    half = _TWO_SIDED * value["std"] if _is_number(value.get("std")) else None
    return Figure(number) if half is None else Figure(number, number - half, number + half)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def table(what: str, left: dict[str, Any], right: dict[str, Any]) -> list[tuple[str, ...]]:
    """Header, and the rows that differ."""
    rows: list[tuple[str, ...]] = [(what, "A", "B", "")]
    for name in dict.fromkeys((*left, *right)):
        pair = left.get(name), right.get(name)
        shown = ["–" if one is None else str(one) for one in pair]
        if shown[0] == shown[1]:
            continue
        shown = _short(*shown)
        if (cut := [text[:_WIDEST] + "…" if len(text) > _WIDEST else text for text in shown])[0] != cut[1]:
            shown = cut
        said = ""
        if isinstance(pair[0], Figure) and isinstance(pair[1], Figure):
            change = "" if pair[0].may_be_zero else f"{100.0 * (pair[1].value / pair[0].value - 1.0):+.3g} %"
            apart = {True: "intervals apart", False: "within the intervals", None: ""}[pair[0].apart(pair[1])]
            said = ", ".join(filter(None, (change, apart)))
        rows.append((name, *shown, said))
    return rows


def _short(left: str, right: str) -> list[str]:
    """Both texts with as many digits of their numbers as tell them apart, four at least."""
    for digits in (4, 7, 12):
        cut = [rounded(text, digits) for text in (left, right)]
        if cut[0] != cut[1]:
            return cut
    return [left, right]
