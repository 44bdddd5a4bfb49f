"""Section `[tune]` of a study file: what is free, and how it is sought."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from memsgyro_jax.base.quantity import Also, FileSection, Whole
from memsgyro_jax.tuning.losses import AbstractLoss, InnovationLikelihood, SquaredRateError
from memsgyro_jax.tuning.tunable import Tunable

from .plan import Quantity, within


class FreeNumber(FileSection):
    """`"filter.bandwidth"`, or `{ path = "filter.bandwidth", low = "5 Hz", high = "5 kHz" }`; a bound left out is the
    default one."""

    path: str
    low: Quantity | None = None
    high: Quantity | None = None

    def build(self, unit: str | None) -> Tunable:
        """The number; raises `ValueError` for a bound in another unit."""
        low, high = (
            None if end is None else within(end, unit, name) for name, end in (("low", self.low), ("high", self.high))
        )
        return Tunable(self.path, low, high)


def _named(given: Any) -> Any:
    return {"path": given} if isinstance(given, str) else given


class Tune(FileSection):
    """Section `[tune]`. Without `free`: the noises of a Kalman filter or the gains of a Lyapunov observer, and the
    filter's frequencies.

    `dies` train, `validation_dies` say when to stop, those of `[sweep]` are reported; a stage takes at most
    `evaluations` gradients. `loss` is "stages" (likelihood of the innovations, then the error), or one for all.
    """

    free: tuple[Annotated[FreeNumber, BeforeValidator(_named), Also(text=True)], ...] | None = None
    loss: Literal["stages", "squared_rate_error", "innovation_likelihood"] = "stages"
    dies: Annotated[Whole, Field(ge=2)] = 128
    validation_dies: Annotated[Whole, Field(ge=1)] = 64
    evaluations: Annotated[Whole, Field(ge=1)] = 40

    def chosen_loss(self, settle: float) -> AbstractLoss | None:
        """The loss from `settle` [s] on; None for the two stages."""
        kinds = {"squared_rate_error": SquaredRateError, "innovation_likelihood": InnovationLikelihood}
        return None if self.loss == "stages" else kinds[self.loss](settle)
