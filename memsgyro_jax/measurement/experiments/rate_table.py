"""Rate table: driven at one frequency, demodulated block by block by a lock-in while the table turns."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from pydantic import Field, StrictBool

from memsgyro_jax.base.quantity import Whole
from memsgyro_jax.base.table import Table
from memsgyro_jax.device.normalised import NormalisedDevice

from ..clock import check_period, usual_period
from ..columns import phasor_columns
from ..declared import Declared
from ..held_noise import noise_beside_steps
from ..rate_nodes import RateNodes
from ..rate_signs import fast_rates, turned_rate
from ..section import ExperimentSection, ToneSection
from .base import CartesianNoise, Phasors, Readings, surroundings
from .clocked import CONDITIONS, ClockedRecord, surroundings_told
from .deviation import Deviation, Known, Series, Variable, by_setting, in_phase, segments
from .missing_force import RateResidual, residual_over_rate
from .rate_blocks import RateTable
from .record import Watched
from .sheet import Sheet


class RateTableSection(ToneSection):
    """`kind = "rate_table"`: lock-in phasors over time on a rate table, open loop, settled before t = 0."""

    lock_in_cycles: Annotated[Whole, Field(gt=0, le=10**9)] | None = None
    """Drive cycles over which each row averages; left out, a low pass makes rows at a rate of their own."""
    rate_reference: Literal["table", "calibrated"] = "table"
    """Whether the column `rate` is the setting of the table, or that of a calibrated reference."""
    uneven: StrictBool = False
    """Whether blocks of the lock-in are lost, or stamps jitter about those of their blocks."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RateTableRecord(ClockedRecord):
    """Lock-in phasors over time on a rate table, open loop, settled before t = 0.

    Args:
        axis: driven electrode, 0 = x, 1 = y.
        drive_force: amplitude [N], of the input [V] for a resonator.
        drive_frequency: [rad/s].
        lock_in_cycles: drive cycles over which each row averages, without a gap; `None` where a low pass makes them.
        rate_calibrated: the rate comes from a calibrated reference, not from the setting of the table.
        has_rate: the file has a rate column; without it the table stands still.
        time: (n,) middle of each block [s].
        rate: (n,) angular rate [rad/s], zeros without the column.
        phasors: (n, channels) complex, in the record unit.
        uneven: whether stamps jitter about those of their blocks, or blocks are lost; there the rate is interpolated.
    """

    kind: ClassVar[str] = "rate_table"
    section: ClassVar[type[ExperimentSection]] = RateTableSection
    axis: int
    drive_force: float
    drive_frequency: float
    lock_in_cycles: int | None
    rate_calibrated: bool
    has_rate: bool
    rate: np.ndarray
    phasors: np.ndarray
    uneven: bool = False

    @property
    def block(self) -> float:
        """Time that a block of the lock-in lasts [s]."""
        if self.lock_in_cycles is None:
            return usual_period(self.time)
        return self.lock_in_cycles * 2 * np.pi / self.drive_frequency

    @property
    def blocks(self) -> np.ndarray:
        """(n,) number of each row's block, from 0."""
        if not self.uneven:
            return np.arange(self.rows)
        place = (self.time - self.time[0]) / self.block
        late = float(np.median(place - np.round(place)))
        number = np.round(place - late).astype(int)
        return np.asarray(number - number[0])

    @property
    def readings(self) -> np.ndarray:
        return self.phasors

    @property
    def extent(self) -> str:
        return f"{self.span}, rate up to {np.degrees(np.max(np.abs(self.rate))):.4g} deg/s"

    @property
    def slope(self) -> np.ndarray:
        """(n,) angular acceleration [rad/s²]."""
        steps = self.time if self.uneven else self.period
        return np.gradient(self.rate, steps) if self.rows > 1 else np.zeros(1)

    @classmethod
    def read(cls, sheet: Sheet) -> Self:
        columns = sheet.columns
        columns.refuse_others(["t", "rate", *CONDITIONS, *columns.signal_names("_I", "_Q", "_amp", "_phase")])
        return cls(
            **sheet.common(),
            **surroundings_told(columns, sheet.declared.environment),
            axis=sheet.axis,
            drive_force=sheet.amount("drive_force", sheet.force_unit),
            drive_frequency=sheet.frequency("drive_frequency"),
            lock_in_cycles=sheet.entry.lock_in_cycles,
            rate_calibrated=sheet.entry.rate_reference == "calibrated",
            has_rate=columns.has("rate"),
            time=columns.time(),
            rate=columns.optional("rate", "rad/s", 0.0),
            phasors=columns.phasors(),
            uneven=sheet.entry.uneven,
        )

    def check(self, table: Table, declared: Declared) -> None:
        if not self.uneven:
            remedy = " (where blocks are lost, or stamps jitter about their blocks, say `uneven = true`)"
            check_period(table, None if self.lock_in_cycles is None else self.block, remedy)
        again = np.flatnonzero(np.diff(self.blocks) < 1)
        if again.size:
            raise table.at(
                int(again[0]) + 1,
                "t",
                f"must be that of a later block of the lock-in than the row before, of {self.block:.6g} s each",
            )

    def noise_told_by(self, channels: Sequence[int]) -> tuple[float | None, float]:
        return noise_beside_steps(self.phasors[:, channels], self.rate, self.blocks)

    def keys(self, declared: Declared) -> dict[str, Any]:
        return {
            "drive_axis": "xy"[self.axis],
            "drive_force": {"value": self.drive_force, "unit": declared.words.force},
            "drive_frequency": {"value": self.drive_frequency, "unit": "rad/s"},
            **({} if self.lock_in_cycles is None else {"lock_in_cycles": self.lock_in_cycles}),
            "rate_reference": "calibrated" if self.rate_calibrated else "table",
            **({"uneven": True} if self.uneven else {}),
        }

    def columns(self, declared: Declared) -> dict[str, np.ndarray]:
        told = {**({"rate [rad/s]": self.rate} if self.has_rate else {}), **self.told_columns}
        return {"t [s]": self.time, **told, **phasor_columns(self.phasors, declared, self.channels)}

    def experiment(self, declared: Declared, number: int) -> RateTable:
        blocks, count = self.blocks, int(self.blocks[-1]) + 1

        def every(values: np.ndarray, lost: float) -> np.ndarray:
            """Values of rows at every block, `lost` where none was kept."""
            out = np.full((count, *values.shape[1:]), lost, values.dtype)
            out[blocks] = values
            return out

        def between(values: np.ndarray) -> np.ndarray:
            return np.interp(np.arange(count), blocks, values)

        told = {"time": between(self.time), **self.surrounded(between)}
        around = eqx.tree_at(
            lambda c: (c.angular_acceleration, c.rate_trusted),
            surroundings(declared, number, count, between(self.rate), **told),
            (jnp.asarray(between(self.slope)), jnp.asarray(np.full(count, float(self.rate_calibrated)))),
        )
        return RateTable(
            name="rate tables",
            time=around.time,
            measured=jnp.asarray(every(self.phasors, 0.0)),
            noise=CartesianNoise(every(self.noise_of_rows, np.inf)),
            frequency=jnp.asarray(self.drive_frequency),
            force=jnp.asarray(self.drive_force * np.eye(declared.channels)[self.axis]),
            surroundings=around,
            step=jnp.asarray(self.block),
            rates=RateNodes.of(np.asarray(around.rate), self.block),
            boxcar=self.lock_in_cycles is not None,
        )

    @classmethod
    def laid_out(cls, declared: Declared, records: Sequence[tuple[int, Self]], alone: bool) -> list[Readings]:
        out = []
        for number, record in records:
            (readings,) = super().laid_out(declared, [(number, record)], alone)
            row = np.zeros(int(record.blocks[-1]) + 1, int)
            whose = np.full(row.size, -1)
            row[record.blocks], whose[record.blocks] = np.arange(record.rows), number
            out.append(replace(readings, record=whose, row=row))
        return out

    def starting_phasors(self, declared: Declared) -> Phasors | None:
        still, readout = self.rate == 0, declared.readout
        if not still.any() or len(self.channels) < declared.channels:
            return None
        motion = readout.motion(self.phasors[still].mean(axis=0)[None], self.drive_frequency)
        force = self.drive_force * np.eye(declared.channels)[self.axis][None]
        weight = np.sqrt(np.sum(still)) * abs(readout.scale) * self.drive_frequency**readout.order / self.noise_level
        return Phasors(np.array([self.drive_frequency]), motion, force + 0j, np.array([weight]))

    def warnings(self, declared: Declared) -> list[str]:
        return [*super().warnings(declared), *fast_rates(self.name, self.rate)]

    def beside_device(self, device: NormalisedDevice, declared: Declared) -> list[str]:
        if declared.channels < 2 or len(self.channels) < 2:
            return []
        motion = declared.readout.motion(self.phasors, self.drive_frequency)
        return turned_rate(self.name, device, self.drive_frequency, self.axis, motion, self.rate)

    def watched(self, noise: np.ndarray) -> list[Watched]:
        return [*super().watched(noise), self.in_time("the rate", self.rate)]

    def known(self, declared: Declared) -> tuple[Known, ...]:
        return (
            *super().known(declared),
            Known("rate", self.rate, "rad/s"),
            Known("angular acceleration", self.slope, "rad/s²", set=False),
        )

    def series(self, deviation: Deviation) -> Series:
        # Both channels by the phase of the drive: that of the sense channel turns over with the rate.
        driven = deviation.predicted[:, self.axis : self.axis + 1]
        known, whole = self.known(deviation.declared), (slice(None),)
        parts = (*segments(self.time), *(part for one in known if one.set for part in by_setting(one, whole)))
        variables = tuple(Variable(one.name, one.values) for one in known)
        white = deviation.white
        return Series(self.name, deviation.channels, white, in_phase(white, driven), whole, parts, (), variables)

    def missing_force(self, deviation: Deviation) -> RateResidual | None:
        if self.axis not in self.channels:
            return None
        noise = np.where(np.isfinite(self.noise_levels), self.noise_levels, 0.0)
        return residual_over_rate(self.name, deviation, self.axis, self.rate, self.time, noise)
