"""The step from sample to sample where a file tells it, or their rate, beside readings without a time of their own."""

import contextlib
import re
from collections.abc import Mapping

import numpy as np

from memsgyro_jax.base.quantity import number_and_unit
from memsgyro_jax.base.units import to_si

from .header import split_header, tidy_unit


_RATES = {
    "fs", "fsample", "fsamp", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency", "samplespersecond",
    "sr", "abtastrate",
}  # fmt: skip
_STEPS = {
    "dt", "deltax", "deltat", "xincrement", "xinc", "wfincrement", "sampleinterval", "samplinginterval",
    "sampleperiod", "samplingperiod", "timestep",
}  # fmt: skip
_UNIT_OF = ("{}_unit", "{} unit", "{}_units")


def step_of_samples(attributes: Mapping[str, str]) -> tuple[float, str]:
    """Seconds from sample to sample and the name of the attribute that tells them; (0, "") where none does."""
    for name, text in attributes.items():
        plain, unit = split_header(name.rpartition("/")[2])
        word = re.sub(r"[^a-z]", "", plain.lower())
        usual = "Hz" if word in _RATES else "s" if word in _STEPS else ""
        if not usual:
            continue
        with contextlib.suppress(ValueError):
            value, own = number_and_unit(re.sub(r"(?<=\d),(?=\d)", ".", text))
            beside = next((attributes[key] for like in _UNIT_OF if (key := like.format(name)) in attributes), "")
            step = _seconds(value, tidy_unit(own) or unit or beside or usual)
            if 0.0 < step < np.inf:
                return step, name
    return 0.0, ""


def _seconds(value: float, unit: str) -> float:
    """Of a rate or a step; zero where its unit is that of neither."""
    for kind in ("Hz", "s"):
        with contextlib.suppress(ValueError, ZeroDivisionError):
            number = to_si(value, unit, kind, "the step")
            return 1.0 / number if kind == "Hz" else number
    return 0.0
