"""Numbers of the instrument that act on rows of their own, by record or by sweep: one direction of a program stands for
several of them, as each row tells of which it speaks.
"""

from typing import NamedTuple, TypeGuard

import numpy as np

from memsgyro_jax.effects import Effect, InstrumentTerm
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.model import Model

from .parameters import parameters


class SideBySide(NamedTuple):
    """Directions that tell the slopes of some readings by every parameter that is asked for.

    Args:
        ways: (g, q) among the parameters of a model, several in one where no row takes more than one of them.
        lane: (q,) the direction that tells a parameter; −1 for one that moves none of these readings, or is not asked
            for.
        rows: (q, r) which numbers of the residual take a parameter.
    """

    ways: np.ndarray
    lane: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, model: Model, readings: Readings, asked: np.ndarray) -> "SideBySide":
        """Of the parameters of a model that are `asked` for (q,)."""
        rows = _taking(model, readings)
        taken: list[np.ndarray] = []  # the rows of each direction
        lane = np.full(asked.size, -1)
        for place in np.flatnonzero(asked & rows.any(axis=1)):
            free = [k for k, others in enumerate(taken) if not np.any(others & rows[place])]
            lane[place] = min(free, default=len(taken))
            taken += [] if free else [np.zeros(rows.shape[1], bool)]
            taken[lane[place]] |= rows[place]
        ways = (lane == np.arange(len(taken))[:, None]).astype(float)
        return cls(ways, lane, np.repeat(rows, readings.size // rows.shape[1], axis=1))

    def apart(self, slopes: np.ndarray) -> np.ndarray:
        """(q, r) slopes by each parameter, of those along the directions (g, r)."""
        return np.where(self.rows & (self.lane >= 0)[:, None], slopes[self.lane], 0.0)


def by_row(effect: Effect) -> TypeGuard[InstrumentTerm]:
    """Whether an effect has several numbers of which a row takes its own."""
    if not isinstance(effect, InstrumentTerm) or effect.strength.size < 2:
        return False
    return np.shape(effect.entry)[-1] == effect.strength.size


def _taking(model: Model, readings: Readings) -> np.ndarray:
    """(q, n) which rows each parameter of a model may move: of numbers by row those that take them."""
    count = readings.experiment.measured.shape[0]
    out = np.ones((len(every := parameters(model)), count), bool)
    remembers = any(getattr(effect, "remembers", False) for effect in model.effects)
    labels = None if remembers else readings.experiment.labels
    for place, effect in enumerate(model.effects):
        if by_row(effect):
            mine = [i for i, p in enumerate(every) if p.effect == place and p.field == "strength"]
            out[mine] = _taken(np.asarray(effect.entry) != 0, labels, readings)
    return out


def _taken(table: np.ndarray, labels: np.ndarray | None, readings: Readings) -> np.ndarray:
    """(k, n) which of the numbers of a table (records, sweeps, k) rows take; where one may depend on others, all rows
    those of all.
    """
    if labels is not None:
        record, sweep = (np.minimum(part, size - 1) for part, size in zip(labels.T, table.shape, strict=False))
        return table[record, sweep].T
    records = np.unique(readings.record[readings.record >= 0])
    some = table[np.minimum(records, len(table) - 1)].any(axis=(0, 1))
    return np.repeat(some[:, None], readings.experiment.measured.shape[0], axis=1)
