"""Raw capture: forces and waveforms sample by sample."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.table import Table
from memsgyro_jax.device.conditions import Conditions

from ..clock import check_period
from ..columns import force_columns
from ..declared import Declared
from ..envelope import FINEST, LONGEST, run_samples, visited_samples
from ..first_order import Contribution, Inquiry, Instants
from ..linear_answer import lines_beside_answer
from ..lock_in import with_interference
from ..model import Model
from ..section import ExperimentSection
from ..standing_line import StandingLine
from .base import BEYOND, Experiment, Noise, Phasors, RealNoise, surroundings
from .checks import check_sampling
from .clocked import CONDITIONS, WaveformRecord, surroundings_told
from .deviation import Known
from .hold import Hold, NearestHold, better_hold, between
from .read_quantity import better_quantity
from .record import Watched
from .sheet import Sheet
from .unknown_start import beside_start, start_that_leaves_least
from .windowed_lines import derivatives


PHASE_STEP = 0.1  # of the highest mode per integration step where a nonlinear part is integrated [rad]
RING_TIMES = 12  # amplitude time constants after which an unknown start has died out
SOLVES = 3  # Gauss-Newton steps towards a start; a linear device needs one


class RawCapture(Experiment):
    """Waveforms under known forces, from rest, or from an unknown motion.

    Of an unknown one that has not died out the residual is that of the best start, and slopes are those beside it.

    Args:
        name: of the record.
        time: of each kept sample [s], (n,).
        measured: waveforms (n, axes) [V].
        noise: how far they may lie from the prediction.
        forces: at the beginning of each integration step [N], ((skipped + n)·substeps, axes).
        increments: change of the force within each step: zero for held forces, same shape.
        step: length of an integration step [s].
        surroundings: conditions per integration step.
        substeps: integration steps per sample.
        skipped: samples at the beginning that are simulated but not compared, while an unknown start dies out.
        solved: whether an unknown start is solved for.
        parts: of a first step that a step is one of; the force runs as it did.
    """

    slow: ClassVar[bool] = True
    swept: ClassVar[bool] = False

    name: str = eqx.field(static=True)
    time: Float[Array, " n"]
    measured: Float[Array, "n axes"]
    noise: Noise
    forces: Float[Array, "t axes"]
    increments: Float[Array, "t axes"]
    step: Array
    surroundings: Conditions
    substeps: int = eqx.field(static=True, default=1)
    skipped: int = eqx.field(static=True, default=0)
    solved: bool = eqx.field(static=True, default=False)
    parts: int = eqx.field(static=True, default=1)

    @property
    def rows_stand_alone(self) -> bool:
        return not self.solved

    def predict(self, bench: Model) -> Float[Array, "n axes"]:
        """Voltage of every channel at every kept sample."""
        return self._predicted(bench, None, self._start(bench)[0])[0]

    def residual(self, bench: Model) -> Float[Array, " r"]:
        """Measured minus predicted in standard deviations, without what another start would change."""
        start, slopes = self._start(bench)
        left = self.noise.whiten(self.measured, self._predicted(bench, None, start)[0]).ravel()
        return beside_start(left, slopes) if self.solved else left

    def residual_beside(self, bench: Model, added: Contribution) -> tuple[Float[Array, " r"], Inquiry]:
        start, slopes = self._start(bench)
        predicted, inquiry = self._asked(bench, added, start)
        left = self.noise.whiten(self.measured, predicted).ravel()
        return (beside_start(left, slopes) if self.solved else left), inquiry

    def predict_beside(self, bench: Model, added: Contribution) -> tuple[Float[Array, "n axes"], Inquiry]:
        return self._asked(bench, added, self._start(bench)[0])

    def _asked(self, bench: Model, added: Contribution, start: Array | None) -> tuple[Float[Array, "n axes"], Inquiry]:
        """`predict_beside` from a start."""
        seen, states = self._predicted(bench, added, start)
        now = self.surroundings
        visited = visited_samples(bench, states, self.forces, self.increments, self.step, now, self._base)
        commands = jnp.stack([self.forces, self.forces + self.increments], axis=1)
        forced, turn = (part.reshape(-1, bench.axes) for part in (commands, jnp.zeros_like(commands)))
        twice = jax.tree.map(lambda leaf: jnp.repeat(leaf, 2), now)
        moments = Instants(state=visited.reshape(-1, bench.size), command=forced, turn=turn, conditions=twice)
        state, command, turn, kept = self._kept(states)
        read = Instants(state=state, command=command, turn=turn, conditions=kept)
        return seen, Inquiry((moments,), read, self._base)

    def nothing(self, bench: Model) -> Contribution:
        return Contribution.none(bench, ((2 * len(self.forces), bench.axes),), self.measured.shape, float)

    @property
    def _base(self) -> Conditions:
        return jax.tree.map(lambda leaf: leaf[0], self.surroundings)

    def _start(self, bench: Model) -> tuple[Array | None, Array]:
        """The best start of a model as it stands, displacement and velocity, and the slopes by it; `None` at rest."""
        if not self.solved:
            return None, jnp.zeros((0, self.measured.size))
        bench, axes = jax.lax.stop_gradient(bench), bench.axes
        omega = jnp.sqrt(bench.device.stiffness[:axes])

        def left(start: Array) -> Array:
            return self.noise.whiten(self.measured, self._predicted(bench, None, start)[0]).ravel()

        units = jnp.concatenate([jnp.ones(axes), omega])
        return start_that_leaves_least(left, jnp.zeros(2 * axes), units, steps=SOLVES, far=jnp.inf)

    def _predicted(
        self, bench: Model, added: Contribution | None, start: Array | None
    ) -> tuple[Float[Array, "n axes"], Array]:
        """Voltages, and the state at the beginning of every step."""
        linear, ends = None, None
        if added is not None:
            linear, ends = added.beside(bench.linear(self._base)), added.forced[0].reshape(-1, 2, bench.axes)
        begin = None if start is None else bench.state_of(start, self._base)
        states = run_samples(
            bench, self.forces, self.increments, self.step, self.surroundings, self._base, start=begin, linear=linear,
            added=ends,
        )  # fmt: skip
        kept = self._kept(states)
        seen = with_interference(bench, jax.vmap(bench.observe)(*kept), kept[-1])
        return seen if added is None else seen + added.seen, states

    def _kept(self, states: Array) -> tuple[Array, Array, Array, Conditions]:
        """State, command, its rate and the conditions at every kept sample."""
        kept = slice(self.skipped * self.substeps, None, self.substeps)
        now = jax.tree.map(lambda leaf: leaf[kept], self.surroundings)
        return states[kept], self.forces[kept], self.increments[kept] / self.step, now

    @property
    def finer(self) -> "RawCapture | None":
        """The same in steps half as long; `None` at the last, and where a fit could not keep them all."""
        more = self.parts < FINEST and 2 * len(self.forces) <= LONGEST
        return self._divided(2 * self.parts) if more else None

    @property
    def coarse(self) -> "RawCapture":
        return self._divided(1)

    def _divided(self, parts: int) -> "RawCapture":
        """The same with every first step in so many parts."""
        first = slice(None, None, self.parts)
        begun, change = self.forces[first], self.parts * self.increments[first] / parts
        now = jax.tree.map(lambda leaf: jnp.repeat(leaf[first], parts, axis=0), self.surroundings)
        return dataclasses.replace(
            self,
            forces=(begun[:, None] + jnp.arange(parts)[:, None] * change[:, None]).reshape(-1, begun.shape[-1]),
            increments=jnp.repeat(change, parts, axis=0),
            step=self.step * self.parts / parts,
            surroundings=now,
            substeps=self.substeps // self.parts * parts,
            parts=parts,
        )

    def proposals(self, name: str) -> Iterator[tuple[str, Experiment]]:
        """Again as it was, and a stronger drive."""
        yield f"repeat `{name}`", self
        stronger = (BEYOND * self.forces, BEYOND * self.increments)
        driven = eqx.tree_at(lambda s: (s.forces, s.increments), self, stronger)
        yield f"repeat `{name}` at {BEYOND:g} times the drive", driven

    def at(self, row: int) -> str:
        return f"at {float(self.time[row]):.4g} s"


class TimeSection(ExperimentSection):
    """`kind = "time_record"`: waveforms under known forces, sample by sample."""

    hold: Hold
    """How the force runs between rows: held from each to the next, on straight lines, or as a band-limited signal."""
    start: Literal["rest", "unknown"]
    """Motion at the first row: at rest, or unknown: rows are left out until it has died away where that leaves half of
    them, else it is solved for."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TimeRecord(WaveformRecord):
    """Raw signals under known forces.

    Args:
        hold: how the force runs between rows: "zero_order", "linear" or "band_limited".
        start: "rest" or "unknown" motion at the first row.
        time: (n,) uniform [s].
        forces: (n, axes) [N], the input [V] for a resonator.
        signals: (n, channels) in the record unit.
        rate: (n,) angular rate [rad/s], zeros where the record does not say.
    """

    kind: ClassVar[str] = "time_record"
    section: ClassVar[type[ExperimentSection]] = TimeSection
    hold: Hold
    start: Literal["rest", "unknown"]
    forces: np.ndarray
    rate: np.ndarray

    @property
    def extent(self) -> str:
        return f"{self.span}, {self.hold} input, start {self.start}"

    @classmethod
    def read(cls, sheet: Sheet) -> Self:
        columns = sheet.columns
        inputs = [name for group in columns.words.forces for name in group]
        columns.refuse_others(["t", *inputs, *columns.signal_names(""), "rate", *CONDITIONS])
        return cls(
            **sheet.common(),
            **surroundings_told(columns, sheet.declared.environment),
            hold=sheet.entry.hold,
            start=sheet.entry.start,
            time=columns.time(),
            forces=columns.forces(),
            signals=columns.signals(),
            rate=columns.optional("rate", "rad/s", 0.0),
        )

    def check(self, table: Table, declared: Declared) -> None:
        if self.start == "rest" and self.time[0] != 0:
            raise table.at(0, "t", 'must be 0 in the first row of a record that starts at "rest"')
        check_period(table, None)
        check_sampling(self.period, self.rows, declared.resonances, table)

    def keys(self, declared: Declared) -> dict[str, Any]:
        return {"hold": self.hold, "start": self.start}

    def columns(self, declared: Declared) -> dict[str, np.ndarray]:
        forces = force_columns(self.forces, declared)
        return {**super().columns(declared), **forces, "rate [rad/s]": self.rate}

    def experiment(self, declared: Declared, number: int) -> RawCapture:
        held, highest = self.hold == "zero_order", declared.resonances[1]
        substeps = max(1, int(np.ceil(0.9 * highest * self.period / PHASE_STEP)))
        fine = np.repeat(self.forces, substeps, axis=0) if held else between(self.forces, substeps, self.hold)
        following = np.concatenate([fine[1:], fine[-1:]])
        rate, time = (np.repeat(values, substeps) for values in (self.rate, self.time))
        around = self.surrounded(lambda values: np.repeat(values, substeps))
        skipped = self._unknown_start(declared)
        solved = skipped > self.rows // 2
        skipped = 0 if solved else skipped
        return RawCapture(
            name="raw captures",
            time=jnp.asarray(self.time[skipped:]),
            measured=jnp.asarray(self.signals[skipped:]),
            noise=RealNoise(self.noise_of_rows[skipped:]),
            forces=jnp.asarray(fine),
            increments=jnp.asarray(np.zeros_like(fine) if held else following - fine),
            step=jnp.asarray(self.period / substeps),
            surroundings=surroundings(declared, number, fine.shape[0], rate, time=time, **around),
            substeps=substeps,
            skipped=skipped,
            solved=solved,
        )

    def _unknown_start(self, declared: Declared) -> int:
        """Samples until an unknown start has died out."""
        if self.start == "rest":
            return 0
        waiting = RING_TIMES * 2 * declared.largest_quality / declared.resonances[0]
        return int(np.ceil(waiting / self.period))

    def starting_phasors(self, declared: Declared) -> Phasors | None:
        """Spectral lines around the resonances, under a Hann window that hides start and end, those of velocity and
        acceleration by parts; none where a channel was not recorded.
        """
        if len(self.channels) < declared.channels:
            return None
        (low, high), readout, held = declared.resonances, declared.readout, self.hold == "zero_order"
        omega = 2 * np.pi * np.fft.rfftfreq(self.rows, self.period)
        read = derivatives(self.signals - self.signals.mean(axis=0), omega, self.period)
        turned = self._turned(omega, readout.order)
        force = derivatives(self.forces, omega, self.period, late=0.5 * held)[readout.order]
        if held:
            force = force * np.sinc(omega * self.period / 2 / np.pi)[:, None]
        if not np.isfinite(high):  # not declared: around the highest line
            low = high = omega[1 + np.argmax(np.abs(read[0][1:]).max(axis=1))]
        near = (omega > 0.5 * low) & (omega < 2.0 * high)
        omega, noise = omega[near], self.noise_level * np.sqrt(np.sum(np.hanning(self.rows) ** 2) / 2)
        motion, slope, bend = (readout.motion(part[near], omega) for part in (*read[:2], read[2] - turned))
        force = force[near] / (1j * omega[:, None]) ** readout.order
        weight = abs(readout.scale) * omega**readout.order / noise
        return Phasors(omega, motion, force, weight, slope=slope, bend=bend)

    def _turned(self, omega: np.ndarray, order: int) -> np.ndarray:
        """Lines of what the rate adds to the acceleration of both axes, 2Ω·(vy, −vx), of readings that are the
        displacement or its derivative of some `order`; of derivatives at a slow rate.
        """
        if self.signals.shape[1] == 1 or not self.rate.any():
            return np.zeros((omega.size, self.signals.shape[1]))
        crossed = (self.signals - self.signals.mean(axis=0))[:, ::-1] * [2.0, -2.0]
        whole = derivatives(self.rate[:, None] * crossed, omega, self.period)[1]
        if order:
            return whole
        steeper = np.gradient(self.rate, self.period)[:, None]
        return whole - derivatives(steeper * crossed, omega, self.period)[0]

    def standing_lines(self, declared: Declared) -> tuple[StandingLine, ...]:
        noise, held = self.noise_std or self.estimated_noise() or 0.0, self.hold == "zero_order"
        known = self.time, self.signals, self.forces, self.starting_phasors(declared), declared.readout
        return lines_beside_answer(*known, held=held, noise=noise)

    def better_keys(self, declared: Declared) -> tuple[dict[str, Any], str]:
        """Another `hold`, where the rows show it."""
        better = self.nearest_hold(declared)
        return ({"hold": better.hold}, better.told) if better.hold else ({}, "")

    def nearest_hold(self, declared: Declared) -> NearestHold:
        """What the rows say of `hold`."""
        return better_hold(self.hold, lambda hold: dataclasses.replace(self, hold=hold), declared)

    def better_quantity(self, declared: Declared) -> tuple[str, str]:
        return better_quantity(self.nearest_hold, declared)[:2]

    def warnings(self, declared: Declared) -> list[str]:
        said = better_quantity(self.nearest_hold, declared).said
        return [*super().warnings(declared), *([f"`{self.name}`: {said}."] if said else [])]

    def watched(self, noise: np.ndarray) -> list[Watched]:
        inputs = [self.in_time(f"the input {name}", column) for name, column in zip("xy", self.forces.T, strict=False)]
        return [*super().watched(noise), *inputs, self.in_time("the rate", self.rate)]

    def known(self, declared: Declared) -> tuple[Known, ...]:
        return (*super().known(declared), Known("rate", self.rate, "rad/s"))
