"""One `[[experiment]]` and its CSV file on the way to a record."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError

from ..columns import Columns
from ..declared import Declared, si
from ..section import Amount
from .checks import near_resonance


_MOST_OFF = 30.0  # K: a larger uncertainty is a temperature itself, or a mistake


@dataclass(frozen=True)
class Sheet:
    """What a kind of measurement reads its record from.

    Args:
        declared: of the device.
        source: `case.toml`, for complaints with line and key.
        number: of the experiment in it, from 0.
        entry: its section, of the class that the kind names.
        columns: its CSV file.
    """

    declared: Declared
    source: Source
    number: int
    entry: Any
    columns: Columns

    def common(self) -> dict[str, Any]:
        """What every record holds, as keyword arguments."""
        entry = self.entry
        noise = None if entry.noise_std is None else self._noise(entry.noise_std)
        rows = self.columns.noise()
        if rows is not None:
            with self.source.section("experiment", self.number, "noise_std"):
                if noise is not None:
                    raise InputError("must be left out where columns hold the noise of each row")
            noise = float(np.sqrt(np.mean(rows**2)))
        return {
            "name": entry.name, "file": entry.file, "lines": self.columns.table.lines, "role": entry.role,
            "note": entry.note, "noise_std": noise, "noise_rows": rows, "recorded": self.columns.recorded,
            "temperature_std": 0.0 if entry.temperature_std is None else self._warmth(entry.temperature_std),
        }  # fmt: skip

    def amount(self, key: str, unit: str) -> float:
        """A positive quantity of the experiment in SI."""
        with self.source.section("experiment", self.number, key):
            drive = self.declared.drive
            if drive is not None and drive.scale and unit == self.force_unit:
                return si(getattr(self.entry, key), drive.unit) * drive.scale
            return si(getattr(self.entry, key), unit)

    def frequency(self, key: str) -> float:
        """A drive frequency [rad/s], near where a die within the design may resonate."""
        value = self.amount(key, "rad/s")
        with self.source.section("experiment", self.number, key):
            near_resonance(value, value, self.declared.resonances)
        return value

    @property
    def axis(self) -> int:
        """The axis that `drive_axis` names; a device of one axis needs no word."""
        given = self.entry.drive_axis
        with self.source.section("experiment", self.number, "drive_axis"):
            if given is None and self.declared.channels == 2:
                raise InputError('is missing; give "x" or "y"')
            if given == "y" and self.declared.channels == 1:
                raise InputError('must be "x" for a device of one axis, but is "y"')
        return 1 if given == "y" else 0

    def drive_levels(self, axis: int) -> np.ndarray:
        """Drive level of each row, from the column or the section."""
        columns, entry = self.columns, self.entry
        drive = columns.drive(axis)
        with self.source.section("experiment", self.number, "drive_force"):
            if drive is not None and entry.drive_force is not None:
                raise InputError("must be left out where a column holds the drive level")
            if drive is None and entry.drive_force is None and self.declared.channels == 1:
                return np.ones(len(columns.table.lines))  # the same for all rows: part of the gain
            if drive is None and entry.drive_force is None:
                name = columns.words.drives[-1][axis]
                raise InputError(f"is missing; give the drive level here or in a column `{name}` of {entry.file}")
        if drive is None:
            drive = np.full(len(columns.table.lines), self.amount("drive_force", self.force_unit))
        return drive

    @property
    def force_unit(self) -> str:
        """Unit of the drive."""
        return self.declared.words.force

    def _warmth(self, std: Amount) -> float:
        """[K], of an oven or a thermometer; an absolute temperature, as degrees Celsius give, is more than that."""
        with self.source.section("experiment", self.number, "temperature_std"):
            if not std.number > 0.0 or not (kelvins := si(std, "K")) <= _MOST_OFF:
                raise InputError(
                    f'must be a difference of temperatures up to {_MOST_OFF:g} K, such as {{ value = 0.1, unit = "K" }}'
                    f", but is {std.number:g} {std.unit}; leave it out where the temperature is exact"
                )
            return kelvins

    def _noise(self, noise: Amount) -> float:
        with self.source.section("experiment", self.number, "noise_std"):
            if noise.number <= 0:
                raise InputError(
                    f"must be positive, but is {noise.number:g} {noise.unit}; leave it out to have it estimated"
                )
            return si(noise, self.declared.readout.unit)
