"""Section `[tune]` of a study file: what is free, and how it is sought."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from memsgyro_jax.base.quantity import Also, FileSection, Whole
from memsgyro_jax.tuning.losses import AbstractLoss, InnovationLikelihood, SquaredRateError
from memsgyro_jax.tuning.tunable import Tunable

from .plan import Quantity, within


class FreeNumber(FileSection):
    """`"filter.bandwidth"`, or `{ path = "filter.bandwidth", low = "5 Hz", high = "5 kHz" }`."""

    path: str
    """Name of a number of the loop, "filter.bandwidth", or of several, "observer.noise_density"."""
    low: Quantity | None = None
    """Least value that it may take, in its unit; left out, a thousandth of a positive number, or what suits it
    better."""
    high: Quantity | None = None
    """Largest value that it may take, in its unit; left out, a thousand times a positive number, or what suits it
    better."""

    def build(self, unit: str | None) -> Tunable:
        """The number; raises `ValueError` for a bound in another unit."""
        low, high = (
            None if end is None else within(end, unit, name) for name, end in (("low", self.low), ("high", self.high))
        )
        return Tunable(self.path, low, high)


def _named(given: Any) -> Any:
    return {"path": given} if isinstance(given, str) else given


class Tune(FileSection):
    """Section `[tune]`: what `memsgyro tune` may move, and what it makes small. The dies of `[sweep]` are reported."""

    free: tuple[Annotated[FreeNumber, BeforeValidator(_named), Also(text=True)], ...] | None = None
    """Numbers of the loop that may move. Left out: the noises of a Kalman filter, or the gains of a Lyapunov observer
    or of a controller that measures by itself, and the frequencies of the output filter."""
    loss: Literal["stages", "squared_rate_error", "innovation_likelihood"] = "stages"
    """What is made small: "stages" for the likelihood of the innovations by the filter's own numbers and then the
    squared rate error by the rest, or one of the two by all."""
    dies: Annotated[Whole, Field(ge=2)] = 128
    """Number of dies whose gradients are followed (training)."""
    validation_dies: Annotated[Whole, Field(ge=1)] = 64
    """Number of further dies that say when to stop and which step was best."""
    evaluations: Annotated[Whole, Field(ge=1)] = 40
    """Number of gradients that a stage takes at most."""

    def chosen_loss(self, settle: float) -> AbstractLoss | None:
        """The loss from `settle` [s] on; None for the two stages."""
        kinds = {"squared_rate_error": SquaredRateError, "innovation_likelihood": InnovationLikelihood}
        return None if self.loss == "stages" else kinds[self.loss](settle)
