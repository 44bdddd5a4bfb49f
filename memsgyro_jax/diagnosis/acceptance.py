"""What an effect must do to stay in a model: explain something, be possible, and be supported by what was left out."""

from collections.abc import Sequence

import numpy as np

from memsgyro_jax.base.text import said_in
from memsgyro_jax.effects import Scanned
from memsgyro_jax.effects.base import SweepEffect
from memsgyro_jax.effects.readout_delay import ReadoutDelay
from memsgyro_jax.measurement.calibration import unit_of_records
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.least_squares import gate

from .fitted import PINNED
from .held_out import support
from .joint_residual import Joint
from .optimum import Optimum
from .scans import coverage
from .score import Score, survival


FEW = 0.05  # of the misfit above noise that is left: who explains less explains nothing
MANY, THIRD = 2, 1.0 / 3.0  # effects from which a further one must explain a third of it
BEYOND_LINEAR = 3.0  # times its linear estimate: so much a refit may find
FASTER = 1.5  # than the clock of a record: a sweep cannot have moved so
LATEST = 1.0  # periods of the lowest resonance: what frequency sweeps show as later is a phase, unless it explains all


def excess(optimum: Optimum) -> float:
    """Misfit of the fitted readings beyond what noise could leave, three standard deviations of χ²."""
    return max(0.0, optimum.chi2 - optimum.dof * gate(optimum.dof))


def share_needed(others: int) -> float:
    """Of the misfit beyond noise, what an effect beside `others` must explain."""
    return THIRD if others >= MANY else FEW


def hopeless(gain: float, before: Optimum, others: int) -> bool:
    """Whether an effect beside `others` needs no refit to be refused, by the fall of χ² in its linear estimate.

    The first effect always gets one: it may take far more than its estimate. Beside it, what is left is small enough.
    """
    return others > 0 and BEYOND_LINEAR * gain < share_needed(others) * excess(before)


def refusal(joint: Joint, place: int, before: Optimum, after: Optimum, *, others: int, case: Case) -> str:
    """Why the effect at `place`, which `after` has and `before` lacks, does not stay; empty where it does.

    Args:
        joint: of `after`.
        place: of the effect in its model.
        before, after: fits of the same readings.
        others: how many effects were found before it.
        case: that is fitted; a scanned effect stays within what its records cover.
    """
    gain, need = before.chi2 - after.chi2, share_needed(others)
    if gain <= 0 or per_freedom(after) >= per_freedom(before):
        return "the model with it fits no better"
    if impossible := _impossible(joint, place, after, case):
        return impossible
    if gain < need * excess(before):
        return f"it explains {100 * gain / excess(before):.2g} % of the misfit that is left"
    if not after.converged:
        return "the fit with it does not converge"
    found = support(before, after, joint.fitted)
    if not found.enough:
        where = "rows" if found.rows < found.records else "records"
        return f"{where} that were left out do not get better by it"
    return ""


def per_freedom(optimum: Optimum) -> float:
    """χ² per degree of freedom."""
    return optimum.chi2 / optimum.dof


def _impossible(joint: Joint, place: int, after: Optimum, case: Case) -> str:
    """Whether a strength stands at a bound, or a scanned effect has left what was recorded."""
    effect, covered = joint.model.effects[place], coverage(case)
    low, high = joint.bounds
    for i in joint.of_effect(place):
        for bound in (low[i], high[i]):
            if np.isfinite(bound) and abs(after.vector[i] - bound) <= PINNED * abs(bound):
                at = said_in(f"{bound:.4g}", unit_of_records(case, joint.parameters[i].unit))
                return f"its strength ends at {at}, the bound that physics sets"
    if late := too_late(joint, place, after, case):
        return late
    if (
        isinstance(effect, SweepEffect)
        and abs(float(np.max(after.vector[joint.of_effect(place)]))) > FASTER * covered.sweep_rate
    ):
        return "the clock of the records says that sweeps move more slowly"
    if isinstance(effect, Scanned):
        grid = effect.grid(covered)
        for i in joint.numbers_of(place):
            tried = [float(getattr(one, joint.parameters[i].field)) for one in grid]
            if len(set(tried)) > 1 and not min(tried) <= after.vector[i] <= max(tried):
                return f"its {joint.parameters[i].field} leaves what was recorded"
    return ""


def too_late(joint: Joint, place: int, after: Optimum, case: Case) -> str:
    """Why an effect is a delay that cannot be believed; empty where it is none, or may be.

    Over a sweep whole periods of a delay are a small slope of the phase, which anything that is missing may have;
    beside angles of the reference, which take back what it turns, such a delay grows without bound. A delay of a
    pipeline over several periods is one that explains the records.
    """
    if not isinstance(joint.model.effects[place], ReadoutDelay):
        return ""
    if not any(record.driven for record in case.records):
        return "a record that nothing drives begins somewhere else instead, which is solved for"
    if not all(record.stepped and np.iscomplexobj(record.readings) for record in case.records):
        return ""
    slowest = float(np.sqrt(np.linalg.eigvalsh(joint.at(after.vector).device.stiffness_matrix)[0]))
    periods = float(after.vector[joint.of_effect(place)][0]) * slowest / (2.0 * np.pi)
    if periods <= LATEST or per_freedom(after) <= gate(after.dof):
        return ""
    return (
        f"it would be {periods:.2g} periods of the resonance, which sweeps show as a phase, and leaves more than noise"
    )


def unsure_noise(case: Case, readings: Sequence[Readings]) -> np.ndarray:
    """One over the degrees of freedom with which the noise of each number of a residual (r,) was estimated."""
    loose = np.array([1.0 / record.noise_freedom for record in case.records] + [0.0])  # the last is for no record
    return np.concatenate([np.repeat(loose[r.record], r.size // r.record.size) for r in readings])


def judged_by_misfit(found: Score, chi2: float, dof: int, unsure: np.ndarray | float = 0.0) -> float:
    """The p-value of a score alone, where what would be left beside it counts as noise if it is more than noise.

    With T of χ² explained, what is left per degree of freedom is the scale: an effect stands out from the misfit of the
    model, not from a noise that the model is far from. `unsure` is that of each reading's noise, from `unsure_noise`.
    """
    if found.size == 0:
        return found.p_value
    left, rest = chi2 - found.statistic, max(dof - found.size, 1)
    doubt = float(np.sum(np.reshape(unsure, (-1, 1)) * found.directions**2)) / found.size
    freedom = 1.0 / doubt if doubt > 0 else np.inf
    if left / rest <= gate(rest, freedom=freedom):
        # An estimate of the noise and what is left are two of the same.
        both = (left + freedom, rest + freedom) if doubt > 0 else (1.0, 1.0)
        return survival(found, freedom + rest, both[0] / both[1])
    return survival(found, rest, left / rest)
