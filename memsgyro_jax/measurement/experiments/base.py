"""The port of the measurement side: a kind of experiment that predicts what the laboratory would have recorded."""

import abc
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, PyTree

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.device.conditions import Conditions

from ..declared import Declared
from ..first_order import Contribution, Inquiry


BEYOND = 2.0  # times the largest drive or speed in a record: so far a next experiment may go


class Noise(Displayed):
    """How far a record may lie from its prediction."""

    @abc.abstractmethod
    def whiten(self, measured: Array, predicted: Array) -> Float[Array, "..."]:
        """Measured minus predicted in standard deviations, real and independent."""


class CartesianNoise(Noise):
    """The same white noise on the in-phase and the quadrature part: `std` in the unit of the record, scalar or one per
    channel.
    """

    std: Array = eqx.field(converter=jnp.asarray)

    def whiten(self, measured: Complex[Array, "n c"], predicted: Complex[Array, "n c"]) -> Float[Array, "n c 2"]:
        """Difference of I and of Q over `std`."""
        error = (measured - predicted) / self.std
        return jnp.stack([error.real, error.imag], axis=-1)


class RealNoise(Noise):
    """White noise on a real signal: `std` in the unit of the record, scalar or one per channel."""

    std: Array = eqx.field(converter=jnp.asarray)

    def whiten(self, measured: Float[Array, "n c"], predicted: Float[Array, "n c"]) -> Float[Array, "n c"]:
        """Difference over `std`."""
        return (measured - predicted) / self.std


class AmplitudeNoise(Noise):
    """Noise of an instrument that tells the amplitude alone: `std` of each of I and Q, of which the modulus was taken.

    The modulus of a phasor A with such noise is √(A² + std²) on average to second order in std/A, and scatters by `std`
    where A is larger; below that it scatters by less, down to 0.66 std of noise alone (Rice distribution).
    """

    std: Array = eqx.field(converter=jnp.asarray)

    def whiten(self, measured: Float[Array, "n c"], predicted: Complex[Array, "n c"]) -> Float[Array, "n c"]:
        """Difference of the amplitude from that expected, over `std`."""
        finite = jnp.where(jnp.isfinite(self.std), self.std, 0.0)
        square = jnp.real(predicted * jnp.conj(predicted)) + finite**2
        expected = jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)
        return (measured - expected) / self.std


class PolarNoise(Noise):
    """Noise of an instrument that reads amplitude and phase: `amplitude` relative to the reading, `phase` in rad, each
    a standard deviation.

    The paper quotes peak-to-peak values NA and Nφ of uniform noise: `from_peak_to_peak` divides them by √12.
    """

    amplitude: Array = eqx.field(converter=jnp.asarray)
    phase: Array = eqx.field(converter=jnp.asarray)

    @classmethod
    def from_peak_to_peak(cls, amplitude: float, phase: float) -> "PolarNoise":
        """From relative amplitude and phase [rad], peak to peak, uniformly distributed."""
        return cls(amplitude / 12**0.5, phase / 12**0.5)

    def whiten(self, measured: Complex[Array, "n c"], predicted: Complex[Array, "n c"]) -> Float[Array, "n c 2"]:
        """Logarithmic amplitude error and wrapped phase error, each over its standard deviation."""
        error = jnp.log(measured / predicted)
        return jnp.stack([error.real / self.amplitude, error.imag / self.phase], axis=-1)


class Experiment(eqx.Module):
    """One record and the settings it was taken with: what a laboratory would have recorded of a device.

    A new kind of experiment subclasses this, predicts its own record from a bench (device, read-out and effects), and
    can then be fitted together with every other kind.
    """

    shows_modes: ClassVar[bool] = False  # a parasitic mode is looked for here first
    slow: ClassVar[bool] = False  # to predict: a scan takes a coarse net
    driven: ClassVar[bool] = True  # by a known force: else it does not tell the mass
    swept: ClassVar[bool] = True  # or may be: else effects of a moving frequency are none of it

    if TYPE_CHECKING:  # a member's field may stand in the place of a property, not of a class variable

        @property
        def name(self) -> str: ...

        @property
        def measured(self) -> Array: ...

        @property
        def noise(self) -> Noise: ...

    else:
        name: AbstractVar[str]
        measured: AbstractVar[Array]
        noise: AbstractVar[Noise]

    @abc.abstractmethod
    def predict(self, bench: PyTree) -> Array:
        """What the laboratory would have recorded, without noise, in the shape and unit of `measured`."""

    def proposals(self, name: str) -> Iterator[tuple[str, "Experiment"]]:
        """Experiments of the same shapes that a laboratory could add, the least effort first; none by default.

        Each is a sentence that says what to do with the record `name`, and what would then be predicted. They stay
        within what the record shows that device and instruments can do: conditions that were varied, within the values
        that they had, and drives and speeds within `BEYOND` times the largest. `measured`, near which a prediction may
        look for its branch or start, need not be right.
        """
        yield from ()

    @property
    def reads_constants(self) -> bool:
        """Whether a constant voltage of a channel shows in what is read; in a phasor of a lock-in none does."""
        return not jnp.iscomplexobj(self.measured)

    @property
    def rows_stand_alone(self) -> bool:
        """Whether what is left of a row depends on the noise of no other, as it does where a start is solved for."""
        return True

    def at(self, row: int) -> str:
        """Where a row was or would be taken, for people: e.g. "near 3000 Hz"; empty by default."""
        return ""

    @property
    def labels(self) -> np.ndarray | None:
        """(n, 2) number of the record and of the single sweep of each row, where none depends on what acts on others;
        `None`, as by default, where one may.
        """
        return None

    def nothing(self, bench: PyTree) -> Contribution | None:
        """No contribution of effects that the model lacks, which `predict_beside` takes; `None`, as by default, where
        they have to be carried through the model.
        """
        return None

    def predict_beside(self, bench: PyTree, added: Contribution) -> tuple[Array, Inquiry]:
        """What `predict` gives, with something added on its way, and all that it asks of the model; only where
        `nothing` is something.
        """
        raise TypeError(f"{type(self).__name__} carries every effect through its model.")

    @property
    def finer(self) -> "Experiment | None":
        """The same, predicted with a finer resolution; `None` where there is none, as by default."""
        return None

    @property
    def coarse(self) -> "Experiment":
        """The same at its first resolution, for a look at many candidates; itself, by default."""
        return self

    def residual(self, bench: PyTree) -> Float[Array, " r"]:
        """Measured minus predicted in standard deviations of the noise, as one vector."""
        return self.noise.whiten(self.measured, self.predict(bench)).ravel()

    def residual_beside(self, bench: PyTree, added: Contribution) -> tuple[Float[Array, " r"], Inquiry]:
        """The same of the prediction with what is added, and all that it asks of the model."""
        predicted, inquiry = self.predict_beside(bench, added)
        return self.noise.whiten(self.measured, predicted).ravel(), inquiry


@dataclass(frozen=True)
class Readings:
    """An experiment, the record that each of its rows belongs to (−1: padding), the row there, whether it is fitted,
    and the experiment in which rows that were left out since still have their weight.
    """

    experiment: Experiment
    record: np.ndarray
    row: np.ndarray
    fitted: bool
    whole: Experiment | None = None

    @property
    def weightless(self) -> np.ndarray:
        """Which numbers of the residual (r,) belong to no record."""
        return np.repeat(self.record < 0, self.size // self.record.size)

    def changed(self, change: Callable[[Experiment], Experiment]) -> "Readings":
        """The same of a changed experiment, with which that of all rows changes: it is the one that is predicted."""
        whole = None if self.whole is None else change(self.whole)
        return replace(self, experiment=change(self.experiment), whole=whole)

    @property
    def axes(self) -> int:
        """Number of channels."""
        return self.experiment.measured.shape[1]

    @property
    def size(self) -> int:
        """Real numbers in the residual."""
        values = self.experiment.measured
        return values.size * (2 if jnp.iscomplexobj(values) else 1)


class Phasors(NamedTuple):
    """Motion under a known force at rest, which tells a linear device without a guess.

    Args:
        omega: (n,) [rad/s], positive.
        motion: (n, axes) displacement phasors [m].
        force: (n, axes) force phasors [N].
        weight: (n,) one over the standard deviation of the motion [1/m].
        modulus: whether the motion is known by its amplitude alone.
        axis: the only one that was recorded, of which motion and force then have one column; `None` where all were.
        slope, bend: (n, axes) phasors of velocity [m/s] and acceleration [m/s²] of what is no steady motion, under a
            window that has begun and ended; `None` for a steady one, of which they are 1j·omega and −omega² times the
            motion.
        beside: (n,) amplitude of the other axis [m], where its phase is not known; else `None`.
    """

    omega: np.ndarray
    motion: np.ndarray
    force: np.ndarray
    weight: np.ndarray
    modulus: bool = False
    axis: int | None = None
    slope: np.ndarray | None = None
    bend: np.ndarray | None = None
    beside: np.ndarray | None = None

    @property
    def derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """Phasors of velocity and acceleration (n, axes)."""
        turn = 1j * self.omega[:, None]
        slope = turn * self.motion if self.slope is None else self.slope
        return slope, turn**2 * self.motion if self.bend is None else self.bend


def surroundings(
    declared: Declared,
    number: int,
    count: int,
    rate: np.ndarray | float = 0.0,
    *,
    time: np.ndarray | float = 0.0,
    temperature: np.ndarray | float | None = None,
    bias_voltage: np.ndarray | float | None = None,
) -> Conditions:
    """Conditions of `count` rows of record `number`: rate [rad/s], time [s], temperature [K] and bias voltage [V], the
    last two as the case declares them where they are `None`.
    """
    around = declared.environment
    return Conditions(
        rate=rate,
        temperature=around.temperature if temperature is None else temperature,
        bias_voltage=around.bias_voltage if bias_voltage is None else bias_voltage,
        time=time,
        progress=np.linspace(0.0, 1.0, count),
        record=float(number),
    ).rows(count)
