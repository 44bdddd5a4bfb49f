"""What a run of one die recorded: its rows, how it went, its pictures and its Dataset."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Complex, Float

from memsgyro_jax.base.axes import axes, settled_limits
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.labelled import Tabular, labelled
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.device.gyro import mode_frequencies

from .controllers import Saturated
from .following_response import by_blocks, by_samples
from .loop import ClosedLoop
from .observers.base import AbstractBlockObserver, LockReadings
from .scenario import AbstractProfile
from .sensitivities import units_of


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

ORBIT = 12  # vibrations of `plot("orbit")`


class Trace(Tabular, eqx.Module):
    """What a run recorded, one row per kept sample; SI units throughout.

    `theta` holds the true coefficients at the end of the run. `rate_estimate` is the loop's output, behind its filter
    where it has one, `rate_unfiltered` the observer's own estimate, of which alone `rate_std` and `nis` speak (NaN for
    an observer without a covariance). `intact_until` is the time in s at which the die was lost (out of its travel, or
    not finite, at a kept sample), infinite for one that was not: rows from then on repeat the last good one. `readings`
    are those of electronics that lock to the drive axis, each over time; None without such. `loop` is what ran.

    A pytree: functions of `simulate` can be differentiated and compiled; `jax.vmap` puts the runs along a leading axis.
    """

    time: Float[np.ndarray, " samples"]
    rate_true: Float[np.ndarray, " samples"]
    rate_estimate: Float[np.ndarray, " samples"]
    rate_unfiltered: Float[np.ndarray, " samples"]
    rate_std: Float[np.ndarray, " samples"]
    motion: Float[np.ndarray, "samples 4"]
    motion_estimate: Float[np.ndarray, "samples 4"]
    theta: Float[np.ndarray, " coefficients"]
    theta_estimate: Float[np.ndarray, "samples coefficients"]
    offset: Float[np.ndarray, "samples 2"]
    offset_estimate: Float[np.ndarray, "samples 2"]
    volts: Float[np.ndarray, "samples 2"]
    force: Float[np.ndarray, "samples 2"]
    nis: Float[np.ndarray, " samples"]
    intact_until: Float[np.ndarray, ""]
    along = "time"
    run: ClassVar[Callable[..., "Trace"]]  # `simulate`, which is made of this
    loop: ClosedLoop
    coefficients: tuple[str, ...] = eqx.field(static=True)
    settings: Settings = eqx.field(static=True)
    readings: LockReadings | None = None

    @property
    def lost_at(self) -> float | None:
        """The time in s at which the die was lost; None for one that was not."""
        return None if np.isinf(self.intact_until) else float(self.intact_until)

    @property
    def status(self) -> str:
        """A sentence on how the run went, or the runs of a map."""
        if np.ndim(self.intact_until):
            return f"{np.sum(np.isfinite(self.intact_until))} of {np.size(self.intact_until)} runs lost"
        law = self.loop.controller
        share = law.reached(self.force) if isinstance(law, Saturated) else 0.0
        limited = f", a force at its limit in {100.0 * share:.3g} % of the samples" if share else ""
        if self.lost_at is None:
            return f"completed{limited}"
        return f"lost at {self.lost_at:.6g} s: out of travel or not finite{limited}"

    @property
    def rate_error(self) -> Float[np.ndarray, " samples"]:
        """Estimate minus truth in rad/s."""
        return self.rate_estimate - self.rate_true

    def rate_response(self, frequency: Float[ArrayLike, "..."]) -> Complex[np.ndarray, "..."]:
        """Complex ratio of the estimate before the output filter to a small sine of the rate, of `frequency` [Hz], as
        the filter followed it at the end of the run: the size is the gain, a negative phase the lag. Zero for a filter
        that holds the rate constant.

        Of a sample of T seconds the filter takes the share K = q T / (q T + P) of what is new, where the rate walks
        with q (`ProcessNoise`) and P is the variance claimed; one that finds the slope of the rate too settles to the
        gains of both with which it claims P. In blocks the loop is run once more without and once with a sine of each
        frequency; within a block its true rate is a ramp, where a sine would lose the share 1 - sinc(f T). The filter's
        other constants must be known by then. Raises `InputError` for an observer that is no Kalman filter of the rate.
        """
        observer = self.loop.observer
        if not isinstance(observer, AbstractBlockObserver) or "rate" not in observer.states:
            raise InputError("A filter must estimate the rate to follow it; make one with `ExtendedKalmanFilter`.")
        walks = float(observer.walk()[observer.states.index("rate")]) > 0.0 or observer.moves() is not None
        if self.loop.blocks is not None and walks:
            return by_blocks(self._settled_under, float(self.rate_true[-1]), frequency)
        return by_samples(observer, float(self.rate_std[-1]), 1.0 / self.settings.sample_rate, frequency)

    def _settled_under(self, rate: AbstractProfile) -> tuple[np.ndarray, np.ndarray]:
        """Times and estimates of the second half of this run under another rate."""
        settings, blocks = self.settings, self.loop.blocks
        assert blocks is not None
        again = self.run(
            self.loop,
            rate,
            sample_rate=settings.sample_rate,
            duration=settings.duration,
            seed=settings.seed or 0,
            decimation=blocks.length,
        )
        late = np.asarray(again.time) > 0.5 * settings.duration
        return np.asarray(again.time)[late], np.asarray(again.rate_unfiltered)[late]

    @property
    def filtered(self) -> bool:
        """Whether the output is another than the observer's own estimate."""
        return not np.array_equal(self.rate_estimate, self.rate_unfiltered, equal_nan=True)

    def last_vibrations(self, motion: Float[np.ndarray, "samples 4"] | None = None) -> Float[np.ndarray, "rows 4"]:
        """The rows of `motion`, the true one without, in the last twelve vibrations of the first mode."""
        motion = self.motion if motion is None else motion
        period = 1.0 / float(np.min(mode_frequencies(self.loop.device)))
        return motion[self.time > self.time[-1] - ORBIT * period]

    def __repr__(self) -> str:
        if not is_concrete(self.time) or self.time.ndim > 1:
            return f"Traces of {jnp.shape(self.time)} samples at {self.settings.sample_rate:g} Hz"
        late = self.time > 0.5 * (self.time[0] + self.time[-1])  # by the clock: blocks grow, and early ones are many
        error = np.degrees(self.rate_error[late])
        return (
            f"Trace of {self.time[-1]:.4g} s, {len(self.time)} samples kept at {self.settings.sample_rate:g} Hz, "
            f"{self.status}\n"
            f"rate error over the second half: mean {np.mean(error):.3g}, "
            f"standard deviation {np.std(error):.3g} deg/s"
        )

    def to_xarray(self) -> "xr.Dataset":
        """The trace over `time`, and over `run` where it is a map of several."""
        lead = ("run",) * (np.ndim(self.time) - 1)
        over = {
            "rate_true": ((), "rad/s", "true rate"),
            "rate_estimate": ((), "rad/s", "estimated rate, the output of the loop"),
            "rate_unfiltered": ((), "rad/s", "estimated rate before the output filter"),
            "rate_std": ((), "rad/s", "claimed standard deviation before the output filter"),
            "motion": (("state",), None, "displacement and velocity"),
            "motion_estimate": (("state",), None, "estimated displacement and velocity"),
            "theta_estimate": (("coefficient",), None, "estimated coefficients of the equations of motion"),
            "offset": (("axis",), "V", "offset of the read-out"),
            "offset_estimate": (("axis",), "V", "estimated offset of the read-out"),
            "volts": (("axis",), "V", "voltage of the read-out"),
            "force": (("axis",), "N", "commanded force"),
            "nis": ((), "1", "normalised innovation squared of both channels"),
        }
        variables: dict[str, tuple] = {n: ((*lead, "time", *d), getattr(self, n), *of) for n, (d, *of) in over.items()}
        variables["theta"] = ((*lead, "coefficient"), self.theta, None, "true coefficients at the end")
        variables["intact_until"] = (lead, self.intact_until, "s", "time at which the die was lost, infinite for none")
        if self.readings is not None:
            told = zip(LockReadings._fields, self.readings, ("rad/s", "Hz", "m", "N"), strict=True)
            variables |= {f"lock_{name}": ((*lead, "time"), *held) for name, *held in told}
        coordinates = {
            "time": ("time", np.atleast_2d(self.time)[0], "s"),
            "axis": ["x", "y"],
            "state": ["x", "y", "vx", "vy"],
            "state_unit": ("state", ["m", "m", "m/s", "m/s"], None),
            "coefficient": list(self.coefficients),
            "coefficient_unit": ("coefficient", list(units_of(self.loop.device.model)), None),
        }
        return labelled(self, variables, coordinates, {**self.settings.as_dict(), "status": self.status})

    def to_case(self, folder: str | Path, **about: Any) -> Path:
        """Write the run as a measurement case, or add it to the case in `folder`; `about` goes to `case_of_trace`.

        Raises `InputError` for a run that no case can hold.
        """
        import memsgyro_jax as mg  # by their public names: measurements stand on the loop, not the loop on them

        return mg.append_to_case(mg.case_of_trace(self, **about), folder)

    def plot(self, quantity: str = "rate", ax: "Axes | None" = None) -> "Axes":
        """Estimate beside truth over time: `rate`, `motion`, `offset`, or the name of a coefficient; or the `orbit`, y
        over x in the last vibrations.
        """
        names = ("rate", "motion", "orbit", "offset", *(n for n in self.coefficients if n != "rate"))
        if quantity not in names:
            raise InputError(f"Argument `quantity` must be one of {', '.join(names)}, but `{quantity}` was given.")
        ax, time = axes(ax), self.time * 1e3
        if quantity == "orbit":
            for path, style in ((self.last_vibrations(self.motion_estimate), "C0-"), (self.last_vibrations(), "k--")):
                ax.plot(1e6 * path[:, 0], 1e6 * path[:, 1], style, lw=0.8, label="true" if "k" in style else "estimate")
            ax.set(xlabel="x [µm]", ylabel="y [µm]", aspect="equal")
            ax.legend(loc="best", frameon=False)
            return ax
        if quantity == "rate":
            estimate, spread = np.degrees(self.rate_unfiltered), np.degrees(self.rate_std)
            if np.any(spread > 0.0):  # without an observer nobody claims one
                band = estimate - spread, estimate + spread
                ax.fill_between(time, *band, color="C0", alpha=0.25, lw=0, label="± claimed std")
            label = "estimate before the filter" if self.filtered else "estimate"
            ax.plot(time, estimate, color="C0", lw=1.0, alpha=0.4 if self.filtered else 1.0, label=label)
            if self.filtered:
                ax.plot(time, np.degrees(self.rate_estimate), color="C1", lw=1.4, label="output")
            ax.plot(time, np.degrees(self.rate_true), color="k", lw=1.2, ls="--", label="true")
            ax.set_ylabel("rate [deg/s]")
            shown = np.concatenate([self.rate_true, self.rate_estimate[len(time) // 4 :]])
            ax.set_ylim(*settled_limits(np.degrees(shown)))
        elif quantity in ("motion", "offset"):
            factor, unit = (1e6, "displacement [µm]") if quantity == "motion" else (1e3, "offset [mV]")
            for axis, name in enumerate("xy"):
                estimate, true = (
                    factor * getattr(self, which)[:, axis] for which in (f"{quantity}_estimate", quantity)
                )
                ax.plot(time, estimate, color=f"C{axis}", lw=1.0, label=name)
                ax.plot(time, true, color="k", lw=0.8, ls="--")
            ax.set_ylabel(unit)
        else:
            index = self.coefficients.index(quantity)
            ax.plot(time, self.theta_estimate[:, index] / self.theta[index] - 1.0, color="C0", lw=1.0, label="estimate")
            ax.axhline(0.0, color="k", lw=1.0, ls="--")
            ax.set_ylabel(f"relative error of {quantity} [1]")
        ax.set_xlabel("time [ms]")
        ax.legend(loc="best", frameon=False)
        return ax
