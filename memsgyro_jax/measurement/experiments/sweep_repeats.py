"""Whether sweeps that ought to be repeats are: at one drive all read the same, but for noise and drift."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from memsgyro_jax.base.text import listed, spoken


_APART = 0.05  # of a factor between two sweeps
_LEFT = 0.1  # of the square of their difference, which that factor leaves: damping that changes leaves more
_FEWEST = 5  # rows that two sweeps share


def alike(held: Sequence[np.ndarray], sweeps: Sequence[slice]) -> list[list[np.ndarray]]:
    """The rows of each sweep, together with those of all whose conditions `held`, (n,) each, agree to three digits."""
    found: dict[tuple, list[np.ndarray]] = {}
    for rows in sweeps:
        key = tuple(f"{values[rows].mean():.3g}" for values in held)
        found.setdefault(key, []).append(np.arange(rows.start, rows.stop))
    return list(found.values())


def factor_between(frequency: np.ndarray, readings: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """The factor by which the rows `other` read what the rows `one` do, where it is nearly all of their difference and
    not one; else one.

    Args:
        frequency: (n,) of all rows.
        readings: (n,) phasors or amplitudes.
        one, other: rows of two sweeps.
    """
    one, other = (rows[np.argsort(frequency[rows], kind="stable")] for rows in (one, other))
    place = frequency[other]
    inside = (place >= frequency[one[0]]) & (place <= frequency[one[-1]])
    if inside.sum() < _FEWEST:
        return 1.0
    want, seen = np.interp(place[inside], frequency[one], readings[one]), readings[other][inside]
    size = float(np.vdot(want, want).real)
    factor = float(np.vdot(want, seen).real) / max(size, 1e-300)
    left, differ = (float(np.sum(np.abs(seen - by * want) ** 2)) for by in (factor, 1.0))
    return factor if factor > 0.0 and abs(np.log(factor)) > _APART and left < _LEFT * differ else 1.0


def of_one_size(frequency: np.ndarray, readings: np.ndarray, sweeps: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    """Sweeps that ought to be repeats, in groups of those that are."""
    groups: list[list[np.ndarray]] = []
    for rows in sweeps:
        mine = (group for group in groups if factor_between(frequency, readings, group[0], rows) == 1.0)
        found = next(mine, None)
        if found is None:
            groups.append([rows])
        else:
            found.append(rows)
    return groups


def courses_of(record: Any) -> tuple[np.ndarray, ...]:
    """Rows of a sweep record that ought to lie on one curve, in the order of frequency: of a sweep and its repeats the
    same way, but for those that read so many times what the others do, which are none.
    """
    held = [*_conditions(record), record.directions]
    groups = [one for some in alike(held, record.sweeps) for one in of_one_size(record.frequency, _read(record), some)]
    joined = map(np.concatenate, groups)
    return tuple(rows[np.argsort(record.frequency[rows], kind="stable")] for rows in joined)


def not_repeats(record: Any, unit: str) -> list[str]:
    """A sentence where sweeps of a record at one drive, whose unit is given, differ by a factor."""
    found, read = [], _read(record)
    for some in alike(_conditions(record), record.sweeps):
        groups = of_one_size(record.frequency, read, some)
        least = min(groups, key=lambda group: float(np.max(np.abs(read[group[0]]))))
        others = (group for group in groups if group is not least)
        factors = sorted(factor_between(record.frequency, read, least[0], group[0]) for group in others)
        by = dict.fromkeys(f"{factor:.3g}" for factor in factors if factor > 1.0)
        if by:
            told = f"a factor of {next(iter(by))}" if len(by) == 1 else f"factors of {listed(by)}"
            level = spoken(float(record.setting[some[0][0]]), unit, 3)
            found.append(f"{record.file}: sweeps at the same drive, {level}, differ by {told}: is the drive the same?")
    return list(dict.fromkeys(found))


def _conditions(record: Any) -> list[np.ndarray]:
    return [record.setting, record.bias_voltage, record.temperature, record.rate]


def _read(record: Any) -> np.ndarray:
    """(n,) readings along the drive, or of the other axis where these were not recorded."""
    return record.readings[:, record.axis if record.axis in record.channels else record.channels[0]]
