"""Names of files in a study, which start at the folder of the study file."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, ValidationInfo
from pydantic_core.core_schema import SerializationInfo


FOLDER = "folder"  # key of the context that validation and writing get: where relative file names start


def _found(given: Any, info: ValidationInfo) -> Any:
    return (info.context or {}).get(FOLDER, Path()) / Path(given) if isinstance(given, str | Path) else given


def _as_text(file: Path, info: SerializationInfo) -> str:
    """Relative where the file lies below the folder that is written to, else whole."""
    folder = (info.context or {}).get(FOLDER)
    if folder is None:
        return str(file.resolve())
    folder, file = Path(folder).resolve(), file.resolve()
    return file.relative_to(folder).as_posix() if file.is_relative_to(folder) else str(file)


RelativePath = Annotated[Path, BeforeValidator(_found), PlainSerializer(_as_text)]
