"""What a run of a whole-angle loop says of the angle that its frame has turned, beside the integrated rate."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.labelled import Tabular, labelled
from memsgyro_jax.base.provenance import Settings

from .angle import angle_by_lowpass
from .controllers import AbstractController, WholeAngle
from .filters import Lowpass
from .trace_result import Trace


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


class TurnedAngle(Tabular, eqx.Module):
    """Angles in rad that the frame has turned since the first `time` [s]: `direct` from the vibration, `integrated`
    from the observer's rate, and the `true` one.
    """

    time: Float[np.ndarray, " samples"]
    direct: Float[np.ndarray, " samples"]
    integrated: Float[np.ndarray, " samples"]
    true: Float[np.ndarray, " samples"]
    settings: Settings = eqx.field(static=True)
    along = "time"

    @property
    def error(self) -> Float[np.ndarray, " samples"]:
        """Direct minus true in rad."""
        return self.direct - self.true

    def __repr__(self) -> str:
        direct, integrated = (np.degrees(angle - self.true) for angle in (self.direct, self.integrated))
        return (
            f"Angle turned from {self.time[0]:.4g} to {self.time[-1]:.4g} s: true {np.degrees(self.true[-1]):.4g} deg\n"
            f"direct: rms error {np.sqrt(np.mean(direct**2)):.3g} deg, {direct[-1]:.3g} at the end\n"
            f"integrated rate: rms error {np.sqrt(np.mean(integrated**2)):.3g} deg, {integrated[-1]:.3g} at the end"
        )

    def to_xarray(self) -> "xr.Dataset":
        """The angles over `time`."""
        variables = {
            "direct": ("time", self.direct, "rad", "angle read off the vibration"),
            "integrated": ("time", self.integrated, "rad", "integral of the estimated rate"),
            "true": ("time", self.true, "rad", "angle that the frame has turned"),
        }
        return labelled(self, variables, {"time": ("time", self.time, "s")}, self.settings.as_dict())

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Errors of both over time."""
        ax = axes(ax)
        for name in ("integrated", "direct"):
            ax.plot(self.time, np.degrees(getattr(self, name) - self.true), lw=1.0, label=name)
        ax.set(xlabel="time [s]", ylabel="error of the angle [deg]")
        ax.legend(frameon=False)
        return ax


def turned_angle(trace: Trace, *, start: float = 0.0, lowpass: Lowpass | None = None) -> TurnedAngle:
    """The angle by method 1 (`angle_by_lowpass`, with its `lowpass`) along a trace, from `start` [s] on.

    Kept rows must be close enough for the ripple at twice the vibration: 20 kHz at some kHz.

    Raises `InputError` for a loop without a `WholeAngle`, whatever stands around it, and where nothing is left to tell.
    """
    law = _law_of(trace.loop.controller)
    motion = np.stack(np.broadcast_arrays(*law.unrocked(tuple(trace.motion_estimate.T), trace.time)), axis=1)
    period = float(trace.time[1] - trace.time[0])
    found = angle_by_lowpass(motion, law.frequency, 1.0 / period, lowpass)
    time = np.asarray(found.time) + trace.time[0]
    chosen = (time >= max(start, trace.time[0])) & (time <= trace.time[-1])
    if not np.any(chosen):
        raise InputError(f"Argument `start` must lie before the last angle at {time[-1]:.4g} s, but is {start:g} s.")
    middle = trace.time - 0.5 / trace.settings.sample_rate  # a true rate is held over a sample
    true = np.interp(time, middle, _integral(trace.rate_true, period))
    integrated = np.interp(time, trace.time, _integral(trace.rate_unfiltered, period))
    angles = (-np.asarray(found.angle), integrated, true)
    direct, integrated, true = (angle[chosen] - angle[chosen][0] for angle in angles)
    return TurnedAngle(time[chosen], direct, integrated, true, trace.settings)


def _law_of(controller: AbstractController) -> WholeAngle:
    law = controller
    while not isinstance(law, WholeAngle):
        if not hasattr(law, "inner"):
            raise InputError(f"The loop must have a WholeAngle controller, but it has {type(controller).__name__}.")
        law = law.inner
    return law


def _integral(rate: Float[np.ndarray, " samples"], period: float) -> Float[np.ndarray, " samples"]:
    """By trapezoids, from the first row on."""
    return np.concatenate([[0.0], np.cumsum(0.5 * period * (rate[1:] + rate[:-1]))])
