"""The candidates of a search as a diagnosis lists them."""

import numpy as np
from scipy import special

from memsgyro_jax.measurement.calibration import unit_of_records
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.model import Model

from .acceptance import excess
from .climb import Climb
from .findings import SIGMAS_SEEN, Candidate
from .search import Ranking


def followed_candidates(case: Case, climb: Climb, count: int) -> tuple[Candidate, ...]:
    """What a climb tried, out of so many candidates, beside the base model of the lowest drive."""
    chi2, missing = climb.base.optimum.chi2, excess(climb.base.optimum)
    return tuple(
        Candidate(
            label=effect.label,
            unit=unit_of_records(case, effect.unit),
            score=chi2 - left,
            p_value=min(1.0, count * float(special.chdtrc(effect.strength.size, max(0.0, chi2 - left)))),
            explained_share=(chi2 - left) / missing,
            kept_share=np.nan,
            smallest_visible=np.nan,
            excited=True,
        )
        for effect, left in climb.ends
    )


def listed_candidates(case: Case, model: Model, ranking: Ranking, *, powers: bool = True) -> tuple[Candidate, ...]:
    """The candidates, best first; what each would have to be to be found, `powers`, is told by a model that explains
    the records alone.
    """
    out = []
    for i in ranking.order:
        effect, mine = model.effects[ranking.places[i]], ranking.scores[i]
        out.append(
            Candidate(
                label=effect.label,
                unit=unit_of_records(case, effect.unit),
                score=mine.statistic,
                p_value=float(ranking.p_values[i]),
                explained_share=mine.share,
                kept_share=mine.kept,
                smallest_visible=mine.visible(SIGMAS_SEEN) if powers else np.nan,
                excited=mine.size > 0,
            )
        )
    return tuple(out)
