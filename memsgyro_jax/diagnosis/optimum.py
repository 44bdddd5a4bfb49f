"""The maximum of the likelihood of readings: which parameters can move, within their bounds, and where they end."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.least_squares import Information, gate, least_squares

from .joint_residual import Joint


GAUSS_NEWTON = 1e-12  # damping to begin with: none, in units of a standard deviation
STATIONARY = 0.02  # standard deviations by which the residual may miss the optimum
NEAR = 0.1  # of the way to a bound: before that a step is straight
FAR = 20.0  # in natural logarithms: no strength moves by a larger factor at once
WHOLE = 30  # evaluations of a fit that is to end; fewer are a glance
POOR = 20.0  # χ² per degree of freedom, above which what a fit leaves is no noise
ALIKE = 9.0  # of χ²: so much worse a device may fit than what is none
FLAT = 1e-6  # of the slope by a parameter: below it, it stands at its bound


@dataclass(frozen=True)
class Optimum:
    """Where a fit ended.

    Args:
        vector: all parameters.
        free: places of those that moved.
        residual: whitened, of the fitted readings (r,).
        jacobian: of the residual by the free parameters (r, k).
        frozen: null directions that were held, each a combination (k,) of the free parameters over their scales.
        converged: whether the optimiser met its tolerance.
        evaluations: of residual and Jacobian.
    """

    vector: np.ndarray
    free: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    frozen: np.ndarray
    converged: bool
    evaluations: int

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals."""
        return float(self.residual @ self.residual)

    @cached_property
    def dof(self) -> int:
        """Readings that are compared, without rows that only fill up a shape, less the parameters that moved."""
        compared = (self.residual != 0) | np.any(self.jacobian != 0, axis=1)
        return int(compared.sum()) - self.free.size

    @property
    def leaves_noise(self) -> bool:
        """Whether what is left is no more than noise: beyond it no standard deviation says how sure a number is."""
        return bool(self.chi2 / self.dof <= gate(self.dof))

    @cached_property
    def information(self) -> Information:
        """What the fitted readings hold of the free parameters."""
        return Information.of(self.jacobian)

    @property
    def covariance(self) -> np.ndarray:
        """Of the free parameters (k, k); infinite along parameters with a part in a null direction."""
        return np.asarray(self.information.covariance)

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of each free parameter; infinite where the data do not hold it."""
        return np.asarray(self.information.std)


def optimise(
    joint: Joint,
    vector: np.ndarray,
    places: np.ndarray,
    chosen: Sequence[Readings],
    *,
    known: tuple[np.ndarray, np.ndarray] | None = None,
    max_evaluations: int = WHOLE,
    beat: float = np.inf,
) -> Optimum:
    """Move the parameters at `places` to the maximum of the likelihood of the chosen readings, within their bounds.

    Directions that the data do not hold are frozen where they are, for a drifting nuisance destroys every later test.
    What depends on a strength that was zero, or would leave its bound at first, is tried again where the others end.
    Of two axes the one that hardly moves takes what the model of the other lacks, and is led astray: where a fit ends
    at no device, the other axis goes first, and what that leads to is taken if it fits as well, or the fit was poor.
    Where that is no device either, the axis stays where it began.

    Args:
        joint: residual and sensitivities.
        vector: all parameters at the start.
        places: of those that move.
        chosen: the readings.
        known: residual and Jacobian by those parameters at the start, where they are known already.
        max_evaluations: bound on evaluations; 0 only evaluates.
        beat: χ² from which the fit is of use; one that will not get there is given up.
    """
    found = _descended(joint, vector, places, chosen, known, max_evaluations, beat)
    if max_evaluations < WHOLE or _is_device(joint, found.vector):
        return found
    first = np.setdiff1d(places, _of_weaker_axis(joint, vector, places, chosen))
    if first.size == places.size:
        return found
    own = _descended(joint, vector, first, chosen, None, max_evaluations, beat)
    again = _descended(joint, own.vector, places, chosen, None, max_evaluations, beat)
    poor = found.chi2 > POOR * found.dof
    if _is_device(joint, again.vector) and (poor or again.chi2 < found.chi2 + ALIKE):
        return again
    if _is_device(joint, own.vector) and (poor or own.chi2 < found.chi2 + ALIKE):
        beside = _descended(joint, own.vector, places, chosen, None, 0)  # what readings hardly hold stays where it was
        return replace(beside, converged=own.converged and not poor)
    return found


def _is_device(joint: Joint, vector: np.ndarray) -> bool:
    """Whether the device is pushed back and slowed down whichever way it moves."""
    device = joint.at(vector).device
    return device.is_held and device.is_slowed


def _of_weaker_axis(joint: Joint, vector: np.ndarray, places: np.ndarray, chosen: Sequence[Readings]) -> np.ndarray:
    """Places of what belongs to the axis that the readings show less of, and of what couples it to the other."""
    names = [parameter.name for parameter in joint.parameters]
    own = [names.index(name) for name in ("kxx/m", "kyy/m") if name in names]
    if len(own) < 2 or not np.isin(own, places).all():
        return places[:0]
    slopes = joint.linearise(vector, np.eye(vector.size)[own], chosen)[1]
    weaker = "xy"[int(np.argmin(np.linalg.norm(slopes, axis=0) * vector[own]))]
    mine = {f"{kind}{weaker}{weaker}/m" for kind in "kd"} | {"kxy/m", "dxy/m"}
    return np.array([i for i in places if names[i] in mine], dtype=int)


def _descended(
    joint: Joint, vector: np.ndarray, places: np.ndarray, chosen: Sequence[Readings],
    known: tuple[np.ndarray, np.ndarray] | None, max_evaluations: int, beat: float = np.inf,
) -> Optimum:  # fmt: skip
    """`optimise` from where it begins."""
    units = np.eye(vector.size)[places]
    value, slope = _finite(*(joint.linearise(vector, units, chosen) if known is None else known))
    first, count, done, tried = slope, 1, True, np.zeros(places.size, bool)
    while count < max_evaluations:
        free = _movable(joint, vector, places, value, slope)
        if not np.any(free & ~tried):
            break
        tried, first = tried | free, slope
        course = _Course(joint, vector, places[free], slope[:, free], chosen)
        end = least_squares(
            course.linearise,
            (value, slope[:, free] @ course.ways.T),
            damping=GAUSS_NEWTON,
            tolerance=STATIONARY,
            evaluations=max_evaluations - count + 1,
            beat=beat,
        )
        vector, along = course.at(end.place)
        count, done = count + int(end.evaluations) - 1, bool(end.settled(STATIONARY))
        late = ~free & (np.any(first != 0, axis=0) | np.isin(places, joint.numbers))
        if np.all(along > FLAT) and not np.any(late):
            value, slope = end.residual, np.zeros_like(slope)
            slope[:, free] = end.slope @ course.back / along
            break
        value, slope = _finite(*joint.linearise(vector, units, chosen))
        count += 1
    begin = Information.of(first)
    return Optimum(vector, places, value, slope, begin.directions[~begin.held], done, count)


def _movable(joint: Joint, vector: np.ndarray, places: np.ndarray, value: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Which of the parameters move the residual and would not leave their bounds in a step of Gauss and Newton."""
    low, high = (bound[places] for bound in joint.bounds)
    free = np.any(slope != 0, axis=0)
    while np.any(free):
        size = np.linalg.norm(slope[:, free], axis=0)
        step = np.zeros(free.size)
        step[free] = -np.linalg.lstsq(slope[:, free] / size, value)[0] / size
        out = free & (((vector[places] <= low) & (step < 0)) | ((vector[places] >= high) & (step > 0)))
        if not np.any(out):
            break
        free = free & ~out
    return free


class _Course:
    """Coordinates of a descent: combinations that the data hold, bent so that no parameter leaves its bounds.

    A strength beside a number that scales the effect too, such as an exponent, moves by factors: in its logarithm the
    valley that both make is straight.

    Args:
        places: of the parameters that move, in the vector.
        slope: of the residual by them at the start (r, f).
    """

    def __init__(self, joint: Joint, vector: np.ndarray, places: np.ndarray, slope: np.ndarray, chosen):
        self.joint, self.vector, self.places, self.chosen = joint, vector, places, chosen
        begin = Information.of(slope)
        held = begin.directions[begin.held]
        self.ways, self.back = held / begin.size, held * begin.size
        self.rows = np.eye(vector.size)[places]
        beside = [joint.of_effect(i) for i in range(len(joint.model.effects)) if joint.numbers_of(i).size]
        self.factors = np.isin(places, np.concatenate([np.zeros(0, int), *beside])) & (vector[places] != 0)

    def at(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The vector at a place (k,), and how much of a step there each parameter that moves still follows (f,)."""
        low, high = (bound[self.places] for bound in self.joint.bounds)
        start, step = self.vector[self.places], place @ self.ways
        values, along = bent(start, step, low, high)
        factor = np.exp(np.clip(step / np.where(self.factors, start, 1.0), -FAR, FAR) * self.factors)
        values, along = np.where(self.factors, start * factor, values), np.where(self.factors, factor, along)
        vector = self.vector.copy()
        vector[self.places] = values
        return vector, along

    def linearise(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual and its slopes by the coordinates."""
        vector, along = self.at(place)
        new, slopes = self.joint.linearise(vector, (self.ways * along) @ self.rows, self.chosen)
        return _finite(new, slopes)


def _finite(residual: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Something finite and large where the model has no residual, and no slopes where it has none."""
    return np.where(np.abs(residual) < 1e100, residual, 1e6), np.where(np.abs(slopes) < 1e100, slopes, 0.0)


def bent(start: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """start + step, but in the last part b = `NEAR` of the way to a bound what is left of the step, s, goes s·b/(b + s)
    far, so that the bound is never passed; also the derivative by the step.
    """
    way = np.minimum(np.maximum(np.where(step < 0, start - low, high - start), 0.0), 1e300)
    rest = np.maximum(np.abs(step) - (1.0 - NEAR) * way, 0.0)
    share = np.where(rest > 0, NEAR * way / (NEAR * way + np.where(rest > 0, rest, 1.0)), 1.0)
    return start + step - np.sign(step) * rest * (1.0 - share), share**2
