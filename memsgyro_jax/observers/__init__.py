"""Observers: what estimates motion and coefficients from the read-out. A sibling file here is a new kind."""

from .base import AbstractObserver as AbstractObserver
from .base import Clock as Clock
from .base import Estimate as Estimate
from .ekf import ExtendedKalmanFilter as ExtendedKalmanFilter
from .lyapunov import LyapunovObserver as LyapunovObserver
