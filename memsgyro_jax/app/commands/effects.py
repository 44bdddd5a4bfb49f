"""`memsgyro effects`: print the catalogue, and what a user's own file adds to it."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from memsgyro_jax.effects import Effect


SCHEMA = "memsgyro-effects/1"


def effects_command(own: Path | None = None, /, *, json: Path | None = None) -> None:
    """The catalogue of physical effects: name, unit of the strength, variants, law and reference.

    Args:
        own: a Python file with effects of your own, which are checked and listed alone. It is run: trust it first.
        json: file for the machine-readable list of the catalogue and your own.
    """
    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.effects import every_effect, load_effects

    from .options import require_writable

    require_writable(json)
    catalogue, added = every_effect(2), load_effects(own) if own else ()
    print(_listing(_described(added or catalogue)))
    if added:
        print("Checked: strength zero is absence, forces and their slopes are finite there, no name of the catalogue.")
    if json is not None:
        write_json(json, {"schema": SCHEMA, "effects": _described((*catalogue, *added))})


def _described(effects: "Sequence[Effect]") -> list[dict[str, Any]]:
    """One entry for effects of the same name and law, with all their variants."""
    entries: dict[tuple[str, str], dict[str, Any]] = {}
    for effect in effects:
        about = {"name": effect.name, "variants": [], "unit": effect.unit, "law": effect.law}
        entry = entries.setdefault((effect.name, effect.law), {**about, "reference": effect.reference})
        entry["variants"] += [effect.where] if effect.where else []
    return list(entries.values())


def _listing(entries: Sequence[dict[str, Any]]) -> str:
    """The entries for people, three lines each: name, unit and variants; law; reference."""
    wide = max(len(entry["name"]) for entry in entries)
    unit = max(len(entry["unit"]) for entry in entries)
    lines = []
    for entry in entries:
        lines.append(f"{entry['name']:{wide}}  {entry['unit']:{unit}}  {', '.join(entry['variants'])}".rstrip())
        lines += [f"    {entry[key]}" for key in ("law", "reference") if entry[key]]
    count = len({entry["name"] for entry in entries})
    counted = "1 effect" if count == 1 else f"{count} effects"
    return "\n".join([*lines, f"{counted}; name, unit of the strength s, variants. Strength zero means absent."])
