"""What the spread of fabrication does to a closed loop: which parameter matters, how it acts, where it is worst."""

from .corners import Corners as Corners
from .corners import corners as corners
from .outputs import Output as Output
from .outputs import mean_error as mean_error
from .outputs import outputs as outputs
from .sobol import Sobol as Sobol
from .sobol import sobol as sobol
from .tornado import Tornado as Tornado
from .tornado import tornado as tornado
