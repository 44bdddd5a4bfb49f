"""What is told of the effects that a search ends with."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from memsgyro_jax.effects.section import settings_of
from memsgyro_jax.measurement.calibration import calibration_share, unit_of_records

from .findings import Accepted
from .fitted import at_bounds
from .result import validation_error
from .search import Search, SearchStep


def accepted_of(
    search: Search, confused: Mapping[int, Iterable[int]], steps: Sequence[SearchStep]
) -> tuple[Accepted, ...]:
    """Effects that a search ends with, by their places in the model, those that explain most first.

    Args:
        search: with them free.
        confused: by the place of an effect, those of others that the records cannot tell from it.
        steps: how the search came there.
    """
    out = []
    labels = [s.added for s in steps]
    for place in confused:
        effect = search.joint.model.effects[place]
        mine = search.own_score(place)
        at = search.joint.of_effect(place)
        where = labels.index(effect.label) if effect.label in labels else len(steps) - 1
        out.append(
            Accepted(
                name=effect.name,
                where=effect.where,
                estimate=tuple(search.optimum.vector[at].tolist()),
                std=tuple(search.optimum.std[np.isin(search.optimum.free, at)].tolist()),
                stopped=at_bounds(search.optimum.vector, search.joint.bounds, at.tolist()),
                unit=unit_of_records(search.case, effect.unit),
                p_value=mine.p_value,
                error_before=validation_error(steps[max(where - 1, 0)].fit),
                error_after=validation_error(steps[where].fit),
                confused_with=tuple(search.joint.model.effects[i].label for i in confused[place]),
                numbers=_numbers(search, place),
                calibration=calibration_share(search.case, effect.unit),
                chi2=mine.statistic,
            )
        )
    return tuple(sorted(out, key=lambda a: -a.chi2))


def _numbers(search: Search, place: int) -> dict[str, tuple[float, float, str]]:
    """Further numbers of an accepted effect: value, standard deviation, unit; of a term of the instrument those that
    were set as well, without a standard deviation.
    """
    std = dict(zip(search.optimum.free.tolist(), search.optimum.std.tolist(), strict=True))
    effect = search.joint.model.effects[place]
    held = settings_of(effect) if effect.of_instrument else ()
    found = {name: (float(getattr(effect, name)), np.nan, "1") for name in held}
    for i in search.joint.numbers_of(place):
        number = search.joint.parameters[i]
        found[number.field + number.index] = (
            float(search.optimum.vector[i]), std[int(i)], unit_of_records(search.case, number.unit),
        )  # fmt: skip
    return found
