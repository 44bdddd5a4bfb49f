"""Temperatures and voltages that the names of files tell, as people write them."""

import re
from collections.abc import Iterator


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
