"""Operating points: settled phasors at one frequency of the drive, each row at conditions of its own.

What a rate table stopped at rate after rate tells, or a chamber that dwells at temperature after temperature, where a
row holds the mean of a dwell and no clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.device.normalised import NormalisedDevice

from ..columns import phasor_columns
from ..declared import Declared
from ..noise import freedom_over_frequency, noise_over_frequency
from ..one_place import set_points
from ..rate_signs import fast_rates, turned_rate
from ..section import DrivenSection, ExperimentSection, Frequency, Quantity
from .base import Phasors, Readings
from .deviation import Known
from .harmonic_sweep import HarmonicSweep
from .record import AbstractRecord, Watched
from .sheet import Sheet
from .sweep_layout import halves, joined_rows
from .sweep_rows import levels_set


_SCATTER = 0.02  # of a drive that is a reading of one setting, and not another
_REST = 1e-3  # of the largest rate: at rest


class OperatingPointsSection(DrivenSection):
    """`kind = "operating_points"`: settled lock-in phasors at one frequency, a row for each rate, temperature, bias
    voltage or drive.
    """

    drive_frequency: Frequency
    """Frequency of the drive."""
    drive_force: Quantity | None = None
    """Amplitude (peak) of the drive, a force, or in the unit that `[drive]` has for it; left out where a column has it,
    or where it is part of a resonator's gain."""
    rate_reference: Literal["table", "calibrated"] = "table"
    """Whether the column `rate` is the setting of the table, or that of a calibrated reference."""


@dataclass(frozen=True, eq=False, kw_only=True)
class OperatingPointsRecord(AbstractRecord):
    """Settled phasors at one frequency of the drive, each row at conditions of its own.

    Args:
        axis: driven electrode, 0 = x, 1 = y.
        drive_frequency: [rad/s].
        drive: (n,) amplitude of the force [N], of the input [V] for a resonator.
        temperature: (n,) [K].
        bias_voltage: (n,) of the electrodes [V].
        rate: (n,) angular rate [rad/s].
        phasors: (n, channels) complex, in the record unit.
        rate_calibrated: the rate comes from a calibrated reference, not from the setting of the table.
    """

    kind: ClassVar[str] = "operating_points"
    section: ClassVar[type[ExperimentSection]] = OperatingPointsSection
    stepped: ClassVar[bool] = True
    settled: ClassVar[bool] = True
    time: ClassVar[None] = None
    phase_known: ClassVar[bool] = True
    axis: int
    drive_frequency: float
    drive: np.ndarray
    temperature: np.ndarray
    bias_voltage: np.ndarray
    rate: np.ndarray
    phasors: np.ndarray
    rate_calibrated: bool = False

    @property
    def readings(self) -> np.ndarray:
        return self.phasors

    @property
    def extent(self) -> str:
        varied = [one.name for one in self._conditions("N") if np.ptp(one.values) > 0]
        return f"{self.drive_frequency / (2 * np.pi):.6g} Hz on {'xy'[self.axis]}, over {' and '.join(varied)}"

    @property
    def frequency(self) -> np.ndarray:
        """(n,) of the drive [rad/s]."""
        return np.full(self.rows, self.drive_frequency)

    @property
    def frequencies(self) -> np.ndarray:
        return np.array([self.drive_frequency])

    @property
    def directions(self) -> np.ndarray:
        """(n,) zero: the frequency stands still."""
        return np.zeros(self.rows)

    @cached_property
    def sweeps(self) -> tuple[slice, ...]:
        """The rows of each setting of the drive that follow each other; where temperatures may be off, of each of those
        too.
        """
        another = np.abs(np.diff(np.log(self.drive))) > _SCATTER
        if self.temperature_std:
            another |= np.diff(set_points(self.temperature)) != 0
        begins = [0, *np.flatnonzero(another) + 1, self.rows]
        return tuple(map(slice, begins[:-1], begins[1:]))

    @cached_property
    def drive_force(self) -> np.ndarray:
        """(n,) drive that was set, of which `drive` may be a reading."""
        return levels_set(self.drive, self.sweeps, _SCATTER)

    # ---- record

    @classmethod
    def read(cls, sheet: Sheet) -> Self:
        columns, around, axis = sheet.columns, sheet.declared.environment, sheet.axis
        drives = [name for group in columns.words.drives for name in group]
        columns.refuse_others(
            [*columns.signal_names("_I", "_Q", "_amp", "_phase"), *drives, "T", "V_bias", "rate"]
        )  # fmt: skip
        return cls(
            **sheet.common(),
            axis=axis,
            drive_frequency=sheet.frequency("drive_frequency"),
            drive=sheet.drive_levels(axis),
            temperature=columns.optional("T", "K", around.temperature),
            bias_voltage=columns.optional("V_bias", "V", around.bias_voltage),
            rate=columns.optional("rate", "rad/s", 0.0),
            phasors=columns.phasors(),
            rate_calibrated=sheet.entry.rate_reference == "calibrated",
        )

    def check(self, table: Table, declared: Declared) -> None:
        if not any(np.ptp(one.values) > 0 for one in self._conditions(declared.words.force)):
            raise InputError(
                f"{table.path}, header: rate, temperature, bias voltage or drive must be a column that varies, as a "
                "row for each is what operating points are."
            )

    def keys(self, declared: Declared) -> dict[str, Any]:
        return {
            "drive_axis": "xy"[self.axis],
            "drive_frequency": {"value": self.drive_frequency, "unit": "rad/s"},
            "rate_reference": "calibrated" if self.rate_calibrated else "table",
        }

    def columns(self, declared: Declared) -> dict[str, np.ndarray]:
        words = declared.words
        return {
            f"{words.drives[0][self.axis]} [{words.force}]": self.drive,
            "V_bias [V]": self.bias_voltage,
            "T [K]": self.temperature,
            "rate [rad/s]": self.rate,
            **phasor_columns(self.phasors, declared, self.channels),
        }

    # ---- predict

    def experiment(self, declared: Declared, number: int) -> HarmonicSweep:
        return self._trusting(joined_rows(declared, [(number, self)], np.arange(self.rows), np.ones(self.rows, bool)))

    @classmethod
    def laid_out(cls, declared: Declared, records: Sequence[tuple[int, Self]], alone: bool) -> list[Readings]:
        """Each record by itself; without a role every second row is fitted."""
        out = []
        for number, record in records:
            laid = halves(declared, [(number, record)])
            out += [replace(part, experiment=record._trusting(part.experiment)) for part in laid]
        return out

    def _trusting(self, experiment: HarmonicSweep) -> HarmonicSweep:
        """The same, whose rate is that of a reference where it is."""
        trusted = jnp.full(experiment.frequency.shape, float(self.rate_calibrated))
        experiment = eqx.tree_at(lambda e: e.surroundings.rate_trusted, experiment, trusted)
        return replace(experiment, name="operating points")

    def motion(self, declared: Declared) -> np.ndarray:
        """(n, axes) displacement phasors that were seen."""
        return declared.readout.motion(self.phasors, self.frequency)

    def starting_phasors(self, declared: Declared) -> Phasors | None:
        around, lowest = declared.environment, self.drive_force.min()
        calm = np.abs(self.rate) <= _REST * np.max(np.abs(self.rate), initial=0.0)
        calm &= (np.abs(self.temperature - around.temperature) < 1) & (self.drive_force <= (1 + _SCATTER) * lowest)
        calm &= np.abs(self.bias_voltage - around.bias_voltage) < 1e-6
        if not calm.any() or len(self.channels) < declared.channels:
            return None
        readout, omega = declared.readout, self.frequency[calm]
        force = np.outer(self.drive[calm], np.eye(declared.channels)[self.axis]) + 0j
        weight = abs(readout.scale) * omega**readout.order / self.noise_level
        return Phasors(omega, self.motion(declared)[calm], force, weight)

    # ---- noise and quality

    def noise_told_by(self, channels: Sequence[int]) -> tuple[float | None, float]:
        place, readings, *rows = self._over_what_varies
        seen = place, readings[:, channels], *rows
        return noise_over_frequency(*seen), freedom_over_frequency(*seen)

    @property
    def _over_what_varies(self) -> tuple[np.ndarray, np.ndarray, list[slice], list[np.ndarray]]:
        """What varies most, the readings in its order, and rows that ought to lie on one curve over it; those that
        repeat all conditions tell the noise best.
        """
        conditions = self._conditions("N")
        most = max(conditions, key=lambda one: len(np.unique(one.values)))
        others = np.stack([one.values for one in conditions if one is not most], axis=1)
        _, group = np.unique(others, axis=0, return_inverse=True)
        order = np.lexsort((most.values, group.ravel()))
        courses = [np.flatnonzero(group.ravel()[order] == k) for k in range(group.max() + 1)]
        pieces = [slice(rows[0], rows[-1] + 1) for rows in courses]
        return most.values[order], self.readings[order], pieces, courses

    def watched(self, noise: np.ndarray) -> list[Watched]:
        return []

    def warnings(self, declared: Declared) -> list[str]:
        return fast_rates(self.name, self.rate)

    def beside_device(self, device: NormalisedDevice, declared: Declared) -> list[str]:
        if declared.channels < 2 or len(self.channels) < 2:
            return []
        return turned_rate(self.name, device, self.drive_frequency, self.axis, self.motion(declared), self.rate)

    # ---- misfit

    def _conditions(self, force: str) -> tuple[Known, ...]:
        return (
            Known("rate", self.rate, "rad/s"),
            Known("temperature", self.temperature, "K"),
            Known("bias voltage", self.bias_voltage, "V"),
            Known("drive", self.drive_force, force),
        )

    def known(self, declared: Declared) -> tuple[Known, ...]:
        """What varies first, as the picture is drawn over it."""
        conditions = self._conditions(declared.words.force)
        return tuple(sorted(conditions, key=lambda one: -len(np.unique(one.values))))
