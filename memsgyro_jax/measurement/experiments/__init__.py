"""Kinds of measurement: how each is read and checked, and what a laboratory would have recorded of a device. A new kind
is a new file beside these, or one of the user's own that `load_case(..., kinds=[...])` is given.

A member is a record (`AbstractRecord`) with the `Experiment` that predicts it from a `Model` with any effects: what
`compare`, `diagnose` and `fit` need. Coupling errors have an experiment of their own, `couplings.FrequencySweep`.
"""

from .base import CartesianNoise as CartesianNoise
from .base import Experiment as Experiment
from .base import Noise as Noise
from .base import Phasors as Phasors
from .base import PolarNoise as PolarNoise
from .base import Readings as Readings
from .base import RealNoise as RealNoise
from .base import surroundings as surroundings
from .deviation import Deviation as Deviation
from .deviation import Known as Known
from .free_decay import FreeDecayRecord as FreeDecayRecord
from .frequency_sweep import FrequencySweepRecord as FrequencySweepRecord
from .harmonic_sweep import HarmonicSweep as HarmonicSweep
from .operating_points import OperatingPointsRecord as OperatingPointsRecord
from .rate_blocks import RateTable as RateTable
from .rate_table import RateTableRecord as RateTableRecord
from .record import AbstractRecord as AbstractRecord
from .ring_down import RingDown as RingDown
from .ring_down import RingDownRecord as RingDownRecord
from .sheet import Sheet as Sheet
from .time_record import RawCapture as RawCapture
from .time_record import TimeRecord as TimeRecord


KINDS: tuple[type[AbstractRecord], ...] = (
    *(FrequencySweepRecord, RingDownRecord, FreeDecayRecord, RateTableRecord, OperatingPointsRecord, TimeRecord),
)
