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
from jaxtyping import Float
from scipy import stats

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario

from ..spread import Points, Spread
from .outputs import Output, mean, place_of, standard_deviation
from .points import inputs_of, run_at


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

NOISE = "noise"
RESAMPLES = 999


@dataclass(frozen=True, eq=False)
class Sobol(Shown):
    """Indices of every output by every input; prints itself.

    Args:
        outputs, inputs: names; the last input is the measurement noise.
        first, total: indices (outputs, inputs); NaN for an output that does not vary.
        first_interval, total_interval: their bootstrap intervals (outputs, inputs, 2).
        mean, std: of each output over the dies, in its unit (outputs,).
        units: of the outputs.
        points: of set A.
        dropped: points of A left out of each output (outputs,), because one of their dies was lost.
        failed: lost dies of all.
        dies: that were run.
        confidence: of the intervals.
    """

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    first: Float[np.ndarray, "outputs inputs"]
    total: Float[np.ndarray, "outputs inputs"]
    first_interval: Float[np.ndarray, "outputs inputs 2"]
    total_interval: Float[np.ndarray, "outputs inputs 2"]
    mean: Float[np.ndarray, " outputs"]
    std: Float[np.ndarray, " outputs"]
    units: tuple[str, ...]
    points: int
    dropped: np.ndarray
    failed: int
    dies: int
    confidence: float
    settings: Settings

    @property
    def status(self) -> str:
        """A sentence: what was run and what was lost."""
        text = f"{self.dies} dies at {self.points} points, {self.failed} lost"
        most = int(np.max(self.dropped))
        return text + (f"; {most} points with a lost die are left out of the errors" if most else "")

    def __repr__(self) -> str:
        lines = [f"Sobol indices with {100 * self.confidence:g} % intervals: {self.status}"]
        for k, (name, unit) in enumerate(zip(self.outputs, self.units, strict=True)):
            if not np.isfinite(self.first[k]).any():
                lost = not np.isfinite(self.mean[k])
                lines.append(f"{name}: every die was lost" if lost else f"{name}: {self.mean[k]:.4g} {unit} for all")
                continue
            lines.append(f"{name}: {self.mean[k]:.4g} ± {self.std[k]:.3g} {unit}")
            rows = [("  input", "first order", "total")]
            for i in np.argsort(-self.total[k]):
                rows.append((f"  {self.inputs[i]}", *(self._text(kind, k, i) for kind in ("first", "total"))))
            lines.append(aligned(rows))
        return "\n".join(lines)

    def _text(self, kind: str, output: int, place: int) -> str:
        low, high = getattr(self, f"{kind}_interval")[output, place]
        return f"{getattr(self, kind)[output, place]:6.3f} ({low:.3f} to {high:.3f})"

    def to_xarray(self) -> "xr.Dataset":
        """Dataset over output, input and end of the interval."""
        import xarray as xr

        where = ("output", "input")
        return xr.Dataset(
            {
                "first": (where, self.first),
                "total": (where, self.total),
                "first_interval": ((*where, "end"), self.first_interval),
                "total_interval": ((*where, "end"), self.total_interval),
                "mean": ("output", self.mean),
                "std": ("output", self.std),
                "dropped": ("output", self.dropped),
            },
            coords={"output": list(self.outputs), "input": list(self.inputs), "end": ["low", "high"],
                    "unit": ("output", list(self.units))},
            attrs={"points": self.points, "dies": self.dies, "failed": self.failed, "confidence": self.confidence,
                   **self.settings.as_dict()},
        )  # fmt: skip

    def plot(self, ax: "Axes | None" = None, output: str | None = None) -> "Axes":
        """Total (light) and first-order (dark) index of every input of one output, with intervals; returns the axes."""
        output = self.outputs[0] if output is None else output
        ax, k = axes(ax), place_of(output, self.outputs)
        order = np.argsort(np.nan_to_num(self.total[k]))
        place = np.arange(len(order))
        for values, interval, colour, offset, label in (
            (self.total[k], self.total_interval[k], "C0", 0.2, "total"),
            (self.first[k], self.first_interval[k], "C1", -0.2, "alone (first order)"),
        ):
            value, ends = np.nan_to_num(values[order]), np.nan_to_num(interval[order])
            error = np.maximum(np.abs(ends.T - value), 0.0)
            ax.barh(place + offset, value, 0.4, xerr=error, color=colour, ecolor="0.4", label=label)
        ax.set_yticks(place, [self.inputs[i] for i in order])
        ax.axvline(0.0, color="k", lw=0.8)
        ax.set_xlabel(f"share of the variance of: {output}")
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
    """Sobol indices of the outputs of a sweep over `spread`.

    Args:
        loop, spread, scenario: as in `sweep`; the spread must be independent.
        points: of each of the two sets, a power of two; `points` times (number of varied parameters + 3) dies are run.
        of: outputs; without, errors of the rate, lost dies, and dies out of tolerance.
        confidence: of the bootstrap intervals.
        seed: of dies and noise.
        settings: of the sweep (`sample_rate`, `duration`, `tolerance`, `progress`, `out`, `resume`...).

    Raises:
        InputError: for a correlated spread, one without variations, `points` that are no power of two, or settings that
            `sweep` refuses.
    """
    _check(spread, points)
    inputs = inputs_of(loop, spread)
    planned = _points(len(inputs), points, seed)
    lot, chosen, values = run_at(planned, loop, spread, scenario, of=of, seed=seed, **settings)
    found = values.reshape(len(chosen), len(inputs) + 3, points)
    parts = [indices_of(sets, confidence, np.random.default_rng((seed, k))) for k, sets in enumerate(found)]
    first, total, first_interval, total_interval, dropped = (np.stack(part) for part in zip(*parts, strict=True))
    plain = found[:, :2].reshape(len(chosen), -1)
    return Sobol(
        outputs=tuple(o.name for o in chosen),
        inputs=(*inputs, NOISE),
        first=first,
        total=total,
        first_interval=first_interval,
        total_interval=total_interval,
        mean=mean(plain),
        std=standard_deviation(plain),
        units=tuple(o.unit for o in chosen),
        points=points,
        dropped=dropped,
        failed=lot.summary.failed,
        dies=lot.summary.dies,
        confidence=confidence,
        settings=lot.settings,
    )


def _check(spread: Spread, points: int) -> None:
    if spread.correlation is not None:
        raise InputError(
            "Argument `spread` must be independent for Sobol indices, but has a correlation; leave `correlation` out."
        )
    if points < 2 or points & (points - 1):
        raise InputError(f"Argument `points` must be a power of two, at least 2, but is {points}.")


def _points(count: int, points: int, seed: int) -> Points:
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
    if kept.shape[1] < 2 or np.ptp(kept[:2]) == 0.0:
        return unknown, unknown, np.full((inputs, 2), np.nan), np.full((inputs, 2), np.nan), dropped

    first, total = _estimates(kept)
    again = [_estimates(kept[:, rng.integers(kept.shape[1], size=kept.shape[1])]) for _ in range(RESAMPLES)]
    # Few points of an output that only counts may resample to one that does not vary: no index, left out.
    ends = np.nanquantile(np.stack(again), [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], axis=0)
    return first, total, ends[:, 0].T, ends[:, 1].T, dropped


def _estimates(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First-order and total indices (inputs,) from outputs (2 + inputs, points)."""
    a, b, *rest = values - np.mean(values[:2])
    mixed, variance = np.stack(rest), np.var(values[:2])
    variance = variance if variance > 0.0 else np.nan
    return np.mean(b * (mixed - a), axis=-1) / variance, 0.5 * np.mean((a - mixed) ** 2, axis=-1) / variance
