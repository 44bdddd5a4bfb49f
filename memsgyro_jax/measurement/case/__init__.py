"""Measurement cases: what a laboratory recorded of one device, what it declares about it, and the design behind it."""

from ..declared import DesignValue as DesignValue
from ..declared import Environment as Environment
from ..declared import Readout as Readout
from ..experiments import AbstractRecord as AbstractRecord
from ..experiments import FreeDecayRecord as FreeDecayRecord
from ..experiments import FrequencySweepRecord as FrequencySweepRecord
from ..experiments import OperatingPointsRecord as OperatingPointsRecord
from ..experiments import RateTableRecord as RateTableRecord
from ..experiments import RingDownRecord as RingDownRecord
from ..experiments import TimeRecord as TimeRecord
from .content import Case as Case
from .quality import CaseQuality as CaseQuality
from .quality import assess as assess
from .read import load_case as load_case
from .write import write_case as write_case
