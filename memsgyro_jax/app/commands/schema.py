"""`memsgyro schema`: what editors check study files, cases and results against."""

import re
from typing import Any, Literal


Kind = Literal["study", "case", "diagnosis"]


def schema_command(kind: Kind, /) -> None:
    """The JSON schema of a study file, of a case.toml, or of what `diagnose --json` writes.

    An editor that knows TOML (Taplo, Even Better TOML) checks and completes a file whose first line names it:
    `memsgyro schema study > study.schema.json`, and "#:schema study.schema.json" as the first line of the study.

    Args:
        kind: of the file.
    """
    from memsgyro_jax.base.files import json_text

    print(json_text(schema_of(kind)))


def schema_of(kind: Kind) -> dict[str, Any]:
    """The schema, draft 2020-12."""
    if kind == "study":
        from ..study.file import StudyFile

        made = StudyFile.model_json_schema()
    elif kind == "case":
        from memsgyro_jax.measurement.case.file import case_model

        made = case_model().model_json_schema()
    else:
        from pydantic import TypeAdapter

        from .answer import DiagnosisAnswer

        made = TypeAdapter(DiagnosisAnswer).json_schema()
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return {**head, **for_editors(made), "title": f"memsgyro {kind}"}


def for_editors(made: dict[str, Any]) -> dict[str, Any]:
    """The schema that pydantic made, as an editor shows it best."""
    parts = made.get("$defs", {})
    for part in (made, *parts.values()):
        _describe(part)
    return _called(made, {name: re.sub(r"\W+", "_", part["title"]).strip("_") for name, part in parts.items()})


def _describe(section: dict[str, Any]) -> None:
    """Every key with its unit, `kind` with what it chooses, and what stands for a key that is left out as a file has
    it: a quantity with its unit, and nothing where another section or the device decides.
    """
    for key, entry in section.get("properties", {}).items():
        unit, told = unit_in(entry), entry.get("description") or (key == "kind" and section.get("description"))
        if told:
            entry["description"] = " ".join(told.split("\n\n")[0].split()) + (f" [{unit}]" if unit else "")
        default = entry.get("default")
        if default is None or isinstance(default, dict):
            entry.pop("default", None)
        elif unit not in (None, "", "1"):
            entry["default"] = _with_unit(default, unit)


def unit_in(entry: Any) -> str | None:
    """The unit of the quantity that a key holds, alone or in a list: "" for any, None for none."""
    inner = entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ()
    if isinstance(entry, dict) and "x-unit" in entry:
        return entry["x-unit"]
    return next((unit for unit in map(unit_in, inner) if unit is not None), None)


def _with_unit(number: Any, unit: str) -> Any:
    if isinstance(number, list):
        return [_with_unit(one, unit) for one in number]
    return number if isinstance(number, str) else f"{number!r} {unit}"


def _called(part: Any, names: dict[str, str]) -> Any:
    """The schema without discriminators, which a device given by its modes has not, and its parts by other `names`:
    those that pydantic gives to profiles tell all that they are made of.
    """
    if isinstance(part, list):
        return [_called(entry, names) for entry in part]
    if not isinstance(part, dict):
        return part
    out: dict[str, Any] = {}
    for key, entry in part.items():
        if key == "$ref":
            head, _, name = entry.rpartition("/")
            out[key] = f"{head}/{names[name]}"
        elif key == "$defs":
            out[key] = {names[name]: _called(inner, names) for name, inner in entry.items()}
        elif key != "discriminator" or not isinstance(entry, dict):
            out["anyOf" if key == "oneOf" else key] = _called(entry, names)
    return out
