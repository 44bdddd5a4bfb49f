"""Pages made from the schemas that editors are given: every key of a study file, and of a case file."""

import re
from collections.abc import Iterator
from typing import Any

from generated import table_row

from memsgyro_jax.app.commands.schema import Kind, schema_of, unit_in


Part = dict[str, Any]
FILES: dict[Kind, str] = {"study": "[study file](study_files.md)", "case": "[case file](records.md)"}
HOW = """Made from the schema of this version, `memsgyro schema {kind}`, by which an editor checks and completes a
{file}.

A quantity is text with any unit of its kind, `"1.8e-7 kg"` or `"180 ug"`, or `{{ value = 180, unit = "ug" }}`; what has
the unit 1 may stand alone, or in `%`. A pair for the axes x and y may be one value for both."""


def pages() -> dict[str, str]:
    """Both pages, by their paths."""
    return {f"{kind}_keys.md": "\n".join(KeysPage(kind).lines()) + "\n" for kind in FILES}


class KeysPage:
    """A page while it is written. Parts that several keys hold, and profiles of all units, stand on it once."""

    def __init__(self, kind: Kind):
        self.kind, self.schema = kind, schema_of(kind)
        self.alike: dict[str, list[Part]] = {}  # parts that differ in units alone, by the name that they share
        for part in self.schema["$defs"].values():
            self.alike.setdefault(_shared(part), []).append(part)
        self.shown: set[str] = set()

    def lines(self) -> Iterator[str]:
        """What stands at the top of a file, then its sections."""
        yield from (f"# Keys of a {self.kind} file", "", HOW.format(kind=self.kind, file=FILES[self.kind]), "")
        sections = {key: names for key, entry in self._entries(self.schema) if (names := self._held(entry))}
        yield from self._table([self.schema], sections)
        for key, names in sections.items():
            entry = self.schema["properties"][key]
            mark = f"[[{key}]]" if entry.get("type") == "array" else f"[{key}]"
            told = entry["description"] if len(names) > 1 else _heading(key, self.alike[names[0]][0])[1]
            yield from ("", f"## `{mark}` {{ #{key} }}", "", told)
            yield from self._parts(key, names, len(names) > 1)

    def _parts(self, key: str, names: list[str], named: bool = True) -> Iterator[str]:
        """What a key may hold, and then what that holds, as far as it was not shown yet."""
        new = [name for name in names if name not in self.shown]
        self.shown.update(new)
        for name in new:
            title, told = _heading(key, self.alike[name][0])
            yield from ("", f"### {title} {{ #{name.lower()} }}", "", told) if named else ()
            yield from ("", *self._table(self.alike[name])) if self._entries(self.alike[name][0]) else ()
        for name in new:
            for inner, entry in self._entries(self.alike[name][0]):
                yield from self._parts(inner, self._held(entry))

    def _table(self, parts: list[Part], sections: Part | None = None) -> Iterator[str]:
        """The keys of parts that differ in units alone; `sections` stand below, by their own headings."""
        yield from ("| key | unit | default | meaning |", "|---|---|---|---|")
        for key, entry in self._entries(parts[0]):
            units = dict.fromkeys(unit_in(part["properties"][key]) or "" for part in parts)
            told = re.sub(r" \[[^][]+\]$", "", entry["description"]) if any(units) else entry["description"]
            places = {name: f"#{key if sections else name.lower()}" for name in self._held(entry)}
            link = next(iter(places.values()), "") if sections or len(places) == 1 else ""
            if places and not link:
                told += f" Kinds: {', '.join(f'[{_kind(self.alike[name][0])}]({at})' for name, at in places.items())}."
            default = _default(entry, required=key in parts[0].get("required", ()))
            yield table_row((f"[`{key}`]({link})" if link else f"`{key}`", ", ".join(units), default, told))

    def _entries(self, part: Part) -> list[tuple[str, Part]]:
        """The keys of a part; its kind stands in its heading."""
        return [(key, entry) for key, entry in part.get("properties", {}).items() if key != "kind"]

    def _held(self, entry: Any) -> list[str]:
        """Shared names of the parts that a key holds, alone or in a list or table."""
        if isinstance(entry, dict) and "$ref" in entry:
            return [_shared(self.schema["$defs"][entry["$ref"].rpartition("/")[2]])]
        inner = entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ()
        return list(dict.fromkeys(name for one in inner for name in self._held(one)))


def _shared(part: Part) -> str:
    """The name of a part without its unit."""
    return part["title"].partition("[")[0]


def _kind(part: Part) -> str:
    """The kind that a part is of, or how it is told."""
    return f"`{part['properties']['kind']['const']}`" if "kind" in part["properties"] else part["title"]


def _heading(key: str, part: Part) -> tuple[str, str]:
    """A heading and a sentence: a description that begins with what is written goes on behind a colon."""
    text = "\n\n".join(" ".join(each.split()) for each in part["description"].split("\n\n")).removeprefix("Section ")
    head, colon, rest = text.partition(": ")
    if not (colon and head.startswith("`")):
        return f"`{key}`", text
    return head, rest[0].upper() + rest[1:]


def _default(entry: Part, *, required: bool) -> str:
    """What a key that is left out is taken for; empty where its meaning tells."""
    default = entry.get("default", "")
    if isinstance(default, list) and len({*map(str, default)}) == 1:
        default = default[0]  # of both axes
    if required or default in ("", []):
        return "required" if required else ""
    if isinstance(default, bool | int):
        return f"`{str(default).lower()}`"
    number, _, unit = str(default).partition(" ")
    return f"`{f'{float(number):.4g} {unit}'.strip() if re.match(r'-?[0-9]', number) else default}`"
