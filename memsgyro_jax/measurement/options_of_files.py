"""What options of an import say of each file, or of each record that is made of two."""

from collections.abc import Sequence
from pathlib import Path

from memsgyro_jax.base.errors import InputError

from .column_map import parse_map
from .demodulators import File, demodulators_joined
from .imported_conditions import for_each_file


_UNMAPPED = "whose names tell"
Level = tuple[float, str]  # with its unit


def joined_files(
    paths: Sequence[Path], read: Sequence[File], given: Sequence[str]
) -> tuple[list[Path], list[File], list[list[int]], list[dict[str, str]]]:
    """The files with the demodulators of one instrument made one each, the numbers of those that each is made of, and
    what was said of the columns of each, empty where nothing was. A file of whose columns something was said stays
    alone.

    Args:
        paths: of the files.
        read: their tables.
        given: maps, one for all files, one for each, or one for each record that they make.

    Raises:
        InputError: another number of maps, or one that cannot be read.
    """
    each = len(given) in (0, 1, len(paths))
    texts = for_each_file("--map", given, len(paths), _UNMAPPED) if each else []
    alone = {place for place, text in enumerate(texts) if _says(text)}
    kept, left, parts = demodulators_joined(paths, read, alone)
    if len(given) != len(kept) and not each:
        for_each_file("--map", given, len(paths), _UNMAPPED)
    texts = [texts[some[0]] for some in parts] if each else list(given)
    return kept, left, parts, [parse_map(text) if _says(text) else {} for text in texts]


def _says(text: str) -> bool:
    return text.strip() not in ("", "-")


def of_joined(given: Sequence[str], parts: Sequence[Sequence[int]], option: str) -> Sequence[str]:
    """What was said of each file, of those of which a record was made of two once; as it is where it was said
    otherwise.
    """
    if len(given) != sum(map(len, parts)) or all(len(some) == 1 for some in parts):
        return given
    if any(given[k] != given[some[0]] for some in parts for k in some):
        raise InputError(f"Option `{option}` must say the same of two files that are the two channels of one record.")
    return [given[some[0]] for some in parts]


def levels_of_files(given: Sequence[Level | None], swept: Sequence[bool], using: Sequence[bool]) -> list[Level | None]:
    """The level of each file, of which those that are `swept` without a column for it need one, while ratios are among
    those that use one.
    """
    if len(given) <= 1:
        return [given[0] if given else None] * len(swept)
    if len(given) == len(swept):
        return list(given)
    for files in (swept, using):
        if len(given) == sum(files):
            left = iter(given)
            return [next(left) if takes else None for takes in files]
    raise InputError(
        f"Option `--drive` must be given once, for each of {len(swept)} files (`-` for one that needs no level), or "
        f"for each of the {sum(swept)} that need one, but has {len(given)}."
    )
