"""What tuning found: the tuned loop, each free number's fate, and how unseen dies fare before and after."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from scipy import stats

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.montecarlo.batch import LOST
from memsgyro_jax.montecarlo.sweep import Lot


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

SCHEMA = "memsgyro-tuning/1"
CONSISTENT = (0.9, 1.1)  # mean of e²/S of a channel within which a filter's claims pass as right
_RESAMPLED = 2000  # bootstrap draws behind an interval


@dataclass(frozen=True)
class Interval:
    """A figure with its 95 % interval over dies, by bootstrap."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.low:.3g} to {self.high:.3g})"


@dataclass(frozen=True)
class Merit:
    """How a lot fares: mean, median and 95th percentile over dies of the mean squared rate error of the settled part,
    in (rad/s)², lost dies, and the filter's consistency.

    `nis` is the mean of e²/S of both channels (1 when consistent), `nees` the mean normalised estimation error squared
    at the end, `nees_expected` the number of states and `nees_interval` where 99 % of such means lie; None without a
    covariance.
    """

    mean: Interval
    median: Interval
    p95: Interval
    dies: int
    lost: int
    nis: tuple[float, float] | None
    nees: float | None
    nees_expected: int | None
    nees_interval: tuple[float, float] | None

    @property
    def consistent(self) -> bool | None:
        """Whether NIS of both channels and NEES are within their intervals; None without a covariance."""
        return None if self.nees is None else not self.inconsistency

    @property
    def inconsistency(self) -> str:
        """What is outside its interval, in words."""
        parts, (low, high) = [], CONSISTENT
        if self.nis is not None and not all(low <= nis <= high for nis in self.nis):
            parts.append(f"NIS is {_pair(self.nis)} instead of 1 ({low:g} to {high:g})")
        if self.nees is not None and self.nees_interval is not None:
            low, high = self.nees_interval
            if not low <= self.nees <= high:
                parts.append(f"NEES is {self.nees:.3g} instead of {self.nees_expected} ({low:.3g} to {high:.3g})")
        return " and ".join(parts)


@dataclass(frozen=True)
class TunedNumber:
    """A free number: `label` and `path`, `start`, tuned `value`, bounds `low` and `high` in SI, the `stage` that moved
    it, and its `fate` in words.
    """

    label: str
    path: str
    start: float
    value: float
    low: float
    high: float
    stage: str
    fate: str


@dataclass(frozen=True)
class StageResult:
    """One stage: its loss by name and why it was used, training and validation loss after each accepted step with the
    evaluations until then, how it ended, and directions along which nothing changes.
    """

    loss: str
    reason: str
    evaluations: tuple[int, ...]
    training: tuple[float, ...]
    validation: tuple[float, ...]
    best: int
    lost: int
    status: str
    nulls: tuple[str, ...]


@dataclass(frozen=True)
class Tuning(Shown):
    """Outcome of `tune`: the tuned `loop`, what moved, and figures on unseen dies with unseen noise.

    `ratio` is the mean squared error after over before, over the same dies; `warnings` are sentences that a user must
    read before believing it.
    """

    loop: ClosedLoop
    numbers: tuple[TunedNumber, ...]
    stages: tuple[StageResult, ...]
    before: Merit
    after: Merit
    ratio: Interval
    warnings: tuple[str, ...]
    settings: Settings
    lots: tuple[Lot, Lot]

    @property
    def status(self) -> str:
        """How each stage ended, and how many warnings there are."""
        ends = "; ".join(f"{stage.loss}: {stage.status}" for stage in self.stages)
        return ends + (f"; {len(self.warnings)} warning{'s'[: len(self.warnings) > 1]}" if self.warnings else "")

    def as_dict(self) -> dict[str, Any]:
        """The machine-readable form; SI, squared errors in (rad/s)²."""
        lots = {name: asdict(getattr(self, name)) for name in ("before", "after", "ratio")}
        rows = {name: [asdict(row) for row in getattr(self, name)] for name in ("numbers", "stages")}
        said = {"schema": SCHEMA, "status": self.status, "warnings": list(self.warnings)}
        return finite(said | rows | lots | self.settings.as_dict())

    def __repr__(self) -> str:
        return "\n".join([self._numbers_table(), "", self._merit_table(), "", *self._closing()])

    def _numbers_table(self) -> str:
        rows = [
            (n.label, f"{n.start:.4g}", f"{n.value:.4g}", f"{n.low:.2g} to {n.high:.2g}", n.fate) for n in self.numbers
        ]
        return aligned([("free number", "start", "tuned", "bounds", ""), *rows])

    def _merit_table(self) -> str:
        both = self.before, self.after
        rows = [(f"on {self.after.dies} unseen dies", "before", "after")]
        for name, field in (("mean squared error [(deg/s)²]", "mean"), ("median", "median"), ("95 %", "p95")):
            rows.append((name, *(_squared_degrees(getattr(merit, field)) for merit in both)))
        rows.append(("after over before", "1", str(self.ratio)))
        rows.append(("lost dies", *(str(merit.lost) for merit in both)))
        if self.after.nis is not None:
            rows.append(("NIS of x and y, 1 expected", *(_pair(merit.nis) for merit in both)))
        if self.after.nees is not None:
            rows.append(("NEES", *(_nees(merit) for merit in both)))
        return aligned(rows)

    def _closing(self) -> list[str]:
        lines = [f"{stage.loss}: {stage.status}; {stage.reason}" for stage in self.stages]
        lines += [f"no effect along {null}" for stage in self.stages for null in stage.nulls]
        return lines + [f"WARNING: {warning}" for warning in self.warnings]

    def to_xarray(self) -> "xr.Dataset":
        """Squared errors of each unseen die before and after, and the free numbers."""
        import xarray as xr

        squared = np.stack([squared_errors(lot) for lot in self.lots], axis=1)
        numbers = {name: ("number", [getattr(n, name) for n in self.numbers]) for name in ("start", "value")}
        return xr.Dataset(
            {"squared_error": (("die", "loop"), squared, {"units": "(rad/s)^2"}), **numbers},
            {"loop": ["before", "after"], "number": [n.label for n in self.numbers]},
            {"status": self.status, **self.settings.as_dict()},
        )

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Share of the unseen dies below a rate error, before and after."""
        ax = axes(ax)
        for name, lot, colour in zip(("before", "after"), self.lots, ("0.5", "C0"), strict=True):
            error = np.sort(np.degrees(lot.data["rate_error_rms"].values))
            share = 100.0 * np.arange(1, error.size + 1) / error.size  # lost dies sort last, as NaN: the top stays open
            ax.step(error, share, where="post", color=colour, lw=1.5, label=name)
        ax.set(
            xlabel="rms rate error of the settled part [deg/s]",
            ylabel="dies below [%]",
            xlim=(0.0, None),
            ylim=(0, 100),
        )
        ax.legend(loc="lower right", frameon=False)
        return ax


def squared_errors(lot: Lot) -> Float[np.ndarray, " dies"]:
    """Mean squared rate error of each die over the settled part, in (rad/s)²; NaN for a lost one."""
    return lot.data["rate_error_rms"].values ** 2


def merit_of(lot: Lot) -> Merit:
    """The figures of a lot."""
    status, squares = lot.data["status"].values, squared_errors(lot)
    alive = squares[status != LOST]
    nis, nees, states = None, lot.summary.nees, lot.summary.states
    if nees is not None:
        nis = tuple(float(v) for v in np.nanmean(lot.data["nis_channel"].values[status != LOST], axis=0))
    interval = None
    if nees is not None and states is not None:
        count = int(np.sum(np.isfinite(lot.data["nees_end"].values)))
        interval = tuple(float(v) for v in stats.chi2.ppf((0.005, 0.995), states * count) / count)
    figures = (_interval(alive, np.mean), _interval(alive, np.median), _interval(alive, _p95))
    lost = int(np.sum(status == LOST))
    return Merit(*figures, len(status), lost, nis, nees, states, interval)


def ratio_of(before: Lot, after: Lot) -> Interval:
    """Mean squared error after over before, on the dies that neither lost."""
    pair = np.stack([squared_errors(before), squared_errors(after)], axis=1)
    pair = pair[np.all(np.isfinite(pair), axis=1)]
    return _interval(pair, lambda rows, axis: np.mean(rows[..., 1], axis=axis) / np.mean(rows[..., 0], axis=axis))


def warnings_of(before: Merit, after: Merit) -> tuple[str, ...]:
    """What a user must know before believing the gain."""
    found = []
    gained = after.mean.value < before.mean.value
    if after.consistent is False:
        when = "the error falls while" if gained else "after tuning"
        found.append(
            f"{when} {after.inconsistency}: the gains are absorbing an error of the model; find what is missing first "
            "(`memsgyro compare`, `memsgyro diagnose`), add it or its process noise, and tune again."
        )
    if after.lost:
        found.append(f"{after.lost} of {after.dies} unseen dies are lost with the tuned loop ({before.lost} before).")
    if not gained:
        found.append("the error on unseen dies has not fallen; the start was as good.")
    return tuple(found)


def _interval(values: np.ndarray, figure: Any) -> Interval:
    if len(values) == 0:
        return Interval(float("nan"), float("nan"), float("nan"))
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(len(values), size=(_RESAMPLED, len(values)))]
    low, high = np.percentile(figure(drawn, axis=1), [2.5, 97.5])
    return Interval(float(figure(values, axis=0)), float(low), float(high))


def _p95(values: np.ndarray, axis: int) -> np.ndarray:
    return np.percentile(values, 95.0, axis=axis)


def _squared_degrees(interval: Interval) -> str:
    factor = np.degrees(1.0) ** 2
    return str(Interval(*(float(factor * v) for v in (interval.value, interval.low, interval.high))))


def _pair(nis: tuple[float, float] | None) -> str:
    return "-" if nis is None else f"{nis[0]:.3g}, {nis[1]:.3g}"


def _nees(merit: Merit) -> str:
    if merit.nees is None or merit.nees_interval is None:
        return "-"
    return f"{merit.nees:.3g} of {merit.nees_expected} ({merit.nees_interval[0]:.3g} to {merit.nees_interval[1]:.3g})"
