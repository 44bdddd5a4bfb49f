"""Kinds of measurement, each of which predicts what the laboratory would have recorded. A new kind is a new file beside
these.

There are two families. `FrequencySweep` predicts from a `Bench` in closed form: coupling errors of one sweep, through a
lock-in with its own errors (`identify`). `HarmonicSweep`, `RingDown`, `RateTable` and `TimeRecord` predict from a
`Model` with any effects: the records of a measurement case (`compare`, `diagnose`, `fit`).
"""

from .base import CartesianNoise as CartesianNoise
from .base import Experiment as Experiment
from .base import Noise as Noise
from .base import PolarNoise as PolarNoise
from .base import RealNoise as RealNoise
from .harmonic_sweep import HarmonicSweep as HarmonicSweep
from .rate_table import RateTable as RateTable
from .ring_down import RingDown as RingDown
from .time_record import TimeRecord as TimeRecord
