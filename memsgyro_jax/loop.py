"""The closed loop: device, read-out, observer and controller, one sample at a time."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from .controllers.base import AbstractController
from .device import AbstractGyro, Pair, Scalar, check_positive, is_concrete, mode_frequencies, number
from .errors import InputError
from .observers.base import AbstractObserver, Clock, Estimate
from .observers.settings import arrays
from .propagate import AbstractDiscretisation, Exact, State4, applied, fence
from .readout import AbstractReadout
from .scenario import Conditions


class LoopState(NamedTuple):
    """Everything that a sample hands to the next."""

    motion: State4
    observer: object
    controller: object


class Sample(NamedTuple):
    """What can be recorded of one sample: truth, measurement, command and estimate at its end."""

    clock: Clock
    conditions: Conditions
    motion: State4
    volts: Pair
    force: Pair
    estimate: Estimate


class ClosedLoop(eqx.Module):
    """A gyro in operation. `start` is the true motion (x, y, vx, vy) at time zero in m and m/s.

    A die whose displacement is beyond `travel` [m], or whose numbers are not finite, at the end of a block of samples
    (a window of a sweep, a kept sample of a trace) is lost: it is frozen and flagged.
    """

    device: AbstractGyro
    readout: AbstractReadout
    observer: AbstractObserver
    controller: AbstractController
    start: State4 = arrays(default=(1e-6, 0.0, 0.0, 0.0))
    travel: Scalar = number(default=50e-6)
    discretisation: AbstractDiscretisation = eqx.field(default_factory=Exact)

    def __check_init__(self):
        if self.device.model != self.observer.model:
            raise InputError(
                "The observer must expect the kind of device it watches; make it with `for_device(gyro, readout)`."
            )
        if getattr(self.observer, "signals", self.readout.signals) != self.readout.signals:
            raise InputError(
                "The observer and the read-out must measure the same, displacement or velocity; make the observer "
                "with `for_device(gyro, readout)`."
            )
        expected, scale = getattr(self.observer, "scale", self.readout.scale), self.readout.scale
        if is_concrete(expected, scale) and np.any(np.sign(np.asarray(expected)) != np.sign(np.asarray(scale))):
            raise InputError(
                "The observer must expect a scale of the same sign as the read-out's; make it with "
                "`for_device(gyro, readout)`."
            )
        check_positive("travel", self.travel)
        if is_concrete(self.start) and not (len(self.start) == 4 and all(np.all(np.isfinite(v)) for v in self.start)):
            raise InputError("Argument `start` must be 4 finite numbers (x, y, vx, vy), in m and m/s.")

    def init(self) -> LoopState:
        """The state at time zero."""
        return LoopState(self.start, self.observer.init(), self.controller.init())

    def step(self, state: LoopState, conditions: Conditions, noise: Pair, clock: Clock) -> tuple[LoopState, Sample]:
        """One sample, from `clock` to one period later; `noise` is a pair of standard normal numbers."""
        estimate = self.observer.estimate(state.observer)
        force, controller = self.controller.command(state.controller, estimate, clock)

        dynamics = self.device.dynamics(conditions.inertial)
        push = applied(dynamics, force)
        motion = self.discretisation.advance(state.motion, push, dynamics.stiffness, dynamics.velocity, clock.period)
        motion = fence(clock.time, motion)

        end = Clock(clock.time + clock.period, clock.sample + 1, clock.period)
        volts = self.readout.measure(motion, noise, conditions.offset_drift, clock.period)
        observer = self.observer.update(state.observer, volts, force, end)

        new = LoopState(motion, observer, controller)
        return new, Sample(end, conditions, motion, volts, force, self.observer.estimate(observer))

    def sampled_at(self, sample_rate: float, design: "ClosedLoop | None" = None) -> "ClosedLoop":
        """This loop with its series long enough to be exact at `sample_rate` [Hz]; inside a transformation, unchanged.

        Raises `InputError` when the sample rate cannot carry the device's modes.
        """
        if not (np.isfinite(sample_rate) and sample_rate > 0.0):
            raise InputError(f"Argument `sample_rate` must be a positive number of Hz, but {sample_rate} was given.")
        device = self.device if design is None else design.device
        if not is_concrete(device):
            return self
        exact = Exact.covering(float(np.max(mode_frequencies(device))) * _MARGIN, sample_rate)
        return jax.tree.map(lambda part: exact if isinstance(part, Exact) else part, self, is_leaf=_is_exact)


_MARGIN = 1.3  # estimates and spread dies may lie above the design's mode frequencies


def _is_exact(part: object) -> bool:
    return isinstance(part, Exact)
