"""What is looked at in a study before seconds are spent on importing what runs it."""

import tomllib
from pathlib import Path

from memsgyro_jax.base.files import read_text


def look_for_study(study: Path | None, *others: Path | None) -> None:
    """Raises the error of a study that is not there or no TOML, and of another file that is not there."""
    for path in filter(None, others):
        if not path.exists():
            read_text(path, "file")
    if study is None:
        return
    text = read_text(study, "study file")
    try:
        tomllib.loads(text)
    except (ValueError, RecursionError):
        from memsgyro_jax.base.toml import read_toml  # takes longer, and finds the words

        read_toml(study, "study file")
