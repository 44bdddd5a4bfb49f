"""The border: text, units and conventions on the outside, SI on the inside.

Conversions are plain arithmetic and take floats, NumPy or JAX arrays of any shape. Text with units goes through pint,
which is imported on first use.

Three conventions that are easily confused, for white noise (IEEE Std 952 and 1431):

- **per-sample standard deviation** σ at sampling rate f_s: what a simulation adds to each sample;
- **one-sided density** d, in unit/√Hz over 0 … f_s/2: what data sheets and analysers quote; σ = d √(f_s/2);
- **angle random walk** N, in deg/√h: rate noise whose *two-sided* power density is N², so that the Allan variance is
  N²/τ and the one-sided density is √2 N.
"""

import atexit
import contextlib
import json
import math
import re
from functools import cache
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from .errors import InputError
from .files import write_whole
from .runtime import cache_directory
from .text import printable


_DEGREE = math.pi / 180.0
_HEADER = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*\[\s*(?P<unit>[^\[\]]*?)\s*\]\s*")
_ROOT = re.compile(r"sqrt\(([^()]+)\)|√\(([^()]+)\)|√([^\W\d_]+)")


TO_PEAK = {"rms": math.sqrt(2.0), "pp": 0.5, "pk": 1.0}
"""What a sine's effective, peak-to-peak or peak value is multiplied with to be its peak amplitude."""

NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
"""A number in a file; Python's float() would also take nan, inf, 1_000 and digits of other scripts."""
_NUMBER = re.compile(NUMBER)
_EXPONENT = r"\(?\s*[+-]?\s*[0-9.]+\s*(?:/\s*[0-9]+\s*)?\)?(?![\w.]|\s*(?:\*\*|\^))"
_POWER = re.compile(rf"(?:\*\*|\^)\s*(?P<exponent>{_EXPONENT})?")
_FOREIGN = re.compile(r"[^\w\s*/^().+√·°%Ωµμ²³¹⁰⁴-⁹⁻⁺-]|[^ \S]")
_COINED = re.compile(  # of data sheets; German, which pint takes for 1e9 rad; of rate tables
    r"\b(?:(?P<prefix>[munµ]?)dps|(?P<word>Grad|RPM|(?:rev|Umdr|U|r)(?=/(?:min|s)\b)))\b"
)
_WORDS = {"Grad": "deg", "RPM": "rpm"}  # further ones are turns
_COMMON = "V A N Hz m s g K F W Pa rad deg degC rpm ppm percent"
_WORD = re.compile(r"[^\W\d_]+")
_HOW = re.compile(r"(?P<base>[^\W\d_]+?)_?(?P<how>rms|pp|pk)", re.IGNORECASE)
_HIGHEST = 20.0  # power of a unit
_LONGEST = 80  # characters of a unit
_APART: list[float] = []  # in place of a line: two units without a common dimension, and one that is a logarithm
_CURVED = [0.0]


class Column(NamedTuple):
    """One CSV column as its header names it.

    Args:
        name: text before the bracket, e.g. ``"rate"``.
        unit: text inside the bracket, e.g. ``"deg/s"``.
    """

    name: str
    unit: str


def rate_to_dps(rate: Any) -> Any:
    """Rate in rad/s to deg/s."""
    return rate / _DEGREE


def decimal(text: str) -> float:
    """The number that a file means by `text`; raises `ValueError` for anything else, and for one that would silently
    become infinite or zero.
    """
    if _NUMBER.fullmatch(text) is None:
        raise ValueError("must be a finite number, but " + (f"is `{printable(text, 60)}`" if text else "is missing"))
    value = float(text)
    if not math.isfinite(value) or (value == 0.0 and any(c in "123456789" for c in re.split("[eE]", text)[0])):
        size = "small" if value == 0.0 else "large"
        raise ValueError(f"must be a finite number, but `{printable(text, 60)}` is too {size} for a computer")
    return value


def parse_header(text: str) -> Column:
    """Reads a CSV column header ``name [unit]``.

    Args:
        text: the header, e.g. ``"rate [deg/s]"``; a pure number is written ``[1]``.

    Raises:
        InputError: if the name or the unit is missing; the caller adds file and column.
    """
    match = _HEADER.fullmatch(text)
    if match is None or not match["name"] or not match["unit"]:
        found = printable(text.strip(), 60)
        raise InputError(f'Column header must read "name [unit]", e.g. "rate [deg/s]" or "gain [1]", but is "{found}".')
    return Column(match["name"], match["unit"])


def to_si(value: Any, unit: str, expected: str, name: str) -> Any:
    """Converts `value` from `unit` to the SI unit `expected`.

    Angles count as a dimension of their own, so that Hz is never taken for rad/s or the reverse.

    Args:
        value: number or array, in `unit`.
        unit: any unit pint knows, also with ``sqrt(...)`` or ``√``, e.g. ``"nN"``, ``"deg/s"``, ``"uV/sqrt(Hz)"``;
            a pure number is ``"1"``.
        expected: the SI unit wanted, e.g. ``"N"``, ``"rad/s"``, ``"V/sqrt(Hz)"``, ``"1"``.
        name: what the value is, for the message: a column, key or argument with where it stands.

    Returns:
        The number or array in `expected`.

    Raises:
        InputError: if `unit` is unknown or measures something else than `expected`.
    """
    try:
        line = _conversion(unit, expected, name)
        if line == _APART:
            celsius = '; degrees Celsius are "degC"' if expected == "K" and unit == "C" else ""  # which is coulomb
            raise InputError(f'Unit of {name} must measure the same as "{expected}", but is "{unit}"{celsius}.')
        with np.errstate(over="ignore", under="ignore"):
            if line == _CURVED:
                found = _registry().Quantity(value, _parse(unit, name)).to(_parse(expected, name)).magnitude
            else:
                found = value * line[0] + line[1] if line[1] else value * line[0]
    except OverflowError:  # of the factor between the units
        found = np.inf
    if np.any(np.isfinite(value) & (~np.isfinite(found) | ((np.asarray(value) != 0) & (np.asarray(found) == 0)))):
        raise InputError(f'Unit of {name} must leave a finite number in "{expected}", but "{unit}" does not.')
    return found


def base_powers(unit: str) -> dict[str, float]:
    """Powers of the SI base units ("kilogram", "meter", "ampere", ...) in a unit; raises `InputError` for none."""
    found = _registry().Quantity(1.0, _parse(unit, "the number")).to_base_units().units
    return {str(name): float(power) for name, power in dict(found._units).items()}


def without_roots(unit: str) -> str:
    """A unit as pint reads it, which reads a root as nothing: V/√Hz is V/(Hz)**0.5."""
    return _ROOT.sub(lambda match: f"({next(filter(None, match.groups()))})**0.5", unit)


def to_peak(unit: str) -> tuple[float, str]:
    """What a number of a unit like "mVrms", "Vpp" or "Vpk" is multiplied with to be a peak amplitude, and the unit of
    that; 1 and the unit itself where it does not say how an amplitude is meant.
    """
    found = _HOW.fullmatch(unit.replace(" ", ""))
    return (TO_PEAK[found["how"].lower()], found["base"]) if found and _is_known(found["base"]) else (1.0, unit)


def _in_full(unit: str) -> str:
    """The unit with what pint calls degrees per second, `dps`, degrees, `Grad`, and turns, as in `rev/min`."""

    def full(found: re.Match) -> str:
        return _WORDS.get(found["word"], "turn") if found["word"] else f"({found['prefix']}deg/s)"

    return _COINED.sub(full, unit)


def _conversion(unit: str, expected: str, name: str) -> list[float]:
    """What a number of `unit` is multiplied with to be one of `expected`, and what is then added.

    Answers stay on disk, for pint takes a second to be imported.
    """
    for text in (unit, expected):
        _require_plain(text, name)
    known, key = _answers(), f"{_in_full(unit)} -> {_in_full(expected)}"
    if key not in known:
        source, target = _parse(unit, name), _parse(expected, name)
        same = _dimension(source) == _dimension(target)
        known[key] = _line(source, target) if same else _APART
    return known[key]


@cache
def _answers() -> dict[str, list[float]]:
    """Conversions that were asked for before; written when the process ends, if there are more by then."""
    folder, found = cache_directory(), dict[str, list[float]]()
    if folder is None:
        return found
    place = folder / "units" / f"lines-{version('pint')}.json"
    with contextlib.suppress(OSError, ValueError):  # not there, or damaged: as if it had never been
        found = json.loads(place.read_text())
    before = len(found)

    def keep() -> None:
        if len(found) > before:
            with contextlib.suppress(OSError):
                place.parent.mkdir(parents=True, exist_ok=True)
                write_whole(place, json.dumps(found))

    atexit.register(keep)
    return found


@cache
def _registry() -> Any:
    import pint

    cache = cache_directory()
    try:
        return pint.UnitRegistry(cache_folder=cache and cache / "units")  # its definitions, parsed
    except Exception:  # a folder that cannot be written, a file there that is damaged
        return pint.UnitRegistry()


@cache
def _parse(text: str, name: str) -> Any:
    _require_plain(text, name)
    try:
        return _registry().parse_units(without_roots(_in_full(text)))
    except Exception as error:  # pint raises its own, tokenizer and assertion errors alike for text it cannot read
        raise _unreadable(text, name, _meant(text)) from error


def _require_plain(text: str, name: str) -> None:
    """Refuses what pint would pass over, any power, however long it would take, and an empty text for a pure number, so
    that a forgotten unit is noticed.
    """
    if _FOREIGN.search(text) or len(text) > _LONGEST or not text.strip():
        raise _unreadable(text, name)
    try:
        powers = [_is_power(found["exponent"]) for found in _POWER.finditer(without_roots(text))]
    except ValueError:  # no number
        powers = [False]
    if not all(powers):
        raise _unreadable(text, name)


def _unreadable(text: str, name: str, remedy: str = ".") -> InputError:
    shown = printable(text, 60)
    return InputError(
        f'Unit of {name} must be one that can be read, e.g. "um", "deg/s" or "1", but is "{shown}"{remedy}'
    )


def _meant(text: str) -> str:
    """The end of a sentence about a unit that is plain, but none: what it may mean."""
    factor, base = to_peak(text)
    if base != text:
        turned = f", {factor:.4g} times the number" if factor != 1 else ""
        return f'; write "{base}", and of an amplitude its peak value{turned}.'
    meant = _WORD.sub(lambda found: _usual(found[0]), text)
    return f'; did you mean "{meant}"?' if meant != text and _is_known(meant) else "."


def _usual(word: str) -> str:
    """The unit that a word in capitals and small letters of its own may mean, of the prefix that it has if there is
    one; the word itself where it is a unit, or none is like it.
    """
    if _is_known(word):
        return word
    usual = [prefix + unit for unit in _COMMON.split() for prefix in ("", *"pnuµmkMG")]
    near = [unit for unit in usual if unit.casefold() == word.casefold()]
    near = [unit for unit in near if not unit.startswith("mH") or unit == "mH"] or near  # no resonator is so slow
    return min(near, key=lambda unit: unit[0] != word[0], default=word.lower() if _is_known(word.lower()) else word)


def _is_known(unit: str) -> bool:
    """Whether pint knows the unit."""
    try:
        _registry().parse_units(without_roots(_in_full(unit)))
    except Exception:  # as above
        return False
    return True


def _is_power(exponent: str | None) -> bool:
    """Whether what stands behind `**` is a plain number of a size that units have."""
    if exponent is None:
        return False
    over, _, under = exponent.strip("() ").partition("/")
    return abs(float(over.replace(" ", ""))) <= _HIGHEST and float(under or 1) != 0


def _line(source: Any, target: Any) -> list[float]:
    """What a number of units `source` is multiplied with, and what is added, as between temperatures."""
    zero, one, far = (float(_registry().Quantity(value, source).to(target).magnitude) for value in (0.0, 1.0, 1e3))
    if zero == 0.0:
        return [one, 0.0]
    slope = (far - zero) / 1e3
    return [slope, zero] if math.isclose(one, zero + slope, rel_tol=1e-12) else _CURVED


@cache
def _dimension(unit: Any) -> Any:
    """Product of base units, in which radian stays visible (pint's own dimensionality drops it)."""
    return _registry().get_root_units(unit)[1]
