"""The search for missing effects: rank candidates by their scores, refit the best, keep what helps, until nothing does.

One model carries every candidate at strength zero, so that one set of compiled programs serves all scores and refits.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from .acceptance import hopeless, judged_by_misfit, refusal, unsure_noise
from .first_numbers import with_numbers_that_show
from .fit import CaseFit, beside_case
from .joint_residual import Joint
from .optimum import WHOLE, Optimum, optimise
from .score import Score, basis, family_p_values, overlap, score, within_bounds


LOOK_AHEAD = 3  # candidates that are refitted before one is chosen
WORTH_A_LOOK = 0.5  # of the best score: below it a candidate is not refitted
TWINS = 0.999  # overlap from which two candidates cannot both be tried
NOTHING = 0.01  # of what a candidate explains: if no more is left, the others need not be refitted
LOOK, INSTRUMENT = "look closer at ", "try what the instrument may have done: "  # told before names of candidates
ROUNDS = 8
GLANCE = 5  # evaluations to compare candidates
PATIENCE = 6  # refits without one that stays after which a round ends
RESTARTS = (0.3, 0.03)  # of the linear estimate of a strength
CONFUSED = 10.8  # expected Δχ² below which noise puts the wrong one of two effects first in one case of twenty


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
    that the model had from the beginning; `own` are those of the user, which go before the catalogue's.
    """

    def __init__(self, base: CaseFit, level: float, given: Sequence[int], tell: Callable[[str], None]):
        self.case, self.joint, self.level, self.tell, self.given = base.case, base.joint, level, tell, tuple(given)
        self.optimum, self.base = base.optimum, base
        self.own: tuple[int, ...] = ()
        self.looked: Mapping[str, int] = {}  # points among which the numbers of an effect were chosen
        self.keep: Callable[[Search], None] = lambda search: None  # is told of every step
        self.accepted: list[int] = []
        self.slow: Mapping[str, str] = {}  # records of which nothing is left but slow noise
        self.listened: CaseFit | None = None  # the fit at which that was looked for
        self.unseen: frozenset[int] | None = None
        self.sensitivities: tuple[Optimum, dict[int, np.ndarray]] = base.optimum, {}  # by the parameters ranked last
        self._refits: dict[tuple[int, ...], tuple[Joint, Optimum, int, Optimum]] = {}
        self.steps = [SearchStep("", base)]

    def candidates(self) -> list[int]:
        """Effects that are not in the model yet."""
        return [i for i in range(len(self.joint.model.effects)) if i not in (*self.given, *self.accepted)]

    def rank(self) -> Ranking:
        """Scores at the present optimum."""
        places = self.candidates()
        if not places:
            return Ranking((), (), np.zeros(0), ())
        blocks = [self.joint.of_effect(i) for i in places]
        columns = np.concatenate(blocks)
        slopes = self._slopes(columns)
        parts = np.split(slopes, np.cumsum([block.size for block in blocks])[:-1], axis=1)
        q = basis(self.optimum.jacobian)
        low, high = self.joint.bounds
        residual, bounds = self.optimum.residual, [(low[block], high[block]) for block in blocks]
        scores = [within_bounds(score(residual, q, s), residual, s, *b) for s, b in zip(parts, bounds, strict=True)]
        chi2, dof, unsure = self.optimum.chi2, self.optimum.dof, unsure_noise(self.case, self.joint.fitted)
        chances = [self.looked.get(self.joint.model.effects[i].label, 1) for i in places]
        scores = [
            replace(s, p_value=min(1.0, n * judged_by_misfit(s, chi2, dof, unsure)))
            for s, n in zip(scores, chances, strict=True)
        ]
        return Ranking(tuple(places), tuple(scores), family_p_values(scores), tuple(parts))

    def _slopes(self, columns: np.ndarray) -> np.ndarray:
        """Sensitivities (r, k) to some parameters; zero where they are rounding, which a fit would blow up to any size.

        Which parameters the records cannot see at all does not change in a search, so once is enough.
        """
        units = np.eye(self.joint.start.size)[columns]
        _, slopes = self.joint.linearise(self.optimum.vector, units, self.joint.fitted)
        self.sensitivities = self.optimum, dict(zip(columns.tolist(), slopes.T, strict=True))
        if self.unseen is None:
            self.unseen = frozenset(columns[self.joint.rounding(self.optimum.vector, units, slopes)].tolist())
        sure = ~np.isin(columns, list(self.unseen))
        return np.where(np.isfinite(slopes) & sure, slopes, 0.0)

    def refit(
        self,
        places: Sequence[int],
        *,
        start: np.ndarray | None = None,
        slopes: np.ndarray | None = None,
        evaluations: int = WHOLE,
        beat: float = np.inf,
    ) -> Optimum:
        """Base and the effects at `places` free, from the present optimum or the vector `start`; `slopes` are the
        sensitivities of the last of them at the present optimum, if known. One from the present optimum is made once;
        one that will not get χ² down to `beat` is given up.
        """
        kept, joint = self._refits.get(tuple(places)), self.joint
        if start is None and kept and kept[0] is joint and kept[1] is self.optimum and kept[2] >= evaluations:
            return kept[3]
        free, known = always_free(joint, (*self.given, *places)), None
        if slopes is not None:
            jacobian = np.zeros((self.optimum.residual.size, joint.start.size))
            jacobian[:, self.optimum.free] = self.optimum.jacobian
            jacobian[:, joint.of_effect(places[-1])] = slopes
            known = self.optimum.residual, jacobian[:, free]
        begin = self.optimum.vector if start is None else start
        found = optimise(joint, begin, free, joint.fitted, known=known, max_evaluations=evaluations, beat=beat)
        if start is None:
            self._refits[tuple(places)] = joint, self.optimum, WHOLE if found.converged else evaluations, found
        return found

    def without(self, place: int) -> np.ndarray:
        """The present parameters with the strength of one effect zero."""
        vector = self.optimum.vector.copy()
        vector[self.joint.of_effect(place)] = 0.0
        return vector

    def advance(self, ranking: Ranking) -> bool:
        """One round: add the best candidate that is significant and stays, if there is one."""
        found = self.best(ranking)
        if found is None:
            return False
        self.take(*found)
        return True

    def best(self, ranking: Ranking) -> tuple[int, Optimum] | None:
        """The candidate that a refit with it favours, of those that are significant and stay, and that refit.

        A user's own effect goes before others that explain as much.
        """
        weak = self._hopeless(ranking)
        refused: set[int] = set(weak)
        while len(refused) - len(weak) < PATIENCE and (promising := self._promising(ranking, refused)):
            labels = [self.joint.model.effects[ranking.places[i]].label for i in promising]
            self.tell(LOOK + ", ".join(labels))
            later = [i for i in ranking.order if ranking.p_values[i] <= self.level and i not in (*promising, *refused)]
            soon, then = ([ranking.places[i] for i in some] for some in (promising, later))
            self.joint.together((*self.given, *self.accepted, *soon), self.joint.named(then))
            refits: dict[int, Optimum] = {}
            for i in promising:
                evaluations = GLANCE if len(promising) > 1 else WHOLE
                refits[i] = self.with_one_more(ranking.places[i], ranking.slopes[i], evaluations)
                if self._explains_all(refits[i]):  # no other can do much better
                    break
            for i in sorted(refits, key=lambda i: (refits[i].chi2 - CONFUSED * (ranking.places[i] in self.own), i)):
                place, chosen = ranking.places[i], refits[i]
                if not chosen.converged:
                    chosen = self.refit([*self.accepted, place], start=chosen.vector)
                if not self.refuses(place, chosen):
                    return place, chosen
            refused |= set(refits)
        return None

    def _hopeless(self, ranking: Ranking) -> list[int]:
        """Positions of the significant candidates that explain too little to be worth a refit."""
        others = len(self.accepted)
        weak = [
            i
            for i in ranking.order
            if ranking.p_values[i] <= self.level
            and ranking.places[i] not in self.own
            and hopeless(ranking.scores[i].statistic, self.optimum, others)
        ]
        if weak:
            labels = ", ".join(self.joint.model.effects[ranking.places[i]].label for i in weak[:LOOK_AHEAD])
            more = f" and {len(weak) - LOOK_AHEAD} more" if len(weak) > LOOK_AHEAD else ""
            self.tell(f"left out {labels}{more}: too little of what is left, by the linear estimate")
        return weak

    def refuses(self, place: int, chosen: Optimum) -> bool:
        """Whether an effect does not stay, though a refit with it was made; it is told why."""
        why = refusal(self.joint, place, self.optimum, chosen, others=len(self.accepted), case=self.case)
        if why:
            self.tell(f"left out {self.joint.model.effects[place].label}: {why}")
        return bool(why)

    def with_one_more(self, place: int, slopes: np.ndarray, evaluations: int) -> Optimum:
        """A refit with one effect more, from its linear estimate; also from nearer zero where it fits worse than
        without: a larger model can only fit better.
        """
        places = [*self.accepted, place]
        found = self.refit(places, slopes=slopes, evaluations=evaluations)
        for part in RESTARTS:
            if found.chi2 < self.optimum.chi2:
                break
            start = self.optimum.vector.copy()
            mine = self.joint.of_effect(place)
            step = -np.linalg.lstsq(self._clean(slopes), self.optimum.residual)[0]
            start[mine] = np.clip(part * step, *(bound[mine] for bound in self.joint.bounds))
            again = self.refit(places, start=start, evaluations=WHOLE)
            found = again if again.chi2 < found.chi2 else found
        return found

    def _clean(self, slopes: np.ndarray) -> np.ndarray:
        """What of some sensitivities is news beside everything free."""
        q = basis(self.optimum.jacobian)
        return slopes - q @ (q.T @ slopes)

    def _promising(self, ranking: Ranking, refused: set[int]) -> list[int]:
        """Positions of the significant candidates that are worth a refit, the first the most."""
        open_ = [i for i in ranking.order if i not in refused and ranking.p_values[i] <= self.level]
        if not open_:
            return []
        promising = [first_twin(ranking, open_)]
        for i in open_:
            worth = ranking.scores[i].statistic >= WORTH_A_LOOK * ranking.scores[promising[0]].statistic
            news = all(overlap(ranking.scores[i], ranking.scores[j]) < TWINS for j in promising)
            own = ranking.places[i] in self.own
            if (own and i not in promising) or (worth and news and len(promising) < LOOK_AHEAD):
                promising.append(i)
        return promising

    def _explains_all(self, refit: Optimum) -> bool:
        """Whether what a refit leaves above the least that noise could leave is next to nothing of what it explains."""
        dof = refit.dof
        least = dof - 3.0 * np.sqrt(2.0 * dof)
        return refit.chi2 - least <= NOTHING * (self.optimum.chi2 - refit.chi2)

    def take(self, place: int, optimum: Optimum) -> None:
        """Add an effect to the model."""
        self.accepted.append(place)
        self.optimum = optimum
        label = self.joint.model.effects[place].label
        self.steps.append(SearchStep(label, beside_case(self.case, self.joint, optimum)))
        self.tell(f"added {label}: χ²/dof {self.steps[-1].fit.chi2_per_dof:.4g}")
        self.keep(self)

    def exchange(self, place: int, other: int, optimum: Optimum) -> None:
        """Put another effect in the place of one that was accepted."""
        self.accepted[self.accepted.index(place)] = other
        self.optimum = optimum
        new, old = (self.joint.model.effects[i].label for i in (other, place))
        self.steps.append(SearchStep(f"{new} in place of {old}", beside_case(self.case, self.joint, optimum)))
        self.tell(f"put {new} in place of {old}: χ²/dof {self.steps[-1].fit.chi2_per_dof:.4g}")
        self.keep(self)

    def prune(self) -> None:
        """Drop effects that the final model no longer needs: taken early, while the misfit was large.

        Wald's test only proposes: far from zero a strength may be imitated by others that could not do without it.
        """
        alone = self.level / max(1, len(self.joint.model.effects))
        proposed = {i: self.own_score(i) for i in self.accepted}
        for place, mine in sorted(proposed.items(), key=lambda pair: -pair[1].p_value):
            if self.own_score(place).p_value <= alone:
                continue
            most = self.optimum.chi2 + special.chdtri(max(1, mine.size), alone)
            fewer = self.refit([i for i in self.accepted if i != place], start=self.without(place), beat=most)
            if fewer.chi2 >= most:
                continue
            self.optimum = fewer
            self.accepted.remove(place)
            self.drop(self.joint.model.effects[place].label)

    def drop(self, label: str) -> None:
        """Note an effect that the present optimum no longer has."""
        self.tell(f"dropped {label}, which the others explain")
        self.steps.append(SearchStep(f"without {label}", beside_case(self.case, self.joint, self.optimum)))
        self.keep(self)

    def own_score(self, place: int) -> Score:
        """Score of an accepted effect beside everything else that is free: its Wald statistic.

        Its further numbers are held: without the effect there are none.
        """
        mine = np.isin(self.optimum.free, self.joint.of_effect(place))
        return score(self.taken_by(place), basis(self.jacobian_without(place)), self.optimum.jacobian[:, mine])

    def taken_by(self, place: int) -> np.ndarray:
        """What an accepted effect takes of the residual (r,), to the first order."""
        mine = np.isin(self.optimum.free, self.joint.of_effect(place))
        return -self.optimum.jacobian[:, mine] @ self.optimum.vector[self.optimum.free[mine]]

    def jacobian_without(self, place: int) -> np.ndarray:
        """Sensitivities of everything free but one effect."""
        mine = np.concatenate([self.joint.of_effect(place), self.joint.numbers_of(place)])
        return self.optimum.jacobian[:, ~np.isin(self.optimum.free, mine)]

    def grown(self, joint: Joint, place: int, gain: float) -> "Search | None":
        """This search with a larger model whose effect at `place` is new; None where χ² falls by less or it goes."""
        free, beat = always_free(joint, (*self.given, *self.accepted, place)), self.optimum.chi2 - gain
        optimum = optimise(joint, joint.start, free, joint.fitted, beat=beat)
        if optimum.chi2 >= beat:
            self.tell(f"left out {joint.model.effects[place].label}: it explains too little, or less than another")
            return None
        # A frequency and its width are found in a narrow valley: again from within it, to its end.
        optimum = optimise(joint, optimum.vector, free, joint.fitted)
        out = Search(self.steps[-1].fit, self.level, self.given, self.tell)
        out.base, out.steps, out.optimum, out.own = self.base, list(self.steps), self.optimum, self.own
        out.keep, out.looked = self.keep, self.looked
        out.joint, out.accepted = joint, list(self.accepted)
        if out.refuses(place, optimum):
            return None
        out.take(place, optimum)
        return out


def first_twin(ranking: Ranking, among: Sequence[int]) -> int:
    """The first of some candidates, or the one that stands first in the catalogue of those that explain the same."""
    best, scores = among[0], ranking.scores
    same = [i for i in among if scores[i].size == scores[best].size and overlap(scores[i], scores[best]) >= TWINS]
    return min([best, *same])


def always_free(joint: Joint, places: Sequence[int]) -> np.ndarray:
    """Places in the vector of the base parameters and all numbers of some effects, ascending."""
    of_effects = [part for i in places for part in (joint.of_effect(i), joint.numbers_of(i))]
    return np.sort(np.concatenate([joint.base(), *of_effects]).astype(int))


def start_search(case, joint: Joint, level: float, given: Sequence[int], tell: Callable[[str], None]) -> Search:
    """Fit the base model with the effects it was given, and begin."""
    tell("fit the base model")
    optimum = optimise(joint, joint.start, always_free(joint, given), joint.fitted)
    vector, looked = with_numbers_that_show(joint, optimum, joint.numbers)
    optimum = replace(optimum, vector=vector)
    base = beside_case(case, joint, optimum)
    tell(f"base model: χ²/dof {base.chi2_per_dof:.4g}")
    out = Search(base, level, given, tell)
    out.looked = {joint.model.effects[i].label: count for i, count in looked.items()}
    return out
