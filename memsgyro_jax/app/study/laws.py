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
from memsgyro_jax.loop.observers import (
    AbstractObserver,
    EnergyObserver,
    ExtendedKalmanFilter,
    JumpTest,
    KnownRateFilter,
    LyapunovObserver,
    ScaleRatioFilter,
    curves_of,
)
from memsgyro_jax.loop.observers.adaptation import Adapting
from memsgyro_jax.loop.observers.fading import AbstractFading, AdaptiveFading, FixedFading
from memsgyro_jax.loop.observers.settings import Annealing, ProcessNoise, design_prior
from memsgyro_jax.loop.readout import AbstractReadout

from .classic import Unobserved


Discretisation = Literal["exact", "euler"]
Positive = Annotated[float, Field(gt=0.0), In("1")]
ObserverT = TypeVar("ObserverT", bound=AbstractObserver)


def discretisation(name: Discretisation) -> AbstractDiscretisation:
    """The way a sample is computed: exactly, or by the thesis' forward Euler."""
    return Exact() if name == "exact" else ForwardEuler()


class Fixed(FileSection):
    """`fading = { kind = "fixed", forgetting = "1400 1/s" }`; zero never forgets."""

    kind: Literal["fixed"]
    forgetting: PerSecond

    def build(self) -> AbstractFading:
        """The law."""
        return FixedFading(self.forgetting)


class Adaptive(FileSection):
    """`fading = { kind = "adaptive", window = "1 ms" }`: forget when the innovations exceed what is expected."""

    kind: Literal["adaptive"]
    window: Duration = 1e-3
    ceiling: Annotated[float, Field(ge=1.0), In("1")] = 1.01

    def build(self) -> AbstractFading:
        """The law."""
        return AdaptiveFading(self.window, self.ceiling)


Fading = Annotated[Fixed | Adaptive, Field(discriminator="kind")]


class Anneal(FileSection):
    """`annealing = { excess = 1000, decay = "0.5 ms" }`: a cautious start; `excess = 0` is none.

    The decay is one and a half periods of the lower mode when left out.
    """

    excess: Share = 1000.0
    decay: Duration | None = None


class JumpWatch(FileSection):
    """`jump = { damping = "10 1/s" }`: a χ² test of the innovations over `window`, beyond whose `level`, in standard
    deviations, the damping coefficients are open by that much again.
    """

    damping: PerSecond
    window: Duration = 1e-3
    level: Positive = 5.0


class PriorSpread(FileSection):
    """Standard deviations of what the filter believes at the start; zero means known exactly.

    `spread` of each coefficient relative to its design value (left out: that of `[spread]`, or 15 % where it has none);
    `motion_error` relative to `amplitude`, the displacement along x at which the filter starts (left out: the true
    one).
    """

    spread: Share | None = None
    rate_std: Annotated[float, Field(ge=0.0), In("rad/s")] = 3.0
    offset_std: Annotated[float, Field(ge=0.0), In("V")] = 20e-3
    amplitude: Metre | None = None
    motion_error: Share = 0.05


_Walk = Annotated[float, Field(ge=0.0), In("rad^2/s^3")]
_StiffnessWalk = Annotated[float, Field(ge=0.0), In("1/s^5")]
_DampingWalk = Annotated[float, Field(ge=0.0), In("1/s^3")]
_MassWalk = Annotated[float, Field(ge=0.0), In("1/(kg^2*s)")]


class Walks(FileSection):
    """Random-walk intensities in (unit of the entry)²/s; what is not named does not walk."""

    rate: _Walk | None = None
    rate_x: _Walk | None = None
    kxx: _StiffnessWalk | None = None
    kyy: _StiffnessWalk | None = None
    kxy: _StiffnessWalk | None = None
    kyx: _StiffnessWalk | None = None
    dxx: _DampingWalk | None = None
    dyy: _DampingWalk | None = None
    dxy: _DampingWalk | None = None
    sigma: _MassWalk | None = None
    sigma_x: _MassWalk | None = None
    sigma_y: _MassWalk | None = None
    offset: Pair[Annotated[float, Field(ge=0.0), In("V^2/s")]] = (0.0, 0.0)
    position: Pair[Annotated[float, Field(ge=0.0), In("m^2/s")]] = (0.0, 0.0)
    velocity: Pair[Annotated[float, Field(ge=0.0), In("m^2/s^3")]] = (0.0, 0.0)

    def build(self, gyro: AbstractGyro) -> ProcessNoise:
        """The process noise; raises `InputError` for a coefficient that the device does not have."""
        given = self.numbers()
        offset, motion = given.pop("offset"), (*given.pop("position"), *given.pop("velocity"))
        theta = ProcessNoise.of(gyro.model, **{name: value for name, value in given.items() if value is not None}).theta
        return ProcessNoise(motion, offset, theta).shaken_as(gyro)


class KalmanSettings(FileSection):
    """What every Kalman filter is told. `noise_density` left out is that of the read-out; `knows_pickoff` tells it the
    curves of the pick-off that the device has as effects.
    """

    known: tuple[str, ...] = ()
    with_offsets: bool = True
    iterations: Annotated[Whole, Field(ge=1)] = 1
    knows_pickoff: bool = False
    discretisation: Discretisation = "exact"
    noise_density: Pair[Density] | None = None
    annealing: Anneal | None = None
    fading: Fading | None = None
    process_noise: Walks = Walks()
    prior: PriorSpread = PriorSpread()

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

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The filter; raises `InputError` for a coefficient that the device does not have."""
        made = ExtendedKalmanFilter.for_device(gyro, readout, **self.settings(gyro))
        made = self.told(made, lambda o: o.noise_density)
        if self.jump is None:
            return made
        return JumpTest.of_damping(made, self.jump.damping, window=self.jump.window, level=self.jump.level)


class BlockKalman(KalmanSettings):
    """`kind = "block_ekf"`: the filter that takes `length` samples at a time by their projections on the modes and the
    `tones` [Hz], behind the first `start`: 512 left out, 2048 for two masses.
    """

    kind: Literal["block_ekf"]
    tones: tuple[Hertz, ...] = ()
    length: Annotated[Whole, Field(ge=2)] = 1024
    start: Annotated[Whole, Field(ge=1)] | None = None

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The filter; raises `InputError` for a length that is no power of two, and what a block cannot hold."""
        blocks = {"tones": self.tones, "length": self.length, "start": self.start}
        made = BlockFilter.for_device(gyro, readout, **blocks, **self.settings(gyro))
        return self.told(made, lambda o: o.filter.noise_density)


class ScaleRatio(KalmanSettings):
    """`kind = "scale_ratio"`: the filter that also finds by how much the scales of the two channels differ, known to
    `ratio` at the start.
    """

    kind: Literal["scale_ratio"]
    ratio: Share = 0.1

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The filter; raises `InputError` for a device of two masses."""
        made = ScaleRatioFilter.for_device(gyro, readout, ratio_std=self.ratio, **self.settings(gyro))
        return self.told(made, lambda o: o.filter.noise_density)


class KnownRate(KalmanSettings):
    """`kind = "known_rate"`: the filter that learns unequal cross damping, known to the share `asymmetry`, while the
    rate is known: `rate`, until `until`.
    """

    kind: Literal["known_rate"]
    until: Annotated[float, Field(ge=0.0), In("s")]
    rate: Annotated[float, In("rad/s")] = 0.0
    asymmetry: Share = 0.1

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
    """What laws that adapt by velocity errors share. `start` scales the first guess of the coefficients.

    `adaptation` multiplies their unit gains, in the order of the device's model; left out, all are 1 but those of
    `known`, which are 0. `length` and `frequency` left out are the start and, nearly, the lower mode.
    """

    known: tuple[str, ...] = ()
    adaptation: tuple[Share, ...] | None = None
    start: Pure = 1.0
    length: Annotated[float, Field(gt=0.0), In("m")] | None = None
    frequency: Annotated[float, Field(gt=0.0), In("rad/s")] | None = None


class LyapunovGains(AdaptiveGains):
    """Those of the Lyapunov observer. With `annealing` the coefficients are adapted faster at first; its decay, left
    out, is 150 periods of the lower mode.
    """

    gain: Pair[Positive] = (100.0, 100.0)
    annealing: Anneal | None = None
    discretisation: Discretisation = "exact"

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
    """`energy = { frequency, amplitude, gain }`: the energy that the observer expects, thesis (4.21)."""

    frequency: tuple[Hertz, Hertz]
    amplitude: tuple[Metre, Metre]
    gain: Share = 1.0


class EnergyLyapunov(LyapunovGains):
    """`kind = "energy_lyapunov"`: the Lyapunov observer with energy state, thesis (4.22) to (4.24)."""

    kind: Literal["energy_lyapunov"]
    energy: EnergyLevel

    def build(self, gyro: AbstractGyro, readout: AbstractReadout) -> AbstractObserver:
        """The observer."""
        return EnergyObserver(self.observer(gyro, readout), **self.energy.numbers())


Observer = Annotated[
    Kalman | BlockKalman | ScaleRatio | KnownRate | Lyapunov | EnergyLyapunov | Unobserved, Field(discriminator="kind")
]
