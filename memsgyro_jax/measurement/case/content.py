"""A measurement case as an immutable object in SI: what is declared of a device, and what was recorded of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned, listed, spoken

from ..calibration import calibration_text
from ..declared import Declared, Drive
from ..experiments import AbstractRecord
from ..experiments.deviation import Known


@dataclass(frozen=True, eq=False, repr=False)
class Case(Shown, Declared):
    """Everything a laboratory declared and recorded of one device; see `Declared` for the other fields.

    Args:
        records: the experiments, in the order of the file.
    """

    records: tuple[AbstractRecord, ...] = ()

    def record(self, name: str) -> AbstractRecord:
        """The experiment of that name; raises `InputError` where there is none."""
        return self.records[self.number(name)]

    def number(self, name: str) -> int:
        """The place of the experiment of that name; raises `InputError` where there is none."""
        names = [record.name for record in self.records]
        if name not in names:
            raise InputError(f"Argument `name` must be one of the experiments {', '.join(names)}, but is {name!r}.")
        return names.index(name)

    def __str__(self) -> str:
        heading = f"{self.name}: {self.device}" + (f", {self.description}" if self.description else "")
        head = ("experiment", "kind", "role", "rows", "drive", "noise", "extent")
        unit = self.readout.unit
        rows = [
            (
                r.name,
                r.kind,
                r.role or "-",
                str(r.rows),
                _level(r.known(self), self.drive),
                _noise(r.noise_std, unit),
                r.extent,
            )
            for r in self.records
        ]
        return "\n".join(filter(None, (heading, calibration_text(self), aligned([head, *rows]), _unsure_warmth(self))))


def _unsure_warmth(case: Case) -> str:
    """By how much the temperatures of which records may be off; empty where all are exact."""
    unsure: dict[float, list[str]] = {}
    for record in case.records:
        if record.temperature_std:
            unsure.setdefault(record.temperature_std, []).append(record.name)
    said = [f"of {listed(names)} by {std:.3g} K" for std, names in unsure.items()]
    return f"The temperatures may be off, {'; '.join(said)} (1σ): they are free in every fit." if said else ""


def _level(known: Sequence[Known], drive: Drive | None) -> str:
    """The level that was set, or the lowest and the highest; a dash where it is no level."""
    column = next((column for column in known if column.name == "drive"), None)
    if column is None:
        return "-"
    unit, scale = (column.unit, 1.0) if drive is None or drive.scale is None else (drive.unit, drive.scale)
    ends = [float(value) / scale for value in (np.min(column.values), np.max(column.values))]
    return " to ".join(dict.fromkeys(spoken(abs(end), unit, 3) for end in ends))


def _noise(std: float | None, unit: str) -> str:
    return "-" if std is None else f"{std:.3g} {unit}".removesuffix(" 1")
