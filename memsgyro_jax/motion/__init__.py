"""Designed motion: tones that a gyro should move in so that its rate is known best."""

from .design import design_motion as design_motion
from .errors import ModelErrors as ModelErrors
from .result import MotionDesign as MotionDesign
from .uncertain import UncertainGyro as UncertainGyro
