"""Conditions that only the names of files tell: nothing is taken from them without a word, but it is hinted at."""

from collections.abc import Mapping, Sequence

from memsgyro_jax.base.units import parse_header, to_si

from .file_names import FileName, bias_in_name, temperature_in_name, told_by_names, volts_in_name
from .imported_conditions import CONDITIONS
from .imported_record import ImportedRecord


_USUAL = 298.15, 1.0  # K, and how near to it no word is needed


def hints(
    files: Sequence[FileName], found: Sequence[Sequence[ImportedRecord]], given: Mapping[str, Sequence[str]]
) -> tuple[str, ...]:
    """A sentence with the option to copy for each condition that names of files tell, and no column and no option.

    Args:
        files: what they are called, in the order of the options.
        found: the records of each.
        given: what the options say, by role.
    """
    told = {
        "T": [told_by_names(one.stem, one.folder, temperature_in_name)[0] for one in files],
        "V_bias": [told_by_names(one.stem, one.folder, bias_in_name)[0] for one in files],
    }
    if not any(told["V_bias"]):
        told["V_bias"] = _volts(files, found)
    sentences = []
    for role, values in told.items():
        open_ = [bool(value) and _may_have(role, some) for value, some in zip(values, found, strict=True)]
        if given[role] or not any(open_) or (role == "T" and _is_usual(values)):
            continue
        known = CONDITIONS[role]
        shown = " ".join(f'"{value}"' if use else "-" for value, use in zip(values, open_, strict=True))
        sentences.append(
            f"the names of files or folders tell a {known.words}, which no column and no option does and which "
            f"is not used; if it is that at which they were recorded, give it: {known.option} {shown}"
        )
    return tuple(sentences)


def _volts(files: Sequence[FileName], found: Sequence[Sequence[ImportedRecord]]) -> list[str]:
    """Voltages in names, where they differ and none is the level of a drive."""
    volts = [told_by_names(one.stem, one.folder, volts_in_name)[0] for one in files]
    levels = any(
        any(sentence.startswith(f"the drive is {value}, as the ") for sentence in one.assumed)
        for value, some in zip(volts, found, strict=True)
        for one in some
    )
    return volts if len({*filter(None, volts)}) > 1 and not levels else [""] * len(files)


def _may_have(role: str, records: Sequence[ImportedRecord]) -> bool:
    """Whether records have none of a condition."""
    told = {parse_header(header).name for record in records for header in record.columns}
    return bool(records) and role not in told


def _is_usual(values: Sequence[str]) -> bool:
    """Whether all temperatures are that of a case that names none."""
    room, near = _USUAL
    split = [value.split() for value in values if value]
    return all(abs(float(to_si(float(number), unit, "K", "the name")) - room) <= near for number, unit in split)
