"""Which rows of a case may share a number of the instrument: by record, single sweep, drive level, or clock."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.measurement.case import AbstractRecord, Case


Place = tuple[int, int]  # record, and single sweep within it


@dataclass(frozen=True)
class RowGroups:
    """Groups of rows that may share a number, each a set of places."""

    shape: tuple[int, int]
    records: list[set[Place]]
    sweeps: list[set[Place]]
    levels: list[set[Place]]
    phasor: list[set[Place]]
    turned: list[set[Place]]
    swept: list[set[Place]]
    clocked: list[set[Place]]
    hasty: list[set[Place]]
    unsettled: list[set[Place]]
    clock: dict[str, np.ndarray]

    @classmethod
    def of(cls, case: Case) -> "RowGroups":
        pieces = [getattr(record, "sweeps", (slice(None),)) for record in case.records]
        places = [[(number, sweep) for sweep in range(len(p))] for number, p in enumerate(pieces)]
        phasor = [np.iscomplexobj(record.readings) for record in case.records]
        times = [time_of(record) for record in case.records]
        clocked = [t is not None and wave for t, wave in zip(times, phasor, strict=True)]
        timed = [set(own) for own, mine in zip(places, clocked, strict=True) if mine]
        stepped = [
            (getattr(record, "settled", True), set(own))
            for record, own, mine in zip(case.records, places, clocked, strict=True)
            if mine and record.stepped
        ]
        levels: dict[tuple, set[Place]] = {}
        for (record, rows), own in zip(zip(case.records, pieces, strict=True), places, strict=True):
            for piece, place in zip(rows, own, strict=True):
                levels.setdefault((record.name, _level(record, piece)), set()).add(place)
        return cls(
            (len(places), max(map(len, places))),
            [set(own) for own in places],
            [{place} for own in places for place in own],
            list(levels.values()),
            [set(own) for own, wave in zip(places, phasor, strict=True) if wave],
            [set(own) for own, wave, r in zip(places, phasor, case.records, strict=True) if wave and r.driven],
            [set(own) for own, wave, r in zip(places, phasor, case.records, strict=True) if wave and r.stepped],
            timed,
            together([own for settled, own in stepped if settled]),
            together([own for settled, own in stepped if not settled]),
            {
                "begin": np.array([0.0 if t is None else t[0] for t in times]),
                "span": np.array([1.0 if t is None else t[-1] - t[0] for t in times]),
            },
        )

    @property
    def one_clock(self) -> list[set[Place]]:
        """The same where there are several records."""
        return self.in_turn if len(self.clocked) > 1 else []

    @property
    def in_turn(self) -> list[set[Place]]:
        """All places with a clock as one group, where each record begins after another ended."""
        timed = [{place[0] for place in group}.pop() for group in self.clocked]
        begin, span = (self.clock[of][timed] for of in ("begin", "span"))
        order = np.argsort(begin)
        follow = np.all(begin[order][1:] >= (begin + span)[order][:-1])
        return together(self.clocked) if follow else []

    @property
    def whole(self) -> dict[str, np.ndarray]:
        """The clock of all records together."""
        timed = [{place[0] for place in group}.pop() for group in self.clocked]
        begin, span = (self.clock[of] for of in ("begin", "span"))
        first = min(begin[timed], default=0.0)
        last = max((begin + span)[timed], default=1.0)
        return {"begin": np.full(begin.shape, first), "span": np.full(begin.shape, last - first)}

    def table(self, groups: Sequence[set[Place]]) -> np.ndarray:
        """Which number a row takes (records, sweeps, k)."""
        out = np.zeros((*self.shape, len(groups)))
        for k, group in enumerate(groups):
            for place in group:
                out[(*place, k)] = 1.0
        return out


def together(groups: Sequence[set[Place]]) -> list[set[Place]]:
    """All places as one group; none where there is none."""
    return [set().union(*groups)] if groups else []


def _level(record: AbstractRecord, piece: slice) -> float:
    """The drive level of a single sweep; records without levels have one."""
    drive = getattr(record, "setting", None)
    return 0.0 if drive is None else float(np.mean(drive[piece]))


def time_of(record: AbstractRecord) -> np.ndarray | None:
    """The clock of the rows of a record [s]; `None` where it has none that runs."""
    time = getattr(record, "time", None)
    return time if time is not None and len(time) > 1 and time[-1] > time[0] else None
