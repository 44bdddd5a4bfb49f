"""A record beside a model: what is tested for a misfit, and what is drawn.

A kind of measurement says here which of its rows belong together and what a misfit may depend on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from memsgyro_jax.base.text import spoken

from ..declared import Declared
from ..model import Model
from .base import Readings


SEGMENTS = 8  # of the time of a record
SETTINGS = 24  # at most, to judge each on its own
_NEAR = 2.0  # full widths of a resonance that count as "at" it


@dataclass(frozen=True, eq=False)
class Deviation:
    """How far a record lies from a model.

    Args:
        model: as fitted, or as it was given.
        declared: of the device.
        number: of the record in its case, as `readings` count it.
        white: (n, channels, parts) deviation over noise, I and Q or one real part; NaN for rows not compared.
        predicted: (n, channels) in the unit of the record.
        readings: in which the record's rows were compared.
    """

    model: Model
    declared: Declared
    number: int
    white: np.ndarray
    predicted: np.ndarray
    readings: tuple[Readings, ...]

    @property
    def seen(self) -> np.ndarray:
        """Which rows are compared (n,)."""
        return np.isfinite(self.white).any(axis=(1, 2))

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels."""
        return ("x", "y")[: self.model.axes]

    def motion(self, period: float) -> np.ndarray:
        """Displacement (n, axes) [m] that a predicted waveform stands for; one that is read by a derivative is
        integrated, and its mean and slope, which nothing shows, are left out.
        """
        seen = (self.predicted - np.asarray(self.model.offset)) / np.asarray(self.model.scale)
        if self.model.order == 0:
            return seen
        from scipy.integrate import cumulative_trapezoid
        from scipy.signal import detrend

        for _ in range(self.model.order):
            seen = detrend(cumulative_trapezoid(seen, dx=period, axis=0, initial=0), axis=0)
        return seen

    @property
    def size(self) -> np.ndarray:
        """(n, channels) root mean square over the parts of each reading."""
        return np.sqrt(np.mean(self.white**2, axis=-1))


@dataclass(frozen=True, eq=False)
class Subset:
    """Some rows of a record.

    Args:
        heading: what they share, e.g. "drive".
        label: its value for people, e.g. "150 nN".
        rows: (n,) which rows.
    """

    heading: str
    label: str
    rows: np.ndarray


@dataclass(frozen=True, eq=False)
class Band:
    """A band of the residual's spectrum, for records with a clock; `low` and `high` in cycles per row, 0 to 0.5."""

    label: str
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Variable:
    """Something that the residual may depend on: name and values (n,)."""

    name: str
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Known:
    """What was set or known about every row.

    Args:
        name: for people, e.g. "bias voltage".
        values: (n,).
        unit: SI.
        set: whether it was held at few values, each of which may be judged on its own.
    """

    name: str
    values: np.ndarray
    unit: str
    set: bool = True


@dataclass(frozen=True, eq=False)
class Series:
    """The whitened residual of one record and what is known about its rows.

    Args:
        record: its name.
        channels: names of the channels.
        white: (n, channels, parts) deviation over noise, in the order of the rows; NaN where not compared.
        turned: the same with each phasor's parts in phase with displacement and with velocity; `white` for signals.
        pieces: rows that follow each other, one slice per sweep; none where rows have no order.
        parts: rows to judge together.
        bands: bands of the spectrum to judge.
        variables: what the residual may depend on.
    """

    record: str
    channels: tuple[str, ...]
    white: np.ndarray
    turned: np.ndarray
    pieces: tuple[slice, ...]
    parts: tuple[Subset, ...] = ()
    bands: tuple[Band, ...] = ()
    variables: tuple[Variable, ...] = ()

    @property
    def compared(self) -> "Series":
        """The same without channels that were not recorded."""
        seen = np.flatnonzero(np.isfinite(self.white).any(axis=(0, 2)))
        names = tuple(self.channels[k] for k in seen)
        return replace(self, channels=names, white=self.white[:, seen], turned=self.turned[:, seen])


@dataclass(frozen=True, eq=False)
class View:
    """One column of a picture of a record.

    Args:
        channel: that is shown.
        heading: of the abscissa, with its unit.
        across: (n,) the abscissa.
        rows: that are shown, as an index into (n,).
        curves: rows of each curve of readings, from left to right; none shows the residual alone, smoothed.
        near: whether it is a close-up of where the base model is worst.
    """

    channel: int
    heading: str
    across: np.ndarray
    rows: np.ndarray | slice
    curves: tuple[np.ndarray, ...] = ()
    near: bool = False


@dataclass(frozen=True, eq=False)
class Overlay:
    """The picture of a record between two models, as data: a caption without the record's name, and its columns."""

    caption: str
    views: tuple[View, ...]


def in_phase(white: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Residual phasors (n, channels, 2) turned by the predicted phase: in phase with displacement, with velocity."""
    size = np.abs(predicted)
    unit = np.where(size > 0, predicted, 1.0) / np.where(size > 0, size, 1.0)
    error = (white[..., 0] + 1j * white[..., 1]) * unit.conj()
    return np.stack([error.real, error.imag], axis=-1)


def by_setting(known: Known, pieces: Sequence[slice]) -> list[Subset]:
    """The rows at each setting of a condition, none where all rows agree; pieces of one setting stand together."""
    digits = 3 if known.unit in ("K", "rad/s") else 4
    labels = np.empty(len(known.values), dtype=object)
    for piece in pieces if len(pieces) > 1 else [slice(i, i + 1) for i in range(len(labels))]:
        labels[piece] = spoken(float(np.mean(known.values[piece])), known.unit, digits)
    found = list(dict.fromkeys(labels))
    return [Subset(known.name, label, labels == label) for label in found] if 1 < len(found) <= SETTINGS else []


def segments(time: np.ndarray) -> tuple[Subset, ...]:
    """Equal segments of the time of a record."""
    place = np.minimum(SEGMENTS * np.arange(len(time)) // max(len(time), 1), SEGMENTS - 1)
    span: Callable[[np.ndarray], str] = lambda t: f"{spoken(t[0], 's', 3)} to {spoken(t[-1], 's', 3)}"  # noqa: E731
    return tuple(Subset("time", span(time[place == k]), place == k) for k in range(SEGMENTS) if np.any(place == k))


def around_modes(frequency: np.ndarray, deviation: Deviation) -> tuple[Subset, ...]:
    """Rows below, at, between and above the resonances of the model."""
    device = deviation.model.device
    modes, width = device.resonances(), float(np.max(np.diag(np.asarray(device.damping_matrix))))
    at = np.min(np.abs(frequency[:, None] - modes), axis=1) <= _NEAR * width
    below, above = frequency < modes[0], frequency > modes[-1]
    parts = (
        ("below resonance", below & ~at),
        ("at resonance", at),
        ("between the resonances", ~(at | below | above)),
        ("above resonance", above & ~at),
    )
    return tuple(Subset("frequency", label, rows) for label, rows in parts if rows.any() and not rows.all())
