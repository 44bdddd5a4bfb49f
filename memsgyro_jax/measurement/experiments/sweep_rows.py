"""Which rows of a file are one frequency sweep, and what they must say of each other."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table


_FEWEST = 3  # rows of a sweep: fewer show no resonance and are what a mistyped level leaves behind


def single_sweeps(frequency: np.ndarray, within: Sequence[tuple[np.ndarray, float]]) -> tuple[slice, ...]:
    """Rows between which no condition leaves its value by more than it may, and the frequency does not turn back."""
    new = np.zeros(len(frequency), bool)
    for values, most in within:
        new |= _settings_begin(values, most)
    steps = np.sign(np.diff(frequency))
    begins, direction = [0], 0.0
    for row in range(1, len(frequency)):
        if new[row] or (direction and steps[row - 1] != direction):
            begins.append(row)
            direction = 0.0
        else:
            direction = steps[row - 1]
    return tuple(slice(a, b) for a, b in zip(begins, [*begins[1:], len(frequency)], strict=True))


def _settings_begin(values: np.ndarray, within: float) -> np.ndarray:
    """Where `values` leave the value of the current setting by more than `within`."""
    begins, held = np.zeros(len(values), bool), values[0]
    for row in np.flatnonzero(np.diff(values) != 0) + 1:
        if abs(values[row] - held) > within:
            begins[row], held = True, values[row]
    return begins


def check_order(table: Table, frequency: np.ndarray, set_to: Sequence[np.ndarray], sweeps: Sequence[slice]) -> None:
    """Each sweep has some rows; where the frequency turns back or stands, a condition must have been set anew."""
    for before, after in pairwise(sweeps):
        row = after.start
        if all(values[row] == values[row - 1] for values in set_to):
            what = "repeats the one before" if frequency[row] == frequency[row - 1] else "turns back"
            raise table.at(
                row, "f", f"must run strictly up or strictly down as long as no condition changes, but it {what}"
            )
        if _short(before):
            break
    for rows in sweeps:
        if _short(rows):
            raise InputError(
                f"{table.path}, line {table.lines[rows.start]}: a sweep must have at least {_FEWEST} rows under one "
                f"setting of drive, bias, temperature and rate, but has {rows.stop - rows.start}; mend or remove them."
            )


def _short(rows: slice) -> bool:
    return bool(rows.stop - rows.start < _FEWEST)


def refuse_repeats(table: Table, frequency: np.ndarray, set_to: Sequence[np.ndarray]) -> None:
    """The same frequency under the same conditions is the same row twice."""
    keys = np.stack([frequency, *set_to], axis=1)
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[group.ravel()] != np.arange(len(frequency)))
    if repeated.size:
        row = int(repeated[0])
        original = table.lines[first[group.ravel()[row]]]
        raise table.at(row, "f", f"must differ from that of line {original}, which has the same conditions")


def check_phase(table: Table, rows: slice, axis: int, frequency: np.ndarray, phasors: np.ndarray, noise: float) -> None:
    """The driven channel turns by about −90° between its half-power points; what turns the other way, or not at all,
    was labelled wrongly.
    """
    order = np.argsort(frequency[rows])
    response = phasors[rows, axis][order]
    amplitude = np.abs(response)
    top = int(np.argmax(amplitude))
    low = amplitude < amplitude[top] / np.sqrt(2)
    if not low[:top].any() or not low[top:].any() or amplitude[top] < 12 * noise:
        return  # no full resonance in the band, or one drowned in noise: nothing to check against
    left, right = int(np.flatnonzero(low[:top])[-1]), top + int(np.argmax(low[top:]))
    turn = np.degrees(np.angle(response[left + 1 : right + 1] * response[left:right].conj()).sum())
    if turn > -30:
        where = f"{table.path}, lines {table.lines[rows][0]} to {table.lines[rows][-1]}"
        hint = "if the file follows e^{-iωt}, negate Q or the phase" if turn > 30 else "are these readings as labelled?"
        raise InputError(
            f"{where}: the phase of channel {'xy'[axis]} must fall by about 90° across the resonance, as "
            f"V(t) = Re[(I + iQ) e^{{iωt}}] does, but changes by {turn:+.0f}°; {hint}."
        )
