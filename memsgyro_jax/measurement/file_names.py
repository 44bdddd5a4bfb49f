"""What the names of files and of their folders tell: what a file is called beside others, and levels, temperatures and
voltages as people write them.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar


_NUMBER = r"(?P<number>\d+(?:[.p]\d+)?)"
_TEMPERATURE = re.compile(  # a dash behind a letter or a digit parts words, one behind anything else is a sign
    rf"(?<![A-Za-z0-9.])(?:[Tt](?:emp)?[ _=]?)?(?P<sign>(?<![A-Za-z0-9])[+-]|m(?:inus[ _]?)?(?=\d))?"
    rf"{_NUMBER}[ _]?(?P<unit>(?:deg[ _]?|°)?C|K)(?![A-Za-z])"
)
_NAMED_BIAS = r"(?:bias|polari[sz]ation|[vu]?[ _]?dc|vb)"
_BIAS = re.compile(
    rf"(?i:(?<![a-z]){_NAMED_BIAS})[ _=-]?(?P<sign>(?<![A-Za-z0-9])[+-])?{_NUMBER}[ _]?(?P<unit>[mk]?V)(?![A-Za-z])"
    rf"|(?<![A-Za-z0-9.]){_NUMBER.replace('number', 'before')}[ _]?(?P<of>[mk]?V)[ _]?(?i:{_NAMED_BIAS})(?![A-Za-z])"
)
_VOLTS = re.compile(rf"(?<![A-Za-z0-9.]){_NUMBER}[ _]?(?P<unit>k?V)(?![A-Za-z])")
_LEVEL = re.compile(  # of a drive that is not told as its peak value
    rf"(?<![A-Za-z0-9.]){_NUMBER}[ _]?(?P<unit>[nuµm]?[VA](?i:rms|pp))(?![A-Za-z])"
    rf"|(?:^|(?<=[ _]))(?P<sign>[+-]|m(?:inus[ _]?)?(?=\d))?{_NUMBER.replace('number', 'before')}[ _]?"
    r"(?P<of>dB[mV])(?![A-Za-z])"
)


_OF_A_DRIVE = re.compile(r"(?i)(?<![a-z])(?:driv|drv|excit)")
Told = TypeVar("Told")


@dataclass(frozen=True)
class FileName:
    """What one of several files is called: by itself, `shown` in sentences, `title` its record, and `folder` the one
    that tells something of it, empty where none does.
    """

    stem: str
    shown: str
    title: str
    folder: str


def names_of_files(paths: Sequence[Path]) -> list[FileName]:
    """What files are called beside each other. Those of one name are told apart by the folders that they are in, which
    then tell of all files in them; so does a folder of one file whose name has the word of a drive.
    """
    places = [path.absolute().parent for path in paths]
    apart = [_apart(path, place, paths) for path, place in zip(paths, places, strict=True)]
    each = Counter(places)
    telling = {place: folder for place, folder in zip(places, apart, strict=True) if folder}
    lone = {place: place.name for place in places if each[place] == 1 and _OF_A_DRIVE.search(place.name)}
    return [
        FileName(
            stem=path.stem,
            shown=f"{folder}/{path.name}" if folder else path.name,
            title=f"{folder}_{path.stem}" if folder and not alone else folder or path.stem,
            folder=(lone | telling).get(place, ""),
        )
        for path, place, folder in zip(paths, places, apart, strict=True)
        for alone in [each[place] == 1 and "demod" in path.stem]  # a name that tells nothing
    ]


def _apart(path: Path, place: Path, paths: Sequence[Path]) -> str:
    """The last folders of a file that tell it apart from others of its name; empty where none bears it."""
    others = {one.absolute().parent for one in paths if one.name == path.name} - {place}
    for depth in range(1, len(place.parts) + 1) if others else ():
        last = place.parts[-depth:]
        if all(other.parts[-depth:] != last for other in others):
            return "/".join(part.strip("/") for part in last)
    return ""


def told_by_names(name: str, folder: str, tell: Callable[[str], Told]) -> tuple[Told, str]:
    """What the name of a file tells, else that of its folder, and which of them: "file" or "folder"."""
    found = tell(name)
    return (tell(folder), "folder") if folder and not found else (found, "file")


def without_bias(stem: str) -> str:
    """The name of a file without the bias voltage that it tells, which is no level of a drive."""
    return _BIAS.sub(" ", stem)


def temperature_in_name(stem: str) -> str:
    """Like "-40 degC", of ``oven_m40C``; empty where the name tells none, or several."""
    return _only(_quantity(one, "K" if one["unit"] == "K" else "degC") for one in _TEMPERATURE.finditer(stem))


def bias_in_name(stem: str) -> str:
    """Like "10 V", of ``bias_10V`` and ``10Vdc``; empty where the name tells none, or several."""
    return _only(_quantity(one, one["unit"] or one["of"]) for one in _BIAS.finditer(stem))


def _quantity(found: re.Match[str], unit: str) -> str:
    words = found.groupdict()
    number = float((words["number"] or words["before"]).replace("p", "."))
    sign = -1.0 if (words.get("sign") or "+")[0] in "-m" else 1.0
    return f"{sign * number + 0.0:g} {unit}"


def _only(told: Iterator[str]) -> str:
    found = {*told}
    return found.pop() if len(found) == 1 else ""


def level_in_name(stem: str) -> str:
    """Like "20 mVrms", of ``sweep_20mVrms``, and "-26 dBV", of ``run_-26dBV`` and ``run_m26dBV``; empty where the name
    tells none, or several.
    """
    return _only(_quantity(one, one["unit"] or one["of"]) for one in _LEVEL.finditer(stem))


def volts_in_name(stem: str) -> str:
    """Like "10 V", of ``sweep_10V``, whatever it is that of; empty where the name tells none, or several."""
    return _only(_quantity(one, one["unit"]) for one in _VOLTS.finditer(stem))
