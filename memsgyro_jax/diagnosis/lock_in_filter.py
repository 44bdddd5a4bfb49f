"""Whether the filter of a lock-in still shows rows further back: looked for in every round, as what it does to sweeps
up and down passes for a drift, and no step from none leads there.
"""

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from scipy import optimize
from scipy.special import gammainc

from memsgyro_jax.effects.lock_in_terms import LockInEffect, LockInMemory
from memsgyro_jax.measurement.experiments import Readings

from .acceptance import BEYOND_LINEAR, excess
from .fit import beside_case
from .instrument import filters_of, instrument_terms
from .joint_residual import Joint
from .optimum import optimise
from .promise import offers_of, promised
from .search import Ranking, Search, SearchStep, always_free


MOSTLY = 0.5  # of the misfit beyond noise, which the filter must take
POLES = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
LAGS = np.geomspace(0.1, 8.0, 28)  # of the usual time between rows
NEXT = np.log(LAGS[1] / LAGS[0])  # from one of them to the next
SIMPLEX, EVALUATIONS = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]]), 80  # to where a filter between them ends
STEPS = 3  # of the device, which without the filter is broader than it is
SHORTEST = 0.3  # of a rate of decay or a stiffness, to which it goes at once


def behind_filter(search: Search, ranking: Ranking) -> Search:
    """The search with the filter of the lock-in, where that takes most of what is missing, and more than any further
    effect or other term of the instrument promises; the same search else.

    Args:
        search: at the present model.
        ranking: the further effects beside it.
    """
    terms, effects = filters_of(search.case), search.joint.model.effects
    present = [effects[i] for i in (*search.given, *search.accepted)]
    missing, own = excess(search.optimum), len(search.given)
    if not terms or missing <= 0 or any(isinstance(e, LockInEffect) and e.last for e in present):
        return search
    sought = _Sought.of(search)
    if sought is None or (found := sought.found(search, _least(search, ranking))) is None:
        return search
    strength = found.lag * np.array([1.0, 1.0 - 1.0 / found.poles])
    term = eqx.tree_at(lambda t: t.strength, terms[0], strength)
    model = search.joint.at(found.vector)
    model = model.with_only((*model.effects[:own], term, *model.effects[own:]))
    whole = Joint(model, search.joint.readings, search.joint.programs)
    accepted = [i + 1 for i in search.accepted]
    optimum = optimise(whole, whole.start, always_free(whole, (*range(own + 1), *accepted)), whole.fitted)
    if excess(optimum) > (1.0 - MOSTLY) * missing:
        return search
    search.tell(f"added {term.label}: χ²/dof {optimum.chi2 / optimum.dof:.4g}")
    out = Search(search.base, search.level, range(own + 1), search.tell)
    out.joint, out.optimum, out.accepted, out.keep = whole, optimum, accepted, search.keep
    out.own, out.looked = tuple(i + 1 for i in search.own), search.looked
    out.steps = [*search.steps, SearchStep(term.label, beside_case(search.case, whole, optimum))]
    return out


def _least(search: Search, ranking: Ranking) -> float:
    """Of χ², what the filter must take to be tried: most of what is missing to the first order, and more than anything
    else promises.
    """
    held = {effect.label for effect in search.joint.model.effects}
    rivals = [term for term in instrument_terms(search.case) if not isinstance(term, LockInMemory)]  # of one pole
    terms = [term for term in rivals if term.label not in held]
    promise = promised(search.optimum, offers_of(search.steps[-1].fit, terms), search.level) if terms else None
    others = [0.0 if promise is None else max(promise.alone), *(score.statistic for score in ranking.scores)]
    return max(MOSTLY * excess(search.optimum) / BEYOND_LINEAR, *others)


class _Found(NamedTuple):
    """A filter, the parameters of the device with it, and the χ² of all that is fitted, to the first order."""

    chi2: float
    lag: float
    poles: float
    vector: np.ndarray


class _Sought(NamedTuple):
    """What sweeps with a clock show of rows further back.

    Args:
        halves: readings of their rows.
        others: fitted readings of other records.
        fits: (n,) which of all rows are fitted.
        measured, std: (n, channels) of all rows [V].
        rows: (n, k) each row and those before it.
        ages: (n, k − 1) times since the latter were read [s].
    """

    halves: tuple[Readings, ...]
    others: tuple[Readings, ...]
    fits: np.ndarray
    measured: np.ndarray
    std: np.ndarray
    rows: np.ndarray
    ages: np.ndarray

    @classmethod
    def of(cls, search: Search) -> "_Sought | None":
        """Of the readings of a search; `None` where no record has a clock."""
        every = [r for r in search.joint.readings if getattr(r.experiment, "every", None) is not None]
        whole = {id(r.experiment.every): r.experiment.every for r in every}  # type: ignore[attr-defined]
        if len(whole) != 1:
            return None
        (sweep,) = whole.values()
        before, channels = sweep.rows_before, sweep.measured.shape[1]
        if not np.isfinite(before.ages).any():
            return None
        fits = np.zeros(len(sweep.frequency), bool)
        for r in every:
            half: Any = r.experiment
            taken = np.isfinite(np.asarray(half.noise.std)).any(axis=1) & (r.record >= 0)
            fits[np.asarray(half.place)[taken & r.fitted]] = True
        rows = np.concatenate([np.arange(fits.size)[:, None], np.asarray(before.rows)], axis=1)
        std = np.broadcast_to(np.asarray(sweep.noise.std), (fits.size, channels))
        others = tuple(r for r in search.joint.fitted if getattr(r.experiment, "every", None) is None)
        return cls(tuple(every), others, fits, np.asarray(sweep.measured), std, rows, np.asarray(before.ages))

    def found(self, search: Search, least: float) -> _Found | None:
        """The best filter; `None` where its first estimate does not take so much from χ²."""
        free, best = search.optimum.free, None
        for _ in range(STEPS):
            best = self._best(search.joint, search.optimum.vector if best is None else best.vector, free)
            if search.optimum.chi2 - best.chi2 < least:
                return None
        return best

    def _best(self, joint: Joint, vector: np.ndarray, free: np.ndarray) -> _Found:
        """The best filter, and a step of the device beside it."""
        settled, slopes, left, others = self._told(joint, vector, free)
        settled, slopes = settled[self.rows[self.fits]], slopes[self.rows[self.fits]]

        def tried(lag: float, n: float) -> tuple[float, np.ndarray]:
            shares = self._shares(lag, n)
            read, along = np.einsum("nk,nkc->nc", shares, settled), np.einsum("nk,nkcp->ncp", shares, slopes)
            std = self.std[self.fits]
            misfit, by = _real((self.measured[self.fits] - read) / std), _real(along / std[..., None])
            return _step(np.concatenate([misfit, left]), np.concatenate([-by, others]))

        usual = np.median(self.ages[np.isfinite(self.ages[:, 0]), 0])
        begin = min(itertools.product(usual * LAGS, POLES), key=lambda pair: tried(*pair)[0])
        lag, n = _finer(lambda lag, n: tried(lag, n)[0], begin)
        chi2, step = tried(lag, n)
        moved, low = vector.copy(), joint.bounds[0][free]
        moved[free] += step
        moved[free] = np.where(low >= 0, np.maximum(moved[free], SHORTEST * vector[free]), moved[free])
        return _Found(chi2, lag, n, moved)

    def _shares(self, lag: float, poles: float) -> np.ndarray:
        """(n, k) of each row that is fitted: how much of it and of those before it a filter shows."""
        ages = self.ages[self.fits]
        old = ~np.isfinite(ages)
        shown = np.where(old, 1.0, gammainc(poles, np.where(old, 1.0, ages) * poles / lag))
        return np.diff(np.pad(shown, ((0, 0), (1, 1)), constant_values=((0, 0), (0, 1))), axis=1)

    def _told(
        self, joint: Joint, vector: np.ndarray, free: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Phasors of all rows as the device settles (n, channels) and their slopes by what is free (n, channels, p);
        residual and slopes of the other records.
        """
        count, channels = self.measured.shape
        settled, slopes = np.zeros((count, channels), complex), np.zeros((count, channels, free.size), complex)
        units = np.eye(vector.size)[free]
        for r in self.halves:
            experiment = r.experiment
            place = np.asarray(experiment.place)  # type: ignore[attr-defined]
            heard = replace(r, experiment=eqx.tree_at(lambda e: e.noise.std, experiment, self.std[place]), whole=None)
            value, slope = joint.linearise(vector, units, [heard])
            value, slope = value.reshape(-1, channels, 2), slope.reshape(-1, channels, 2, free.size)
            settled[place] = value[..., 0] + 1j * value[..., 1]
            slopes[place] = slope[:, :, 0] + 1j * slope[:, :, 1]
        known = np.isfinite(self.std)
        settled = np.where(known, self.measured - np.where(known, self.std, 0.0) * settled, 0.0)
        slopes = -np.where(known, self.std, 0.0)[..., None] * slopes
        rest = joint.linearise(vector, units, self.others) if self.others else (np.zeros(0), np.zeros((0, free.size)))
        return settled, slopes, *rest


def _finer(misfit: Callable[[float, float], float], begin: tuple[float, float]) -> tuple[float, float]:
    """Lag and poles, at least one, of the least misfit near those of a grid."""
    end = optimize.minimize(
        lambda x: misfit(begin[0] * np.exp(x[0]), begin[1] * np.exp(x[1])), np.zeros(2), method="Nelder-Mead",
        bounds=[(-NEXT, NEXT), (max(-3 * NEXT, -np.log(begin[1])), 3 * NEXT)],
        options={"initial_simplex": NEXT * SIMPLEX, "maxfev": EVALUATIONS},
    )  # fmt: skip
    return float(begin[0] * np.exp(end.x[0])), float(begin[1] * np.exp(end.x[1]))


def _real(values: np.ndarray) -> np.ndarray:
    """Real and imaginary parts of rows (n, channels, ...) one below the other."""
    return np.stack([values.real, values.imag], axis=2).reshape(-1, *values.shape[2:])


def _step(residual: np.ndarray, jacobian: np.ndarray) -> tuple[float, np.ndarray]:
    """χ² after a Gauss-Newton step, and the step."""
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0, size, 1.0)
    step = -np.linalg.lstsq(jacobian / size, residual, rcond=1e-10)[0] / size
    left = residual + jacobian @ step
    return float(left @ left), step
