"""Whether all that is read comes late by many periods, told before a device is known: no step from none leads there."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.effects import InstrumentTerm
from memsgyro_jax.effects.lock_in_terms import LateReadings, LockInBackground, LockInFeedthrough, ReferencePhase
from memsgyro_jax.measurement.one_resonance import Seen, lateness

from .fit import beside_case
from .instrument import every_term
from .joint_residual import Joint
from .optimum import optimise
from .search import Search, SearchStep, always_free


_RESONANCE = ("k/m", "d/m")


def late_first(search: Search) -> Search:
    """The search beside what comes late, a turned reference and a background, where the sweeps of a device of one axis
    show a delay that turns them by more than those two could; the same search else.
    """
    terms = every_term(search.case)
    late = [term for term in terms if isinstance(term, LateReadings)]
    seen = _seen(search) if late and not search.given and not search.steps[-1].fit.leaves_noise else None
    if seen is None:
        return search
    model = search.joint.at(search.joint.start)
    beside = [_begun(term, seen, float(late[0].middle)) for term in _with_them(terms)]
    given = range(len(beside))
    whole = Joint(model.with_only((*beside, *model.effects)), search.joint.readings, search.joint.programs)
    free = always_free(whole, given)
    # What leaks past would first pull at a resonance that is known.
    others = np.array([i for i in free if whole.parameters[i].name not in _RESONANCE])
    optimum = optimise(whole, whole.start, others, whole.fitted)
    optimum = optimise(whole, optimum.vector, free, whole.fitted)
    if optimum.chi2 >= search.optimum.chi2:
        return search
    out = Search(beside_case(search.case, whole, optimum), search.level, tuple(given), search.tell)
    out.base, out.keep, out.looked = search.base, search.keep, search.looked
    out.own = tuple(i + len(beside) for i in search.own)
    labels = ", ".join(term.label for term in beside)
    out.steps = [*search.steps, SearchStep(labels, out.steps[-1].fit)]
    search.tell(f"added {labels}: χ²/dof {optimum.chi2 / optimum.dof:.4g}")
    return out


def _seen(search: Search) -> Seen | None:
    """What comes late of the fitted sweeps of one axis, taken together."""
    fitted = [record for record in search.case.records if record.role != "validation"]
    offered = [row for one in fitted if (row := one.starting_phasors(search.case)) is not None]
    if not offered or any(row.modulus or row.motion.shape[1] > 1 or row.slope is not None for row in offered):
        return None
    parts = ((row.omega, row.motion[:, 0], row.force[:, 0], row.weight) for row in offered)
    return lateness(*map(np.concatenate, zip(*parts, strict=True)))


def _with_them(terms: tuple[InstrumentTerm, ...]) -> list[InstrumentTerm]:
    """What comes late, a turned reference, and one background, in proportion to the drive where that can be told."""
    turned = [t for t in terms if isinstance(t, ReferencePhase) and not t.where]
    past = [t for t in terms if isinstance(t, LockInFeedthrough)] or [
        t for t in terms if isinstance(t, LockInBackground)
    ]
    late = [t for t in terms if isinstance(t, LateReadings)]
    return [*turned[:1], *past[:1], *late]


def _begun(term: InstrumentTerm, seen: Seen, middle: float) -> InstrumentTerm:
    """A term with what is seen of it; the angle is that of another middle of the frequencies."""
    if isinstance(term, LateReadings):
        return eqx.tree_at(lambda t: t.strength, term, jnp.full_like(term.strength, seen.delay))
    if isinstance(term, ReferencePhase):
        angle = seen.angle + (seen.middle - middle) * seen.delay
        return eqx.tree_at(lambda t: t.strength, term, jnp.full_like(term.strength, angle))
    return term
