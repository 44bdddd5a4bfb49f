"""Which columns of a table are the readings of two channels, and which axis was driven, as their names say."""

import re
from collections.abc import Iterable, Mapping, Sequence

from .formats import SourceColumn


PARTS = {
    "I": {"x", "i", "re", "real", "inphase", "realz"},
    "Q": {"y", "q", "im", "imag", "imaginary", "quadrature", "quad", "imagz"},
}
"""Last words of a name for the parts of a phasor."""
_PART_OF = {word: part for part, words in PARTS.items() for word in words} | {
    **dict.fromkeys(("r", "amp", "ampl", "amplitude", "magnitude", "mag", "abs", "modulus", "betrag"), "amp"),
    **dict.fromkeys(("phase", "theta", "phi", "arg", "angle"), "phase"),
}
_AXES = {"vx": "x", "vy": "y", "x": "x", "y": "y"}
_JOINED = re.compile(r"(i|q|re|im|amp|phase|theta)([xy])")
_FORMS = ({"I", "Q"}, {"amp", "phase"}, {"amp"})
_DRIVEN = re.compile(
    r"(?<![a-z])(?:drive|driven|drv|excited?|excitation|force|axis)(?:[ _.-]*(?:on|at|axis))?[ _.-]*([xy])(?![a-z])|"
    r"(?<![a-z0-9])([xy])[ _.-]*(?:drive|driven|drv|excited|excitation|force|axis)(?![a-z])"
)
_ALONE = re.compile(r"(?<![a-z0-9])([xy])(?![a-z])")


def plain_words(name: str) -> str:
    """A name in small letters, its words apart."""
    name = " ".join(re.sub(r"[_\-/.:|()]+", " ", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)).lower().split())
    return re.sub(r"\bin ?phase\b", "inphase", name)


def channel_and_part(name: str) -> tuple[str, str]:
    """Of which channel a column is, "x" and "y" or a number, and which part of its phasor; empty where no word says."""
    words: list[str] = []
    numbers: list[str] = []
    for word in plain_words(name).split():
        if joined := _JOINED.fullmatch(word):
            words += joined.groups()
        elif found := re.fullmatch(r"([^\W\d]*?)(\d+)", word):
            numbers.append(found[2])
            words += [found[1]] if found[1] else []
        else:
            words.append(word)
    parts = [word for word in words if word in _PART_OF]
    axes = [word for word in words if word in _AXES]
    others = [word for word in parts if word not in axes]
    if len(axes) == len(others) == 1:
        return _AXES[axes[0]], _PART_OF[others[0]]
    if len(parts) == len(numbers) == 1 and not re.search(r"\bs\d\d\b", plain_words(name)):  # of a network analyser
        return numbers[0], _PART_OF[parts[0]]
    return "", ""


def two_channels(columns: Iterable[SourceColumn]) -> dict[str, SourceColumn]:
    """Parts of both channels, "I" and "y_I" and so on, of columns that are readings; none where they are not clearly
    those of two channels in one form.
    """
    found: dict[str, dict[str, SourceColumn]] = {}
    for column in columns:
        label, part = channel_and_part(column.name)
        if not part or part in found.get(label, {}):
            return {}
        found.setdefault(label, {})[part] = column
    if len(found) != 2 or len({label.isdigit() for label in found}) != 1:
        return {}
    first, second = (found[label] for label in sorted(found, key=lambda label: (len(label), label)))
    form = next((form for form in _FORMS if form <= {*first} and form <= {*second}), None)
    if form is None or {*first} != {*second}:
        return {}
    return {part: first[part] for part in sorted(form)} | {f"y_{part}": second[part] for part in sorted(form)}


def two_waveforms(columns: Sequence[SourceColumn]) -> tuple[SourceColumn, SourceColumn] | None:
    """The waveforms of x and y of two columns, where their names say so, like ``Vx`` and ``Vy``."""
    found = {_AXES[name]: column for column in columns if (name := plain_words(column.name)) in _AXES}
    return (found["x"], found["y"]) if len(columns) == len(found) == 2 else None


def two_drives(columns: Sequence[SourceColumn]) -> tuple[SourceColumn, SourceColumn] | None:
    """The drives of x and y of two columns, where their names say so, like ``u_x`` and ``u_y``."""
    found = {axis: column for column in columns if (axis := axis_of_drive(column.name))}
    return (found["x"], found["y"]) if len(columns) == len(found) == 2 else None


def said_of_channels(columns: Mapping[str, SourceColumn]) -> str:
    """The sentence on what two channels were taken for."""
    named = [
        " and ".join(
            f"`{columns[prefix + part].name}`" for part in ("I", "Q", "amp", "phase") if prefix + part in columns
        )
        for prefix in ("", "y_")
    ]
    named = [columns["signal"].name, columns["y_signal"].name] if "y_signal" in columns else named
    made = "the readings of two channels make it a device of two axes (`single_mass`)"
    return f"{made}, x read by {named[0]}, y by {named[1]}"


def axis_of_drive(name: str) -> str:
    """The axis that the name of a column of drives has, like ``F_x``; empty where it has none."""
    found = re.search(
        r"(?:^|\s)(?:f|u|v|i|drive|force|excitation) ?([xy])$|^([xy]) (?:drive|force|excitation)\b", plain_words(name)
    )
    return (found[1] or found[2]) if found else ""


def axis_in_name(name: str) -> str:
    """The axis that was driven, as the name of a record says, like ``drive_x_20mV``; empty where it does not."""
    name = re.sub(r"(?<=[a-z])(?=[XY](?![A-Za-z]))", "_", name).lower()
    for words in (_DRIVEN, _ALONE):
        said = {axis for found in words.finditer(name) for axis in found.groups() if axis}
        if len(said) == 1:
            return said.pop()
        if said:
            return ""
    return ""
