"""Which rows of a file are one frequency sweep, and what they must say of each other."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.measurement.outliers import lone_rows

from .sweep_coverage import at_one_gain


_AFTER = 6  # rows on each side of a turn that say whether it was one
_FEWEST = 3  # rows of a sweep: fewer show no resonance and are what a mistyped level leaves behind


def single_sweeps(frequency: np.ndarray, within: Sequence[tuple[np.ndarray, float]]) -> tuple[slice, ...]:
    """Rows between which no condition leaves its value by more than it may, and the frequency does not turn back; it
    may stand, where rows are repeated; of those at a turn half belong to each side.
    """
    new = np.zeros(len(frequency), bool)
    for values, most in within:
        new |= _settings_begin(values, most)
    steps = np.sign(np.diff(frequency))
    begins, direction = [0], 0.0
    for row in range(1, len(frequency)):
        step = steps[row - 1]
        if new[row]:
            begins.append(row)
            direction = 0.0
        elif direction and step == -direction:
            standing = int(np.argmax(frequency[row - 1 :: -1] != frequency[row - 1]))
            begins.append(max(row - standing // 2, begins[-1] + 1))
            direction = 0.0
        elif step:
            direction = step
    return tuple(slice(a, b) for a, b in zip(begins, [*begins[1:], len(frequency)], strict=True))


def _settings_begin(values: np.ndarray, within: float) -> np.ndarray:
    """Where `values` leave the value of the current setting by more than `within`."""
    begins, held = np.zeros(len(values), bool), values[0]
    for row in np.flatnonzero(np.diff(values) != 0) + 1:
        if abs(values[row] - held) > within:
            begins[row], held = True, values[row]
    return begins


def levels_set(values: np.ndarray, sweeps: Sequence[slice], scatter: float) -> np.ndarray:
    """(n,) what was set in each sweep, of which `values`, positive, are readings: the mean of all sweeps within a
    relative `scatter` of the next.
    """
    means = np.array([values[rows].mean() for rows in sweeps])
    order = np.argsort(means)
    group = np.empty(len(means), int)
    group[order] = np.cumsum(np.diff(np.log(means[order]), prepend=np.log(means[order[0]])) > scatter)
    levels = np.array([means[group == k].mean() for k in range(group.max() + 1)])
    return np.repeat(levels[group], [rows.stop - rows.start for rows in sweeps])


def check_order(table: Table, frequency: np.ndarray, sweeps: Sequence[slice]) -> None:
    """The rows have an order; each sweep has some, and its frequency turns back for good: not for one row, which is a
    wrong digit.
    """
    short = sum(rows.stop - rows.start < _FEWEST for rows in sweeps)
    if short > 1 and 2 * short >= len(sweeps):  # some wrong levels alone leave longer sweeps between them
        raise InputError(
            f"{table.path}, column `f`: the rows must run up or down in frequency, one setting of drive, bias, "
            f"temperature and rate after the other, but change course {len(sweeps) - 1} times in "
            f"{len(frequency)} rows; sort them by setting and then by `f`, and leave out `t` if there is one."
        )
    for before, after in pairwise(sweeps):
        row = _astray(frequency, before, after)
        if row is not None:
            raise table.at(row, "f", "must run up or down from row to row, but it turns back for this one alone")
    for rows in sweeps:
        if rows.stop - rows.start < _FEWEST:
            raise InputError(
                f"{table.path}, line {table.lines[rows.start]}: a sweep must have at least {_FEWEST} rows under one "
                f"setting of drive, bias, temperature and rate, but has {rows.stop - rows.start}; mend or remove them."
            )


def _astray(frequency: np.ndarray, before: slice, after: slice) -> int | None:
    """The row at the turn without which the sweep before goes on as it ran, by a step of its usual size."""
    turn, end = after.start, min(after.stop, after.start + _AFTER)
    if (frequency[turn] - frequency[turn - 1]) * (frequency[turn - 1] - frequency[before.start]) >= 0:
        return None  # another setting begins
    start = max(before.start, turn - _AFTER)
    for row in (turn - 1, turn):
        kept = np.delete(frequency[start:end], row - start)
        steps = np.diff(kept)
        usual = np.median(np.abs(steps))
        if len(kept) >= 4 and (np.all(steps > 0) or np.all(steps < 0)) and np.max(np.abs(steps)) <= 3 * usual:
            return row
    return None


def refuse_copies(table: Table) -> None:
    """The same reading to the last digit under the same conditions is the same row twice; one that was repeated has
    noise of its own.
    """
    rows = np.stack(list(table.columns.values()), axis=1)
    _, first, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[group.ravel()] != np.arange(len(rows)))
    if repeated.size:
        row = int(repeated[0])
        original = table.lines[first[group.ravel()[row]]]
        raise table.at(row, "f", f"must not repeat line {original} to the last digit under the same conditions")


def check_phase(table: Table, rows: slice, axis: int, frequency: np.ndarray, phasors: np.ndarray, noise: float) -> None:
    """The driven channel turns by about −90° between its half-power points; what turns the other way, or not at all,
    was labelled wrongly.
    """
    order = np.argsort(frequency[rows])
    f, response = frequency[rows][order], phasors[rows, axis][order]
    turns = _turns(response, noise)
    if _turns_wrongly(turns):  # a wrong row may stand higher than the resonance, and is named by `check`
        lone = [row for row, _ in lone_rows(f, response, noise)]
        turns = _turns(np.delete(response, lone), noise)
    if not _turns_wrongly(turns) or not _turns_wrongly(_turns(at_one_gain(response), noise)):  # `check` names a gain
        return
    where = f"{table.path}, lines {table.lines[rows][0]} to {table.lines[rows][-1]}"
    conjugated = 'if the file follows e^{-iωt}, say `convention = "exp(-iwt)"`'
    raise InputError(
        f"{where}: the phase of channel {'xy'[axis]} must fall by about 90° across the resonance, as "
        f"V(t) = Re[(I + iQ) e^{{iωt}}] does, but changes by {turns[0]:+.0f}°; "
        f"{conjugated + '.' if turns[0] > 30 else 'are these readings as labelled?'}"
    )


def _turns(response: np.ndarray, noise: float) -> list[float]:
    """By how many degrees a response in the order of frequency turns, as it is and beside what the ends of its band
    have; one of them, or none, where it has no half-power points.
    """
    ends = max(1, len(response) // 10)
    background = np.mean(np.concatenate([response[:ends], response[-ends:]]))
    return [turn for taken in (0.0, background) if (turn := _turn(response - taken, noise)) is not None]


def _turns_wrongly(turns: Sequence[float]) -> bool:
    """Whether a resonance in the band turns the other way, or not at all; one drowned in noise tells nothing."""
    return len(turns) == 2 and min(turns) > -30


def _turn(response: np.ndarray, noise: float) -> float | None:
    """By how many degrees a response in the order of frequency turns between its half-power points, if it has both."""
    amplitude = np.abs(response)
    top = int(np.argmax(amplitude))
    low = amplitude < amplitude[top] / np.sqrt(2)
    if not low[:top].any() or not low[top:].any() or amplitude[top] < 12 * noise:
        return None
    left, right = int(np.flatnonzero(low[:top])[-1]), top + int(np.argmax(low[top:]))
    return float(np.degrees(np.angle(response[left + 1 : right + 1] * response[left:right].conj()).sum()))
