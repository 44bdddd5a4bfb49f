"""What the records of several files say about each other: copies, what is read, and which way phasors turn."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from memsgyro_jax.base.units import parse_header, to_si

from .imported_record import ImportedRecord
from .imported_sweep import TURNED
from .told_beside import NO_LEVEL


_SECOND = re.compile(r"V[xy]_(?:Q|phase) ")


def without_copies(found: Sequence[list[ImportedRecord]]) -> tuple[list[list[ImportedRecord]], list[str]]:
    """The records of each file without those that are copies of another, which would count as measured twice, and a
    sentence for each copy.

    Rows at another drive level are no copy, unless nobody told the level of one of them.
    """
    seen: dict[tuple, list[ImportedRecord]] = {}
    copies: dict[int, str] = {}
    records = [record for some in found for record in some]
    for record in sorted(records, key=lambda one: NO_LEVEL in one.assumed):
        others = {key: value for key, value in record.keys.items() if key != "drive_force"}
        rows = tuple((header, np.asarray(values, float).tobytes()) for header, values in record.columns.items())
        alike = seen.setdefault((record.kind, rows, repr(sorted(others.items()))), [])
        same = [one for one in alike if NO_LEVEL in record.assumed or one.keys == record.keys]
        if same:
            copies[id(record)] = f"{record.source}, as its rows are those of {same[0].source}"
        else:
            alike.append(record)
    kept = [[record for record in some if id(record) not in copies] for some in found]
    return kept, [copies[id(record)] for record in records if id(record) in copies]


def agreed(records: list[ImportedRecord]) -> list[ImportedRecord]:
    """Records of one read-out: what most of those that tell show is read, and said where one shows something else."""
    told = Counter(record.quantity for record in records if record.quantity)
    if len(told) < 2:
        return records
    (most, _), *_ = told.most_common()
    said = f"most records show {most}, which is taken for all (`quantity` under `[readout]` says otherwise)"
    return [
        record if record.quantity in ("", most) else replace(record, quantity=most, assumed=(*record.assumed, said))
        for record in records
    ]


def turned_alike(records: list[ImportedRecord]) -> list[ImportedRecord]:
    """Phasors over time, negated where every sweep with a phase was; of a decay only if that brings its frequency
    nearer to a resonance of the sweeps, or tells nothing.
    """
    sweeps = [one for one in records if one.kind == "frequency_sweep" and any(map(_SECOND.match, one.columns))]
    if not sweeps or not all(TURNED in record.assumed for record in sweeps):
        return records
    peaks = np.array([_peak(record) for record in sweeps])
    said = "its phase is negated, as that of the sweeps, which show that the files follow e^{-iωt}"

    def turned(record: ImportedRecord) -> ImportedRecord:
        parts = [name for name in record.columns if _SECOND.match(name)]
        if record in sweeps or not parts or (record.kind == "free_decay" and not _is_nearer_negated(record, peaks)):
            return record
        negated = {name: -values if name in parts else values for name, values in record.columns.items()}
        return replace(record, columns=negated, assumed=(*record.assumed, said))

    return [turned(record) for record in records]


def _column(record: ImportedRecord, start: str, unit: str) -> np.ndarray:
    """The column whose header starts so, in an SI unit, or in its own where `unit` is empty."""
    header = next(header for header in record.columns if header.startswith(f"{start} "))
    values = np.asarray(record.columns[header], float)
    return to_si(values, parse_header(header).unit, unit, start) if unit else values


def _phasors(record: ImportedRecord) -> np.ndarray:
    """(n,) of the channel that moves most."""
    found = []
    for axis in "xy":
        if any(header.startswith(f"V{axis}_I ") for header in record.columns):
            found.append(_column(record, f"V{axis}_I", "") + 1j * _column(record, f"V{axis}_Q", ""))
        elif any(header.startswith(f"V{axis}_phase ") for header in record.columns):
            phase = _column(record, f"V{axis}_phase", "rad")
            found.append(_column(record, f"V{axis}_amp", "") * np.exp(1j * phase))
    return max(found, key=lambda one: float(np.max(np.abs(one))))


def _peak(sweep: ImportedRecord) -> float:
    """Where a sweep is largest [Hz]."""
    return float(_column(sweep, "f", "Hz")[np.argmax(np.abs(_phasors(sweep)))])


def _is_nearer_negated(decay: ImportedRecord, peaks: np.ndarray) -> bool:
    """Whether a decay with its phase negated is nearer to one of the resonances [Hz], or at least as near."""
    z, time = _phasors(decay), _column(decay, "t", "s")
    told = decay.keys["reference_frequency"]
    reference = float(to_si(told["value"], told["unit"], "Hz", "reference"))
    beat = float(np.angle(np.sum(z[1:] * np.conj(z[:-1])))) / (2 * np.pi * float(np.median(np.diff(time))))
    return bool(np.min(np.abs(reference - beat - peaks)) <= np.min(np.abs(reference + beat - peaks)))
