"""Changes to a text, drawn by a seed: damage, changes that mean nothing, and changes that mean another number."""

import re
from collections.abc import Callable

import numpy as np


Mutator = Callable[[bytes, np.random.Generator], bytes]
NUMBER = re.compile(rb"(?<![\w.#-])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?![\w.])")
EXTREMES = (
    *(b"0", b"-0.0", b"-1", b"1e308", b"1e400", b"1e-400", b"5e-324", b"nan", b"inf", b"-inf", b"1_0", b"0x1f", b"1,5"),
    *(b"1" * 30, b"9" * 5000, b"true", b'"text"', b"[]", b"{}", b"[[[]]]", b"", b"1979-05-27", b'"1 V"', b"'1 kg'"),
)
UNITS = (
    b"V",
    b"mV",
    b"Hz",
    b"kHz",
    b"rad/s",
    b"s",
    b"N",
    b"kg",
    b"m",
    b"1",
    b"",
    b"V^1e15",
    b"dBm",
    b"K",
    b"degC",
    b"V/m",
)
UNICODE = ("\ufeff", "\u0000", "\u2028", "\u00b5", "\u0663", "\U0001f4a5", "\x0c", "\r", "\x1b[31m", "\u202e", "é")


def _place(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(max(len(data), 1)))


def flip_bit(data: bytes, rng: np.random.Generator) -> bytes:
    """One bit."""
    place = _place(data, rng)
    return data[:place] + bytes([data[place] ^ (1 << int(rng.integers(8)))]) + data[place + 1 :] if data else data


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """The end is missing."""
    return data[: _place(data, rng)]


def drop_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """A few bytes are missing."""
    place = _place(data, rng)
    return data[:place] + data[place + int(rng.integers(1, 9)) :]


def insert_unicode(data: bytes, rng: np.random.Generator) -> bytes:
    """A character that no keyboard has."""
    place = _place(data, rng)
    return data[:place] + str(rng.choice(UNICODE)).encode() + data[place:]


def insert_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Binary rubbish."""
    place = _place(data, rng)
    return data[:place] + rng.bytes(int(rng.integers(1, 12))) + data[place:]


def _lines(change: Callable[[list[bytes], int, np.random.Generator], list[bytes]]) -> Mutator:
    def mutate(data: bytes, rng: np.random.Generator) -> bytes:
        lines = data.split(b"\n")
        return b"\n".join(change(lines, int(rng.integers(len(lines))), rng))

    return mutate


def _moved(lines: list[bytes], n: int, rng: np.random.Generator) -> list[bytes]:
    others, at = lines[:n] + lines[n + 1 :], int(rng.integers(len(lines)))
    return [*others[:at], lines[n], *others[at:]]


move_line = _lines(_moved)
drop_line = _lines(lambda lines, n, rng: lines[:n] + lines[n + 1 :])
double_line = _lines(lambda lines, n, rng: lines[: n + 1] + lines[n:])
misspell = _lines(lambda lines, n, rng: [*lines[:n], re.sub(rb"^(\w)(\w)", rb"\2\1", lines[n]), *lines[n + 1 :]])
decimal_comma = _lines(lambda lines, n, rng: [*lines[:n], lines[n].replace(b".", b","), *lines[n + 1 :]])


def _replaced(pattern: re.Pattern[bytes], choices: tuple[bytes, ...]) -> Mutator:
    def mutate(data: bytes, rng: np.random.Generator) -> bytes:
        places = list(pattern.finditer(data))
        if not places:
            return data
        place = places[int(rng.integers(len(places)))]
        return data[: place.start()] + choices[int(rng.integers(len(choices)))] + data[place.end() :]

    return mutate


extreme_number = _replaced(NUMBER, EXTREMES)
other_unit = _replaced(re.compile(rb'(?<=\[)[^\[\]",\n]+(?=\])|(?<=\d )[^"\n\d]+(?=")|(?<=unit = ")[^"]*'), UNITS)
other_value = _replaced(re.compile(rb"(?<== ).+"), EXTREMES)

DAMAGE: tuple[Mutator, ...] = (
    *(flip_bit, cut, drop_bytes, insert_unicode, insert_bytes, drop_line, double_line, move_line, misspell),
    *(decimal_comma, extreme_number, extreme_number, other_unit, other_value),
)


def other_number(data: bytes, rng: np.random.Generator) -> bytes:
    """One number of the text is another: a digit, the sign, or a factor of ten."""
    places = list(NUMBER.finditer(data))
    place = places[int(rng.integers(len(places)))]
    old = place.group()
    digits = [m.start() for m in re.finditer(rb"\d", re.split(rb"[eE]", old)[0])]
    at = digits[int(rng.integers(len(digits)))]
    new = (
        old[:at] + str((int(old[at : at + 1]) + int(rng.integers(1, 10))) % 10).encode() + old[at + 1 :],
        old[1:] if old.startswith(b"-") else b"-" + old,
        old + b"e1" if b"e" not in old.lower() else old + b"0",
    )[int(rng.integers(3))]
    same = float(new) == float(old)
    return data if same else data[: place.start()] + new + data[place.end() :]


def _ends(data: bytes, rng: np.random.Generator) -> bytes:
    return data.replace(b"\n", b"\r\n")


def _mark(data: bytes, rng: np.random.Generator) -> bytes:
    return b"\xef\xbb\xbf" + data


remark = _lines(lambda lines, n, rng: [*lines[:n], b"# 1e400 = nan", *lines[n:]])
blank = _lines(lambda lines, n, rng: [*lines[:n], b"", *lines[n:]])


def _spaces(data: bytes, rng: np.random.Generator) -> bytes:
    return data.replace(b" = ", b"  =\t") if b" = " in data else data.replace(b",", b", ")


NEUTRAL: tuple[Mutator, ...] = (_ends, _mark, remark, blank, _spaces)
