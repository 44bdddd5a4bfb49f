"""Measurement cases: what a laboratory recorded of one device, what it declares about it, and the design behind it."""

from .quality import CaseQuality as CaseQuality
from .quality import assess as assess
from .read import load_case as load_case
from .records import AbstractRecord as AbstractRecord
from .records import Case as Case
from .records import DesignValue as DesignValue
from .records import Environment as Environment
from .records import FrequencySweepRecord as FrequencySweepRecord
from .records import RateTableRecord as RateTableRecord
from .records import Readout as Readout
from .records import RingDownRecord as RingDownRecord
from .records import TimeRecord as TimeRecord
from .write import write_case as write_case
