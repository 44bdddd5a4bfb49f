"""Experiments that a laboratory could add to a case: the same records, driven, biased, heated or turned otherwise.

They have the shapes of records that were taken, so that the compiled programs predict them at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.experiments import Readings


@dataclass(frozen=True, eq=False)
class Proposal:
    """A feasible experiment: what to do, and its readings as they would be predicted."""

    text: str
    readings: Readings


def plans(case: Case, readings: Sequence[Readings]) -> tuple[Proposal, ...]:
    """Feasible experiments, the least effort first, as the kinds of the fitted readings propose them."""
    return tuple(
        Proposal(text, replace(taken, experiment=other))
        for taken in readings
        if taken.fitted
        for text, other in taken.experiment.proposals(case.records[int(taken.record[0])].name)
    )
