"""Which motion tells the rate best, under limits on displacement and force and under stated errors of the model."""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.device.gyro import AbstractGyro, check_positive, mode_frequencies
from memsgyro_jax.device.propagate import Exact, State4
from memsgyro_jax.loop.bound import OFFSETS
from memsgyro_jax.loop.controllers import DesignedMotion, OpenLoop, Tone
from memsgyro_jax.loop.controllers.base import Tones as AxisTones
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import Annealing, ExtendedKalmanFilter, design_prior
from memsgyro_jax.loop.readout import AbstractReadout, ChargeAmplifier, Delayed
from memsgyro_jax.loop.scenario import as_scenario
from memsgyro_jax.loop.trace import count_steps
from memsgyro_jax.montecarlo.spread import Spread

from . import picture
from .aim import aim, aimed, modes, stay
from .errors import ModelErrors
from .information import Tones, held, rate_variance, sensitivities
from .plant import Plant, plant, unknowns
from .search import Problem, search
from .uncertain import UncertainGyro


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

_SLOTS = 4  # designs of up to so many tones share one compiled program
_USELESS = 1e4  # rad/s
_ALIKE = 0.01  # starts that end within this share of the best count as having found it


@dataclass(frozen=True)
class Setting:
    """What a design was made for: device, read-out, what the observer knows, run, and limits per axis."""

    gyro: AbstractGyro
    readout: AbstractReadout
    known: tuple[str, ...]
    rate: float
    sample_rate: float
    duration: float
    displacement: float
    force: float


@dataclass(frozen=True)
class MotionDesign:
    """A steady motion: per tone and axis, displacement = Re amplitude · exp(2πi frequency t).

    `frequency` (tones,) in Hz; `amplitude` (tones, 2) in m and `force` (tones, 2) in N are complex, the force that of
    the design device. `errors` are those it was made for, `nominal` is the design for none (None where this is it);
    `agreeing` of `starts` searches ended within 1 % of it.
    """

    frequency: Float[np.ndarray, " tones"]
    amplitude: Complex[np.ndarray, "tones 2"]
    force: Complex[np.ndarray, "tones 2"]
    start: State4
    errors: ModelErrors
    setting: Setting
    nominal: "MotionDesign | None" = None
    starts: int = 0
    agreeing: int = 0

    @property
    def controller(self) -> DesignedMotion:
        """Keeps this motion on any die, by forces computed from the estimate."""
        return DesignedMotion(_axis_tones(self.frequency, self.amplitude))

    @property
    def open_loop(self) -> OpenLoop:
        """The forces of the design device, whatever the die."""
        return OpenLoop(_axis_tones(self.frequency, self.force))

    def closed_loop(self, gyro: AbstractGyro | None = None) -> ClosedLoop:
        """A loop in this motion: its controller, a Kalman filter made for the design device, and `gyro` (default: it).

        The gyro has been moving so for long: the motion of the design is its start and the mean of the filter's prior.
        Where the design counts with errors of gain or delay, the filter estimates them; a `UncertainGyro` has them.
        """
        made = self.setting
        device, expected, readout = made.gyro if gyro is None else gyro, made.gyro, made.readout
        known = tuple(name for name in made.known if name in expected.model.names)
        usual = design_prior(made.gyro, amplitude=made.displacement)
        prior = eqx.tree_at(lambda p: p.motion, usual, tuple(map(jnp.asarray, self.start)))
        if float(self.errors.force_gain) > 0.0 or float(self.errors.delay) > 0.0:
            device = device if isinstance(device, UncertainGyro) else UncertainGyro(device)
            expected = UncertainGyro(expected)
            readout = Delayed(readout, device.delay)  # type: ignore[call-arg]
            prior, known = expected.prior(prior, self.errors, known)
        observer = ExtendedKalmanFilter.for_device(
            expected, made.readout, prior=prior, known=known, annealing=Annealing(),
            with_offsets=not set(OFFSETS) <= set(made.known),
        )  # fmt: skip
        return ClosedLoop(device, readout, observer, self.controller, self.start)

    def bound(self, errors: ModelErrors | None = None, gyro: AbstractGyro | None = None) -> float:
        """Least standard deviation of the rate [rad/s] at the end of the run, under `errors` (default: those of the
        design), for `gyro` (default: the design device) in this motion.

        Everything that an observer finds by itself counts as unknown, without prior but for the errors.
        """
        made = self.setting
        gyro = made.gyro if gyro is None else gyro.gyro if isinstance(gyro, UncertainGyro) else gyro
        die = _plant(replace(made, gyro=gyro), _step(made))
        std = (self.errors if errors is None else errors).std(made.gyro)
        moved = Tones(2.0 * np.pi * self.frequency, self.amplitude)
        variance = _variance(die, moved, _own(made), std, 1.0 / made.sample_rate, _samples(made),
                             made.readout.signals, _rate_index(made))  # fmt: skip
        return math.sqrt(float(variance))

    def aimed_at(self, gyro: AbstractGyro) -> "MotionDesign":
        """This design carried over to the modes of another die: its part in each mode and its place between them stay.

        `gyro` may be what an observer has found. The displacement stays within the limit.
        """
        own = Tones(2.0 * np.pi * self.frequency, self.amplitude)
        omega, amplitude = map(np.asarray, _aimed(own, aim(self.setting.gyro, gyro), self.setting.displacement))
        setting = replace(self.setting, gyro=gyro)
        return _finished(omega / (2.0 * np.pi), amplitude, setting, self.errors, self.starts, self.agreeing)

    def with_tones(
        self, frequency: Float[np.ndarray, " tones"], amplitude: Complex[np.ndarray, "tones 2"]
    ) -> "MotionDesign":
        """Another motion in the place of this one: what somebody else's choice of tones is worth."""
        return _finished(np.asarray(frequency, float), np.asarray(amplitude, complex), self.setting, self.errors, 0, 0)

    def to_xarray(self) -> "xr.Dataset":
        """Tones over (tone, axis), and the rate error over (design, model_error)."""
        return picture.dataset(self)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Displacement of both axes, tone by tone, and how far each tone is from a mode."""
        return picture.draw(self, ax)

    def __repr__(self) -> str:
        return picture.text(self)


def design_motion(
    gyro: AbstractGyro,
    readout: AbstractReadout | None = None,
    *,
    tones: int = 4,
    own_axis: bool = False,
    displacement: float = 1e-6,
    force: float = math.inf,
    errors: ModelErrors | None = None,
    known: tuple[str, ...] = (),
    spread: Spread | None = None,
    dies: int = 8,
    aiming: bool = True,
    band: tuple[float, float] | None = None,
    rate: float = 1.0,
    sample_rate: float = 100e3,
    duration: float = 0.1,
    starts: int = 16,
    steps: int = 200,
    seed: int = 0,
) -> MotionDesign:
    """Frequencies, amplitudes and phases of `tones` that let the rate be known best after `duration` [s].

    What is made small is the information bound of the rate, with motion, offsets and coefficients unknown (but for the
    `known` ones) and `errors` of the model known a priori to their standard deviations. The default is `ModelErrors()`:
    a design for a right model uses what the model omits; it is made too, as `nominal`, to show the difference.
    `own_axis=True` lets every tone move one axis only, x and y in turn. `displacement` [m] and `force` [N] bound the
    sum of amplitudes of each axis, `band` [Hz] the frequencies (default: half the lower to one and a half the upper
    mode). With a `spread`, the mean logarithm over `dies` is made small, each of which moves in the design aimed at it
    (`MotionDesign.aimed_at`), or, `aiming=False`, like the design device. The search descends from the `starts` best of
    many random designs, `steps` steps each.

    The bound is local: it takes the observer to be near the truth. A mass, say, that a tone of a picometre would tell
    in principle is then as good as unknown to a filter; count with errors, or name what is `known`.

    Raises `InputError` for what cannot be: no tone, limits that are not positive, an empty band or one beyond half the
    sample rate, an unknown name, a read-out without noise, fewer tones than the unknowns need.
    """
    require_float64("`design_motion`")
    readout = ChargeAmplifier.chi2010() if readout is None else readout
    lower, upper = mode_frequencies(gyro)
    band = (0.5 * float(lower), 1.5 * float(upper)) if band is None else band
    setting = Setting(gyro, readout, tuple(known), rate, sample_rate, duration, displacement, force)
    _check(setting, tones, band, dies, starts)
    errors = ModelErrors() if errors is None else errors
    step = _step(setting)
    die = _plant(setting, step)
    gyros = [gyro] if spread is None else _drawn(setting, spread, dies, seed)
    lot = [(_plant(replace(setting, gyro=each), step), aim(gyro, each) if aiming else stay(gyro)) for each in gyros]
    stacked, aims = jax.tree.map(lambda *leaves: np.stack(leaves), *lot)

    def found(errors: ModelErrors) -> MotionDesign:
        problem = Problem(
            stacked, aims, die, _own(setting), jnp.asarray(errors.std(gyro)), _used(tones, own_axis),
            jnp.asarray(displacement), jnp.asarray(force), jnp.asarray(band), jnp.asarray(1.0 / sample_rate),
            _samples(setting), readout.signals, _rate_index(setting),
        )  # fmt: skip
        best = search(problem, modes(gyro), starts, steps, seed)
        if not best.losses[0] < math.log(_USELESS):
            raise InputError(
                f"Argument `tones` must be enough for all that is unknown, but {tones} leave the rate undetermined; "
                "add tones, or name what is `known`."
            )
        agreeing = int(np.sum(best.losses < best.losses[0] + _ALIKE))
        omega, amplitude = (np.asarray(part[0])[:tones] for part in best.tones)
        return _finished(omega / (2.0 * np.pi), amplitude, setting, errors, starts, agreeing)

    nominal = found(ModelErrors.none())
    return nominal if not np.any(errors.std(gyro)) else replace(found(errors), nominal=nominal)


_held, _aimed = jax.jit(held), jax.jit(aimed)


@partial(jax.jit, static_argnums=(5, 6, 7))
def _variance(
    die: Plant, moved: Tones, own: Array, std: Array, period: float, samples: int, signals: tuple[int, int], rate: int
) -> Array:
    return rate_variance(sensitivities(die, moved, period, samples, signals), own, rate, std)


def _finished(frequency, amplitude, setting, errors, starts, agreeing) -> MotionDesign:
    """The design, with the forces and the start that belong to it."""
    die = _plant(setting, _step(setting))
    kept = _held(die, Tones(2.0 * np.pi * frequency, amplitude), 1.0 / setting.sample_rate)
    order = np.argsort(frequency)
    start = tuple(float(v) for v in np.sum(np.asarray(kept.motion), axis=0).real)
    force = np.asarray(kept.force)[order]
    return MotionDesign(frequency[order], amplitude[order], force, start, errors, setting, None, starts, agreeing)


def _check(setting: Setting, tones: int, band: tuple[float, float], dies: int, starts: int) -> None:
    for name, count in (("tones", tones), ("dies", dies), ("starts", starts)):
        if count < 1:
            raise InputError(f"Argument `{name}` must be at least 1, but {count} was given.")
    for name in ("displacement", "sample_rate", "duration"):
        check_positive(name, getattr(setting, name))
    if not setting.force > 0.0:
        raise InputError(f"Argument `force` must be positive, but {setting.force:g} was given.")
    count_steps(setting.sample_rate, setting.duration)
    if not 0.0 < band[0] < band[1] < 0.5 * setting.sample_rate:
        raise InputError(
            f"Argument `band` must be two rising frequencies below half the sample rate of {setting.sample_rate:g} Hz, "
            f"but {band[0]:g} and {band[1]:g} Hz were given."
        )
    names = unknowns(setting.gyro.model)[: _count_own(setting)]
    for name in setting.known:
        if name not in names or name == "rate":
            raise InputError(
                f"Argument `known` must name some of {', '.join(n for n in names if n != 'rate')}, but holds `{name}`."
            )
    if any(float(v) <= 0.0 for v in setting.readout.noise_density):
        raise InputError(
            "The read-out must have noise on both axes for a bound to exist, but a `noise_density` of 0 was given."
        )


def _used(tones: int, own_axis: bool) -> Float[np.ndarray, "slots 2"]:
    used = np.zeros((-(-tones // _SLOTS) * _SLOTS, 2))
    used[:tones] = np.eye(2)[np.arange(tones) % 2] if own_axis else 1.0
    return jnp.asarray(used)


def _count_own(setting: Setting) -> int:
    return 6 + len(setting.gyro.model.names)


def _own(setting: Setting) -> Float[np.ndarray, " own"]:
    names = unknowns(setting.gyro.model)[: _count_own(setting)]
    return jnp.asarray([float(name not in setting.known) for name in names])


def _rate_index(setting: Setting) -> int:
    return 6 + setting.gyro.model.index("rate")


def _samples(setting: Setting) -> int:
    return count_steps(setting.sample_rate, setting.duration)


def _step(setting: Setting) -> Exact:
    return Exact.covering(1.3 * float(np.max(mode_frequencies(setting.gyro))), setting.sample_rate)


def _plant(setting: Setting, step: Exact) -> Plant:
    return plant(setting.gyro, setting.readout, setting.rate, setting.sample_rate, step)


def _drawn(setting: Setting, spread: Spread, dies: int, seed: int) -> list[AbstractGyro]:
    """The devices of a lot, one by one."""
    observer = ExtendedKalmanFilter.for_device(setting.gyro, setting.readout)
    loop = ClosedLoop(setting.gyro, setting.readout, observer, OpenLoop())
    drawn = spread.draw(loop, as_scenario(setting.rate), seed, np.arange(dies)).loop.device
    pick = lambda i: jax.tree.map(lambda v, one: v[i] if jnp.ndim(v) > jnp.ndim(one) else v, drawn, setting.gyro)  # noqa: E731
    return [pick(i) for i in range(dies)]


def _axis_tones(frequency: np.ndarray, phasor: np.ndarray) -> AxisTones:
    """Tones per axis: Re a·exp(iωt) is |a|·sin(ωt + arg a + π/2)."""

    def axis(column: np.ndarray) -> tuple[Tone, ...]:
        return tuple(Tone(f, abs(a), np.angle(a) + 0.5 * np.pi) for f, a in zip(frequency, column, strict=True))

    return axis(phasor[:, 0]), axis(phasor[:, 1])
