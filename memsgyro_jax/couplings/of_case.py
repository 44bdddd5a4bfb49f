"""The frequency sweeps of a measurement case, as the couplings are identified from them."""

from pathlib import Path
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed
from memsgyro_jax.measurement.case import Case, FrequencySweepRecord, load_case

from .record import SweepRecord


def case_sweeps(folder: str | Path) -> list[SweepRecord]:
    """The frequency sweeps of both channels that a case holds, each with its driven axis and its drive.

    What else the case holds is named in the notes.

    **Raises:** `InputError` for a case without such a sweep, for one of one axis, and where a sweep does not tell the
    phase, or was taken under more than one condition; and as `load_case` does.
    """
    case = load_case(folder)
    sweeps: list[Any] = [record for record in case.records if hasattr(record, "calm")]
    if not sweeps:
        raise InputError(f"{folder}: the case must hold a frequency sweep to identify couplings, but holds none.")
    others = [record.name for record in case.records if record not in sweeps]
    notes = (f"Of {folder} the frequency sweeps are used, and not {listed(others)}.",) if others else ()
    return [_sweep(record, case, notes) for record in sweeps]


def _sweep(record: FrequencySweepRecord, case: Case, notes: tuple[str, ...]) -> SweepRecord:
    place = f"{case.folder / record.file}"
    if len(record.channels) != 2:
        raise InputError(f"{place}: the couplings need both channels, x and y, but the sweep holds one.")
    if not record.phase_known:
        raise InputError(f"{place}: the couplings need amplitude and phase, but the sweep holds amplitudes alone.")
    for name, values in (("T", record.temperature), ("V_bias", record.bias_voltage), ("rate", record.rate)):
        if np.ptp(values) > 0:
            raise InputError(
                f"{place}, column `{name}`: couplings are identified at one condition, but it changes; "
                "split the file by it."
            )
    start = np.concatenate([np.full(part.stop - part.start, record.frequency[part.start]) for part in record.sweeps])
    return SweepRecord(
        name=record.name,
        frequency=record.frequency,
        phasors=record.phasors,
        axis=record.axis,
        drive=record.drive,
        start=start,
        rate=float(record.rate[0]),
        polar=False,
        elapsed=record.time,
        unit=case.readout.unit,
        notes=notes,
        lines=record.lines,
    )
