"""Controllers: what turns an estimate into drive forces. A sibling file here is a new kind."""

from .base import AbstractController as AbstractController
from .base import AbstractLinearController as AbstractLinearController
from .base import Tone as Tone
from .damping_compensation import DampingCompensation as DampingCompensation
from .designed_motion import DesignedMotion as DesignedMotion
from .open_loop import OpenLoop as OpenLoop
from .reference_model import ReferenceModel as ReferenceModel
