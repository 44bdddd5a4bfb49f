"""Controllers: what turns an estimate into drive forces. A sibling file here is a new kind."""

from .ahead import Ahead as Ahead
from .base import AbstractController as AbstractController
from .base import AbstractLinearController as AbstractLinearController
from .base import Tone as Tone
from .classic import ClassicControl as ClassicControl
from .damping_compensation import DampingCompensation as DampingCompensation
from .demodulator import AbstractDemodulator as AbstractDemodulator
from .demodulator import ProductDemodulator as ProductDemodulator
from .demodulator import TrackingDemodulator as TrackingDemodulator
from .designed_motion import DesignedMotion as DesignedMotion
from .energy_control import EnergyControl as EnergyControl
from .open_loop import OpenLoop as OpenLoop
from .phase_locked_drive import PhaseLockedDrive as PhaseLockedDrive
from .reference_model import ReferenceModel as ReferenceModel
from .saturated import Saturated as Saturated
from .sense import AbstractSense as AbstractSense
from .sense import ForceRebalance as ForceRebalance
from .sense import OpenSense as OpenSense
from .sliding_mode import SlidingMode as SlidingMode
from .whole_angle import WholeAngle as WholeAngle
