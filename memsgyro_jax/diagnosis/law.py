"""An unknown law, drawn from the rows of a case without a catalogue and written as an effect to edit.

The law is a sum of at most three terms F = −s·z·(max(|z| − t, 0)/z₀)^e, z a displacement or a velocity: a power with
free exponent, from a threshold on or from rest; each next one is that which leaves least of the rows' equations. Or it
is a spline: a stiffness and a damping between knots. The numbers start a fit; they do not replace it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import equinox as eqx
import numpy as np
from scipy.optimize import minimize

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.effects.instrument import DriveLevel
from memsgyro_jax.effects.lock_in_terms import LockInBackground, ReferencePhase
from memsgyro_jax.effects.trial import at_strength
from memsgyro_jax.measurement.calibration import length_of_records, per_second, units_of_records
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.model import Model

from .backbone import KNOTS, Equations, describing, equations
from .fit import CaseFit
from .instrument import instrument_terms
from .law_file import LawTerm, bends, law_text


TERMS = 3
EXPONENTS = {"stiffness": (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0), "damping": (-0.9, -0.5, 0.5, 1.0, 2.0, 3.0, 4.0)}
BEYOND = (0.0, 1.0)  # exponents tried beyond a threshold
THRESHOLDS = (0.15, 0.3, 0.45, 0.6, 0.75, 0.85)  # of the largest size
STILL = 0.01  # of the damping that a linear fit finds, which a device at rest has at least
WORTH = 0.05  # of what is left, which a further term must take
CANCEL = 0.05  # of the sizes of all terms of one kind: where no row shows more of their sum, they cancel


@dataclass(frozen=True, eq=False, repr=False)
class DrawnLaw(Shown):
    """A law as terms, or as a spline where there are none.

    Args:
        measured, axis: what it was drawn from, 0 = x, 1 = y.
        terms: in the order in which they were found; one of "even_stiffness", which no row tells, comes from a fit.
        knots, values: of the spline: where its slope changes and by how much, per kind; empty beside terms.
        seen: lowest and highest displacement and velocity amplitude that any row has, in what the records are in.
        left: root mean square of what is left of the rows over their noise: without any law, and with it.
        beside: the model with the linear part that goes with the law, from which a fit should start.
    """

    measured: Case
    axis: int
    terms: tuple[LawTerm, ...]
    knots: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]
    seen: tuple[tuple[float, float], tuple[float, float]]
    left: tuple[float, float]
    beside: Model

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects in the file."""
        kinds = [term.kind for term in self.terms] + ["stiffness", "damping"][: len(self.values)]
        return tuple(
            f"drawn_{kind}" + (f"_{kinds[: k + 1].count(kind)}" if kinds[:k].count(kind) else "")
            for k, kind in enumerate(kinds)
        )

    def write(self, path: str | Path) -> Path:
        """The effect file, whole or not at all."""
        splines = tuple(zip(self.knots, self.values, strict=True))
        length, units = length_of_records(self.measured), units_of_records(self.measured)
        text = law_text(self.measured.name, self.axis, self.names, self.seen, self.terms, splines, length, units)
        return write_whole(path, text)

    def __str__(self) -> str:
        where = f"{self.measured.name}, axis {'xy'[self.axis]}: what is left of the rows"
        if not self.names:
            return f"{where}, {self.left[0]:.4g} × noise, holds no law beyond a linear device"
        lines = [f"{where}, each by itself, falls from {self.left[0]:.4g} to {self.left[1]:.4g} × noise with"]
        for name, term in zip(self.names, self.terms, strict=False):
            more = "" if term.threshold is None else f", threshold = {term.threshold:.4g}"
            lines.append(f"  {name}: {term.formula}, s = {term.strength:.4g}, exponent = {term.exponent:.3g}{more}")
        lines += [f"  {name}: straight lines with rounded corners" for name in self.names[len(self.terms) :]]
        (low, high), (slow, fast), length = *self.seen, length_of_records(self.measured)
        lines.append(
            f"  seen from {low:.3g} to {high:.3g} {length} and {slow:.3g} to {fast:.3g} {per_second(length)}; beyond, "
            "the law extrapolates"
        )
        if not any(term.kind == "even_stiffness" for term in self.terms):
            lines.append("  drawn the same for both signs: amplitude and phase at the drive do not tell them apart")
        return "\n".join(lines)


def draw_law(fit: CaseFit, axis: int = 0, *, terms: int = TERMS, spline: bool = False) -> DrawnLaw:
    """The law of one axis that the rows of a case show beside a fitted model.

    Args:
        fit: the case beside its base model, from `fit`.
        axis: 0 = x, 1 = y.
        terms: at most so many.
        spline: draw the forces between knots instead.

    Raises:
        InputError: where too few rows show the axis.
    """
    given = equations(fit, axis)
    sizes, grids, tables = splines(given)
    columns = given.columns(*tables.values())
    weight = given.robust(columns)
    found, _, rest = given.solve(columns, weight)
    plain = _Trial(given, sizes, weight, (), -(1 - STILL) * float(fit.model.device.damping[axis]))
    chosen, left, places = plain, rms(rest, weight), (0, KNOTS, 2 * KNOTS)
    if not spline:
        chosen = _grown(plain, terms)
        left, found, stiff = chosen.left, chosen.found, sum(t.kind == "stiffness" for t in chosen.terms)
        places = (0, 1 + stiff, 2 + len(chosen.terms))
    beside = _beside(fit, axis, given, found[places[0]], found[places[1]], found[places[2] :])
    mass = 1.0 / abs(float((fit.model if fit.joint.gain is None else beside).device.mobility))
    values = tuple(mass * found[p + 1 : p + KNOTS] for p in places[:2]) if spline else ()
    seen = tuple((float(z.min()), float(z.max())) for z in sizes.values())
    return DrawnLaw(
        measured=fit.case, axis=axis, terms=() if spline else chosen.solved(mass),
        knots=tuple(grids.values()) if spline else (), values=values, seen=(seen[0], seen[1]),
        left=(plain.left, left), beside=beside,
    )  # fmt: skip


def splines(given: Equations) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], dict[str, np.ndarray]]:
    """For stiffness and damping: the size (n,) of what each row has of its variable, knots, and describing functions
    (n, 1 + knots) of a force that is straight between them.
    """
    sizes = {"stiffness": given.amplitude, "damping": given.amplitude * given.omega}
    grids = {kind: np.geomspace(max(z.min(), z.max() / 30.0), z.max(), KNOTS) for kind, z in sizes.items()}
    tables = {
        kind: np.stack([np.ones(len(given.omega)), *(describing(hat, sizes[kind]) for hat in bends(grid))], 1)
        for kind, grid in grids.items()
    }
    return sizes, grids, tables


def _beside(
    fit: CaseFit, axis: int, given: Equations, stiffness: float, damping: float, nuisances: np.ndarray
) -> Model:
    """The fitted model with what the rows say of its linear part, its gain and its lock-in beside the law."""
    device = fit.model.device
    gain, phase, *constant = (*nuisances, 0.0, 0.0, 0.0, 0.0)[:4] if len(nuisances) else (0.0,) * 4
    stiff, damp = (np.array(values) for values in (device.stiffness, device.damping))
    stiff[axis] = max(stiff[axis] + stiffness, 0.25 * stiff[axis])
    damp[axis] = max(damp[axis] + damping, STILL * damp[axis])
    mobility = device.mobility * max(float(np.hypot(1.0 + gain, phase)), 0.01)
    mobility = mobility if fit.joint.gain is None else fit.joint.gain * stiff[axis]
    model = eqx.tree_at(lambda m: m.device, fit.model, NormalisedDevice(stiff, damp, mobility))
    if not len(nuisances):
        return model
    volts = np.zeros(2 * model.axes)
    # A constant reading stands in the equations as a displacement, which a derivative's channel shows by (iω)ⁿ.
    shown = complex(*constant) * float(model.scale[axis]) * (1j * np.median(given.omega)) ** model.order
    volts[2 * axis : 2 * axis + 2] = shown.real, shown.imag
    starts = {ReferencePhase: np.arctan2(phase, 1.0 + gain), LockInBackground: volts, DriveLevel: 0.0}
    known = {effect.name for effect in model.effects}
    # Of a term for all rows and one for each record that which all share: both together are one number too many.
    terms = [t for t in instrument_terms(fit.case) if type(t) in starts and not t.where and t.name not in known]
    return model.with_effect(*(at_strength(t, np.zeros(t.strength.shape) + starts[type(t)]) for t in terms))


@dataclass(frozen=True, eq=False)
class _Trial:
    """Terms beside a linear device and the nuisances: linear least squares at given exponents and thresholds."""

    given: Equations
    sizes: dict[str, np.ndarray]
    weight: np.ndarray
    terms: tuple[LawTerm, ...]
    least: float  # linear damping beyond the fitted: below it, nothing would damp the device at rest

    def columns(self) -> np.ndarray:
        return self.given.columns(*self._tables)

    @cached_property
    def _tables(self) -> tuple[np.ndarray, ...]:
        """Describing functions (n, 1 + terms) of stiffness and damping, that of a linear force first."""
        tables = []
        for kind, size in self.sizes.items():
            mine = [describing(term.share, size) for term in self.terms if term.kind == kind]
            tables.append(np.stack([np.ones(len(size)), *mine], axis=1))
        return tuple(tables)

    @property
    def left(self) -> float:
        """Root mean square of what is left; infinite where a force that falls with speed would feed the motion, and
        where terms of one kind cancel: two alike of opposite sign are a slope in what tells them apart, and no law.
        """
        found, rest = self._solution
        falling = [t.exponent < 0 > t.strength for t in self._with(found)]
        return np.inf if any(falling) or self._cancels(found) else rms(rest, self.weight)

    def _cancels(self, found: np.ndarray) -> bool:
        """Whether all terms of one kind together are next to nothing of what they are one by one."""
        count = self._tables[0].shape[1]
        for table, values in zip(self._tables, (found[:count], found[count:]), strict=True):
            parts = table[:, 1:] * values[1 : table.shape[1]]
            whole, sizes = np.abs(parts.sum(axis=1)), np.abs(parts).sum(axis=1)
            if np.max(whole) < CANCEL * np.max(sizes):
                return True
        return False

    @property
    def found(self) -> np.ndarray:
        """The solution: linear stiffness and its terms, linear damping and its terms, nuisances."""
        return self._solution[0]

    @cached_property
    def _solution(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers and what they leave (2n,)."""
        columns, damping = self.columns(), 1 + sum(term.kind == "stiffness" for term in self.terms)
        found, _, rest = self.given.solve(columns, self.weight)
        if found[damping] >= self.least:
            return found, rest
        others = np.delete(columns, damping, axis=1)
        held = replace(self.given, target=self.given.target - (self.least * columns[:, damping]).reshape(-1, 2))
        found, _, rest = held.solve(others, self.weight)
        return np.insert(found, damping, self.least), rest

    def solved(self, mass: float) -> tuple[LawTerm, ...]:
        """The terms with their strengths."""
        return self._with(mass * self.found)

    def _with(self, found: np.ndarray) -> tuple[LawTerm, ...]:
        out = []
        stiff = 1 + sum(term.kind == "stiffness" for term in self.terms)
        place = {"stiffness": 1, "damping": stiff + 1}
        for term in self.terms:
            out.append(replace(term, strength=float(found[place[term.kind]])))
            place[term.kind] += 1
        return tuple(out)

    def polished(self) -> "_Trial":
        """Exponents and thresholds of all terms moved to where least is left."""
        numbers = [
            n for t in self.terms for n in (t.exponent, *(() if t.threshold is None else (t.threshold / t.size,)))
        ]

        def at(values: Sequence[float]) -> _Trial:
            rest, terms = list(values), []
            for term in self.terms:
                moved = replace(term, exponent=float(np.clip(rest.pop(0), *term.bounds)))
                if term.threshold is not None:
                    place = np.clip(rest.pop(0) * term.size, term.least, 0.98 * term.size)
                    moved = replace(moved, threshold=float(place))
                terms.append(moved)
            return replace(self, terms=tuple(terms))

        best = minimize(lambda v: at(v).left, numbers, method="Nelder-Mead", options={"maxfev": 120 * len(numbers)})
        better = at(best.x)
        return better if better.left < self.left else self


def _grown(trial: _Trial, most: int) -> _Trial:
    """Terms one by one, each the best beside those before, while a further one is worth it."""
    for _ in range(most):
        tried = [replace(trial, terms=(*trial.terms, term)) for term in _family(trial.sizes)]
        best = min(tried, key=lambda one: one.left).polished()
        if not is_worth(best.left, trial.left, len(trial.given.amplitude)):
            break
        trial = best
    return trial


def _family(sizes: dict[str, np.ndarray]) -> list[LawTerm]:
    out = []
    for kind, size in sizes.items():
        top, least = float(size.max()), float(size.min())
        out += [LawTerm(kind, 1.0, exponent, None, top, least) for exponent in EXPONENTS[kind]]
        reached = [share * top for share in THRESHOLDS if share * top > least]
        out += [LawTerm(kind, 1.0, exponent, t, top, least) for exponent in BEYOND for t in reached]
    return out


def is_worth(left: float, before: float, rows: int) -> bool:
    """Whether something further takes enough of what was left of some rows."""
    return bool(left <= (1 - WORTH) * before and 2 * rows * np.log(before / left) >= 3 * np.log(2 * rows))


def rms(rest: np.ndarray, weight: np.ndarray) -> float:
    """Root mean square of what is left (2n,) of rows with weights (2n,)."""
    return float(np.sqrt(np.average(rest**2, weights=weight**2)))
