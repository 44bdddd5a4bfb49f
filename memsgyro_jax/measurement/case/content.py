"""A measurement case as an immutable object in SI: what is declared of a device, and what was recorded of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned, spoken

from ..calibration import calibration_text
from ..declared import Declared
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
        for record in self.records:
            if record.name == name:
                return record
        names = ", ".join(record.name for record in self.records)
        raise InputError(f"Argument `name` must be one of the experiments {names}, but is {name!r}.")

    def __str__(self) -> str:
        heading = f"{self.name}: {self.device}" + (f", {self.description}" if self.description else "")
        head = ("experiment", "kind", "role", "rows", "drive", "noise", "extent")
        rows = [
            (r.name, r.kind, r.role or "-", str(r.rows), _drive(r.known(self)), _noise(r.noise_std, self.readout.unit))
            + (r.extent,)
            for r in self.records
        ]
        return "\n".join(filter(None, (heading, calibration_text(self), aligned([head, *rows]))))


def _drive(known: Sequence[Known]) -> str:
    """The level, or the lowest and the highest, of what is known of rows; a dash where it is no level."""
    levels = [np.abs([np.min(column.values), np.max(column.values)]) for column in known if column.name == "drive"]
    units = [column.unit for column in known if column.name == "drive"]
    return " to ".join(dict.fromkeys(spoken(float(level), units[0], 3) for level in levels[0])) if levels else "-"


def _noise(std: float | None, unit: str) -> str:
    return "-" if std is None else f"{std:.3g} {unit}".removesuffix(" 1")
