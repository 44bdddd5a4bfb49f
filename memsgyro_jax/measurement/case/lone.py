"""Rows that stand alone among their neighbours: wrong digits, or a resonance too narrow for the rows of its sweep."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..experiments import AbstractRecord
from ..narrow_peak import is_narrow_peak
from ..outliers import excursions, lone_rows


_SEEN = 3  # rows above half of a peak that show a resonance
_NARROW = 3.0  # steps of a sweep: a resonance of more, at half of its peak, is seen as a curve


@dataclass(frozen=True, eq=False)
class _Course:
    """A column over the rows of a single sweep, or of a record in time.

    Args:
        record, piece: number of the record, and of the sweep within it.
        name: of the column.
        place: (n,) frequency [rad/s], or whatever the rows run over.
        values: (n,) real or complex.
        noise: standard deviation of each real number.
        lines: (n,) in the file.
        over_frequency: whether the rows run over frequency.
    """

    record: int
    piece: int
    name: str
    place: np.ndarray
    values: np.ndarray
    noise: float
    lines: np.ndarray
    over_frequency: bool

    @cached_property
    def resonance(self) -> tuple[float, float] | None:
        """Between which frequencies [rad/s] the readings exceed half of the largest, if some rows do and it is not at
        an end.
        """
        size = np.abs(self.values)
        top = int(np.argmax(size))
        below = np.flatnonzero(size <= 0.5 * size[top])
        before, after = below[below < top], below[below > top]
        if not before.size or not after.size or after[0] - before[-1] <= _SEEN:
            return None
        low, high = sorted((float(self.place[before[-1]]), float(self.place[after[0]])))
        return low, high

    @cached_property
    def excursions(self) -> np.ndarray:
        """Places of the rows that lie far off their neighbours, alone or not."""
        return self.place[excursions(self.place, self.values, self.noise)]

    def step(self, row: int) -> float:
        """The larger step to a neighbour of a row."""
        return float(np.max(np.abs(np.diff(self.place[max(row - 1, 0) : row + 2]))))


def lone_sentences(records: Sequence[AbstractRecord]) -> list[list[str]]:
    """Of each record a sentence for each row that stands alone among its neighbours.

    None where a resonance explains it of which the sweep has a row or two: one whose flanks stand beside it, one that
    another channel, sweep or record shows there, or that leaves other sweeps off their neighbours at its frequency.
    """
    said: list[list[str]] = [[] for _ in records]
    for course, row, sigmas in _lone(records):
        said[course.record].append(
            f"{records[course.record].file}, line {course.lines[row]}: {course.name} lies {_far(sigmas)} off "
            "its neighbours; is a digit wrong?"
        )
    return said


def lone_readings(records: Sequence[AbstractRecord]) -> dict[int, tuple[int, ...]]:
    """Rows of each record, by its number, in which `lone_sentences` names a channel."""
    found: dict[int, set[int]] = {}
    for course, row, _ in _lone(records):
        if course.name.startswith("channel"):
            at = int(np.flatnonzero(records[course.record].lines == course.lines[row])[0])
            found.setdefault(course.record, set()).add(at)
    return {number: tuple(sorted(rows)) for number, rows in found.items()}


def _lone(records: Sequence[AbstractRecord]) -> Iterator[tuple[_Course, int, float]]:
    """Every row that stands alone, and by how many standard deviations."""
    courses = [
        _Course(
            number, piece, column.name, column.place[rows], column.values[rows], column.noise, record.lines[rows],
            column.over_frequency,
        )
        for number, record in enumerate(records)
        for column in record.watched(record.noise_levels)
        for piece, rows in enumerate(column.pieces)
    ]  # fmt: skip
    for course in courses:
        for row, sigmas in lone_rows(course.place, course.values, course.noise):
            if not _of_a_resonance(course, row, courses):
                yield course, row, sigmas


def _of_a_resonance(course: _Course, row: int, courses: Sequence[_Course]) -> bool:
    if not course.over_frequency:
        return False
    if is_narrow_peak(course.place, course.values, row):
        return True
    place, step = course.place[row], course.step(row)
    others = [other for other in courses if other.over_frequency and other is not course]
    shown = [other.resonance for other in others if other.resonance]
    if any(low - step <= place <= high + step and high - low <= _NARROW * step for low, high in shown):
        return True
    apart = [other for other in others if (other.record, other.piece) != (course.record, course.piece)]
    return any(bool(np.any(np.abs(other.excursions - place) <= 0.5 * step)) for other in apart)


def _far(sigmas: float) -> str:
    return f"{sigmas:.0f} standard deviations" if np.isfinite(sigmas) else "far"
