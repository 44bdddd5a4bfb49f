"""The closed loop: device, read-out, observer and controller, one sample at a time."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.arguments import check_kind
from memsgyro_jax.base.concrete import at_hand, is_concrete, settled, strong
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.brownian import correlated, thermal_acceleration
from memsgyro_jax.device.gyro import (
    AbstractGyro,
    Inertial,
    Pair,
    Scalar,
    check_positive,
    natural_frequencies,
    number,
)
from memsgyro_jax.device.propagate import AbstractDiscretisation, Exact, State4, applied, fence
from memsgyro_jax.device.small import Matrix, Vector, plus

from .blocks.length import Blocks
from .controllers.base import AbstractController
from .filters import AbstractFilter, check_fits
from .observers.base import AbstractCovarianceObserver, AbstractObserver, Clock, Estimate
from .observers.settings import arrays
from .own_parts import check_within_travel, commanded, estimated
from .readout import AbstractReadout
from .scenario import Conditions
from .with_effects import SampleEffects, check_effects, check_own_states, own_start


class FilterState(NamedTuple):
    """The output filter's last output in rad/s, and its own state."""

    rate: Scalar
    held: tuple


class LoopState(NamedTuple):
    """Everything that a sample hands to the next; `output` is None in a loop without an output filter, `own` are the
    numbers of the effects' own states, `flicker` the states of the read-out's.
    """

    motion: State4
    observer: object
    controller: object
    output: FilterState | None = None
    own: tuple[Scalar, ...] = ()
    flicker: tuple[Pair, ...] = ()


class Sample(NamedTuple):
    """What can be recorded of one sample: truth, measurement, command and estimate at its end.

    `rate` in rad/s is what the loop gives out: the estimate's, behind the output filter where there is one.
    """

    clock: Clock
    conditions: Conditions
    motion: State4
    volts: Pair
    force: Pair
    estimate: Estimate
    rate: Scalar


class ClosedLoop(Displayed):
    """A gyro in operation. `start` is the true motion (x, y, vx, vy) at time zero in m and m/s.

    A die whose displacement is beyond `travel` [m], or whose numbers are not finite, at the end of a block of samples
    (a window of a sweep, a kept sample of a trace) is lost: it is frozen and flagged.

    `filter` smooths the estimated rate into the loop's output, from the observer's first estimate on; None gives out
    the estimate itself. Nothing feeds back from it.

    **Raises:** `InputError` for a part in the place of another, and for parts that do not fit each other.

    `blocks` advances a linear loop many samples at a time (see `in_blocks`), None sample by sample.
    """

    device: AbstractGyro
    readout: AbstractReadout
    observer: AbstractObserver
    controller: AbstractController
    start: State4 = arrays(default=(1e-6, 0.0, 0.0, 0.0))
    travel: Scalar = number(default=50e-6)
    discretisation: AbstractDiscretisation = eqx.field(default_factory=Exact)
    filter: AbstractFilter | None = None
    blocks: Blocks | None = None

    def __check_init__(self):
        _check_parts(self)
        check_kind("discretisation", self.discretisation, AbstractDiscretisation, "a discretisation, `Exact()` say")
        if self.device.model != self.observer.model:
            raise InputError(
                "The observer must expect the kind of device it watches; make it with `for_device(gyro, readout)`."
            )
        if getattr(self.observer, "signals", self.readout.signals) != self.readout.signals:
            raise InputError(
                "The observer and the read-out must measure the same, displacement or velocity; make the observer "
                "with `for_device(gyro, readout)`."
            )
        scale = at_hand(self.readout).scale
        expected = getattr(self.observer, "scale", scale)
        if is_concrete(expected, scale) and np.any(np.sign(np.asarray(expected)) != np.sign(np.asarray(scale))):
            raise InputError(
                "The observer must expect a scale of the same sign as the read-out's; make it with "
                "`for_device(gyro, readout)`."
            )
        check_effects(self.device, self.readout.signals)
        check_positive("travel", self.travel)
        check_within_travel(self.controller, self.travel)
        if is_concrete(self.start) and not (len(self.start) == 4 and all(np.all(np.isfinite(v)) for v in self.start)):
            raise InputError("Argument `start` must be 4 finite numbers (x, y, vx, vy), in m and m/s.")
        if not (self.filter is None or isinstance(self.filter, AbstractFilter)):
            raise InputError(
                "Argument `filter` must be a filter, `Lowpass(10.0)` say, or None, "
                f"but is {type(self.filter).__name__}."
            )

    @property
    def present(self) -> "ClosedLoop":
        """The same loop without effects of strength zero: they are absent to the last bit and the last operation."""
        device = self.device.present
        return self if device is self.device else eqx.tree_at(lambda made: made.device, self, device)

    @property
    def silent(self) -> "ClosedLoop":
        """The same loop without noise, of which its observer knows nothing: none of the read-out, no Brownian force,
        no steps of a converter, across which noise would carry the signal.
        """
        quiet = eqx.tree_at(lambda made: made.readout.noise_density, self, (jnp.zeros(()), jnp.zeros(())))
        if quiet.device.temperature is not None:
            quiet = eqx.tree_at(lambda made: made.device, quiet, quiet.device.at_temperature(None))
        if quiet.readout.adc is not None:
            quiet = eqx.tree_at(lambda made: made.readout.adc, quiet, quiet.readout.adc.without_steps)
        return quiet if quiet.readout.flicker is None else eqx.tree_at(lambda made: made.readout.flicker, quiet, None)

    def in_blocks(self, length: int = 512, *, start: int | None = None) -> "ClosedLoop":
        """The same loop advanced by blocks of `length` samples in closed form, after at least `start` samples one by
        one (None: as many as suit the device) and shorter blocks that grow: the same statistics, at a fraction of the
        work.

        It needs a device without effects, and read-out, observer and controller that are linear within a block; a loop
        with another part runs sample by sample and tells which. A filter whose rate walks follows up to half a
        block later (by 1.5 to 1.9 ms in blocks of 5.1 ms, sines of 1 to 30 Hz) and says so. Figures and traces then
        hold the ends of blocks. Tones near a mode are told with twice the statistics, which takes longer. Tuning goes
        by blocks too, and the information bound of a long run.

        Raises `InputError` unless `length` is a power of two.
        """
        return replace(self, blocks=Blocks(length, start))

    def linearise(self, *arguments: Any, **options: Any) -> Any:
        """The matrices A, B, C, D where a run has come to, by name; the arguments are those of `mg.linearise`."""
        import memsgyro_jax as mg  # by its public name: what describes a loop stands on the loop

        return mg.linearise(self, *arguments, **options)

    def output_rate(self, sample_rate: float) -> float:
        """How often in a second the loop gives out a rate: for every sample, or for every block."""
        return sample_rate if self.blocks is None else sample_rate / self.blocks.length

    def init(self) -> LoopState:
        """The state at time zero."""
        observer, controller, output = self.observer.init(), self.controller.init(), None
        if self.filter is not None:
            level = jnp.asarray(self._given_out(observer, controller).rate, float)
            output = FilterState(level, self.filter.init(level))
        flicker = () if self.readout.flicker is None else self.readout.flicker.init()
        return LoopState(self.start, observer, controller, output, own_start(self.device, self.start), flicker)

    def estimate(self, state: LoopState) -> Estimate:
        """What observer and controller say at a state, before the output filter."""
        return self._given_out(state.observer, state.controller)

    def _given_out(self, observer: Any, controller: Any) -> Estimate:
        return self.controller.output(controller, estimated(self.observer, observer))

    def rate(self, state: LoopState) -> Scalar:
        """The loop's output in rad/s: the estimated rate, behind the output filter where there is one."""
        return self.estimate(state).rate if state.output is None else state.output.rate

    def step(
        self,
        state: LoopState,
        conditions: Conditions,
        noise: Pair,
        clock: Clock,
        shaking: State4 | None = None,
        flicker: tuple[Pair, ...] | None = None,
    ) -> tuple[LoopState, Sample]:
        """One sample, from `clock` to one period later; `noise` is a pair of standard normal numbers, `shaking` four
        for the device's Brownian force, None for none, `flicker` a pair for each state of the read-out's flicker.
        """
        estimate = estimated(self.observer, state.observer)
        force, controller = commanded(self.controller, state.controller, estimate, clock)

        motion, own, shown = self._moved(state, conditions, force, clock, shaking)
        end = Clock(clock.time + clock.period, clock.sample + 1, clock.period)
        held = state.flicker
        if flicker is not None and self.readout.flicker is not None:
            held, shown["late"] = self.readout.flicker.step(held, flicker, clock.sample, clock.period)
        volts = self.readout.measure(motion, noise, conditions.offset_drift, clock.period, **shown)
        observer = self.observer.update(state.observer, volts, force, end)
        controller = self.controller.measured(controller, volts, end)

        estimate, output = self._given_out(observer, controller), None
        if self.filter is not None and state.output is not None:
            output = FilterState(*self.filter.step(state.output.held, estimate.rate, clock.period))
        rate = estimate.rate if output is None else output.rate
        new = LoopState(motion, observer, controller, output, own, held)
        return new, Sample(end, conditions, motion, volts, force, estimate, rate)

    def _moved(
        self, state: LoopState, conditions: Conditions, force: Pair, clock: Clock, shaking: State4 | None
    ) -> tuple[State4, tuple[Scalar, ...], dict[str, Any]]:
        """True motion and own states at the end of a sample, and what the read-out must know of effects, if any."""
        dynamics = self.device.dynamics(conditions.inertial)
        shaken = (0.0,) * 4 if shaking is None else self._shaken(conditions, shaking, clock)
        if not self.device.effects:
            push = applied(dynamics, force)
            motion = self.discretisation.advance(
                state.motion, push, dynamics.stiffness, dynamics.velocity, clock.period
            )
            return fence(clock.time, tuple(map(plus, motion, shaken))), (), {}
        plant = SampleEffects.of(self.device, dynamics, conditions, force, self.readout.scale, clock).driven(
            state.motion, state.own
        )
        push = applied(dynamics, plant.held)
        motion, own = self.discretisation.extended(
            state.motion, state.own, push, dynamics.stiffness, dynamics.velocity, plant
        )
        motion, own = fence(clock.time, (tuple(map(plus, motion, shaken)), own))
        return motion, own, {"effects": plant.shown_at(motion, own)} if plant.shows else {}

    def _shaken(self, conditions: Conditions, shaking: State4, clock: Clock) -> Vector:
        """What the Brownian force adds to the motion in a sample."""
        return fence(clock.time, correlated(self.shaking(conditions, clock.period), shaking))

    def shaking(self, conditions: Conditions, period: Scalar) -> Matrix:
        """Covariance (x, y, vx, vy) that the Brownian force adds in a sample of `period` [s], of a device that knows
        its temperature. It is that of the frame at rest, from which that of a turning one differs by twice its angle in
        a sample.
        """
        at_rest = self.device.dynamics(Inertial(damping_change=conditions.damping_change))
        temperature = self.device.temperature if conditions.temperature is None else conditions.temperature
        density = thermal_acceleration(at_rest.damping, at_rest.gain, temperature)
        return self.discretisation.white(at_rest.stiffness, at_rest.damping, density, period)

    def sampled_at(self, sample_rate: float, design: "ClosedLoop | None" = None, duration: float = 0.1) -> "ClosedLoop":
        """This loop with its series long enough to be exact at `sample_rate` [Hz], and for a filter that runs for
        `duration` [s]; what an `Exact` was given stands.

        Under `jax.vmap` and `jax.jit`, where the device's numbers are not known, the device that the observer starts
        from tells the length; where that is unknown too the loop is unchanged: call this before the transformation.
        Raises `InputError` when the sample rate cannot carry the device's modes or the output filter.
        """
        if not (np.isfinite(sample_rate) and sample_rate > 0.0):
            raise InputError(f"Argument `sample_rate` must be a positive number of Hz, but {sample_rate} was given.")
        if self.filter is not None:
            check_fits(self.filter, self.output_rate(sample_rate))
        check_own_states((self if design is None else design).device, self.discretisation, sample_rate)
        whole = settled(self if design is None else design)
        known = at_hand(whole.device).dynamics(Inertial())
        if not is_concrete(known):
            known = estimated(whole.observer, whole.observer.init()).dynamics
        if not is_concrete(known):
            return self
        highest = float(np.max(natural_frequencies(known.stiffness))) * _MARGIN
        decay = 0.5 * max(float(np.max(np.abs(known.damping[i][i]))) for i in (0, 1))
        left = float(np.exp(-min(decay * duration, 100.0)))
        exact = partial(Exact.covering, highest, sample_rate, left=left)
        exact()  # whoever propagates needs two samples per period
        made = jax.tree.map(lambda part: exact(part) if isinstance(part, Exact) else part, self, is_leaf=_is_exact)
        return strong(made)


def claim_error(loop: ClosedLoop, sample_rate: float) -> float | None:
    """Largest share by which the standard deviations that the loop's observer claims are off, because it takes the
    derivative of a sample at few nodes; None where it claims none, propagates otherwise, or numbers are not known.
    """
    steps = getattr(loop.observer, "discretisation", None)
    stiffness = at_hand(settled(loop.device)).dynamics(Inertial()).stiffness
    if not isinstance(steps, Exact) or not isinstance(loop.observer, AbstractCovarianceObserver):
        return None
    if not is_concrete(stiffness):
        return None
    return steps.claim_error(float(np.max(natural_frequencies(stiffness))), sample_rate)


_PARTS = {
    "device": (AbstractGyro, "a device"),
    "readout": (AbstractReadout, "a read-out"),
    "observer": (AbstractObserver, "an observer"),
    "controller": (AbstractController, "a controller"),
}


def _check_parts(loop: ClosedLoop) -> None:
    """Refuse a part in the place of another, and say what each place got."""
    wrong = [
        f"`{name}` must be {what}, but is {_called(getattr(loop, name))}"
        for name, (kind, what) in _PARTS.items()
        if not isinstance(getattr(loop, name), kind)
    ]
    if wrong:
        raise InputError(
            f"Argument {', and '.join(wrong)}; the order is ClosedLoop(device, readout, observer, controller)."
        )


def _called(part: object) -> str:
    """What a part is, and of which class."""
    kinds = [f"{what}, " for kind, what in _PARTS.values() if isinstance(part, kind)]
    return f"{''.join(kinds)}of type {type(part).__name__}"


_MARGIN = 1.3  # estimates and spread dies may lie above the design's mode frequencies


def _is_exact(part: object) -> bool:
    return isinstance(part, Exact)


def as_loop(given: object) -> ClosedLoop:
    """A closed loop as it is; raises `InputError` for anything else, a device say."""
    if not isinstance(given, ClosedLoop):
        raise InputError(
            "Argument `loop` must be a ClosedLoop, of device, read-out, observer and controller, but is a "
            f"{type(given).__name__}; a device alone has none of the others."
        )
    return given
