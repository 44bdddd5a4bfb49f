"""Free decay: a vibration that dies out, whatever made it; how it began is solved for."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.linalg import inverse
from memsgyro_jax.base.table import Table
from memsgyro_jax.device.conditions import Conditions

from ..clock import check_period
from ..columns import phasor_columns
from ..declared import Declared, si
from ..envelope import HARMONICS, Driven, run_samples
from ..model import Model
from ..section import ExperimentSection, Quantity
from ..steady import fundamental
from ..tracking import Track
from .base import BEYOND, CartesianNoise, Experiment, Noise, Readings, RealNoise, surroundings
from .checks import check_sampling
from .clocked import WaveformRecord
from .deviation import Deviation, Series, in_phase, segments
from .missing_force import TimeForce
from .sheet import Sheet


PHASE_STEP = 0.06  # of the highest mode per integration step [rad]
TURN = 4.0  # phase by which a vibration may turn within a piece, between its lowest and highest frequency [rad]
CYCLES, ROWS = 4, 24  # in a piece at least
SOLVES = 4  # Gauss-Newton steps towards the start of a piece


class FreeDecay(Experiment):
    """Readings of a device left alone, in pieces of equal length, each of which begins in its own unknown motion.

    The residual is that of the best start of every piece: starts are nuisances, eliminated where the model stands
    (variable projection: Golub and Pereyra, Inverse Problems 19 (2003) R1), so that no fit carries them and slopes are
    those beside them. Each piece therefore leaves 2·axes less than its number of readings in χ². Short pieces keep a
    decay whose frequency changes by many cycles comparable with a model that does not know of it yet.

    Args:
        name: of the record.
        measured: waveforms (pieces·m, axes), or phasors of e^{iωt}.
        noise: how far they may lie from the prediction.
        start: displacement and velocity at the beginning of each piece to begin with, (pieces, 2·axes).
        period: between samples [s].
        surroundings: conditions per sample.
        frequency: of the reference of phasors [rad/s].
        substeps: integration steps per sample.
    """

    driven: ClassVar[bool] = False
    slow: ClassVar[bool] = True

    name: str = eqx.field(static=True)
    measured: Array
    noise: Noise
    start: Float[Array, "pieces s"]
    period: Array
    surroundings: Conditions
    frequency: Array
    substeps: int = eqx.field(static=True, default=1)

    def predict(self, bench: Model) -> Array:
        """Every reading, from the start of its piece that suits the readings best."""
        starts, _ = self._solved(jax.lax.stop_gradient(bench))
        seen = jax.vmap(lambda s, c: self._readings(bench, s, c))(starts, self._by_piece(self.surroundings))
        return seen.reshape(self.measured.shape)

    def residual(self, bench: Model) -> Float[Array, " r"]:
        """Measured minus predicted in standard deviations, without what another start would change."""
        starts, slopes = self._solved(jax.lax.stop_gradient(bench))

        def one(start: Array, slope: Array, measured: Array, noise: Noise, now: Conditions) -> Array:
            left = noise.whiten(measured, self._readings(bench, start, now)).ravel()
            return left - slope.T @ (inverse(slope @ slope.T) @ (slope @ left))

        return jax.vmap(one)(starts, slopes, *self._pieces()).ravel()

    def proposals(self, name: str) -> Iterator[tuple[str, Experiment]]:
        """Again as it was, and from a larger start."""
        yield f"repeat `{name}`", self
        larger = eqx.tree_at(lambda d: (d.measured, d.start), self, (BEYOND * self.measured, BEYOND * self.start))
        yield f"repeat `{name}` from {BEYOND:g} times the amplitude", larger

    def at(self, row: int) -> str:
        return f"at {float(np.asarray(self.surroundings.time)[row]):.4g} s"

    def _pieces(self) -> tuple[Array, Noise, Conditions]:
        """Readings, their noise (each reading's own, as rows may be left out) and conditions of every piece."""
        wide = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, self.measured.shape), self.noise)
        return self._by_piece(self.measured), self._by_piece(wide), self._by_piece(self.surroundings)

    def _by_piece(self, rows: Any) -> Any:
        """Rows (n, ...) as (pieces, m, ...)."""
        count = self.start.shape[0]
        return jax.tree.map(lambda leaf: leaf.reshape(count, -1, *leaf.shape[1:]), rows)

    def _solved(self, model: Model) -> tuple[Array, Array]:
        """The best start of every piece (pieces, s), and the slopes there of its residual (pieces, s, r) by unit."""

        def one(begin: Array, measured: Array, noise: Noise, now: Conditions) -> tuple[Array, Array]:
            omega = jnp.sqrt(jnp.max(model.device.stiffness))
            axes = model.axes
            q, v = begin[:axes], begin[axes:]
            size = jnp.sqrt(jnp.sum(q**2) + jnp.sum(v**2) / omega**2) + 1e-300
            units = size * jnp.concatenate([jnp.ones(axes), jnp.full(axes, omega)])

            def left(start: Array) -> Array:
                return noise.whiten(measured, self._readings(model, start, now)).ravel()

            def step(start: Array, _: None) -> tuple[Array, Array]:
                value, slope = jax.vmap(lambda e: jax.jvp(left, (start,), (e,)), out_axes=(None, 0))(jnp.diag(units))
                move = -inverse(slope @ slope.T) @ (slope @ value)
                move = move * jnp.minimum(1.0, 1.0 / (jnp.sqrt(jnp.sum(move**2)) + 1e-30))
                return start + units * move, slope

            found, slopes = jax.lax.scan(step, begin, None, length=SOLVES)
            return found, slopes[-1]

        begin = jax.lax.stop_gradient(self.start)
        return jax.vmap(one)(begin, *self._pieces())

    def _readings(self, model: Model, start: Array, now: Conditions) -> Array:
        """Readings (m, axes) of one piece."""
        rows, first = self.measured.shape[0] // self.start.shape[0], jax.tree.map(lambda leaf: leaf[0], now)
        fine = jax.tree.map(lambda leaf: jnp.repeat(leaf, self.substeps), now)
        step, quiet = self.period / self.substeps, jnp.zeros((rows * self.substeps, model.axes))
        if not jnp.iscomplexobj(self.measured):
            begin = model.state_of(start, first)
            states = run_samples(model, quiet, quiet, step, fine, first, start=begin)[:: self.substeps]
            return jax.vmap(lambda s, c: model.observe(s, quiet[0], quiet[0], c))(states, now)
        axes, omega = model.axes, jnp.sqrt(model.device.stiffness[: model.axes])
        vector = start[:axes] - 1j * start[axes:] / omega  # the analytic signal of each axis' own vibration
        vector = jnp.concatenate([vector, 1j * omega * vector])
        turning = model.state_of(vector.real, first) + 1j * model.state_of(vector.imag, first)
        free = Driven.of(model, self.frequency, jnp.zeros(axes), first)
        begin = jnp.zeros((HARMONICS + 1, model.size), complex).at[1].set(turning)
        _, course = free.run(begin, step, fine)
        states = course.start[:: self.substeps]
        return jax.vmap(lambda s, c: fundamental(model, self.frequency, s, free.force, c))(states, now)


class FreeDecaySection(ExperimentSection):
    """Free decay."""

    begin: Quantity | None = Field(default=None, alias="from")
    end: Quantity | None = Field(default=None, alias="to")
    reference_frequency: Quantity | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class FreeDecayRecord(WaveformRecord):
    """A device left alone, from any motion: start amplitude and phase are unknown.

    Without a role the earlier half is fitted where no other kind is, and the later half validates.

    Args:
        time: (n,) uniform [s].
        signals: (n, channels) in the record unit; complex phasors of e^{iωt} from a lock-in.
        reference_frequency: of the phasors [rad/s]; `None` for waveforms.
    """

    kind: ClassVar[str] = "free_decay"
    section: ClassVar[type[ExperimentSection]] = FreeDecaySection
    last_resort: ClassVar[bool] = True
    reference_frequency: float | None = None

    @property
    def extent(self) -> str:
        return f"{self.span}, from an unknown start at {self.time[0]:.4g} s"

    @classmethod
    def read(cls, sheet: Sheet) -> Self:
        columns, entry = sheet.columns, sheet.entry
        reference = None if entry.reference_frequency is None else sheet.frequency("reference_frequency")
        ends = ("",) if reference is None else ("_I", "_Q", "_amp", "_phase")
        columns.refuse_others(["t", *columns.signal_names(*ends)])
        time = columns.time()
        kept = np.ones(len(time), bool)
        for key, name, inside in (("from", "begin", np.greater_equal), ("to", "end", np.less_equal)):
            given = getattr(entry, name)
            if given is not None:
                with sheet.source.section("experiment", sheet.number, key):
                    kept &= inside(time, si(given, "s", positive=False))
                    if kept.sum() < ROWS:
                        raise InputError(f"must leave {ROWS} rows or more, but leaves {kept.sum()}")
        common = sheet.common()
        return cls(
            **{**common, "lines": common["lines"][kept]},
            time=time[kept],
            signals=(columns.signals() if reference is None else columns.phasors())[kept],
            reference_frequency=reference,
        )

    def check(self, table: Table, declared: Declared) -> None:
        if len(self.channels) < declared.channels:
            raise InputError(
                f"{table.path}, header: must have the readings of both axes, as a decay begins in an unknown motion of "
                "each; with the drive before it, a ring-down may do without one."
            )
        check_period(table, None)
        if self.reference_frequency is None:
            check_sampling(self.period, self.rows, declared.resonances, table)

    def keys(self, declared: Declared) -> dict[str, Any]:
        if self.reference_frequency is None:
            return {}
        return {"reference_frequency": {"value": self.reference_frequency, "unit": "rad/s"}}

    def columns(self, declared: Declared) -> dict[str, np.ndarray]:
        if self.reference_frequency is None:
            return super().columns(declared)
        return {"t [s]": self.time, **phasor_columns(self.signals, declared)}

    # ---- pieces

    def piece_rows(self, declared: Declared) -> int:
        """Rows of a piece: so few that between the lowest and the highest frequency seen the vibration turns little,
        and at most half of the record.
        """
        cycle, most = 2 * np.pi / declared.resonances[0] / self.period, self.rows // 2
        least = max(ROWS, int(np.ceil(CYCLES * cycle)))
        span = 0.0
        for channel in range(declared.channels):
            seen = self.track(declared, channel).seen
            if seen.time.size > 1:
                sure = seen.where(seen.omega_std * self.period * least < 0.1 * TURN)
                span = max(span, float(np.ptp(sure.omega)) if sure.time.size > 1 else 0.0)
        turned = TURN / (span * self.period) if span > 0.0 else np.inf
        return max(1, int(min(most, max(least, turned))))

    def experiment(self, declared: Declared, number: int) -> FreeDecay:
        return self._experiment(declared, number, slice(self.rows % self.piece_rows(declared), None))

    @classmethod
    def laid_out(cls, declared: Declared, records: Sequence[tuple[int, Self]], alone: bool) -> list[Readings]:
        out = []
        for number, record in records:
            rows = record.piece_rows(declared)
            pieces, whole = record.rows // rows, slice(record.rows % rows, None)
            parts = [(whole, record.role == "fit")]
            if record.role is None and alone:
                half = pieces // 2 * rows
                parts = [(slice(whole.start, whole.start + half), True), (slice(record.rows - half, None), False)]
            for part, fitted in parts:
                experiment = record._experiment(declared, number, part)
                places = np.arange(record.rows)[part]
                out.append(Readings(experiment, np.full(places.size, number), places, fitted))
        return out

    def _experiment(self, declared: Declared, number: int, part: slice) -> FreeDecay:
        """Of some rows, a whole number of pieces."""
        signals, time, rows = self.signals[part], self.time[part], self.piece_rows(declared)
        phasors = self.reference_frequency is not None
        away = self._distance(declared)
        noise = self.noise_level
        return FreeDecay(
            name="free decays",
            measured=jnp.asarray(signals),
            noise=CartesianNoise(noise) if phasors else RealNoise(noise),
            start=jnp.asarray(self._starts(declared, part, rows)),
            period=jnp.asarray(self.period),
            surroundings=surroundings(declared, number, len(time), time=time),
            frequency=jnp.asarray(self.reference_frequency or 0.0),
            substeps=max(1, int(np.ceil(away * self.period / PHASE_STEP))),
        )

    def _distance(self, declared: Declared) -> float:
        """How fast at most the vibration turns in the frame of the record [rad/s].

        Phasors of one axis show it themselves; what a design leaves open may be a thousand times as wide.
        """
        reference = self.reference_frequency or 0.0
        if reference and declared.channels == 1:
            seen = self.track(declared, 0).seen
            if seen.time.size:
                return 2.0 * float(np.max(np.abs(seen.omega - reference)))
        return max(abs(omega - reference) for omega in declared.resonances)

    def _starts(self, declared: Declared, part: slice, rows: int) -> np.ndarray:
        """Displacement and velocity at the beginning of each piece, as its strongest vibration has them."""
        columns = []
        for channel in range(declared.channels):
            few = replace(self, lines=self.lines[part], time=self.time[part], signals=self.signals[part])
            track = few.track(declared, channel, rows)
            back = 0.5 * (rows - 1) * self.period
            turn = track.omega - (self.reference_frequency or 0.0)
            begin = track.phasor * np.exp((track.decay - 1j * turn) * back)
            begin = declared.readout.motion(begin[:, None], track.omega)[:, 0]
            columns.append((begin.real, (1j * track.omega * begin).real))
        return np.stack([c[0] for c in columns] + [c[1] for c in columns], axis=1)

    # ---- start, noise, misfit and overlay

    def free_modes(self, declared: Declared) -> list[tuple[float, float, float]]:
        """Per channel: amplitude, angular frequency [rad/s] and decay rate [1/s] of its strongest vibration, as means
        weighted with the squared amplitude.
        """
        found = []
        for channel in range(declared.channels):
            track = self.track(declared, channel)
            weight = track.amplitude**2 / np.sum(track.amplitude**2)
            rates = float(weight @ track.omega), float(weight @ track.decay)
            found.append((float(track.amplitude.max()), *rates))
        return found

    @property
    def offset(self) -> np.ndarray:
        return super().offset if self.reference_frequency is None else np.zeros(self.signals.shape[1])

    def series(self, deviation: Deviation) -> Series:
        if self.reference_frequency is None:
            return super().series(deviation)
        turned = in_phase(deviation.white, deviation.predicted)
        return Series(self.name, deviation.channels, deviation.white, turned, (slice(None),), segments(self.time))

    def missing_force(self, deviation: Deviation) -> TimeForce | None:
        return super().missing_force(deviation) if self.reference_frequency is None else None

    def decay(self, declared: Declared, channel: int) -> Track:
        return self.track(declared, channel)

    def warnings(self, declared: Declared) -> list[str]:
        loud = [self.track(declared, channel).seen.time.size for channel in range(declared.channels)]
        if max(loud) > 0:
            return []
        return [f"{self.file}: nothing that vibrates stands clear of the noise; is `from` right?"]
