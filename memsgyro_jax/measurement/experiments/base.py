"""The port of the measurement side: a kind of experiment that predicts what the laboratory would have recorded."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, PyTree


class Noise(eqx.Module):
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
    """One record and the settings it was taken with.

    A new kind of experiment subclasses this, predicts its own record from a bench (device, read-out and effects), and
    can then be fitted together with every other kind.
    """

    name: eqx.AbstractVar[str]
    measured: eqx.AbstractVar[Array]
    noise: eqx.AbstractVar[Noise]

    @abc.abstractmethod
    def predict(self, bench: PyTree) -> Array:
        """What the laboratory would have recorded, without noise, in the shape and unit of `measured`."""

    @abc.abstractmethod
    def conditions(self) -> dict[str, Float[Array, " n"]]:
        """What was set or known per row, by name with its SI unit, e.g. `{"drive [N]": ...}`: where a misfit may depend
        on.
        """

    def residual(self, bench: PyTree) -> Float[Array, " r"]:
        """Measured minus predicted in standard deviations of the noise, as one vector."""
        return self.noise.whiten(self.measured, self.predict(bench)).ravel()
