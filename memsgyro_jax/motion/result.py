"""A designed motion: its tones, what it was made for, and what it lets an observer know."""

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.units import rate_to_dps
from memsgyro_jax.device.gyro import AbstractGyro, mode_frequencies
from memsgyro_jax.device.propagate import Exact, State4
from memsgyro_jax.loop.controllers import DesignedMotion, OpenLoop, Tone
from memsgyro_jax.loop.controllers.base import Tones as AxisTones
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import Annealing, ExtendedKalmanFilter, design_prior
from memsgyro_jax.loop.observers.base import OFFSETS
from memsgyro_jax.loop.readout import AbstractReadout, Delayed
from memsgyro_jax.loop.trace import count_steps

from .aim import aim, aimed
from .errors import ModelErrors
from .information import Tones, held, rate_variance, sensitivities
from .plant import Plant, plant, unknowns
from .uncertain import UncertainGyro


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


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

    @cached_property
    def step(self) -> Exact:
        """How motion is propagated, fit for the design device's modes."""
        return Exact.covering(1.3 * float(np.max(mode_frequencies(self.gyro))), self.sample_rate)

    @property
    def samples(self) -> int:
        """Samples of the run."""
        return count_steps(self.sample_rate, self.duration)

    @property
    def own(self) -> tuple[str, ...]:
        """What the observer may find by itself, in the order of the sensitivities."""
        return unknowns(self.gyro.model)[: 6 + len(self.gyro.model.names)]

    @property
    def free(self) -> Float[Array, " own"]:
        """1 for what is unknown, 0 for what is known, of `own`."""
        return jnp.asarray([float(name not in self.known) for name in self.own])

    @property
    def rate_index(self) -> int:
        """Where the rate stands among `own`."""
        return 6 + self.gyro.model.index("rate")

    def plant(self, gyro: AbstractGyro | None = None) -> Plant:
        """The design device, or `gyro` in its place, behind the read-out and sampled."""
        return plant(self.gyro if gyro is None else gyro, self.readout, self.rate, self.sample_rate, self.step)


@dataclass(frozen=True)
class MotionDesign(Shown):
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
        The filter knows of the errors that the design counts with: it finds those of gain and delay, which an
        `UncertainGyro` has, and as it cannot tell unequal cross damping from a rate, its claim of the rate covers that.
        """
        made = self.setting
        device, expected, readout = made.gyro if gyro is None else gyro, made.gyro, made.readout
        known, annealing = tuple(name for name in made.known if name in expected.model.names), Annealing()
        usual = design_prior(made.gyro, amplitude=made.displacement)
        prior = eqx.tree_at(lambda p: p.motion, usual, tuple(map(jnp.asarray, self.start)))
        if np.any(self.errors.std(expected)):
            device = device if isinstance(device, UncertainGyro) else UncertainGyro(device)
            expected = UncertainGyro(expected)
            readout = Delayed(readout, device.delay) if float(self.errors.delay) > 0.0 else readout
            prior, known = expected.prior(prior, self.errors, known)
            # The more it counts with, the less it bears to be linearised about its prior; what it loses by a slow start
            # is nothing beside what cross damping hides of the rate.
            if float(self.errors.cross_damping) > 0.0:
                annealing = Annealing(1e5, 0.05 * made.duration)
        observer = ExtendedKalmanFilter.for_device(
            expected, made.readout, prior=prior, known=known, annealing=annealing,
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
        die = made.plant(gyro)
        std = (self.errors if errors is None else errors).std(made.gyro)
        moved = Tones(2.0 * np.pi * self.frequency, self.amplitude)
        variance = _variance(die, moved, made.free, std, 1.0 / made.sample_rate, made.samples,
                             made.readout.signals, made.rate_index)  # fmt: skip
        return math.sqrt(float(variance))

    def aimed_at(self, gyro: AbstractGyro) -> "MotionDesign":
        """This design carried over to the modes of another die: its part in each mode and its place between them stay.

        `gyro` may be what an observer has found. The displacement stays within the limit.
        """
        own = Tones(2.0 * np.pi * self.frequency, self.amplitude)
        omega, amplitude = map(np.asarray, _aimed(own, aim(self.setting.gyro, gyro), self.setting.displacement))
        setting = replace(self.setting, gyro=gyro)
        return finished(omega / (2.0 * np.pi), amplitude, setting, self.errors, self.starts, self.agreeing)

    def with_tones(
        self, frequency: Float[np.ndarray, " tones"], amplitude: Complex[np.ndarray, "tones 2"]
    ) -> "MotionDesign":
        """Another motion in the place of this one: what somebody else's choice of tones is worth."""
        return finished(np.asarray(frequency, float), np.asarray(amplitude, complex), self.setting, self.errors, 0, 0)

    def to_xarray(self) -> "xr.Dataset":
        """Tones over (tone, axis), and the rate error over (design, model_error)."""
        import xarray as xr

        rows, others = _cases(ModelErrors() if self.nominal is None else self.errors), self._designs
        bounds = [[other.bound(case) for case in rows.values()] for other in others.values()]
        variables = {
            "frequency": ("tone", self.frequency, {"units": "Hz"}),
            "displacement": (("tone", "axis"), np.abs(self.amplitude), {"units": "m"}),
            "phase": (("tone", "axis"), np.angle(self.amplitude), {"units": "rad"}),
            "force": (("tone", "axis"), np.abs(self.force), {"units": "N"}),
            "force_phase": (("tone", "axis"), np.angle(self.force), {"units": "rad"}),
            "bound": (("design", "model_error"), bounds, {"units": "rad/s"}),
        }
        made = self.setting
        settings = {"sample_rate": made.sample_rate, "duration": made.duration, "known": ", ".join(made.known)}
        return xr.Dataset(variables, {"axis": ["x", "y"], "design": list(others), "model_error": list(rows)}, settings)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Displacement of both axes, tone by tone, and how far each tone is from a mode."""
        ax = axes(ax)
        modes, places, labels = mode_frequencies(self.setting.gyro), np.arange(len(self.frequency)), []
        for axis, name in enumerate("xy"):
            size = 1e6 * np.abs(self.amplitude[:, axis])
            ax.bar(places + 0.2 * (2 * axis - 1), size, 0.38, color=f"C{axis}", label=name)
        for frequency in self.frequency:
            near = int(np.argmin(np.abs(modes - frequency)))
            labels.append(f"{frequency:.1f} Hz\nmode {near + 1} {frequency - modes[near]:+.1f} Hz")
        ax.set_xticks(places, labels, fontsize="small")
        ax.set_ylim(0.0, 1.05e6 * self.setting.displacement)
        ax.set_ylabel("displacement [µm]")
        ax.legend(loc="best", frameon=False)
        return ax

    def __repr__(self) -> str:
        made = self.setting
        bound = rate_to_dps(self.bound())
        lines = [
            (
                f"Designed motion, {len(self.frequency)} tones within {1e6 * made.displacement:.3g} µm: bound of the "
                f"rate {bound:.3g} deg/s after {made.duration:g} s ({self.agreeing} of {self.starts} starts agree)"
            )
        ]
        for frequency, amplitude in zip(self.frequency, self.amplitude, strict=True):
            parts = (
                f"{n} {1e6 * abs(a):.4f} µm at {np.degrees(np.angle(a)):4.0f}°"
                for n, a in zip("xy", amplitude, strict=True)
            )
            lines.append(f"  {frequency:8.1f} Hz  " + ", ".join(parts))
        peak = np.sum(np.abs(self.force), axis=0)
        lines.append(f"  force up to {1e6 * peak[0]:.3g} and {1e6 * peak[1]:.3g} µN")
        others = self._designs
        rows = _cases(self.errors if np.any(self.errors.std(made.gyro)) else ModelErrors())
        width = max(25, *map(len, rows))
        lines.append(f"  {'bound of the rate [deg/s]':<{width}}" + "".join(f"  {name:>14}" for name in others))
        for name, case in rows.items():
            figures = (f"  {rate_to_dps(other.bound(case)):14.4g}" for other in others.values())
            lines.append(f"  {name:<{width}}" + "".join(figures))
        if self.nominal is not None:
            lines.append(f"  {self._worth}")
        return "\n".join(lines)

    @property
    def _worth(self) -> str:
        """What designing for the errors has gained over the nominal design, under the same errors."""
        assert self.nominal is not None
        own, other = self.bound(), self.nominal.bound(self.errors)
        gain, floor = 1.0 - own / other, float(self.errors.std(self.setting.gyro)[0]) / 4.0
        gains = "nothing" if gain < _NIL else f"{100.0 * gain:.2g} %"
        text = f"designing for these errors gains {gains} over the nominal design under them"
        text += f" ({rate_to_dps(own):.5g} against {rate_to_dps(other):.5g} deg/s)"
        rules = f"; cross damping by itself is {rate_to_dps(floor):.5g} deg/s, which no motion lowers"
        return text + (rules if floor > _RULES * own else "")

    @property
    def _designs(self) -> dict[str, "MotionDesign"]:
        """This design, and the nominal one where there is another."""
        return {"this design": self} | ({} if self.nominal is None else {"nominal design": self.nominal})


def _cases(errors: ModelErrors) -> dict[str, ModelErrors]:
    """The errors one after the other, each beside those before: what a table of designs is read by."""
    cross, gain, delay = errors.cross_damping, errors.force_gain, errors.delay
    steps = ((0.0, 0.0, 0.0), (cross, 0.0, 0.0), (cross, gain, 0.0), (cross, gain, delay))
    made = {str(ModelErrors(*step)): ModelErrors(*step) for step in steps}
    return {"right model" if name == "none" else name: error for name, error in made.items()}


_NIL, _RULES = 0.01, 0.9  # a gain that nobody would design for; a share of the bound that rules it
_held, _aimed = jax.jit(held), jax.jit(aimed)


@partial(jax.jit, static_argnums=(5, 6, 7))
def _variance(
    die: Plant, moved: Tones, own: Array, std: Array, period: float, samples: int, signals: tuple[int, int], rate: int
) -> Array:
    return rate_variance(sensitivities(die, moved, period, samples, signals), own, rate, std)


def finished(frequency, amplitude, setting, errors, starts, agreeing) -> MotionDesign:
    """The design, with the forces and the start that belong to it."""
    die = setting.plant()
    kept = _held(die, Tones(2.0 * np.pi * frequency, amplitude), 1.0 / setting.sample_rate)
    order = np.argsort(frequency)
    start = tuple(float(v) for v in np.sum(np.asarray(kept.motion), axis=0).real)
    force = np.asarray(kept.force)[order]
    return MotionDesign(frequency[order], amplitude[order], force, start, errors, setting, None, starts, agreeing)


def _axis_tones(frequency: np.ndarray, phasor: np.ndarray) -> AxisTones:
    """Tones per axis: Re a·exp(iωt) is |a|·sin(ωt + arg a + π/2)."""

    def axis(column: np.ndarray) -> tuple[Tone, ...]:
        return tuple(Tone(f, abs(a), np.angle(a) + 0.5 * np.pi) for f, a in zip(frequency, column, strict=True))

    return axis(phasor[:, 0]), axis(phasor[:, 1])
