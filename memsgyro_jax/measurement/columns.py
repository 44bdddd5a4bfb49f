"""The columns of one CSV file of a case, in SI, with the checks that need nothing but the column."""

import difflib
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.table import Table
from memsgyro_jax.base.text import ended, suggestion

from .declared import Declared, Drive, Vocabulary, angular


@dataclass(frozen=True)
class Columns:
    """A table read with the vocabulary of a device.

    Args:
        table: the file.
        words: names and units of the device.
        unit: of the records, "V" or "1".
        drives: what drives the device, where that is not what usually does.
        carried: names of columns that nothing depends on.
        conjugated: whether phasors follow e^{-iωt}.
        inverted: whether readings have the other sign.
        others: what `refuse_others` found of them, and of those that resemble no known name: header to values.
    """

    table: Table
    words: Vocabulary
    unit: str
    drives: Drive | None = None
    carried: tuple[str, ...] = ()
    conjugated: bool = False
    inverted: bool = False
    others: dict[str, np.ndarray] = field(default_factory=dict)

    def has(self, name: str) -> bool:
        """Whether the file has the column."""
        return name in self.table.columns

    def refuse(self, what: str, column: str | None = None) -> InputError:
        """The error about the header, or about a column as a whole."""
        where = f"column `{column}`" if column else "header"
        return InputError(ended(f"{self.table.path}, {where}: {what}"))

    def si(self, name: str, unit: str) -> np.ndarray:
        """A column in the SI unit `unit`, or in rad/s for "rad/s" whether written in cycles or in angle per time."""
        self._need(name)
        values = self.table.si(name, unit)
        if not np.all(np.isfinite(values)):
            raise self.table.at(int(np.argmin(np.isfinite(values))), name, f"must be finite in {unit}")
        return values

    def frequency(self) -> np.ndarray:
        """Column `f` in rad/s, positive."""
        self._need("f")
        values = angular(self.table.columns["f"], self.table.units["f"], f"column `f` of {self.table.path}")
        return self._positive("f", np.asarray(values))

    def optional(self, name: str, unit: str, default: float) -> np.ndarray:
        """A column in SI, or `default` in every row; a temperature is above absolute zero."""
        if not self.has(name):
            return np.full(len(self.table.lines), default)
        values = self.si(name, unit)
        return self._positive(name, values, "above absolute zero") if unit == "K" else values

    def time(self) -> np.ndarray:
        """Column `t` [s], strictly increasing."""
        time = self.si("t", "s")
        late = np.diff(time) <= 0
        if np.any(late):
            raise self.table.at(int(np.argmax(late)) + 1, "t", "must be later than that of the row before")
        return time

    def drive(self, axis: int) -> np.ndarray | None:
        """The drive level of the axis, positive, or `None` where the file has no such column."""
        names = self.words.drives[0] if len(self.words.drives) == 1 else self._used(self.words.drives)
        for number, name in enumerate(names):
            if number != axis and self.has(name) and np.any(self.table.columns[name] != 0):
                raise self.refuse(
                    f"must be zero where `drive_axis` is {'xy'[axis]}, as one electrode is driven at a time", name
                )
        name = names[axis]
        return self._positive(name, self._force(name)) if self.has(name) else None

    def forces(self) -> np.ndarray:
        """(n, axes) raw inputs; an electrode without a column is not driven."""
        names = self._used(self.words.forces)
        if not any(map(self.has, names)):
            raise self.refuse(f"must have an input, column {_listed(names)}, but has none")
        still = np.zeros(len(self.table.lines))
        return np.stack([self._force(name) if self.has(name) else still for name in names], axis=1)

    @property
    def recorded(self) -> tuple[bool, ...]:
        """Which channels the file holds; all where it has none that is known, which is told when they are read."""
        ends, names = ("", "_I", "_Q", "_amp", "_phase"), self.words.signals[0]
        found = tuple(any(self.has(name + end) for end in ends) for name in names)
        return found if any(found) else (True,) * len(names)

    def signals(self) -> np.ndarray:
        """(n, channels) real readings; zero where a channel was not recorded."""
        return self._signed(self._stacked([(name,) for name in self._used(self.words.signals)], self._reading))

    def phasors(self) -> np.ndarray:
        """(n, channels) complex readings, from I and Q or from amplitude and phase; zero where a channel was not
        recorded.
        """
        named, polar = (
            self._pairs(("_I", "_Q"), self.words.pairs),
            self._pairs(("_amp", "_phase"), self.words.amplitudes),
        )
        if (angled := any(map(self.has, sum(polar, ())))) and any(map(self.has, sum(named, ()))):
            raise self.refuse("must have either I and Q or amplitude and phase, but has some of both")
        return self._signed(self._stacked(*((polar, self._polar) if angled else (named, self._cartesian))))

    @property
    def has_phase(self) -> bool:
        """Whether phasors are more than amplitudes."""
        named, polar = (
            self._pairs(("_I", "_Q"), self.words.pairs),
            self._pairs(("_amp", "_phase"), self.words.amplitudes),
        )
        angled = [*sum(named, ()), *(phase for _, phase in polar)]
        return any(map(self.has, angled)) or not any(self.has(first) for first, _ in polar)

    def amplitudes(self) -> np.ndarray:
        """(n, channels) amplitudes without a phase; zero where a channel was not recorded."""
        names = [(first,) for first, _ in self._pairs(("_amp", "_phase"), self.words.amplitudes)]
        return self._stacked(names, self._amplitude)

    def noise(self) -> np.ndarray | None:
        """(n, channels) standard deviation of each real reading, from columns `x_std` or `std`; `None` without one."""
        names = self._used((*(tuple(name + "_std" for name in group) for group in self.words.signals), ("std",)))
        if not any(map(self.has, names)):
            return None
        channels, one = self.recorded, len(names) == 1
        found = [self._positive(n, self._reading(n)) for n, seen in zip(names, channels, strict=False) if one or seen]
        each = iter(found * len(channels) if one else found)
        return np.stack([next(each) if seen else found[0] for seen in channels], axis=1)

    def refuse_others(self, known: Iterable[str]) -> None:
        """Keeps columns that this kind of experiment does not know in `others`, and refuses those that may be the
        misspelt name of one that it does, unless they are declared as carried along.
        """
        known = [*known, *self.signal_names("_std"), "std"]
        for name, values in self.table.columns.items():
            if name in known:
                continue
            if name not in self.carried and difflib.get_close_matches(name, known, n=1):
                raise self.refuse(
                    f"is not known to this kind of experiment ({suggestion(name, known)}); or list it in `carried`",
                    name,
                )
            self.others[f"{name} [{self.table.units[name]}]"] = values

    def signal_names(self, *ends: str) -> list[str]:
        """Every name a reading may have."""
        further = sum((*self.words.pairs, *self.words.amplitudes), ()) if any(ends) else ()
        return [*(name + end for group in self.words.signals for name in group for end in ends), *further]

    def _pairs(self, ends: tuple[str, str], further: tuple[tuple[str, str], ...]) -> tuple[tuple[str, str], ...]:
        """The two columns of each channel, as the file names them."""
        groups = [tuple((name + ends[0], name + ends[1]) for name in group) for group in self.words.signals]
        names = self._used(tuple(sum(group, ()) for group in (*groups, *((pair,) for pair in further))))
        return tuple(zip(names[::2], names[1::2], strict=True))

    def _stacked(self, names: Sequence[tuple[str, ...]], read: Callable[..., np.ndarray]) -> np.ndarray:
        """What `read` makes of the columns of each channel (n, channels)."""
        none = np.zeros(len(self.table.lines))
        return np.stack(
            [read(*some) if seen else none for some, seen in zip(names, self.recorded, strict=True)], axis=1
        )

    def _signed(self, readings: np.ndarray) -> np.ndarray:
        readings = np.conj(readings) if self.conjugated else readings
        return -readings if self.inverted else readings

    def _force(self, name: str) -> np.ndarray:
        if self.drives is not None and self.drives.scale:
            return self.si(name, self.drives.unit) * self.drives.scale
        return self.si(name, self.words.force)

    def _used(self, groups: tuple[tuple[str, ...], ...], ends: tuple[str, ...] = ("",)) -> tuple[str, ...]:
        """The group of names that the file uses; the first where it uses none."""
        used = [group for group in groups if any(self.has(name + end) for name in group for end in ends)]
        if len(used) > 1:
            raise self.refuse(
                f"must name its columns in one way, but has both {_listed(used[0])} and {_listed(used[1])}"
            )
        return used[0] if used else groups[0]

    def _need(self, name: str) -> None:
        if not self.has(name):
            found = ", ".join(f"`{column}`" for column in self.table.columns)
            raise self.refuse(f"must have the column `{name}`, but has {found}")

    def _positive(self, name: str, values: np.ndarray, words: str = "positive") -> np.ndarray:
        wrong = ~((values > 0) & np.isfinite(values))
        if np.any(wrong):
            raise self.table.at(int(np.argmax(wrong)), name, f"must be {words}")
        return values

    def _reading(self, name: str) -> np.ndarray:
        self._need(name)
        if re.fullmatch(r"(dB|Np|B|neper|bel|decibel)\w*", self.table.units[name]):
            raise self.refuse(
                f'must be in a linear unit such as "{self.unit}", but is in {self.table.units[name]}; convert it', name
            )
        return self.si(name, self.unit)

    def _cartesian(self, first: str, second: str) -> np.ndarray:
        return self._reading(first) + 1j * self._reading(second)

    def _amplitude(self, name: str) -> np.ndarray:
        amplitude = self._reading(name)
        negative = amplitude < 0
        if np.any(negative):
            raise self.table.at(int(np.argmax(negative)), name, "must be an amplitude, zero or more")
        return amplitude

    def _polar(self, first: str, second: str) -> np.ndarray:
        amplitude, phase = self._amplitude(first), self.si(second, "rad")
        if np.ptp(phase) > 12 * np.pi:
            raise self.refuse(
                f"must turn by a few half turns at most, but covers {np.ptp(phase):.0f} rad; is it in degrees?",
                second,
            )
        return amplitude * np.exp(1j * phase)


def _listed(names: Iterable[str]) -> str:
    return " or ".join(f"`{name}`" for name in names)


def signal_columns(signals: np.ndarray, declared: Declared, seen: Iterable[int] = (0, 1)) -> dict[str, np.ndarray]:
    """Real readings (n, channels) as a file has them, those that were recorded: header to column."""
    names = declared.words.signals[0]
    return {f"{name} [{declared.readout.unit}]": signals[:, c] for c, name in enumerate(names) if c in seen}


def force_columns(forces: np.ndarray, declared: Declared) -> dict[str, np.ndarray]:
    """Raw inputs (n, axes) as a file has them: header to column."""
    words = declared.words
    return {f"{name} [{words.force}]": forces[:, axis] for axis, name in enumerate(words.forces[0])}


def phasor_columns(phasors: np.ndarray, declared: Declared, seen: Iterable[int] = (0, 1)) -> dict[str, np.ndarray]:
    """Complex readings (n, channels) as I and Q, those that were recorded: header to column."""
    return {
        header.replace(" [", f"_{end} ["): part
        for header, value in signal_columns(phasors, declared, seen).items()
        for end, part in (("I", value.real), ("Q", value.imag))
    }


def amplitude_columns(phasors: np.ndarray, declared: Declared, seen: Iterable[int] = (0, 1)) -> dict[str, np.ndarray]:
    """Amplitudes (n, channels) without a phase, those that were recorded: header to column."""
    values = signal_columns(np.abs(phasors), declared, seen)
    return {header.replace(" [", "_amp ["): value for header, value in values.items()}
