"""The loss port: a number per die that tuning makes small, gathered sample by sample while the loop runs."""

import abc
from typing import Any, ClassVar, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar, check_not_negative, number
from memsgyro_jax.loop import engine
from memsgyro_jax.loop.loop import ClosedLoop, Sample


Memory = TypeVar("Memory")


class AbstractLoss(Displayed, engine.AbstractRecorder[Memory, tuple[()]]):
    """Gathers a running memory over the samples of one die and turns it into a number at the end.

    Written for one die, like an observer: dies are trailing axes. Nothing of the run is stored, so the memory is all
    there is. It must be smooth in what is tuned; a condition on time or on the truth may jump. A loss with a field
    `settle` [s] counts samples from then on.
    """

    sees_truth: ClassVar[bool] = True  # False where only measurement, command and estimate are used
    believes_claims: ClassVar[bool] = False  # True where a filter that claims less error is better, whatever it makes

    def __check_init__(self):
        check_not_negative("settle", getattr(self, "settle", 0.0))

    @abc.abstractmethod
    def value(self, memory: Memory) -> Scalar:
        """The loss of the die."""

    def of_loop(self, loop: ClosedLoop) -> Scalar:
        """What the loss counts of the loop itself, its die and its gains, beside the run: nothing."""
        return jnp.zeros(())

    def combine(self, values: Float[Array, " dies"]) -> Float[Array, ""]:
        """The loss of a lot from those of its dies: the mean, unless a loss says otherwise."""
        return jnp.mean(values)

    def begins(self) -> Scalar:
        """The time in s from which samples count; a run must be longer."""
        return getattr(self, "settle", 0.0)

    def counts(self, sample: Sample) -> Bool[Array, ""]:
        """Whether a sample counts."""
        return sample.clock.time >= self.begins()

    def block(self, memory: Memory) -> tuple[Memory, tuple[()]]:
        """Nothing is handed out before the end."""
        return memory, ()


class AbstractSums(AbstractLoss[tuple[Scalar, ...]]):
    """`sums` sums over the samples that count. A subclass gives `terms` and makes a `value` of the sums."""

    sums: ClassVar[int] = 2

    @abc.abstractmethod
    def terms(self, sample: Sample) -> tuple[Scalar, ...]:
        """What a sample adds to each sum."""

    def init(self):
        return (jnp.zeros(()),) * self.sums

    def sample(self, memory, sample):
        counts = self.counts(sample)
        return tuple(sum_ + jnp.where(counts, term, 0.0) for sum_, term in zip(memory, self.terms(sample), strict=True))


class AbstractMean(AbstractSums):
    """The mean of something over the samples from `settle` [s] on. A subclass gives `of`:

    class AbsoluteError(mg.losses.AbstractMean):
        def of(self, sample):
            return abs(sample.rate - sample.conditions.inertial.rate)
    """

    settle: Scalar = number(default=0.0)

    @abc.abstractmethod
    def of(self, sample: Sample) -> Scalar:
        """What is averaged."""

    def terms(self, sample):
        return self.of(sample), 1.0

    def value(self, memory):
        return memory[0] / jnp.maximum(memory[1], 1.0)


class AbstractFinal(AbstractLoss[Scalar]):
    """A loss that the last sample alone decides. A subclass gives `of` and makes a `value` of it."""

    @abc.abstractmethod
    def of(self, sample: Sample) -> Scalar:
        """What is kept of the last sample."""

    def init(self):
        return jnp.zeros(())

    def sample(self, memory, sample):
        return self.of(sample) + 0.0 * memory


def rate_error(sample: Sample) -> Scalar:
    """What the loop gives out less the true rate, in rad/s."""
    return sample.rate - sample.conditions.inertial.rate


def missed(error: Scalar, tolerance: Scalar, softness: Scalar) -> Scalar:
    """0 for an error well within ±`tolerance`, 1 far beyond; the edge is a logistic curve of relative width `softness`,
    so that the tolerance has a derivative.
    """
    # √(e² + small²) for |e|: smooth where the error passes zero, which changes nothing out at the tolerance.
    size = jnp.sqrt(error**2 + (1e-3 * tolerance) ** 2)
    return jax.nn.sigmoid((size / tolerance - 1.0) / softness)


def claimed_variance(sample: Sample, who: str) -> Scalar:
    """The variance of the rate that the observer claims; raises `InputError` where it claims none."""
    return _claimed(sample.estimate.rate_variance, "the rate", who)


def innovation_of(sample: Sample, who: str):
    """The innovation of a sample; raises `InputError` where the observer claims no variance for it."""
    return _claimed(sample.estimate.innovation, "its innovations", who)


def _claimed(found: Any, of: str, who: str) -> Any:
    if found is None:
        raise InputError(
            f"The loss `{who}` must have an observer that claims a variance for {of}, an `ExtendedKalmanFilter` say, "
            "but this loop's has none."
        )
    return found
