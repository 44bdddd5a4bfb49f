"""Sobol indices of a sweep: which share of an output's variance each parameter, and the noise, is answerable for.

Two independent sets of dies A and B, and for each input i the dies A with input i taken from B. With f their outputs,

    first order  S_i = mean(f_B (f_ABi - f_A)) / var          (Saltelli et al., Comput. Phys. Commun. 181 (2010) 259)
    total        T_i = mean((f_A - f_ABi)²) / (2 var)         (Jansen, Comput. Phys. Commun. 117 (1999) 35)

The measurement noise is one more input: a die of ABi has the noise of its die in A.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario

from ..spread import Points, Spread, as_spread
from .outputs import Output, mean, standard_deviation
from .points import inputs_of, run_at
from .result import Sensitivity


if TYPE_CHECKING:
    from matplotlib.axes import Axes

NOISE = "noise"
RESAMPLES = 999
FEWEST = 20
"""Dies of both sets that must differ from all others in an output, one that is nearly always 0 say, for it to have
indices: those of fewer say which dies were drawn.
"""
_DASH = "     -"  # as wide as an index
_UNTOLD = "-: not told, as its uncertainty is larger than itself; more `points` narrow it"


@dataclass(frozen=True, eq=False, repr=False)
class Sobol(Sensitivity):
    """Indices of every output by every input, the last of which is the measurement noise.

    Args:
        first, total: indices (outputs, inputs); NaN for an output that is the same in all but `FEWEST` dies.
        first_interval, total_interval: their bootstrap intervals (outputs, inputs, 2).
        mean, std: of each output over the dies, in its unit (outputs,).
        points: of set A.
        dropped: points of A left out of each output (outputs,), because one of their dies was lost.
        failed: lost dies of all.
        dies: that were run.
        confidence: of the intervals.
    """

    first: Float[np.ndarray, "outputs inputs"]
    total: Float[np.ndarray, "outputs inputs"]
    first_interval: Float[np.ndarray, "outputs inputs 2"]
    total_interval: Float[np.ndarray, "outputs inputs 2"]
    mean: Float[np.ndarray, " outputs"]
    std: Float[np.ndarray, " outputs"]
    points: int
    dropped: Int[np.ndarray, " outputs"]
    failed: int
    dies: int
    confidence: float

    @property
    def status(self) -> str:
        text = f"{self.dies} dies at {self.points} points, {self.failed} lost"
        most = int(np.max(self.dropped))
        return text + (f"; {most} points with a lost die are left out of the errors" if most else "")

    def _title(self) -> str:
        return f"Sobol indices with {100 * self.confidence:g} % intervals"

    def _text(self, output: int) -> str:
        name, unit, mean = self.outputs[output], self.units[output], self.mean[output]
        if not np.isfinite(self.first[output]).any():
            if not np.isfinite(mean):
                return f"{name}: every die was lost"
            if self.std[output] == 0.0:
                return f"{name}: {mean:.4g} {unit} for all"
            return f"{name}: {mean:.4g} {unit}; no indices, because {self._why_none(output)}"
        rows = [("  input", "first order", "total")]
        for i in np.argsort(-self.total[output]):
            indices = ((self.first, self.first_interval), (self.total, self.total_interval))
            rows.append((f"  {self.inputs[i]}", *(_index(v[output, i], *ends[output, i]) for v, ends in indices)))
        untold = f"\n  {_UNTOLD}" if any(told.startswith(_DASH) for row in rows[1:] for told in row[1:]) else ""
        return f"{name}: {mean:.4g} ± {self.std[output]:.3g} {unit}\n{aligned(rows)}{untold}"

    def _why_none(self, output: int) -> str:
        """Too few dies for any indices, with how many points it takes, or too few of them that differ."""
        kept = self.points - int(self.dropped[output])
        if 2 * kept > FEWEST:
            return f"it is the same for all but fewer than {FEWEST} dies"
        which = f"{self.points} points" if kept == self.points else f"{kept} points without a lost die"
        enough = FEWEST // 2 + 1
        needed = 1 << int(np.ceil(np.log2(enough * self.points / max(kept, 1))))
        return f"{which} are too few of at least {enough}; give `points` = {needed} or, for small indices, some hundred"

    def plot(self, ax: "Axes | None" = None, output: str | None = None) -> "Axes":
        """Total (light) and first-order (dark) index of every input of one output, with intervals; returns the axes."""
        ax, k = axes(ax), self._place(output)
        total, first = self.total[k], self.first[k]
        bars = [(total, np.abs(self.total_interval[k].T - total), "total"),
                (first, np.abs(self.first_interval[k].T - first), "alone (first order)")]  # fmt: skip
        self._bars(ax, np.argsort(np.nan_to_num(total)), bars)
        ax.set_xlabel(f"share of the variance of: {self.outputs[k]}")
        ax.legend(loc="lower right", frameon=False)
        return ax


def sobol(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Scenario | AbstractProfile | float = 1.0,
    *,
    points: int = 128,
    of: Sequence[Output] | None = None,
    confidence: float = 0.95,
    seed: int = 0,
    **settings: Any,
) -> Sobol:
    """Sobol indices of the outputs of a sweep over `spread`, which must be independent.

    Each of the two sets has `points` points, a power of two; `points` times (number of varied parameters + 3) dies are
    run. `confidence` is that of the bootstrap intervals. Other arguments are those of `tornado`.

    Raises `InputError` for a correlated spread, one without variations, `points` that are no power of two, and settings
    that `sweep` refuses.
    """
    _check(spread, points)
    inputs = inputs_of(loop, spread)
    planned = designed_points(len(inputs), points, seed)
    run = run_at(planned, loop, spread, scenario, of, seed, settings)
    found = run.values.reshape(len(run.chosen), len(inputs) + 3, points)
    parts = [indices_of(sets, confidence, np.random.default_rng((seed, k))) for k, sets in enumerate(found)]
    first, total, first_interval, total_interval, dropped = (np.stack(part) for part in zip(*parts, strict=True))
    plain = found[:, :2].reshape(len(found), -1)
    return Sobol(
        **run.told,
        inputs=(*inputs, NOISE),
        first=first,
        total=total,
        first_interval=first_interval,
        total_interval=total_interval,
        mean=mean(plain),
        std=standard_deviation(plain),
        points=points,
        dropped=dropped,
        failed=run.lot.summary.failed,
        dies=run.lot.summary.dies,
        confidence=confidence,
    )


def _check(spread: Spread, points: int) -> None:
    if as_spread(spread).correlation is not None or spread.shared > 0.0:
        raise InputError(
            "Argument `spread` must be independent for Sobol indices, but has a correlation; leave `correlation` and "
            "`shared` out."
        )
    if points < 2 or points & (points - 1):
        raise InputError(f"Argument `points` must be a power of two, at least 2, but is {points}.")


def designed_points(count: int, points: int, seed: int) -> Points:
    """Sets A, B, A with the noise of B, and A with one input of B at a time, one after the other."""
    sequence = stats.qmc.Sobol(2 * count, scramble=True, rng=np.random.default_rng((seed, count)))
    uniform = sequence.random_base2(int(np.log2(points)))
    normal = stats.norm.ppf(np.clip(uniform, 1e-12, 1.0 - 1e-12))
    a, b = normal[:, :count], normal[:, count:]
    mixed = [np.where(np.arange(count) == i, b, a) for i in range(count)]
    own, other = np.arange(points), np.arange(points) + points
    return Points(np.concatenate([a, b, *mixed, a]), np.concatenate([own, other, np.tile(own, count), other]))


def indices_of(values: Float[np.ndarray, "sets points"], confidence: float, rng: np.random.Generator) -> tuple:
    """First-order and total indices, their intervals (inputs, 2), and how many points were left out, from the outputs
    of A, B, and A with one input of B at a time; points with a NaN in any set are left out.
    """
    whole = np.all(np.isfinite(values), axis=0)
    kept, inputs = values[:, whole], len(values) - 2
    unknown = np.full(inputs, np.nan)
    dropped = np.asarray(values.shape[1] - kept.shape[1])
    alike = np.unique(kept[:2], return_counts=True)[1]
    if kept.shape[1] < 2 or kept[:2].size - np.max(alike, initial=0) < FEWEST:
        return unknown, unknown, np.full((inputs, 2), np.nan), np.full((inputs, 2), np.nan), dropped

    first, total = _estimates(kept)
    again = [_estimates(kept[:, rng.integers(kept.shape[1], size=kept.shape[1])]) for _ in range(RESAMPLES)]
    # Few points of an output that only counts may resample to one that does not vary: no index, left out.
    ends = np.nanquantile(np.stack(again), [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], axis=0)
    return first, total, ends[:, 0].T, ends[:, 1].T, dropped


def _index(value: float, low: float, high: float) -> str:
    """An index with its interval, without its value where that is less than its uncertainty."""
    told = f"{value:6.3f}" if abs(value) >= 0.5 * (high - low) else _DASH
    return f"{told} ({low:.3f} to {high:.3f})"


def _estimates(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First-order and total indices (inputs,) from outputs (2 + inputs, points)."""
    a, b, *rest = values - np.mean(values[:2])
    mixed, variance = np.stack(rest), np.var(values[:2])
    variance = variance if variance > 0.0 else np.nan
    return np.mean(b * (mixed - a), axis=-1) / variance, 0.5 * np.mean((a - mixed) ** 2, axis=-1) / variance
