"""What the rows of a record, its declarations and the design must say of each other."""

from functools import singledispatch
from itertools import pairwise

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table

from .clock import check_period
from .records import AbstractRecord, FrequencySweepRecord, RateTableRecord, Readout, RingDownRecord, TimeRecord


_TWO_PI = 2 * np.pi
_FEWEST = 3  # rows of a sweep: fewer show no resonance and are what a mistyped level leaves behind
_REACH = 2.0  # factor around the design's resonances within which a frequency is believed


def check(record: AbstractRecord, table: Table, readout: Readout, resonances: tuple[float, float]) -> None:
    """Raises `InputError` where a record contradicts itself, the read-out's range or the resonances [rad/s]."""
    _check_range(record, table, readout)
    _check_kind(record, table, resonances)


@singledispatch
def _check_kind(record: AbstractRecord, table: Table, resonances: tuple[float, float]) -> None:
    raise TypeError(f"no checks for {type(record).__name__}")


@_check_kind.register
def _(record: FrequencySweepRecord, table: Table, resonances: tuple[float, float]) -> None:
    try:
        near_resonance(float(record.frequency.min()), float(record.frequency.max()), resonances)
    except InputError as error:
        raise InputError(f"{table.path}, column `f`: the band {error}.") from error
    _check_order(record, table)
    _refuse_repeats(record, table)
    for rows in record.sweeps:
        _check_phase(record, rows, table)


@_check_kind.register
def _(record: RingDownRecord, table: Table, resonances: tuple[float, float]) -> None:
    if record.time[0] < 0:
        raise table.at(0, "t", "must not be before the force is removed at t = 0")
    check_period(table, None)
    _check_sampling(record.period, record.rows, resonances, table)


@_check_kind.register
def _(record: RateTableRecord, table: Table, resonances: tuple[float, float]) -> None:
    check_period(table, record.lock_in_cycles * _TWO_PI / record.drive_frequency)


@_check_kind.register
def _(record: TimeRecord, table: Table, resonances: tuple[float, float]) -> None:
    if record.start == "rest" and record.time[0] != 0:
        raise table.at(0, "t", 'must be 0 in the first row of a record that starts at "rest"')
    check_period(table, None)
    _check_sampling(record.period, record.rows, resonances, table)


def near_resonance(low: float, high: float, resonances: tuple[float, float]) -> None:
    """Refuses a band [rad/s] that lies beyond any resonance of the design: a wrong unit, most likely."""
    if high * _REACH < resonances[0] or low > _REACH * resonances[1]:
        expected = f"{resonances[0] / _TWO_PI:.6g} and {resonances[1] / _TWO_PI:.6g} Hz"
        shown = f"{low / _TWO_PI:.6g}" if low == high else f"{low / _TWO_PI:.6g} to {high / _TWO_PI:.6g}"
        raise InputError(
            f"must come within a factor of {_REACH:g} of a resonance, which the design puts between "
            f"{expected}, but is {shown} Hz (is the unit right?)"
        )


def _check_range(record: AbstractRecord, table: Table, readout: Readout) -> None:
    """No reading exceeds the converter's range; the phasor of a clipped wave reaches 4/π of it."""
    if readout.adc_range is None:
        return
    phasors = np.iscomplexobj(record.readings)
    limit = 1.01 * readout.adc_range * (4 / np.pi if phasors else 1.0) + 8 * (record.noise_std or 0.0)
    row, channel = np.unravel_index(np.argmax(np.abs(record.readings)), record.readings.shape)
    largest = abs(record.readings[row, channel])
    if largest > limit:
        raise InputError(
            f"{table.path}, line {table.lines[row]}: a reading must lie within the declared `adc_range` of "
            f"±{readout.adc_range:g} {readout.unit}, but channel {'xy'[channel]} reads {largest:g} {readout.unit}; "
            "is the unit right?"
        )


def _check_sampling(period: float, rows: int, resonances: tuple[float, float], table: Table) -> None:
    slowest, rate = resonances[0] / _TWO_PI, 1 / period
    if rate < 2 * slowest:
        raise InputError(
            f"{table.path}, column `t`: the sampling must be faster than twice the resonance, which the design puts at "
            f"{slowest:.6g} Hz or above, but is at {rate:.6g} Hz; is the unit right?"
        )
    if rows * period * resonances[1] / _TWO_PI < 1:
        raise InputError(
            f"{table.path}, column `t`: the record must last for a cycle of the resonance, which the design puts at "
            f"{resonances[1] / _TWO_PI:.6g} Hz or below, but lasts {rows * period:.3g} s; is the unit right?"
        )


def _check_order(record: FrequencySweepRecord, table: Table) -> None:
    """Each sweep has some rows; where the frequency turns back or stands, a condition must have been set anew."""
    sweeps = record.sweeps
    for before, after in pairwise(sweeps):
        row = after.start
        if all(values[row] == values[row - 1] for values in _conditions(record)):
            what = "repeats the one before" if record.frequency[row] == record.frequency[row - 1] else "turns back"
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


def _conditions(record: FrequencySweepRecord) -> tuple[np.ndarray, ...]:
    return record.drive, record.bias_voltage, record.temperature, record.rate


def _refuse_repeats(record: FrequencySweepRecord, table: Table) -> None:
    """The same frequency under the same conditions is the same row twice."""
    keys = np.stack([record.frequency, *_conditions(record)], axis=1)
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[group.ravel()] != np.arange(record.rows))
    if repeated.size:
        row = int(repeated[0])
        original = table.lines[first[group.ravel()[row]]]
        raise table.at(row, "f", f"must differ from that of line {original}, which has the same conditions")


def _check_phase(record: FrequencySweepRecord, rows: slice, table: Table) -> None:
    """The driven channel turns by about −90° between its half-power points; what turns the other way, or not at all,
    was labelled wrongly.
    """
    order = np.argsort(record.frequency[rows])
    response = record.phasors[rows, record.axis][order]
    amplitude = np.abs(response)
    top = int(np.argmax(amplitude))
    low = amplitude < amplitude[top] / np.sqrt(2)
    if not low[:top].any() or not low[top:].any() or amplitude[top] < 12 * (record.noise_std or 0.0):
        return  # no full resonance in the band, or one drowned in noise: nothing to check against
    left, right = int(np.flatnonzero(low[:top])[-1]), top + int(np.argmax(low[top:]))
    turn = np.degrees(np.angle(response[left + 1 : right + 1] * response[left:right].conj()).sum())
    if turn > -30:
        where = f"{table.path}, lines {table.lines[rows][0]} to {table.lines[rows][-1]}"
        hint = "if the file follows e^{-iωt}, negate Q or the phase" if turn > 30 else "are these readings as labelled?"
        raise InputError(
            f"{where}: the phase of channel {'xy'[record.axis]} must fall by about 90° across the resonance, as "
            f"V(t) = Re[(I + iQ) e^{{iωt}}] does, but changes by {turn:+.0f}°; {hint}."
        )
