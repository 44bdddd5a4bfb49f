"""`memsgyro schema`: what editors check study files, cases and results against."""

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
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_any_of(made), "title": f"memsgyro {kind}"}


def _any_of(part: Any) -> Any:
    """The schema without discriminators, which a device given by its modes has not."""
    if isinstance(part, list):
        return [_any_of(entry) for entry in part]
    if not isinstance(part, dict):
        return part
    kept = {key: entry for key, entry in part.items() if key != "discriminator" or not isinstance(entry, dict)}
    return {"anyOf" if key == "oneOf" else key: _any_of(entry) for key, entry in kept.items()}
