"""A measurement case as an immutable object in SI: what is declared of a device, and what was recorded of it."""

from dataclasses import dataclass

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned

from ..calibration import calibration_text
from ..declared import Declared
from ..experiments import AbstractRecord


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
        head = ("experiment", "kind", "role", "rows", "noise", "extent")
        rows = [
            (r.name, r.kind, r.role or "-", str(r.rows), _noise(r.noise_std, self.readout.unit), r.extent)
            for r in self.records
        ]
        return "\n".join(filter(None, (heading, calibration_text(self), aligned([head, *rows]))))


def _noise(std: float | None, unit: str) -> str:
    return "-" if std is None else f"{std:.3g} {unit}".removesuffix(" 1")
