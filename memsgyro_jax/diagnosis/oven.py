"""Temperatures that a case holds for exact, where its records say that an oven was off: then all that depends on
temperature is off by the same kelvins, from set point to set point.

Such errors leave a misfit that no effect of the device explains, or a false one. A number for the temperature of each
set point takes it, and tells it in kelvins.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from memsgyro_jax.effects import free_numbers
from memsgyro_jax.effects.instrument import RecordTemperature
from memsgyro_jax.measurement.case import Case

from .findings import Accepted
from .instrument import declared_terms, undeclared_temperature
from .joint_residual import Joint
from .optimum import Optimum
from .promise import Offer
from .score import basis
from .search import Search
from .worth_trying import COURSE, count_temperatures


MOST = 3.0  # K by which an oven may be off: what scatters by more is a law that is missing
LEAST = 1e-6  # K; and of the largest sensitivity to a temperature, below which a combination of them shows nothing


def oven_offer(search: Search) -> tuple[RecordTemperature, Offer] | None:
    """A number for the temperature of each set point, and what it would take of the present misfit; `None` where the
    case says how far they may be off, has too few of them, or the model does not depend on them.

    What is known of the numbers beforehand is the scatter that the misfit asks for.
    """
    term = undeclared_temperature(search.case)
    joint, optimum = search.joint, search.optimum
    model = joint.at(optimum.vector)
    kept = [model.effects[i] for i in sorted((*search.given, *search.accepted))]
    if term is None or count_temperatures(search.case) < COURSE or term.label in {effect.label for effect in kept}:
        return None
    beside = Joint(model.with_only((*kept, term)), joint.readings, joint.programs)
    units = np.eye(beside.start.size)[beside.of_effect(len(kept))]
    slopes = beside.linearise(beside.start, units, beside.fitted)[1]
    spread = scatter(optimum, slopes) if np.isfinite(slopes).all() else 0.0
    if not LEAST < spread < MOST:
        return None
    (number,) = [n for n in free_numbers(term) if n.field == "strength"]
    every = np.ones(term.strength.size)
    term = eqx.tree_at(lambda t: t.spread, term, jnp.asarray(spread * every))
    return term, Offer(slopes, number.low * every, number.high * every, spread * every)


def scatter(optimum: Optimum, slopes: np.ndarray) -> float:
    """Standard deviation of numbers that nobody knows, by the likelihood of the residual that they leave: of what the
    free parameters do not take, and beside noise as large as the rest of the misfit.

    Args:
        optimum: of the model without them.
        slopes: of its residual by each of them (r, k).
    """
    q = basis(optimum.jacobian)
    u, size, _ = np.linalg.svd(slopes - q @ (q.T @ slopes), full_matrices=False)
    shown = size > LEAST * np.max(np.linalg.norm(slopes, axis=0), initial=0.0)
    seen, size = (u.T @ optimum.residual)[shown], size[shown]
    if seen.size < 2:  # one alone is any number
        return 0.0
    noise = max(1.0, (optimum.chi2 - float(seen @ seen)) / max(1, optimum.dof - seen.size))

    def cost(power: float) -> float:
        variance = noise + (size * 10.0**power) ** 2
        return float(np.sum(np.log(variance) + seen**2 / variance))

    return float(10.0 ** optimize.minimize_scalar(cost, bounds=np.log10([LEAST, 2.0 * MOST]), method="bounded").x)


def of_oven(case: Case, terms: Sequence[Accepted], effects: Sequence) -> str:
    """A sentence where a case holds temperatures for exact that its records deny; empty else."""
    warm = {effect.label: effect for effect in effects if isinstance(effect, RecordTemperature)}
    found = [term for term in terms if term.label in warm]
    if not found or declared_terms(case) or np.isnan(found[0].std).any():
        return ""
    kelvins = float(np.mean(np.asarray(warm[found[0].label].known_to)))
    return (
        f" The records scatter by {kelvins:.2g} K about their course with the temperature, as an oven that is off its "
        f"set points lets them: `temperature_std` declares by how much it may be."
    )
