"""Section `[observer]` of a study file."""

from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeVar

import equinox as eqx
import jax.numpy as jnp
from pydantic import Field

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import (
    Density,
    Duration,
    FileSection,
    Hertz,
    In,
    Metre,
    Pair,
    PerSecond,
    Pure,
    Share,
    Whole,
)
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.device.propagate import AbstractDiscretisation, Exact, ForwardEuler
from memsgyro_jax.loop.blocks.block_filter import BlockFilter
from memsgyro_jax.loop.integrated import Integrated
from memsgyro_jax.loop.observers import (
    AbstractObserver,
    EnergyObserver,
    ExtendedKalmanFilter,
    JumpTest,
    KnownRateFilter,
    LyapunovObserver,
    RateSlopeFilter,
    ScaleRatioFilter,
    curves_of,
)
from memsgyro_jax.loop.observers.adaptation import Adapting
from memsgyro_jax.loop.observers.fading import AbstractFading, AdaptiveFading, FixedFading
from memsgyro_jax.loop.observers.settings import Annealing, design_prior
from memsgyro_jax.loop.readout import AbstractReadout

from .beliefs import PriorSpread, Walks
from .classic import Unobserved


Discretisation = Literal["exact", "euler"]
OfDevice = Literal["exact", "euler", "integrated"]
Positive = Annotated[float, Field(gt=0.0), In("1")]
ObserverT = TypeVar("ObserverT", bound=AbstractObserver)


def discretisation(name: OfDevice) -> AbstractDiscretisation:
    """The way a sample is computed: exactly but for the effects, by the thesis' forward Euler, or to a tolerance."""
    return {"exact": Exact, "euler": ForwardEuler, "integrated": Integrated}[name]()


class Fixed(FileSection):
    """`fading = { kind = "fixed", forgetting = "1400 1/s" }`: forget at one pace; zero never forgets."""

    kind: Literal["fixed"]
    forgetting: PerSecond
    """How fast the filter forgets: its memory is 1/forgetting, λ = exp(forgetting·period) in a sample."""

    def build(self) -> AbstractFading:
        """The law."""
        return FixedFading(self.forgetting)


class Adaptive(FileSection):
    """`fading = { kind = "adaptive", window = "1 ms" }`: forget when the innovations exceed what is expected."""

    kind: Literal["adaptive"]
    window: Duration = 1e-3
    """Time constant over which the innovations are averaged."""
    ceiling: Annotated[float, Field(ge=1.0), In("1")] = 1.01
    """Largest factor λ of the covariance in a sample."""

    def build(self) -> AbstractFading:
        """The law."""
        return AdaptiveFading(self.window, self.ceiling)


Fading = Annotated[Fixed | Adaptive, Field(discriminator="kind")]


class Anneal(FileSection):
    """`annealing = { excess = 1000, decay = "0.5 ms" }`: a start by the factor 1 + excess·exp(-t/decay), on the
    variance of the measurement of a Kalman filter (cautious), on the gains by which a Lyapunov observer adapts (hasty).
    """

    excess: Share = 1000.0
    """What the factor exceeds 1 by at time zero; zero is none."""
    decay: Duration | None = None
    """Time constant with which that fades; left out, 1.447 periods of the lower mode, of a Lyapunov observer 100 times
    that."""


class JumpWatch(FileSection):
    """`jump = { damping = "10 1/s" }`: a χ² test of the innovations, beyond whose level the damping is open again."""

    damping: PerSecond
    """Standard deviation (1σ) by which the damping coefficients per mass are open again when the test is met."""
    window: Duration = 1e-3
    """Time constant over which the normalised innovations squared are averaged."""
    level: Positive = 5.0
    """What their mean must exceed, in standard deviations of what a consistent filter has."""


class KalmanSettings(FileSection):
    """What every Kalman filter is told."""

    known: tuple[str, ...] = ()
    """Coefficients that are taken as known and not estimated, by name: "rate", "kxx", "kyy", "kxy", "dxx", "dyy",
    "dxy", "sigma" (1/mass) of one mass; "rate_x", "kyx", "sigma_x", "sigma_y" are those of two."""
    with_offsets: bool = True
    """Whether the two offsets of the read-out are estimated; false expects none (the thesis' ideal circuit)."""
    iterations: Annotated[Whole, Field(ge=1)] = 1
    """How often each sample is linearised: more than once about its smoothed start (iterated filter-smoother)."""
    knows_pickoff: bool = False
    """Whether the filter is told the curves of the pick-off that the device has as effects."""
    discretisation: Discretisation = "exact"
    """How the filter computes a sample: exactly, or by the thesis' forward Euler."""
    noise_density: Pair[Density] | None = None
    """White noise that the filter expects of the read-out, one-sided density; left out, that of the read-out."""
    annealing: Anneal | None = None
    """A cautious start; left out, none."""
    fading: Fading | None = None
    """A memory that fades; left out, one that lasts."""
    process_noise: Walks = Walks()
    """What the filter expects to change: random-walk intensities; what is left out stays as it is."""
    prior: PriorSpread = PriorSpread()
    """What the filter believes at the start."""

    def settings(self, gyro: AbstractGyro) -> dict[str, Any]:
        """What `for_device` of the filter is given; raises `InputError` for a coefficient that the device does not
        have.
        """
        return {
            "known": self.known,
            "with_offsets": self.with_offsets,
            "prior": design_prior(gyro, **self.prior.numbers()),
            "process_noise": self.process_noise.build(gyro),
            "fading": self.fading and self.fading.build(),
            "annealing": self.annealing and Annealing(**self.annealing.numbers()),
            "discretisation": discretisation(self.discretisation),
            "iterations": self.iterations,
            "pickoff": curves_of(gyro) if self.knows_pickoff else (),
        }

    def told(self, made: ObserverT, density: Callable[[Any], Any]) -> ObserverT:
        """`made` with the noise density of the section, which stands at `density`."""
        if self.noise_density is None:
            return made
        return eqx.tree_at(density, made, tuple(map(jnp.asarray, self.noise_density)))


class Kalman(KalmanSettings):
    """`kind = "ekf"`: extended Kalman filter."""

    kind: Literal["ekf"]
    jump: JumpWatch | None = None
    """A test for jumps of the damping; left out, none."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The filter; raises `InputError` for a coefficient that the device does not have."""
        made = ExtendedKalmanFilter.for_device(gyro, readout, **self.settings(gyro))
        made = self.told(made, lambda o: o.noise_density)
        if self.jump is None:
            return made
        return JumpTest.of_damping(made, self.jump.damping, window=self.jump.window, level=self.jump.level)


class BlockKalman(KalmanSettings):
    """`kind = "block_ekf"`: the filter that takes a block of samples at a time, by their projections on the modes and
    the tones. It can neither fade nor iterate, nor know curves of the pick-off or the device's Brownian force.
    """

    kind: Literal["block_ekf"]
    tones: tuple[Hertz, ...] = ()
    """Frequencies of auxiliary signals that the motion holds beside its modes; what is left out tells nothing."""
    length: Annotated[Whole, Field(ge=2)] = 1024
    """Number of samples in a block, a power of two."""
    start: Annotated[Whole, Field(ge=1)] | None = None
    """Number of samples that are taken one by one before the first block; left out, 512, for two masses 2048."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The filter; raises `InputError` for a length that is no power of two, and what a block cannot hold."""
        blocks = {"tones": self.tones, "length": self.length, "start": self.start}
        made = BlockFilter.for_device(gyro, readout, **blocks, **self.settings(gyro))
        return self.told(made, lambda o: o.filter.noise_density)


class ScaleRatio(KalmanSettings):
    """`kind = "scale_ratio"`: the filter that also finds by how much the scales of the two channels differ."""

    kind: Literal["scale_ratio"]
    ratio: Share = 0.1
    """Standard deviation (1σ) of that difference at the start, as a share of the scale; zero is no difference."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The filter; raises `InputError` for a device of two masses."""
        made = ScaleRatioFilter.for_device(gyro, readout, ratio_std=self.ratio, **self.settings(gyro))
        return self.told(made, lambda o: o.filter.noise_density)


class RateSlope(KalmanSettings):
    """`kind = "rate_slope"`: the filter that also finds how fast the rate changes, for rates that move."""

    kind: Literal["rate_slope"]
    slope: Annotated[float, Field(ge=0.0), In("rad/s^2")]
    """Standard deviation (1σ) of the slope of the rate at the start: 2π·f·A for a swing of amplitude A."""
    walk: Annotated[float, Field(ge=0.0), In("rad^2/s^5")] = 0.0
    """Random walk of the slope, variance per time: (2π·f)³·A² follows such a swing; zero is a steady slope."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The filter; raises `InputError` for a rate that is taken as known."""
        slope = {"slope_std": self.slope, "slope_walk": self.walk}
        made = RateSlopeFilter.for_device(gyro, readout, **slope, **self.settings(gyro))
        return self.told(made, lambda o: o.filter.noise_density)


class KnownRate(KalmanSettings):
    """`kind = "known_rate"`: the filter that learns unequal cross damping while the rate is known."""

    kind: Literal["known_rate"]
    until: Annotated[float, Field(ge=0.0), In("s")]
    """Time until which the rate is known; zero means never."""
    rate: Annotated[float, In("rad/s")] = 0.0
    """The rate until then."""
    asymmetry: Share = 0.1
    """Standard deviation (1σ) of dyx - dxy at the start, as a share of the design's dxy; zero means equal."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The filter; raises `InputError` for a device of two masses."""
        phase = {"until": self.until, "rate": self.rate, "asymmetry": self.asymmetry}
        made = KnownRateFilter.for_device(gyro, readout, **phase, **self.settings(gyro))
        return self.told(made, lambda o: o.filter.noise_density)


Made = TypeVar("Made", bound=Adapting)


def scaled(made: Made, adaptation: tuple[float, ...] | None) -> Made:
    """The observer or controller with other factors of its unit gains; raises `InputError` for too few or many."""
    if adaptation is None:
        return made
    if len(adaptation) != len(made.adaptation):
        names = ", ".join(made.model.names)
        raise InputError(f"adaptation must have one entry for each of {names}, but has {len(adaptation)}")
    return eqx.tree_at(lambda o: o.adaptation, made, tuple(map(jnp.asarray, adaptation)))


class AdaptiveGains(FileSection):
    """What laws that adapt by velocity errors share. Their gains have no units: they hold for motion in units of
    `length` and time in units of 1/`frequency`.
    """

    known: tuple[str, ...] = ()
    """Coefficients that are taken as known and not adapted, by name: "sigma" (1/mass), "kxx", ..."""
    adaptation: tuple[Share, ...] | None = None
    """Factors of the unit gains by which the coefficients are adapted, in the order of the device's model; left out, 1,
    and 0 for those of `known`."""
    start: Pure = 1.0
    """First guess of the coefficients, as a share of those of the design; the rate starts at zero."""
    length: Annotated[float, Field(gt=0.0), In("m")] | None = None
    """Unit of length of the gains; left out, 2 % of the travel, at which a mass usually starts."""
    frequency: Annotated[float, Field(gt=0.0), In("rad/s")] | None = None
    """Angular frequency whose inverse is the unit of time of the gains; left out, 1.037 times that of the lower
    mode."""


class LyapunovGains(AdaptiveGains):
    """Those of the Lyapunov observer."""

    gain: Pair[Positive] = (100.0, 100.0)
    """Gain l by which the error of the velocity corrects the motion, of x and y, thesis (4.11)."""
    annealing: Anneal | None = None
    """A start at which the coefficients are adapted faster; left out, none."""
    discretisation: Discretisation = "exact"
    """How the observer computes a sample: exactly, or by the thesis' forward Euler."""

    def observer(self, gyro: AbstractGyro, readout: AbstractReadout) -> LyapunovObserver:
        """The observer; raises `InputError` for another read-out or a coefficient that the device does not have."""
        names = ("gain", "known", "start", "length", "frequency")
        given = {name: value for name, value in self.numbers().items() if name in names}
        made = LyapunovObserver.for_device(
            gyro, readout, discretisation=discretisation(self.discretisation),
            annealing=self.annealing and Annealing(**self.annealing.numbers()), **given,
        )  # fmt: skip
        return scaled(made, self.adaptation)


class Lyapunov(LyapunovGains):
    """`kind = "lyapunov"`: the thesis' own observer; it needs a velocity read-out."""

    kind: Literal["lyapunov"]

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The observer."""
        return self.observer(gyro, readout)


class EnergyLevel(FileSection):
    """`energy = { frequency, amplitude, gain }` of an observer: the energy that it expects, thesis (4.21)."""

    frequency: tuple[Hertz, Hertz]
    """Frequencies (x, y) at which the axes swing under energy control, by which the energy is reckoned."""
    amplitude: tuple[Metre, Metre]
    """Displacement amplitudes (x, y) of which the energy is expected."""
    gain: Share = 1.0
    """Factor of the thesis' unit gain by which missing energy moves the coefficients; zero leaves them to the
    velocity."""


class EnergyLyapunov(LyapunovGains):
    """`kind = "energy_lyapunov"`: the Lyapunov observer with energy state, thesis (4.22) to (4.24)."""

    kind: Literal["energy_lyapunov"]
    energy: EnergyLevel
    """The energy that the observer expects."""

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The observer."""
        return EnergyObserver(self.observer(gyro, readout), **self.energy.numbers())


Observer = Annotated[
    Kalman | BlockKalman | ScaleRatio | RateSlope | KnownRate | Lyapunov | EnergyLyapunov | Unobserved,
    Field(discriminator="kind"),
]
