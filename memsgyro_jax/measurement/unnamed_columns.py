"""What columns without names may be, for the `--map` of a message."""

import re
from dataclasses import replace

import numpy as np

from .formats import SourceColumn, SourceTable


_CALENDAR = (1e9, 2.2e9)  # seconds of a calendar, from 2001 to 2039
_HIGHEST = 1e12  # Hz: above it milliseconds of a calendar
_TURNS = 10.0  # of a phase in degrees, which covers more than one in radians does
_WIDER = 5.0  # times what stands beside it, as degrees are beside decibels or an amplitude


def unnamed_sweep(table: SourceTable) -> dict[str, list[SourceColumn]]:
    """The frequency and the parts of a phasor, role to column, if a table of two or three columns without names, but
    for those that stay as they are, begins with what rises like a frequency, in a band away from zero, and not like a
    time; else nothing. Units that the numbers tell, decibels and degrees, stand with them.
    """
    if not all(re.fullmatch(r"column \d+", c.name) and c.values.dtype.kind in "iuf" for c in table.columns):
        return {}
    first, *others = (c for c in table.columns if c is table.columns[0] or np.nanmin(c.values) < np.nanmax(c.values))
    values = first.values
    if len(others) not in (1, 2) or not np.all(np.isfinite(values)):
        return {}
    dated = (values.max() > _CALENDAR[0] and values.min() < _CALENDAR[1]) or values.max() > _HIGHEST
    if dated or values.min() <= max(1.0, 0.5 * np.ptp(values)):
        return {}
    size, angle = others[0], others[-1]
    size = replace(size, unit="dB") if np.nanmax(size.values) < 0 else size
    if len(others) == 1:
        return {"f": [first], "amp": [size]}
    covered = float(np.nanmax(np.abs(angle.values)))
    one_sign = np.nanmin(size.values) >= 0 or size.unit
    if one_sign and covered > max(_TURNS, _WIDER * float(np.ptp(size.values))):
        return {"f": [first], "amp": [size], "phase": [replace(angle, unit="deg")]}
    return {"f": [first], "I": [others[0]], "Q": [angle]}
