"""Name and unit of a column from the text above it, in the ways in which instruments write them."""

import re

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import to_si


_BRACKETS = re.compile(r"^(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*$")
_BEHIND = re.compile(r"^(.*?)\s*(?:[/,:_]|\s)\s*([^\s/,:_]+(?:/√?[^\s/,:_]+)?)$")
_PER_SECOND = re.compile(r"^(.+?)[_ ]([pnuµm]?m|deg|rad)_s(2?)$")  # names without room for a slash: vel_mm_s
_OVER_C = re.compile(r"[VvUuIiQq][_ ]C")  # voltage, current or charge of a capacitor
_BARE = {
    "Hz", "kHz", "MHz", "GHz", "s", "ms", "us", "µs", "ns", "V", "mV", "uV", "µV", "nV", "A", "mA", "uA", "µA", "nA",
    "Vrms", "mVrms", "Vpp", "Vpk", "dB", "dBV", "dBm", "deg", "°", "rad", "degC", "°C", "K", "mK", "N", "mN", "nN",
    "m", "mm", "um", "µm", "nm", "m/s", "m/s^2", "sec", "second", "seconds", "Volt", "Volts", "degrees", "rad/s",
    "deg/s", "dps", "mdps", "Grad", "Ohm", "ohm", "kOhm", "MOhm", "Ω", "kΩ", "MΩ",
}  # fmt: skip
_SAME = {
    "°": "deg", "degree": "deg", "degrees": "deg", "sec": "s", "second": "s", "seconds": "s", "secs": "s",
    "Volt": "V", "Volts": "V", "volt": "V", "volts": "V", "volts rms": "Vrms", "°C": "degC", "ºC": "degC", "C": "degC",
    "deg C": "degC", "HZ": "Hz", "hz": "Hz", "hertz": "Hz", "Hertz": "Hz", "khz": "kHz", "KHz": "kHz", "Mhz": "MHz",
    "SEC": "s", "Sec": "s", "V rms": "Vrms", "V_rms": "Vrms", "V RMS": "Vrms", "VRMS": "Vrms", "Vp-p": "Vpp",
    "V pp": "Vpp", "Vp": "Vpk", "V pk": "Vpk", "V_pk": "Vpk", "-": "1", "none": "1", "a.u.": "1", "arb": "1",
    "arb.": "1", "lin": "1", "dBVrms": "dBV", "counts": "1", "LSB": "1", "strain": "1", "m/m": "1", "ue": "ppm",
    "µε": "ppm", "µm/m": "ppm", "um/m": "ppm", "g": "g_0", "gn": "g_0", "Deg": "deg", "DEG": "deg", "Rad": "rad",
    "Newtons": "N", "Amps": "A", "dbm": "dBm", "db": "dB", "RAD": "rad", "dBV rms": "dBV", "v": "V", "mv": "mV",
    "Ohm": "ohm", "Ohms": "ohm", "ohms": "ohm", "OHM": "ohm", "Ω": "ohm", "kOhm": "kohm", "kΩ": "kohm", "MOhm": "Mohm",
    "MΩ": "Mohm", "mOhm": "mohm", "Siemens": "S",
}  # fmt: skip
SPECIAL = re.compile(r"(?P<decibel>dBV|dBm|dB)|(?P<base>[a-zA-Zµμ]+?)(?P<how>rms|pp|pk)")
"""Units that say how an amplitude is meant."""


def split_header(text: str) -> tuple[str, str]:
    """Name and unit of a header; the unit is empty where none can be made out."""
    text = text.strip().strip('"').strip()
    if found := _BRACKETS.match(text):
        unit = tidy_unit(found[2] if found[2] is not None else found[3])
        if unit:
            return found[1] or unit, unit
    if found := _PER_SECOND.match(text):
        return found[1], f"{found[2]}/s" + ("^2" if found[3] else "")
    celsius = ("C",) if not _OVER_C.fullmatch(text) else ()
    if (found := _BEHIND.match(text)) and found[1] and (found[2] in _BARE or found[2] in ("sec", "%", *celsius)):
        return found[1].rstrip("_ "), tidy_unit(found[2])
    return text, ""


def tidy_unit(text: str) -> str:
    """The unit that a text means, in the words of this package; empty where it means none."""
    text = text.strip().replace("μ", "µ")
    text = _SAME.get(text, text)
    if text == "%":
        return "percent"
    if not text or is_unit(text):
        return text
    return text.lower() if len(text) > 3 and is_unit(text.lower()) else ""


def is_unit(text: str) -> bool:
    """Whether a text is a unit that can be converted."""
    if found := SPECIAL.fullmatch(text):
        return found["decibel"] is not None or is_unit(found["base"])
    try:
        to_si(1.0, text, text, "the column")
    except InputError:
        return False
    return True
