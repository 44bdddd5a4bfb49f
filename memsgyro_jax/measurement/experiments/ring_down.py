"""Ring-down: driven from rest for a while, then left alone."""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import StrictBool

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.device.conditions import Conditions

from ..clock import check_period
from ..declared import Declared
from ..envelope import Driven
from ..lock_in import with_interference
from ..model import Model
from ..noise import freedom_over_time, noise_beside_tone, noise_over_time
from ..section import ExperimentSection, Seconds, ToneSection
from ..tracking import Track
from .base import BEYOND, Experiment, Noise, RealNoise, surroundings
from .checks import check_sampling, exchanged
from .clocked import CONDITIONS, WaveformRecord, surroundings_told
from .sheet import Sheet


_CYCLES = 6  # of the drive at most in a step before it is removed
_MORE = 1.2  # times as many steps are no loss where they save another program


class RingDown(Experiment):
    """Waveforms after the drive F cos ωt, begun at rest, was taken away at t = 0 after a whole number of cycles.

    Args:
        name: of the record.
        time: of each sample since the drive was removed [s], (n,); evenly spaced where `nodes` is zero.
        measured: waveforms (n, axes) [V].
        noise: how far they may lie from the prediction.
        frequency: of the drive [rad/s].
        force: amplitude per axis [N], (axes,).
        surroundings: conditions, scalars.
        driven_for: how long it was driven before, a whole number of cycles [s].
        steps: of the integration before the removal.
        late: whether the first sample comes after the removal, rather than with it.
        nodes: at which the decay is integrated, evenly spaced; from the last of them before it, a step leads to each
            sample. Zero where the samples themselves are such.
    """

    swept: ClassVar[bool] = False

    name: str = eqx.field(static=True)
    time: Float[Array, " n"]
    measured: Float[Array, "n axes"]
    noise: Noise
    frequency: Array
    force: Float[Array, " axes"]
    surroundings: Conditions
    driven_for: Array
    steps: int = eqx.field(static=True)
    late: bool = eqx.field(static=True, default=False)
    nodes: int = eqx.field(static=True, default=0)

    def predict(self, bench: Model) -> Float[Array, "n axes"]:
        """Voltage of every channel at every sample."""
        driven = Driven.of(bench, self.frequency, self.force, self.surroundings)
        nodes, none = self.nodes or self.time.size, jnp.zeros_like(self.force)
        step = (self.time[-1] - self.time[0]) / (nodes - 1)
        legs = [(self.force, self.driven_for / self.steps, self.steps), (none, step, nodes - 1)]
        if self.late:
            legs.insert(1, (none, self.time[0], 1))
        before = sum(count for _, _, count in legs[:-1])
        begin = driven.at_rest()
        states = jnp.concatenate([begin[None], driven.run_legs(begin, legs, self.surroundings)])[before:]
        if self.nodes:
            free, place = Driven.of(bench, self.frequency, none, self.surroundings), (self.time - self.time[0]) / step
            below = jnp.clip(jnp.floor(place).astype(int), 0, nodes - 1)

            now = free.around(self.surroundings)

            def onwards(state: Array, span: Array) -> Array:
                return free.propagator(span).advance(state, free.load, lambda s: free.rest(s, now))[0]

            states = jax.vmap(onwards)(states[below], (place - below) * step)
        quiet = jnp.zeros(bench.axes)

        def sample(state: Array, time: Array) -> Array:
            return bench.observe(driven.instant(state, time), quiet, quiet, self.surroundings)

        now = dataclasses.replace(self.surroundings, time=self.time)
        return with_interference(bench, jax.vmap(sample)(states, self.time), now)

    def proposals(self, name: str) -> Iterator[tuple[str, Experiment]]:
        """Again as it was, and from a stronger drive."""
        yield f"repeat `{name}`", self
        driven = eqx.tree_at(lambda r: r.force, self, BEYOND * self.force)
        yield f"repeat `{name}` at {BEYOND:g} times the drive", driven

    def at(self, row: int) -> str:
        return f"at {float(self.time[row]):.4g} s"


def _steps(cycles: float) -> int:
    """Steps through so many cycles of the drive: one of eight numbers in an octave, so that records of one length have
    a program in common.
    """
    least = int(np.ceil(cycles / _CYCLES))
    unit = max(1, 2 ** (least.bit_length() - 4))
    return -(-least // unit) * unit


class RingDownSection(ToneSection):
    """`kind = "ring_down"`: driven from rest for a while, then left alone from t = 0 on."""

    drive_duration: Seconds
    """Time for which the drive acted before t = 0; the whole number of its cycles nearest below counts."""
    uneven: StrictBool = False
    """Whether its stamps are right though they follow no clock of one period, or rows are lost."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RingDownRecord(WaveformRecord):
    """Free decay: from rest the axis is driven with F cos(ωt) for the whole number of cycles nearest below
    `drive_duration`; the force is removed at t = 0.

    Args:
        axis: driven electrode, 0 = x, 1 = y.
        drive_force: amplitude [N], of the input [V] for a resonator.
        drive_frequency: [rad/s].
        drive_duration: [s].
        time: (n,) uniform [s], unless `uneven`.
        signals: (n, channels) in the record unit.
        uneven: whether the stamps jitter or have gaps.
    """

    kind: ClassVar[str] = "ring_down"
    section: ClassVar[type[ExperimentSection]] = RingDownSection
    last_resort: ClassVar[bool] = True
    axis: int
    drive_force: float
    drive_frequency: float
    drive_duration: float
    uneven: bool = False

    @property
    def extent(self) -> str:
        return f"{self.span} after driving {'xy'[self.axis]} at {self.drive_frequency / (2 * np.pi):.6g} Hz"

    @classmethod
    def read(cls, sheet: Sheet) -> Self:
        columns = sheet.columns
        columns.refuse_others(["t", *CONDITIONS, *columns.signal_names("")])
        return cls(
            **sheet.common(),
            **surroundings_told(columns, sheet.declared.environment),
            axis=sheet.axis,
            drive_force=sheet.amount("drive_force", sheet.force_unit),
            drive_frequency=sheet.frequency("drive_frequency"),
            drive_duration=sheet.amount("drive_duration", "s"),
            time=columns.time(),
            signals=columns.signals(),
            uneven=sheet.entry.uneven,
        )

    def check(self, table: Table, declared: Declared) -> None:
        if self.time[0] < 0:
            raise table.at(0, "t", "must not be before the force is removed at t = 0")
        if not self.uneven:
            check_period(table, None, " (where the stamps are right, say `uneven = true`)")
        check_sampling(self.period, self.rows, declared.resonances, table)

    def keys(self, declared: Declared) -> dict[str, Any]:
        return {
            "drive_axis": "xy"[self.axis],
            "drive_force": {"value": self.drive_force, "unit": declared.words.force},
            "drive_frequency": {"value": self.drive_frequency, "unit": "rad/s"},
            "drive_duration": {"value": self.drive_duration, "unit": "s"},
            **({"uneven": True} if self.uneven else {}),
        }

    def noise_told_by(self, channels: Sequence[int]) -> tuple[float | None, float]:
        seen = self.signals[:, channels]
        beside, freedom = noise_beside_tone(self.time, seen, self.drive_frequency), freedom_over_time(seen)
        return (beside if self.uneven else min(beside, noise_over_time(seen))), freedom

    def experiment(self, declared: Declared, number: int) -> RingDown:
        driven = self.drive_duration * self.drive_frequency / (2 * np.pi)
        cycles = int(np.floor(driven + 1e-9))
        if cycles < 1:
            raise InputError(
                f"{declared.folder}, experiment `{self.name}`: `drive_duration` must hold at least one drive cycle, "
                f"but holds {driven:.3g}."
            )
        around = surroundings(declared, number, 1, **self.surrounded(np.mean))
        _, fastest = declared.resonances  # which records of both axes have in common
        return RingDown(
            name="ring-downs",
            time=jnp.asarray(self.time),
            measured=jnp.asarray(self.signals),
            noise=RealNoise(self.noise_of_rows),
            frequency=jnp.asarray(self.drive_frequency),
            force=jnp.asarray(self.drive_force * np.eye(declared.channels)[self.axis]),
            surroundings=jax.tree.map(lambda leaf: leaf[0], around),
            driven_for=jnp.asarray(cycles * 2 * np.pi / self.drive_frequency),
            steps=_steps(max(cycles, min(_MORE * cycles, self.drive_duration * fastest / (2 * np.pi)))),
            late=bool(self.time[0] > 0),
            nodes=self._nodes if self.uneven else 0,
        )

    @property
    def _nodes(self) -> int:
        """Nodes as far apart as most samples are, over all of the record."""
        usual = float(np.median(np.diff(self.time)))
        return max(2, 1 + int(np.ceil((self.time[-1] - self.time[0]) / usual)))

    def decay(self, declared: Declared, channel: int) -> Track:
        return self.track(declared, channel)

    def warnings(self, declared: Declared) -> list[str]:
        found = super().warnings(declared) + exchanged(self.file, self.axis, self.signals[:, self.channels])
        decay = declared.shortest_decay
        if self.drive_duration < 5 * decay:
            found.append(
                f"{self.file}: the drive of {self.drive_duration:.3g} s lasts less than 5 time constants of {decay:.3g}"
                " s or more, so the decay starts from a transient."
            )
        if self.period * self.rows < decay:
            found.append(
                f"{self.file}: the record of {self.period * self.rows:.3g} s is shorter than the time constant of "
                f"{decay:.3g} s or more, so that the damping shows little."
            )
        return found
