"""The loss port: a number per die that tuning makes small, gathered sample by sample while the loop runs."""

import abc
from typing import ClassVar, Generic, TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar, check_not_negative, number
from memsgyro_jax.loop.loop import Sample


Memory = TypeVar("Memory")


class AbstractLoss(Displayed, Generic[Memory]):
    """Gathers a running memory over the samples of one die and turns it into a number at the end.

    Written for one die, like an observer: dies are trailing axes. Nothing of the run is stored, so the memory is all
    there is. It must be smooth in what is tuned; a condition on time or on the truth may jump.
    """

    sees_truth: ClassVar[bool] = True  # False where only measurement, command and estimate are used

    @abc.abstractmethod
    def init(self) -> Memory:
        """The memory before the first sample."""

    @abc.abstractmethod
    def sample(self, memory: Memory, sample: Sample) -> Memory:
        """The memory after one more sample."""

    @abc.abstractmethod
    def value(self, memory: Memory) -> Scalar:
        """The loss of the die."""

    def combine(self, values: Float[Array, " dies"]) -> Float[Array, ""]:
        """The loss of a lot from those of its dies: the mean, unless a loss says otherwise."""
        return jnp.mean(values)

    def begins(self) -> Scalar:
        """The time in s from which samples count; a run must be longer."""
        return 0.0


class AbstractMean(AbstractLoss[tuple[Scalar, Scalar]]):
    """The mean of something over the samples from `settle` [s] on. A subclass gives `of`:

    class AbsoluteError(mg.losses.AbstractMean):
        def of(self, sample):
            return abs(sample.rate - sample.conditions.inertial.rate)
    """

    settle: Scalar = number(default=0.0)

    def __check_init__(self):
        check_not_negative("settle", self.settle)

    @abc.abstractmethod
    def of(self, sample: Sample) -> Scalar:
        """What is averaged."""

    def init(self) -> tuple[Scalar, Scalar]:
        """Sum and count."""
        return jnp.zeros(()), jnp.zeros(())

    def sample(self, memory, sample):
        """Add a sample once settled."""
        counts = sample.clock.time >= self.settle
        return memory[0] + jnp.where(counts, self.of(sample), 0.0), memory[1] + counts

    def value(self, memory):
        """Sum over count."""
        return memory[0] / jnp.maximum(memory[1], 1.0)

    def begins(self) -> Scalar:
        """`settle`."""
        return self.settle


def rate_error(sample: Sample) -> Scalar:
    """What the loop gives out less the true rate, in rad/s."""
    return sample.rate - sample.conditions.inertial.rate


def claimed_variance(sample: Sample, who: str) -> Scalar:
    """The variance of the rate that the observer claims; raises `InputError` where it claims none."""
    if sample.estimate.rate_variance is None:
        raise InputError(
            f"The loss `{who}` must have an observer that claims a variance for the rate, an `ExtendedKalmanFilter` "
            "say, but this loop's has none."
        )
    return sample.estimate.rate_variance


def innovation_of(sample: Sample, who: str):
    """The innovation of a sample; raises `InputError` where the observer claims no variance for it."""
    if sample.estimate.innovation is None:
        raise InputError(
            f"The loss `{who}` must have an observer that claims a variance for its innovations, an "
            "`ExtendedKalmanFilter` say, but this loop's has none."
        )
    return sample.estimate.innovation
