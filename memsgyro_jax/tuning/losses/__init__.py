"""What tuning makes small. A new loss is a subclass of one of the abstract classes, here or elsewhere."""

from .base import AbstractFinal as AbstractFinal
from .base import AbstractLoss as AbstractLoss
from .base import AbstractMean as AbstractMean
from .base import AbstractSums as AbstractSums
from .base import rate_error as rate_error
from .claimed_variance import ClaimedVariance as ClaimedVariance
from .consistency import Consistency as Consistency
from .convergence_time import ConvergenceTime as ConvergenceTime
from .delay import Delay as Delay
from .expected_misses import ExpectedMisses as ExpectedMisses
from .innovation_likelihood import InnovationLikelihood as InnovationLikelihood
from .loop_margin import LoopMargin as LoopMargin
from .out_of_tolerance import OutOfTolerance as OutOfTolerance
from .squared_rate_error import SquaredRateError as SquaredRateError
from .weighted import Weighted as Weighted
from .worst_dies import WorstDies as WorstDies
