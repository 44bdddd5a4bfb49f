"""Noise of a record: as declared, or estimated from what no device can do."""

import numpy as np
from scipy import signal

from .case import AbstractRecord, FrequencySweepRecord
from .case import TimeRecord as RawRecord


def noise_level(record: AbstractRecord) -> float:
    """Standard deviation of the noise on each real reading, in the unit of the record: declared or estimated."""
    return record.noise_std if record.noise_std is not None else estimated_noise(record)


def estimated_noise(record: AbstractRecord) -> float:
    """White noise level from the record alone.

    Raw captures: the spectrum in the uppermost fifth of the band, where a resonator far below hardly answers. Sweeps
    and lock-in series: third differences, which smooth curves do not have, by their median, which resonances do not
    move.
    """
    values = np.asarray(record.readings)
    parts = np.stack([values.real, values.imag], axis=-1) if np.iscomplexobj(values) else values[..., None]
    if isinstance(record, RawRecord):
        frequency, density = signal.welch(parts, fs=1.0, nperseg=min(1024, len(values)), axis=0)
        return float(np.sqrt(0.5 * np.median(density[frequency > 0.4])))
    pieces = [np.arange(record.rows)]
    if isinstance(record, FrequencySweepRecord):
        pieces = [np.arange(record.rows)[piece] for piece in record.sweeps]
    third = [np.diff(parts[piece], 3, axis=0).ravel() for piece in pieces if len(piece) > 3]
    spread = np.median(np.abs(np.concatenate(third))) if third else float(np.std(parts))
    return float(spread / 0.6745 / np.sqrt(20.0))
