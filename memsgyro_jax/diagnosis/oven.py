"""Temperatures that a case holds for exact, where its records say that an oven was off: then all that depends on
temperature is off by the same kelvins, from set point to set point.

Such errors leave a misfit that no effect of the device explains, or a false one. A number for the temperature of each
set point takes it, and tells it in kelvins.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import optimize, special

from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects import free_numbers
from memsgyro_jax.effects.instrument import RecordTemperature
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.experiments.base import Experiment
from memsgyro_jax.measurement.one_place import set_points

from .findings import Accepted
from .instrument import declared_terms, temperatures_of, undeclared_temperature
from .joint_residual import Joint
from .optimum import Optimum
from .promise import Offer
from .score import basis
from .search import Search
from .worth_trying import COURSE, count_temperatures


MOST = 3.0  # K by which an oven may be off: what scatters by more is a law that is missing
STEP = 1e-3  # K of a difference: far below the width of a resonance in a spring's drift, far above rounding
LEAST = 1e-6  # K; and of the largest sensitivity to a temperature, below which a combination of them shows nothing
CUBIC, CHANCE = 3, 0.01  # degree of a course that is no line, and how seldom errors look like one


def oven_offer(search: Search) -> tuple[RecordTemperature, Offer] | None:
    """A number for the temperature of each set point, and what it would take of the present misfit; `None` where the
    case says how far they may be off, has too few of them, or the model does not depend on them.

    What is known of the numbers beforehand is the scatter that the misfit asks for.
    """
    term = undeclared_temperature(search.case)
    joint, optimum = search.joint, search.optimum
    model = joint.at(optimum.vector)
    kept = [model.effects[i] for i in sorted((*search.given, *search.accepted))]
    held, depends = {effect.label for effect in kept}, any(not effect.of_instrument for effect in kept)
    if term is None or not depends or term.label in held or count_temperatures(search.case) < COURSE:
        return None
    slopes = _slopes(joint, optimum.vector, term)
    if not np.isfinite(slopes).all():
        return None
    found = SetPointErrors.of(optimum, slopes)
    if not LEAST < found.size < MOST or found.is_course(temperatures_of(search.case, term)):
        return None
    count = found.values.size
    spread = found.size * np.sqrt((count + 1) / (count - 1))  # as so few say it roughly: the tails of Student's
    (number,) = [n for n in free_numbers(term) if n.field == "strength"]
    every = np.ones(term.strength.size)
    term = eqx.tree_at(lambda t: t.spread, term, jnp.asarray(spread * every))
    return term, Offer(slopes, number.low * every, number.high * every, spread * every)


def _slopes(joint: Joint, vector: np.ndarray, term: RecordTemperature) -> np.ndarray:
    """Sensitivities (r, k) of the fitted readings to the number of each set point, by central differences: all set
    points are moved at once, as each reading belongs to one, and no program is needed that the fit has not made.
    """
    placed = [r for r in joint.fitted if hasattr(r.experiment, "surroundings")]
    warm, cold = ([_warmed(r, term, kelvins) for r in placed] for kelvins in (STEP, -STEP))
    ends = joint.residual(vector, [*warm, *cold])
    moved = {id(r): (ends[i] - ends[i + len(placed)]) / (2.0 * STEP) for i, r in enumerate(placed)}
    blocks = []
    for readings in joint.fitted:
        block = np.zeros((readings.size, term.strength.size))
        if id(readings) in moved:
            mine = _taken(term, readings)[-len(readings.experiment.measured) :]  # a capture begins before its readings
            block = moved[id(readings)][:, None] * np.repeat(mine, readings.size // len(mine), axis=0)
        blocks.append(block)
    return np.concatenate(blocks)


def _taken(term: RecordTemperature, readings: Readings) -> np.ndarray:
    """(n, k) how much of each number a row takes; (k,) of readings with the conditions of one."""
    experiment: Any = readings.experiment  # most kinds have surroundings, not all
    around: Conditions = experiment.surroundings
    return np.asarray(term.entry)[np.asarray(around.record, int), np.asarray(around.sweep, int)]


def _warmed(readings: Readings, term: RecordTemperature, kelvins: float) -> Readings:
    """The same readings, predicted where every set point is warmer."""
    moved = kelvins * _taken(term, readings).sum(axis=-1)

    def warmer(experiment: Experiment) -> Experiment:
        return eqx.tree_at(lambda e: e.surroundings.temperature, experiment, replace_fn=lambda t: t + moved)

    return readings.changed(warmer)


class SetPointErrors(NamedTuple):
    """Numbers that nobody knows, one for each set point, as a residual tells them beside all that is free.

    Args:
        ways: (m, k) orthonormal combinations of them that it shows.
        values: (m,) what each of these is.
        std: (m,) the standard deviation of that, beside noise as large as the rest of the misfit.
    """

    ways: np.ndarray
    values: np.ndarray
    std: np.ndarray

    @classmethod
    def of(cls, optimum: Optimum, slopes: np.ndarray) -> "SetPointErrors":
        """By the slopes of the residual by each number (r, k)."""
        q = basis(optimum.jacobian)
        u, size, ways = np.linalg.svd(slopes - q @ (q.T @ slopes), full_matrices=False)
        shown = size > LEAST * np.max(np.linalg.norm(slopes, axis=0), initial=0.0)
        seen, size = (u.T @ optimum.residual)[shown], size[shown]
        rest = (optimum.chi2 - float(seen @ seen)) / max(1, optimum.dof - seen.size)
        return cls(ways[shown], -seen / size, np.sqrt(max(1.0, rest)) / size)

    @property
    def size(self) -> float:
        """The standard deviation of the numbers, by the likelihood of what is seen of them; zero of one alone."""
        if self.values.size < 2:
            return 0.0

        def cost(power: float) -> float:
            variance = self.std**2 + 10.0 ** (2.0 * power)
            return float(np.sum(np.log(variance) + self.values**2 / variance))

        return float(10.0 ** optimize.minimize_scalar(cost, bounds=np.log10([LEAST, 2.0 * MOST]), method="bounded").x)

    def is_course(self, kelvins: np.ndarray) -> bool:
        """Whether what is surely told of the numbers, at temperatures (k,), is a curve over these, which errors seldom
        are: a cubic against the line that the model takes, by Fisher's F; of too few nobody can say.
        """
        told = self.values / (1.0 + (self.std / self.size) ** 2)
        points = set_points(kelvins)
        count = np.bincount(points)  # several numbers at one temperature may be of one visit
        warm, here = (np.bincount(points, each) / count for each in (kelvins, told @ self.ways))
        spare = count.size - (CUBIC + 1)
        if spare < 1:
            return False
        line, cubic = (_left(warm, here, degree) for degree in (1, CUBIC))
        return bool(special.fdtrc(CUBIC - 1, spare, (line - cubic) / (CUBIC - 1) / (cubic / spare)) < CHANCE)


def _left(places: np.ndarray, values: np.ndarray, degree: int) -> float:
    """The squares that a polynomial leaves of some values."""
    q, _ = np.linalg.qr(((places - places.mean()) / np.ptp(places))[:, None] ** np.arange(degree + 1))
    return float(np.sum((values - q @ (q.T @ values)) ** 2))


def of_oven(case: Case, terms: Sequence[Accepted], effects: Sequence) -> str:
    """A sentence where a case holds temperatures for exact that its records deny; empty else."""
    warm = {effect.label: effect for effect in effects if isinstance(effect, RecordTemperature)}
    found = [term for term in terms if term.label in warm]
    if not found or declared_terms(case) or np.isnan(found[0].std).any():
        return ""
    kelvins = float(np.mean(np.asarray(warm[found[0].label].known_to)))
    return (
        f" The records scatter by {kelvins:.2g} K about their course with the temperature, as an oven that is off its "
        "set points lets them (`temperature_std` declares by how much it may be), or a course that is none of those "
        "tried: sweeps repeated at these temperatures tell, as errors do not come back."
    )
