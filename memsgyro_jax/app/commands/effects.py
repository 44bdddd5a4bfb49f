"""What `memsgyro effects` does: print the catalogue, and what a user's own file adds to it."""

import json as formats
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from memsgyro_jax.base.files import write_whole
from memsgyro_jax.effects import Effect, catalogue, load_effects


SCHEMA = "memsgyro-effects/1"


def run(own: Path | None, json: Path | None) -> None:
    """Read the user's file if there is one, print all effects, and write what was asked for."""
    effects = (*catalogue(2), *(load_effects(own) if own else ()))
    entries = described(effects)
    print(table(entries))
    if json is not None:
        write_whole(json, formats.dumps({"schema": SCHEMA, "effects": entries}, indent=2, ensure_ascii=False) + "\n")


def described(effects: Sequence[Effect]) -> list[dict[str, Any]]:
    """One entry for effects of the same name and law, with all their variants."""
    entries: dict[tuple[str, str], dict[str, Any]] = {}
    for effect in effects:
        about = {"name": effect.name, "variants": [], "unit": effect.unit, "law": effect.law}
        entry = entries.setdefault((effect.name, effect.law), {**about, "reference": effect.reference})
        entry["variants"] += [effect.where] if effect.where else []
    return list(entries.values())


def table(entries: Sequence[dict[str, Any]]) -> str:
    """The entries for people, three lines each: name, unit and variants; law; reference."""
    wide = max(len(entry["name"]) for entry in entries)
    unit = max(len(entry["unit"]) for entry in entries)
    lines = []
    for entry in entries:
        lines.append(f"{entry['name']:{wide}}  {entry['unit']:{unit}}  {', '.join(entry['variants'])}".rstrip())
        lines += [f"    {entry[key]}" for key in ("law", "reference") if entry[key]]
    count = len({entry["name"] for entry in entries})
    return "\n".join([*lines, f"{count} effects; name, unit of the strength s, variants. Strength zero means absent."])
