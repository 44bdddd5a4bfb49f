"""In words, at what drive, temperature, bias voltage and rate records were taken, for captions of their pictures."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from memsgyro_jax.base.text import spoken
from memsgyro_jax.measurement.declared import Declared
from memsgyro_jax.measurement.experiments import AbstractRecord
from memsgyro_jax.measurement.experiments.deviation import Known


_DIGITS = 4


def settings_in_words(records: Sequence[AbstractRecord], declared: Declared) -> tuple[str, ...]:
    """Of each record what it tells of its settings, but not where all records of the case agree in one value."""
    every = [_settings(record, declared) for record in records]
    told = {name for known in every for name in known if len(_values(every, name)) > 1}
    return tuple(", ".join(f"{name} {_range(one)}" for name, one in known.items() if name in told) for known in every)


def _settings(record: Any, declared: Declared) -> dict[str, Known]:
    """By name; a kind of measurement may know of none."""
    known = getattr(record, "known", None)
    return {} if known is None else {one.name: one for one in known(declared) if one.set and one.values.size}


def _values(every: list[dict[str, Known]], name: str) -> set[str]:
    """Those of all records, as they are told."""
    return {_range(known[name]) for known in every if name in known}


def _range(known: Known) -> str:
    """The value of all rows, or from where to where."""
    ends = [spoken(float(end(known.values)), known.unit, _DIGITS) for end in (np.min, np.max)]
    return " to ".join(dict.fromkeys(ends))
