"""Components of a micromachined gyro by their dimensions, and devices by their layout and the errors of the process.

Everything is in SI, elementwise over arrays of dies, and differentiable. No fringe fields, no anchors that yield, no
holes in plates: what a formula holds for stands beside it.
"""

from .capacitors import Comb as Comb
from .capacitors import DriveForce as DriveForce
from .capacitors import ParallelPlate as ParallelPlate
from .capacitors import drive_force as drive_force
from .films import SqueezeFilm as SqueezeFilm
from .films import couette_damping as couette_damping
from .films import effective_viscosity as effective_viscosity
from .films import squeeze_film as squeeze_film
from .layout import LayoutGyro as LayoutGyro
from .layout import PlateLayout as PlateLayout
from .layout import Process as Process
from .springs import Beam as Beam
from .springs import PlaneStiffness as PlaneStiffness
from .springs import crab_leg_coupling as crab_leg_coupling
from .springs import hairpin as hairpin
from .springs import in_series as in_series
from .springs import polyline as polyline
from .springs import u_fold_coupling as u_fold_coupling
