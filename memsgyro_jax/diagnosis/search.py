"""The search for missing effects: rank candidates by their scores, refit the best, keep what helps, until nothing does.

One model carries every candidate at strength zero, so that one set of compiled programs serves all scores and refits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from .fit import CaseFit, beside_case
from .joint_residual import Joint
from .optimum import Optimum, optimise
from .score import Score, basis, family_p_values, overlap, score, within_bounds


LOOK_AHEAD = 3  # candidates that are refitted before one is chosen
WORTH_A_LOOK = 0.5  # of the best score: below it a candidate is not refitted
TWINS = 0.999  # overlap from which two candidates cannot both be tried
NOTHING = 0.01  # of what a candidate explains: if no more is left, the others need not be refitted
ROUNDS = 8
NUDGE = 1e-9  # of the base parameters
GLANCE, LONG = 5, 30  # evaluations to compare candidates, and to settle on one


@dataclass(frozen=True, eq=False)
class Ranking:
    """Scores of all candidates that are not in the model yet, their family-wise p-values, and their sensitivities."""

    places: tuple[int, ...]
    scores: tuple[Score, ...]
    p_values: np.ndarray
    slopes: tuple[np.ndarray, ...]

    @property
    def order(self) -> list[int]:
        """Positions in this ranking, the most significant first; among equals the catalogue decides."""
        return sorted(range(len(self.places)), key=lambda i: (self.scores[i].p_value, -self.scores[i].statistic, i))


@dataclass(frozen=True, eq=False)
class SearchStep:
    """What one round added (its label) and where the fit stood afterwards."""

    added: str
    fit: CaseFit


class Search:
    """State of a search; `accepted` and `given` are places of effects in the model's tuple: those it found, and those
    that the model had from the beginning.
    """

    def __init__(self, base: CaseFit, level: float, given: Sequence[int], tell: Callable[[str], None]):
        self.case, self.joint, self.level, self.tell, self.given = base.case, base.joint, level, tell, tuple(given)
        self.optimum, self.base = base.optimum, base
        self.accepted: list[int] = []
        self.unseen: frozenset[int] | None = None
        self.steps = [SearchStep("", base)]

    def candidates(self) -> list[int]:
        """Effects that are not in the model yet."""
        return [i for i in range(len(self.joint.model.effects)) if i not in (*self.given, *self.accepted)]

    def rank(self) -> Ranking:
        """Scores at the present optimum."""
        places = self.candidates()
        blocks = [self.joint.of_effect(i) for i in places]
        columns = np.concatenate(blocks)
        slopes = self._slopes(columns)
        parts = np.split(slopes, np.cumsum([block.size for block in blocks])[:-1], axis=1)
        q = basis(self.optimum.jacobian)
        low, high = self.joint.bounds
        residual, bounds = self.optimum.residual, [(low[block], high[block]) for block in blocks]
        scores = [within_bounds(score(residual, q, s), residual, s, *b) for s, b in zip(parts, bounds, strict=True)]
        return Ranking(tuple(places), tuple(scores), family_p_values(scores), tuple(parts))

    def _slopes(self, columns: np.ndarray) -> np.ndarray:
        """Sensitivities (r, k) to some parameters; zero where they are rounding, which a fit would blow up to any size.

        Rounding is told by moving the base in its ninth digit: a true sensitivity stays what it was. Which parameters
        the records cannot see at all does not change in a search, so once is enough.
        """
        units = np.eye(self.joint.start.size)[columns]
        _, slopes = self.joint.linearise(self.optimum.vector, units, self.joint.fitted)
        if self.unseen is None:
            moved = self.optimum.vector.copy()
            moved[self.joint.base()] *= 1.0 + NUDGE
            _, again = self.joint.linearise(moved, units, self.joint.fitted)
            rounding = np.linalg.norm(slopes - again, axis=0) > 0.1 * np.linalg.norm(slopes, axis=0)
            self.unseen = frozenset(columns[rounding].tolist())
        sure = ~np.isin(columns, list(self.unseen))
        return np.where(np.isfinite(slopes) & sure, slopes, 0.0)

    def refit(
        self,
        places: Sequence[int],
        *,
        start: np.ndarray | None = None,
        slopes: np.ndarray | None = None,
        evaluations: int = LONG,
    ) -> Optimum:
        """Base and the effects at `places` free, from the present optimum or the vector `start`; `slopes` are the
        sensitivities of the last of them at the present optimum, if known.
        """
        free, known = always_free(self.joint, (*self.given, *places)), None
        if slopes is not None:
            jacobian = np.zeros((self.optimum.residual.size, self.joint.start.size))
            jacobian[:, self.optimum.free] = self.optimum.jacobian
            jacobian[:, self.joint.of_effect(places[-1])] = slopes
            known = self.optimum.residual, jacobian[:, free]
        begin = self.optimum.vector if start is None else start
        return optimise(self.joint, begin, free, self.joint.fitted, known=known, max_evaluations=evaluations)

    def without(self, place: int) -> np.ndarray:
        """The present parameters with the strength of one effect zero."""
        vector = self.optimum.vector.copy()
        vector[self.joint.of_effect(place)] = 0.0
        return vector

    def advance(self, ranking: Ranking) -> bool:
        """One round: add the best significant candidate, if there is one."""
        if not ranking.places or ranking.p_values[ranking.order[0]] > self.level:
            return False
        promising = [self.first_twin(ranking)]
        for i in ranking.order:
            worth = ranking.scores[i].statistic >= WORTH_A_LOOK * ranking.scores[promising[0]].statistic
            news = all(overlap(ranking.scores[i], ranking.scores[j]) < TWINS for j in promising)
            if worth and news and ranking.p_values[i] <= self.level and len(promising) < LOOK_AHEAD:
                promising.append(i)
        labels = [self.joint.model.effects[ranking.places[i]].label for i in promising]
        self.tell("look closer at " + ", ".join(labels))
        refits: list[Optimum] = []
        for i in promising:
            evaluations = GLANCE if len(promising) > 1 else LONG
            places = [*self.accepted, ranking.places[i]]
            refits.append(self.refit(places, slopes=ranking.slopes[i], evaluations=evaluations))
            if self._explains_all(refits[-1]):  # no other can do much better
                break
        best = int(np.argmin([o.chi2 for o in refits]))
        place, chosen = ranking.places[promising[best]], refits[best]
        if chosen.chi2 >= self.optimum.chi2:
            return False
        if not chosen.converged:
            chosen = self.refit([*self.accepted, place], start=chosen.vector)
        self.take(place, chosen)
        return True

    def _explains_all(self, refit: Optimum) -> bool:
        """Whether what a refit leaves above the least that noise could leave is next to nothing of what it explains."""
        dof = refit.residual.size - refit.free.size
        least = dof - 3.0 * np.sqrt(2.0 * dof)
        return refit.chi2 - least <= NOTHING * (self.optimum.chi2 - refit.chi2)

    def first_twin(self, ranking: Ranking) -> int:
        """The best candidate, or the one that stands first in the catalogue of those that explain the same."""
        best = ranking.order[0]
        same = [
            i
            for i, mine in enumerate(ranking.scores)
            if mine.size == ranking.scores[best].size and overlap(mine, ranking.scores[best]) >= TWINS
        ]
        return min([best, *same])

    def take(self, place: int, optimum: Optimum) -> None:
        """Add an effect to the model."""
        self.accepted.append(place)
        self.optimum = optimum
        self.steps.append(
            SearchStep(self.joint.model.effects[place].label, beside_case(self.case, self.joint, optimum))
        )
        self.tell(f"added {self.joint.model.effects[place].label}: χ²/dof {self.steps[-1].fit.chi2_per_dof:.4g}")

    def prune(self) -> None:
        """Drop effects that the final model no longer needs: taken early, while the misfit was large.

        Wald's test only proposes: far from zero a strength may be imitated by others that could not do without it.
        """
        alone = self.level / max(1, len(self.joint.model.effects))
        proposed = {i: self.own_score(i) for i in self.accepted}
        for place, mine in sorted(proposed.items(), key=lambda pair: -pair[1].p_value):
            if len(self.accepted) == 1 or self.own_score(place).p_value <= alone:
                continue
            fewer = self.refit([i for i in self.accepted if i != place], start=self.without(place))
            if stats.chi2.sf(fewer.chi2 - self.optimum.chi2, max(1, mine.size)) <= alone:
                continue
            self.optimum = fewer
            self.accepted.remove(place)
            label = self.joint.model.effects[place].label
            self.tell(f"dropped {label}, which the others explain")
            self.steps.append(SearchStep(f"without {label}", beside_case(self.case, self.joint, self.optimum)))

    def own_score(self, place: int) -> Score:
        """Score of an accepted effect beside everything else that is free: its Wald statistic.

        Its further numbers are held: without the effect there are none.
        """
        mine = np.isin(self.optimum.free, self.joint.of_effect(place))
        explained = self.optimum.jacobian[:, mine] @ self.optimum.vector[self.optimum.free[mine]]
        return score(explained, basis(self.jacobian_without(place)), self.optimum.jacobian[:, mine])

    def jacobian_without(self, place: int) -> np.ndarray:
        """Sensitivities of everything free but one effect."""
        mine = np.concatenate([self.joint.of_effect(place), self.joint.numbers_of(place)])
        return self.optimum.jacobian[:, ~np.isin(self.optimum.free, mine)]

    def run(self, ranking: Ranking | None = None) -> Ranking:
        """Rounds until nothing is significant, from a ranking of the present model; returns that of the last one."""
        ranking = self.rank() if ranking is None else ranking
        for _ in range(ROUNDS):
            if not self.advance(ranking):
                break
            ranking = self.rank()
        before = len(self.accepted)
        self.prune()
        return ranking if before == len(self.accepted) else self.rank()

    def grown(self, joint: Joint, place: int, gain: float) -> "Search | None":
        """This search with a larger model whose effect at `place` is new; None unless χ² falls by `gain`."""
        free = always_free(joint, (*self.given, *self.accepted, place))
        optimum = optimise(joint, joint.start, free, joint.fitted)
        if optimum.chi2 >= self.optimum.chi2 - gain:
            return None
        # A frequency and its width are found in a narrow valley: again from within it, to its end.
        optimum = optimise(joint, optimum.vector, free, joint.fitted)
        out = Search(self.steps[-1].fit, self.level, self.given, self.tell)
        out.joint, out.accepted = joint, list(self.accepted)
        out.take(place, optimum)
        return out


def always_free(joint: Joint, places: Sequence[int]) -> np.ndarray:
    """Places in the vector of the base parameters and all numbers of some effects, ascending."""
    of_effects = [part for i in places for part in (joint.of_effect(i), joint.numbers_of(i))]
    return np.sort(np.concatenate([joint.base(), *of_effects]).astype(int))


def start_search(case, joint: Joint, level: float, given: Sequence[int], tell: Callable[[str], None]) -> Search:
    """Fit the base model with the effects it was given, and begin."""
    tell("fit the base model")
    optimum = optimise(joint, joint.start, always_free(joint, given), joint.fitted)
    base = beside_case(case, joint, optimum)
    tell(f"base model: χ²/dof {base.chi2_per_dof:.4g}")
    return Search(base, level, given, tell)
