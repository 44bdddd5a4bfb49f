"""Whether the filter of a lock-in still shows rows further back: looked for in every round, as what it does to sweeps
up and down passes for a drift, and no step from none leads there.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, PyTree
from scipy import optimize

from memsgyro_jax.base.few_at_a_time import over_rows
from memsgyro_jax.base.kept import kept
from memsgyro_jax.base.plainly import PLAINLY
from memsgyro_jax.base.transforms import from_vector
from memsgyro_jax.effects.base import Effect, LockInEffect, UntilNow
from memsgyro_jax.effects.lock_in_poles import MOST_POLES, LockInFilter, shares_of
from memsgyro_jax.effects.lock_in_terms import LockInMemory
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.lock_in import BentCourse, rows_and_ages, until_now
from memsgyro_jax.measurement.model import Model

from .acceptance import BEYOND_LINEAR, excess
from .fewer import MOST, SAME, with_given
from .fit import beside_case
from .instrument import filters_of, instrument_terms
from .joint_residual import Joint
from .optimum import optimise
from .promise import offers_of, promised
from .search import Ranking, Search


SOME = (1, 4)  # poles, by which a lag is first looked for
LAGS = np.geomspace(0.05, 8.0, 22)  # of the usual time between rows
NEXT = float(np.log(LAGS[1] / LAGS[0]))  # from one of them to the next
FEWER = 6  # parts of a row of a bent resonance, which tell a filter to a tenth of the noise of a clear record
STEPS = 3  # of the device, which without the filter is broader than it is
SHORTEST = 0.3  # of a rate of decay or a stiffness, to which it goes at once


def behind_filter(search: Search, ranking: Ranking) -> Search:
    """The search with the filter of the lock-in, where that takes most of what is missing, and more than any further
    effect or other term of the instrument promises, and with as many poles as that takes; the same search else.

    Args:
        search: at the present model.
        ranking: the further effects beside it.
    """
    if _place(search) is not None:
        with_poles_chosen(search)
        return search
    terms, effects = filters_of(search.case), search.joint.model.effects
    present = [effects[i] for i in (*search.given, *search.accepted)]
    missing = excess(search.optimum)
    if not terms or missing <= 0 or any(isinstance(e, LockInEffect) and e.last for e in present):
        return search
    sought = _Sought.of(search)
    found = None if sought is None else sought.found(search, search.optimum.vector, _least(search, ranking))
    if found is None:
        return search
    out = with_given(search, found.of(terms[0]), found.vector)
    if excess(out.optimum) > (1.0 - MOST) * missing:
        return search
    search.tell(f"added {terms[0].label}: χ²/dof {out.optimum.chi2 / out.optimum.dof:.4g}")
    return out


def with_poles_chosen(search: Search) -> None:
    """Give the filter that a search has as many poles as fit best beside the effects found since."""
    if (place := _place(search)) is None or (sought := _Sought.of(search)) is None:
        return
    if (found := sought.found(search, search.without(place), -np.inf)) is None:
        return
    model = search.joint.at(found.vector)
    effects = [found.of(effect) if i == place else effect for i, effect in enumerate(model.effects)]
    whole = Joint(model.with_only(effects), search.joint.readings, search.joint.programs)
    optimum = optimise(whole, whole.start, search.optimum.free, whole.fitted)
    if optimum.chi2 < search.optimum.chi2 - SAME:
        search.joint, search.optimum, search.unseen = whole, optimum, None
        last = replace(search.steps[-1], fit=beside_case(search.case, whole, optimum))
        search.steps = [*search.steps[:-1], last]


def _place(search: Search) -> int | None:
    """Of the filter among the effects of a search that has one."""
    given = [i for i in search.given if isinstance(search.joint.model.effects[i], LockInFilter)]
    return given[0] if given else None


def _least(search: Search, ranking: Ranking) -> float:
    """Of χ², what the filter must take to be tried: most of what is missing to the first order, and more than anything
    else promises.
    """
    held = {effect.label for effect in search.joint.model.effects}
    rivals = [term for term in instrument_terms(search.case) if not isinstance(term, LockInMemory)]  # of one pole
    terms = [term for term in rivals if term.label not in held]
    promise = promised(search.optimum, offers_of(search.steps[-1].fit, terms), search.level) if terms else None
    others = [0.0 if promise is None else max(promise.alone), *(score.statistic for score in ranking.scores)]
    return max(MOST * excess(search.optimum) / BEYOND_LINEAR, *others)


class _Found(NamedTuple):
    """A filter, the parameters of the device with it, and the χ² of all that is fitted, to the first order."""

    chi2: float
    tau: float
    poles: int
    vector: np.ndarray

    def of(self, term: Any) -> Any:
        """The term of a filter, as this one."""
        numbers = np.array([self.tau]), jnp.asarray(float(self.poles))
        return eqx.tree_at(lambda t: (t.strength, t.poles), term, numbers)


class _Sought(NamedTuple):
    """What sweeps with a clock show of rows further back.

    Args:
        sweep: all their rows.
        halves: readings of some of them.
        others: fitted readings of other records.
        fits: (n,) which rows are fitted.
        std: (n, channels) of their noise [V].
    """

    sweep: Any
    halves: tuple[Readings, ...]
    others: tuple[Readings, ...]
    fits: np.ndarray
    std: np.ndarray

    @classmethod
    def of(cls, search: Search) -> "_Sought | None":
        """Of the readings of a search; `None` where no record has a clock."""
        sweeps = {id(sweep): sweep for r in search.joint.readings if (sweep := _every(r)) is not None}
        if len(sweeps) != 1:
            return None
        (sweep,) = sweeps.values()
        halves = tuple(r for r in search.joint.readings if _every(r) is not None)
        others = tuple(r for r in search.joint.fitted if _every(r) is None)
        fits = np.zeros(sweep.frequency.size, bool)
        for r in halves:
            half: Any = r.experiment
            taken = np.isfinite(np.asarray(half.noise.std)).any(axis=1) & (r.record >= 0)
            fits[np.asarray(half.place)[taken & r.fitted]] = True
        std = np.broadcast_to(np.asarray(sweep.noise.std), sweep.measured.shape)
        return cls(sweep, halves, others, fits, std)

    def found(self, search: Search, vector: np.ndarray, least: float) -> _Found | None:
        """The best filter beside the parameters of a vector that has none; `None` where its first estimate does not
        take so much from χ².
        """
        joint, best = search.joint, None
        free = np.array([i for i in search.optimum.free if not isinstance(_owner(joint, i), LockInFilter)])
        for _ in range(STEPS):
            best = self._best(joint, vector if best is None else best.vector, free)
            if search.optimum.chi2 - best.chi2 < least:
                return None
        return best

    def _best(self, joint: Joint, vector: np.ndarray, free: np.ndarray) -> _Found:
        """The best filter, and a step of the device beside it."""
        columns, left, others = self._told(joint, vector, free)
        measured, std = np.asarray(self.sweep.measured)[self.fits], self.std[self.fits]
        seen = self._seen(joint, vector, free, columns)

        def tried(tau: float, poles: int) -> tuple[float, np.ndarray]:
            read = np.asarray(seen(jnp.asarray(tau), jnp.asarray(float(poles))))
            misfit, by = _real((measured - read[..., 0]) / std), _real(read[..., 1:] / std[..., None])
            return _step(np.concatenate([misfit, left]), np.concatenate([-by, others]))

        ages = self.sweep.rows_before.ages[:, 0]
        usual = float(np.median(ages[np.isfinite(ages)]))
        lag = min(usual * LAGS, key=lambda lag: min(tried(lag / n, n)[0] for n in SOME))
        ends = [(*_finer(lambda tau, n=n: tried(tau, n)[0], lag / n), n) for n in range(1, MOST_POLES + 1)]
        _, tau, poles = min(ends)
        chi2, step = tried(tau, poles)
        at, low = vector.copy(), joint.bounds[0][free]
        at[free] += step
        at[free] = np.where(low >= 0, np.maximum(at[free], SHORTEST * vector[free]), at[free])
        return _Found(chi2, tau, poles, at)

    def _seen(
        self, joint: Joint, vector: np.ndarray, free: np.ndarray, columns: np.ndarray
    ) -> Callable[[Array, Array], Array]:
        """What a filter shows (n, channels, columns) of rows that settle to these columns, phasors and their slopes by
        what is free, as it depends on its time constant and poles.
        """
        model = joint.at(vector).present
        if not self.sweep.bends(model):
            moved = jax.tree.map(lambda leaf: leaf[self.fits], _moved(model, jnp.asarray(columns), self.sweep))
            return lambda tau, poles: _read(tau, poles, moved)
        acting = tuple(i for i, e in enumerate(joint.at(vector).effects) if np.any(np.asarray(e.strength) != 0))
        units = jnp.asarray(np.eye(vector.size)[free])
        courses = _courses(jnp.asarray(vector), units, joint.model, joint.spec, acting, self.sweep)
        before = jax.tree.map(lambda leaf: leaf[self.fits], rows_and_ages(self.sweep.rows_before))
        return lambda tau, poles: _read_bent(tau, poles, *courses, before)

    def _told(self, joint: Joint, vector: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Phasors to which the device settles in all rows and their slopes by what is free (1 + p, n, channels);
        residual and slopes of the other records.
        """
        told = np.zeros((1 + free.size, *self.std.shape), complex)
        units = np.eye(vector.size)[free]
        for r in self.halves:
            half: Any = r.experiment
            place, at_once = np.asarray(half.place), jnp.zeros(half.frequency.shape)
            heard = eqx.tree_at(lambda e: e.noise.std, half, jnp.asarray(self.std[place]))
            heard = heard if half.unsettled is None else eqx.tree_at(lambda e: e.unsettled, heard, at_once)
            value, slope = joint.linearise(vector, units, [replace(r, experiment=heard, whole=None)])
            parts = np.concatenate([value[:, None], slope], axis=1).T.reshape(1 + free.size, *half.measured.shape, 2)
            told[:, place] = parts[..., 0] + 1j * parts[..., 1]
        told = -np.where(np.isfinite(self.std), self.std, 0.0) * told
        told[0] += np.where(np.isfinite(self.std), np.asarray(self.sweep.measured), 0.0)
        rest = joint.linearise(vector, units, self.others) if self.others else (np.zeros(0), np.zeros((0, free.size)))
        return told, *rest


def _owner(joint: Joint, parameter: int) -> Effect | None:
    """The effect that a parameter is of; none where it is the device's."""
    place = joint.parameters[parameter].effect
    return None if place is None else joint.model.effects[place]


def _every(readings: Readings) -> Any:
    """All rows of the sweeps that readings are some of, where these follow each other by a clock; else `None`."""
    return getattr(readings.experiment, "every", None)


def _moved_of(model: Model, columns: Complex[Array, "c n axes"], sweep: Any) -> UntilNow:
    """How each row (n, ...) came about, of several motions at once (n, c, ...)."""
    known = sweep.frequency, sweep.surroundings, sweep.dwell, sweep.unsettled, sweep.rows_before
    return jax.vmap(lambda values: until_now(model, values, *known), out_axes=BY_MOTION)(columns)


def _read_of(tau: Array, poles: Array, moved: UntilNow) -> Complex[Array, "n axes c"]:
    """What a filter shows of several motions."""

    def row(moved: UntilNow) -> Array:
        part = shares_of(tau, poles, moved)
        return jax.vmap(part.of, in_axes=(OF_A_ROW,), out_axes=1)(moved)

    return jax.vmap(row)(moved)


def _courses_of(
    vector: Array, ways: Array, model: Model, spec: PyTree, acting: tuple[int, ...], sweep: Any
) -> tuple[BentCourse, BentCourse]:
    """How a device that is not linear went from row to row, with the effects at some places, and the slopes of that
    along some ways (p, parameters).
    """

    def course(vector: Array) -> BentCourse:
        whole = from_vector(vector, model, spec)
        return sweep.course(whole.with_only(whole.effects[i] for i in acting), FEWER)

    value, along = jax.linearize(course, vector)
    return value, jax.vmap(along)(ways)


def _read_bent_of(
    tau: Array, poles: Array, course: BentCourse, slopes: BentCourse, before: tuple[Array, Array, Array]
) -> Complex[Array, "n axes c"]:
    """What a filter shows of such a course, and of its slopes."""

    def row(*before: Array) -> Array:
        def seen(course: BentCourse) -> Array:
            moved = course.until_now(*before)
            return shares_of(tau, poles, moved).of(moved)

        value, along = jax.linearize(seen, course)
        return jnp.concatenate([value[:, None], jax.vmap(along, out_axes=1)(slopes)], axis=1)

    return over_rows(row, *before)


BY_MOTION, OF_A_ROW = UntilNow(1, 1, None, None, None, None), UntilNow(0, 0, None, None, None, None)
_moved, _read = kept(_moved_of, PLAINLY), kept(_read_of, PLAINLY)
_courses, _read_bent = kept(_courses_of, PLAINLY), kept(_read_bent_of)


def _finer(misfit: Callable[[float], float], begin: float) -> tuple[float, float]:
    """The least misfit near a time constant of a grid, and where it is."""
    end = optimize.minimize_scalar(lambda x: misfit(begin * np.exp(x)), bounds=(-NEXT, NEXT), method="bounded")
    return float(end.fun), float(begin * np.exp(end.x))


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
