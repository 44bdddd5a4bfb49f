"""The port: a kind of measurement, from the rows of its file to what a misfit of it may depend on.

A member is one class of record with its `Experiment`. What it must say is how it is read and written and what the
laboratory would have recorded of a model; all else has a default that claims nothing about the kind.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.device.normalised import NormalisedDevice

from ..channel_noise import ToldNoise, told_by_channels
from ..declared import Declared
from ..section import ExperimentSection
from ..standing_line import StandingLine
from ..tracking import Track
from .base import Experiment, Phasors, Readings
from .deviation import Deviation, Known, Overlay, Series, Variable, View, by_setting, in_phase
from .missing_force import MissingForce
from .sheet import Sheet


Role = Literal["fit", "validation"]


class Watched(NamedTuple):
    """A column in which a row that stands alone among its neighbours is a wrong digit.

    Args:
        name: for people.
        values: (n,) real or complex.
        noise: standard deviation of each real number; zero where it carries none.
        place: (n,) abscissa, monotonic within each piece.
        pieces: rows that follow each other.
        over_frequency: whether `place` is the frequency of the drive [rad/s].
    """

    name: str
    values: np.ndarray
    noise: float
    place: np.ndarray
    pieces: Sequence[slice]
    over_frequency: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class AbstractRecord(abc.ABC):
    """One experiment.

    Args:
        name: unique within the case.
        file: CSV file below the folder of the case.
        lines: (n,) line of each row in that file, from 1.
        role: "validation" is never fitted; `None` where the case does not say.
        note: free text.
        noise_std: of each real reading (each of I and Q for phasors), in the record unit; `None` asks to estimate it.
        noise_rows: (n, channels) the same, where the file tells it row by row, of which `noise_std` is then the mean.
        temperature_std: of the temperature at which it was taken [K], the same error in all rows of one temperature.
        left: noise that a model leaves where the rows told too much of it, of each recorded channel where they differ,
            and its degrees of freedom.
        recorded: which channels the file holds; all where it is empty. The readings of others are zero, and their noise
            is infinite.
        carried: columns that nothing depends on, header to values.
        undeclared: which of them the case does not say to carry along.
    """

    kind: ClassVar[str]  # the word for it in `case.toml`
    section: ClassVar[type[ExperimentSection]] = ExperimentSection  # its keys there
    last_resort: ClassVar[bool] = False  # without a role, fitted only where no other kind is
    stepped: ClassVar[bool] = False  # each row is a setting of its own, reached from that of the row before
    driven: ClassVar[bool] = True  # by a known force: else its phase is that of an unknown start
    name: str
    file: str
    lines: np.ndarray
    role: Role | None = None
    note: str = ""
    noise_std: float | None = None
    noise_rows: np.ndarray | None = None
    temperature_std: float = 0.0
    left: tuple[float | tuple[float, ...], float] | None = None
    recorded: tuple[bool, ...] = ()
    carried: Mapping[str, np.ndarray] = field(default_factory=dict)
    undeclared: tuple[str, ...] = ()

    # ---- record

    @property
    def sweep_rate(self) -> float:
        """Fastest that the frequency of the drive moves by the file's own clock [rad/s²]; infinite where none says,
        zero where it stands still or its steps are predicted.
        """
        return 0.0

    @property
    def rows(self) -> int:
        """How many rows the record has."""
        return len(self.lines)

    @property
    @abc.abstractmethod
    def readings(self) -> np.ndarray:
        """(n, channels) what was read, real or complex, in the record unit."""

    @property
    def channels(self) -> list[int]:
        """Numbers of those that were recorded."""
        every = self.recorded or (True,) * self.readings.shape[1]
        return [number for number, seen in enumerate(every) if seen]

    @property
    @abc.abstractmethod
    def extent(self) -> str:
        """What the record spans, for people."""

    @classmethod
    @abc.abstractmethod
    def read(cls, sheet: Sheet) -> Self:
        """The record that a section of `case.toml` and its CSV file hold; raises `InputError` for what is wrong."""

    def only(self, rows: np.ndarray) -> Self:
        """A record of some of the rows, by their numbers or by a mask (n,)."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        kept = {n: v[rows] for n, v in values.items() if isinstance(v, np.ndarray) and v.shape[:1] == (self.rows,)}
        return replace(self, **kept, carried={name: column[rows] for name, column in self.carried.items()})

    def no_louder_than(self, loudest: float) -> "AbstractRecord | None":
        """What of a record whose drive nobody knows is as quiet as sweeps that reach that much [V]; by default all."""
        return self

    def check(self, table: Table, declared: Declared) -> None:  # noqa: B027
        """Raises `InputError` where rows, declarations and design contradict each other; by default they never do."""

    def keys(self, declared: Declared) -> dict[str, Any]:
        """What `case.toml` says of this record beside what it says of all."""
        return {}

    @abc.abstractmethod
    def columns(self, declared: Declared) -> dict[str, np.ndarray]:
        """The CSV file in SI, header to column (n,)."""

    # ---- predict

    @abc.abstractmethod
    def experiment(self, declared: Declared, number: int) -> Experiment:
        """What predicts the rows, or the last of them; `number` is that of the record in its case."""

    @classmethod
    def laid_out(cls, declared: Declared, records: Sequence[tuple[int, Self]], alone: bool) -> list[Readings]:
        """The readings of all records of this kind, each with its number; `alone` where no other kind may be fitted.

        By default one experiment per record, fitted as a whole or not at all. Records of one shape share a program.
        """
        out = []
        for number, record in records:
            experiment = record.experiment(declared, number)
            rows = np.arange(record.rows)[-experiment.measured.shape[0] :]
            fitted = (alone or not cls.last_resort) if record.role is None else record.role == "fit"
            out.append(Readings(experiment, np.full(rows.size, number), rows, fitted))
        return out

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies at which the record looked for a response [rad/s]; by default none."""
        return np.zeros(0)

    @property
    def duration(self) -> float:
        """Time [s] over which the device may have changed within the record; zero where rows have no time."""
        return 0.0

    # ---- start

    def starting_phasors(self, declared: Declared) -> Phasors | None:
        """Motion at known frequencies and forces, from which a start of a fit is found; by default none."""
        return None

    def free_modes(self, declared: Declared) -> list[tuple[float, float, float]] | None:
        """Per channel: amplitude, angular frequency [rad/s] and decay rate [1/s] of the strongest vibration of a device
        left alone; by default none.
        """
        return None

    def interference(self, declared: Declared) -> tuple[StandingLine, ...]:
        """Lines that stand in it beside what the device does; by default none is looked for."""
        return ()

    @property
    def offset(self) -> np.ndarray | None:
        """(channels,) the constant in the readings, as far as the record shows one at a glance."""
        return None

    # ---- noise and quality

    def estimated_noise(self) -> float | None:
        """Standard deviation of each real reading as the rows alone tell it, root mean square over channels where they
        differ; `None` where they do not tell.
        """
        return self.told_noise.level

    def noise_told_by(self, channels: Sequence[int]) -> tuple[float | None, float]:
        """Noise that the rows tell of some channels as if it were one, `None`, the default, where they do not, and its
        degrees of freedom.
        """
        return None, np.inf

    @cached_property
    def told_noise(self) -> ToldNoise:
        """Noise as the rows alone tell it, of each channel where these differ by more than chance."""
        return told_by_channels(self.noise_told_by, self.channels, self.noise_by_channel)

    @property
    def noise_by_channel(self) -> bool:
        """Whether the rows of each channel tell its own noise."""
        return True

    @property
    def noise_freedom(self) -> float:
        """Degrees of freedom with which the noise is known: infinite where it is declared."""
        if self.noise_std is not None:
            return np.inf
        return self.estimated_freedom() if self.left is None else self.left[1]

    def estimated_freedom(self) -> float:
        """Degrees of freedom of `estimated_noise`: its square scatters like that of so many normal numbers."""
        return self.told_noise.freedom

    @cached_property
    def noise_level(self) -> float:
        """Declared or estimated, root mean square over channels where they differ; raises `InputError` where it is
        neither.
        """
        found = self.noise_std
        if found is None:
            found = self.estimated_noise() if self.left is None else float(np.sqrt(np.mean(np.square(self.left[0]))))
        if not found:
            raise InputError(
                f"Experiment `{self.name}` must declare its `noise_std`, as its rows do not tell their noise."
            )
        return found

    @cached_property
    def noise_levels(self) -> np.ndarray:
        """(channels,) the same of each channel, mean square over rows where the file tells it row by row; zero where it
        is neither declared nor told, infinite in channels that were not recorded.
        """
        every, seen = np.full(self.readings.shape[1], np.inf), self.channels
        if self.noise_rows is not None:
            every[seen] = np.sqrt(np.mean(self.noise_rows[:, seen] ** 2, axis=0))
        elif self.noise_std is not None:
            every[seen] = self.noise_std
        elif self.left is not None:
            every[seen] = self.left[0]
        else:
            every[seen] = self.told_noise.levels or self.estimated_noise() or 0.0
        return every

    @property
    def noise_of_rows(self) -> np.ndarray:
        """(n, channels) standard deviation of each real reading; infinite in channels that were not recorded."""
        every = np.full(self.readings.shape, np.inf)
        seen = self.channels
        levels = np.where(self.noise_levels > 0.0, self.noise_levels, self.noise_level)
        every[:, seen] = levels[seen] if self.noise_rows is None else self.noise_rows[:, seen]
        return every

    def watched(self, noise: np.ndarray) -> list[Watched]:
        """Columns in which a row far off its neighbours is an error, where each channel has the standard deviation
        `noise` (channels,), zero where it is not known; none by default.
        """
        return []

    def warnings(self, declared: Declared) -> list[str]:
        """A sentence for everything about the rows that a colleague should know; none by default."""
        return []

    def better_keys(self, declared: Declared) -> tuple[dict[str, Any], str]:
        """Keys of its section that its rows contradict, as they show them, and a sentence on it; by default none."""
        return {}, ""

    def better_quantity(self, declared: Declared) -> tuple[str, str]:
        """The same of what the case says that its read-out shows: by default nothing, both empty."""
        return "", ""

    def beside_device(self, device: NormalisedDevice, declared: Declared) -> list[str]:
        """The same of what they contradict in the device that the phasors of all records show."""
        return []

    # ---- misfit and overlay

    def known(self, declared: Declared) -> tuple[Known, ...]:
        """What was set or known about every row, on which a misfit may depend; by default nothing."""
        return ()

    def series(self, deviation: Deviation) -> Series:
        """What a misfit is tested against: by default each setting, and each variable, of what is known."""
        known, white = self.known(deviation.declared), deviation.white
        phasors = white.shape[-1] == 2
        return Series(
            self.name,
            deviation.channels,
            white,
            in_phase(white, deviation.predicted) if phasors else white,
            (),
            tuple(part for one in known if one.set for part in by_setting(one, ())),
            (),
            tuple(Variable(one.name, one.values) for one in known),
        )

    def at(self, row: int) -> str:
        """Where a row is, for people: "near 3.026 kHz"; empty where parts and segments say it already."""
        return ""

    def overlay(self, base: Deviation, final: Deviation) -> Overlay:
        """The picture of the record: by default every channel over the first of what is known, else over the row."""
        known = self.known(base.declared)
        across, heading = (
            (known[0].values, f"{known[0].name} [{known[0].unit}]") if known else (np.arange(self.rows), "row")
        )
        order = (np.argsort(across, kind="stable"),)
        return Overlay("", tuple(View(c, heading, across, slice(None), order) for c in self.channels))

    def missing_force(self, deviation: Deviation) -> MissingForce | None:
        """The force that the model lacks to move as it was seen to move, as one of three views; by default none."""
        return None

    def decay(self, declared: Declared, channel: int) -> Track | None:
        """Amplitude, frequency and decay rate of a channel where the record rings down; by default it does not."""
        return None

    def __str__(self) -> str:
        return f"{self.name}: {self.kind}, {self.rows} rows, {self.extent}"
