"""Observers: what estimates motion and coefficients from the read-out. A sibling file here is a new kind."""

from .base import AbstractBlockObserver as AbstractBlockObserver
from .base import AbstractCovarianceObserver as AbstractCovarianceObserver
from .base import AbstractObserver as AbstractObserver
from .base import Clock as Clock
from .base import Estimate as Estimate
from .ekf import ExtendedKalmanFilter as ExtendedKalmanFilter
from .energy import EnergyObserver as EnergyObserver
from .fading import AdaptiveFading as AdaptiveFading
from .fading import FixedFading as FixedFading
from .jump_test import JumpTest as JumpTest
from .known_rate import KnownRateFilter as KnownRateFilter
from .lyapunov import LyapunovObserver as LyapunovObserver
from .no_observer import NoObserver as NoObserver
from .pickoff import curves_of as curves_of
from .rate_slope import RateSlopeFilter as RateSlopeFilter
from .scale_ratio import ScaleRatioFilter as ScaleRatioFilter
from .settings import Annealing as Annealing
from .settings import Prior as Prior
from .settings import ProcessNoise as ProcessNoise
from .settings import design_prior as design_prior
