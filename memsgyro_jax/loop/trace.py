"""One closed-loop run of one die, kept sample by sample."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity, whole
from memsgyro_jax.base.axes import axes, settled_limits
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.labelled import Tabular, labelled
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.device.propagate import State4

from . import engine, noise
from .blocks.length import Blocks, lengths
from .blocks.run import prepared, run_in_blocks
from .controllers import Saturated
from .expectation import expectations, tell
from .loop import ClosedLoop, Sample, as_loop
from .observers.base import LockReadings
from .scenario import AbstractProfile, Scenario, as_scenario
from .sensitivities import units_of


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


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

    @property
    def filtered(self) -> bool:
        """Whether the output is another than the observer's own estimate."""
        return not np.array_equal(self.rate_estimate, self.rate_unfiltered, equal_nan=True)

    def __repr__(self) -> str:
        if not is_concrete(self.time) or self.time.ndim > 1:
            return f"Traces of {jnp.shape(self.time)} samples at {self.settings.sample_rate:g} Hz"
        error = np.degrees(self.rate_error[len(self.time) // 2 :])
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
        """Estimate beside truth over time: `rate`, `motion`, `offset`, or the name of a coefficient."""
        names = ("rate", "motion", "offset", *(n for n in self.coefficients if n != "rate"))
        if quantity not in names:
            raise InputError(f"Argument `quantity` must be one of {', '.join(names)}, but `{quantity}` was given.")
        ax, time = axes(ax), self.time * 1e3
        if quantity == "rate":
            estimate, spread = np.degrees(self.rate_unfiltered), np.degrees(self.rate_std)
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


class _Row(NamedTuple):
    """What a trace keeps of a sample."""

    time: jax.Array
    rate: jax.Array
    motion: State4
    offset: tuple
    volts: tuple
    force: tuple
    estimate: Any
    output: jax.Array


class TraceRecorder(engine.AbstractRecorder[_Row, _Row]):
    """Keeps the last sample of each block; `empty` gives the shapes."""

    empty: _Row

    def init(self) -> _Row:
        """Zeros."""
        return self.empty

    def sample(self, memory: _Row, sample: Sample) -> _Row:
        """The sample itself."""
        return _row(sample)

    def block(self, memory: _Row) -> tuple[_Row, _Row]:
        """The last sample."""
        return memory, memory


def simulate(
    loop: ClosedLoop,
    scenario: Scenario | AbstractProfile | float = 0.0,
    *,
    sample_rate: float | str,
    duration: float | str,
    seed: int = 0,
    die: int = 0,
    decimation: int = 1,
) -> Trace:
    """Run one die of `loop` for `duration` [s] at `sample_rate` [Hz] and keep every `decimation`-th sample.

    `scenario` is a `Scenario`, a profile of the rate, or a constant rate in rad/s. Noise depends on (`seed`, `die`)
    only. Every number of `loop` and `scenario` may be differentiated and mapped from outside (`jax.grad`, `jax.vmap`);
    settings and status are then filled in as far as they are known. What the observer cannot expect of the run, a
    moving rate that it holds constant say, is logged before it begins. Raises `InputError` for a sample rate that
    cannot carry the device's modes, and outside float64.

    A loop `in_blocks` keeps the ends of its blocks, and before them as many samples as `decimation` says, or somewhat
    more. Its volts are without noise, its `nis` that of the block's statistics.
    """
    runtime.require_float64("simulate")
    loop, seed, die, decimation = as_loop(loop), whole("seed", seed), whole("die", die), whole("decimation", decimation)
    sample_rate, duration = quantity("sample_rate", sample_rate, "Hz"), quantity("duration", duration, "s")
    steps = count_steps(sample_rate, duration)
    if not 1 <= decimation <= steps:
        raise InputError(
            f"Argument `decimation` must lie between 1 and the {steps} samples, but {decimation} was given."
        )
    scenario, loop = as_scenario(scenario), loop.sampled_at(sample_rate, duration=duration)
    ran, hindered = prepared(loop.present)
    tell((*expectations(loop, scenario, sample_rate, duration), *hindered))
    words = noise.die_words(jax.random.key(seed), jnp.asarray(die))
    rows = _Rows.of(ran.blocks, steps, decimation)
    done = _compiled(ran, scenario, words, 1.0 / sample_rate, rows)
    settings = Settings.of(loop, scenario, sample_rate=sample_rate, duration=duration, seed=seed)
    end = scenario.at((rows.ends[-1] - 0.5) / sample_rate).inertial
    return _as_trace(done, loop, loop.device.coefficients(end.rate, end.damping_change), settings, rows)


def count_steps(sample_rate: float, duration: float) -> int:
    """Samples in `duration`; raises `InputError` unless there is at least one."""
    if not (np.isfinite(duration) and duration > 0.0):
        raise InputError(f"Argument `duration` must be a positive number of seconds, but {duration} was given.")
    steps = round(sample_rate * duration) if np.isfinite(sample_rate) else 0
    if steps < 1:
        raise InputError(
            f"Argument `duration` must hold at least one sample at {sample_rate:g} Hz, but {duration:g} s was given."
        )
    return steps


class _Rows(NamedTuple):
    """Rows of samples run one by one, samples of each; samples in growing blocks behind them, then blocks and samples
    of each.
    """

    rows: int
    apart: int
    lead: int = 0
    blocks: int = 0
    length: int = 1

    @classmethod
    def of(cls, blocks: Blocks | None, steps: int, decimation: int) -> "_Rows":
        """Those of a run of `steps` samples."""
        if blocks is None:
            return cls(steps // decimation, decimation)
        first, lead = blocks.first(steps)
        apart = max(n for n in range(1, min(decimation, first) + 1) if first % n == 0)
        return cls(first // apart, apart, lead, (steps - first - lead) // blocks.length, blocks.length)

    @property
    def sizes(self) -> np.ndarray:
        """Samples of each block."""
        return lengths(self.rows * self.apart, self.lead, self.length, 1, self.blocks)

    @property
    def ends(self) -> np.ndarray:
        """The number of samples at the end of each row, behind a zero."""
        first = np.arange(self.rows + 1) * self.apart
        return np.concatenate([first, first[-1] + np.cumsum(self.sizes)])


@eqx.filter_jit
def _compiled(loop: ClosedLoop, scenario: Scenario, words: tuple, period: float, rows: _Rows) -> engine.Run:
    def row() -> _Row:
        clock = engine.Clock(jnp.zeros(()), jnp.zeros((), int), period)
        return _row(loop.step(loop.init(), scenario.at(0.0), (0.0, 0.0), clock)[1])

    empty = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), jax.eval_shape(row))
    recorder = TraceRecorder(empty)
    if loop.blocks is None:
        return engine.run(loop, scenario, words, period, rows.rows, rows.apart, recorder)
    return run_in_blocks(loop, scenario, words, period, (rows.rows, rows.apart), rows.sizes, recorder)


def _row(sample: Sample) -> _Row:
    drift, inertial = sample.conditions.offset_drift, sample.conditions.inertial
    made = sample.clock.time, inertial.rate, sample.motion, drift, sample.volts, sample.force
    return _Row(*jax.tree.map(lambda x: jnp.asarray(x, float), (*made, sample.estimate, sample.rate)))


def _as_trace(done: engine.Run, loop: ClosedLoop, theta: tuple, settings: Settings, rows: _Rows) -> Trace:
    nominal = loop.readout.offset
    xp = np if is_concrete(done, theta, nominal) else jnp
    columns = lambda entries: xp.stack(xp.broadcast_arrays(*map(xp.asarray, entries)), axis=-1)  # noqa: E731
    row: _Row = jax.tree.map(xp.asarray, done.outputs)
    estimate, missing = row.estimate, xp.full(row.time.shape, np.nan)
    with np.errstate(invalid="ignore"):  # the variance of a lost die may be negative
        std = missing if estimate.rate_variance is None else xp.sqrt(estimate.rate_variance)
    return Trace(
        time=row.time,
        rate_true=row.rate,
        rate_estimate=row.output,
        rate_unfiltered=estimate.rate,
        rate_std=std,
        motion=columns(row.motion),
        motion_estimate=columns(estimate.motion),
        theta=columns(theta),
        theta_estimate=columns(estimate.theta),
        offset=columns(nominal) + columns(row.offset),
        offset_estimate=columns(estimate.offset),
        volts=columns(row.volts),
        force=columns(row.force),
        nis=missing if estimate.nis is None else estimate.nis,
        intact_until=xp.where(done.alive, np.inf, xp.asarray(rows.ends)[done.blocks_alive] / settings.sample_rate),
        loop=loop,
        coefficients=loop.device.model.names,
        settings=settings,
        readings=estimate.readings,
    )
