"""What tuning found: the tuned loop, each free number's fate, and how unseen dies fare before and after."""

from dataclasses import asdict, astuple, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.display import stated_at
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.labelled import Tabular, columns_of, labelled
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.montecarlo.batch import Plan
from memsgyro_jax.montecarlo.status import LOST
from memsgyro_jax.montecarlo.sweep import Lot

from .right import CONSISTENT, nees_interval, nis_interval, shift_of_nees


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

SCHEMA = "memsgyro-tuning/1"
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
    at the end, `nees_expected` what it is for a right filter, the number of states but for a rate that is another than
    the prior expects. Of 400 right filters one is outside `nis_interval` of a channel, one outside `nees_interval`.
    None without a covariance.
    """

    mean: Interval
    median: Interval
    p95: Interval
    dies: int
    lost: int
    nis: tuple[float, float] | None
    nees: float | None
    nees_expected: float | None
    nees_interval: tuple[float, float] | None
    nis_interval: tuple[tuple[float, float], tuple[float, float]] = (CONSISTENT, CONSISTENT)

    @property
    def consistent(self) -> bool | None:
        """Whether NIS of both channels and NEES are within their intervals; None without a covariance."""
        return None if self.nees is None else not self.inconsistency

    @property
    def cautious(self) -> bool:
        """Whether the filter claims more error than it makes, and nowhere less."""
        pairs = [] if self.nis is None else list(zip(self.nis, self.nis_interval, strict=True))
        pairs += [] if self.nees is None or self.nees_interval is None else [(self.nees, self.nees_interval)]
        return any(value < low for value, (low, _) in pairs) and all(value <= high for value, (_, high) in pairs)

    @property
    def inconsistency(self) -> str:
        """What is outside its interval, in words."""
        parts = []
        if self.nis is not None:
            within = [low <= nis <= high for nis, (low, high) in zip(self.nis, self.nis_interval, strict=True)]
            low, high = self.nis_interval[within.index(False)] if not all(within) else CONSISTENT
            parts += [] if all(within) else [f"NIS is {_pair(self.nis)} instead of 1 ({low:.3g} to {high:.3g})"]
        if self.nees is not None and self.nees_interval is not None:
            low, high = self.nees_interval
            if not low <= self.nees <= high:
                parts.append(f"NEES is {self.nees:.3g} instead of {self.nees_expected:.3g} ({low:.3g} to {high:.3g})")
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
class Tuning(Tabular):
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
    along: ClassVar[str] = "number"

    @property
    def status(self) -> str:
        """How each stage ended, and how many warnings there are."""
        ends = "; ".join(f"{stage.loss}: {stage.status}" for stage in self.stages)
        return ends + (f"; {len(self.warnings)} warning{'s'[: len(self.warnings) > 1]}" if self.warnings else "")

    def as_dict(self) -> dict[str, Any]:
        """The machine-readable form; SI, squared errors in (rad/s)²."""
        lots = {name: asdict(getattr(self, name)) for name in ("before", "after", "ratio")}
        rows = {name: [asdict(row) for row in getattr(self, name)] for name in ("numbers", "stages")}
        said = {"schema": SCHEMA, "status": self.status, "gains": list(self.gains), "warnings": list(self.warnings)}
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
        rows = [(f"on {self.after.dies} unseen dies (intervals of 95 %)", "before", "after")]
        for name, field in (("mean squared error [(deg/s)²]", "mean"), ("median", "median"), ("95 %", "p95")):
            rows.append((name, *(_squared_degrees(getattr(merit, field)) for merit in both)))
        rows.append(("after over before", "1", str(self.ratio)))
        rows.append(("lost dies", *(str(merit.lost) for merit in both)))
        if self.after.nis is not None:
            rows.append(("NIS of x and y, 1 expected", *(_pair(merit.nis) for merit in both)))
        if self.after.nees is not None:
            rows.append(("NEES", *(_nees(merit) for merit in both)))
        return aligned(rows)

    @property
    def gains(self) -> tuple[str, ...]:
        """What tuning has brought, in sentences, as far as unseen dies tell."""
        found, (before, after) = [], (self.before, self.after)
        if self.ratio.high < 1.0:
            found.append(f"the mean squared error on unseen dies falls to {self.ratio} of that before")
        elif self.ratio.low <= 1.0:
            found.append(f"the error on unseen dies is as before, within what they tell (ratio {self.ratio})")
        if before.consistent is False and after.consistent:
            said = f"NIS {_pair(before.nis)} -> {_pair(after.nis)}, NEES {before.nees:.3g} -> {after.nees:.3g}"
            found.append(f"what the filter claims of its error is right now: {said}")
        return tuple(found)

    def _closing(self) -> list[str]:
        lines = [f"{stage.loss}: {stage.status}; {stage.reason}" for stage in self.stages]
        lines += [f"no effect along {null}" for stage in self.stages for null in stage.nulls]
        return [*lines, *self.gains, *(f"WARNING: {warning}" for warning in self.warnings)]

    def to_xarray(self) -> "xr.Dataset":
        """The free numbers over `number`, squared errors of each unseen die before and after, their figures with the
        interval, and the losses over the accepted `step`s of all stages.
        """
        squared = np.stack([squared_errors(lot) for lot in self.lots], axis=1)
        names = ("mean", "median", "p95")
        figures = [[astuple(getattr(merit, name)) for merit in (self.before, self.after)] for name in names]
        steps = [
            (s.loss, *each) for s in self.stages for each in zip(s.evaluations, s.training, s.validation, strict=True)
        ]
        variables = {
            **columns_of("number", self.numbers, start=None, value=None, low=None, high=None, stage=None, fate=None),
            "squared_error": (("die", "loop"), squared, "(rad/s)**2", "mean squared rate error of the settled part"),
            "merit": (("figure", "loop", "end"), figures, "(rad/s)**2", "figure of the squared error over dies"),
            "ratio": ("end", astuple(self.ratio), "1", "mean squared error after over before"),
            "loss": ("step", [step[0] for step in steps], None),
        }
        units = {"evaluations": "1", "training": None, "validation": None}
        variables |= {n: ("step", [s[k] for s in steps], unit) for k, (n, unit) in enumerate(units.items(), 1)}
        coordinates = {
            "loop": ["before", "after"],
            "figure": list(names),
            "end": ["value", "low", "high"],
            "number": [n.label for n in self.numbers],
            "number_unit": ("number", [stated_at(self.loop, n.path) for n in self.numbers], None),
        }
        about = {"status": self.status, "gains": self.gains, "warnings": self.warnings}
        return labelled(self, variables, coordinates, {**about, **self.settings.as_dict()})

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


def merit_of(lot: Lot, loop: ClosedLoop | None = None) -> Merit:
    """The figures of a lot; `loop` is what ran, where its prior is to be reckoned with."""
    status, squares = lot.data["status"].values, squared_errors(lot)
    there = status != LOST
    nis, nees, states = None, lot.summary.nees, lot.summary.states
    expected, interval, around = None, None, (CONSISTENT, CONSISTENT)
    if nees is not None and states is not None:
        channels = lot.data["nis_channel"].values[there]
        nis = tuple(float(v) for v in np.nanmean(channels, axis=0))
        plan = Plan(**{name: lot.data.attrs[name] for name in Plan._fields})
        first, second = (nis_interval(int(dies), plan.innovations) for dies in np.isfinite(channels).sum(axis=0))
        around = first, second
        each = int(np.isfinite(lot.data["nees_end"].values).sum())
        shift, slack = (0.0, (0.0, 0.0)) if loop is None else shift_of_nees(lot, loop)
        expected = states + shift
        interval = nees_interval(each, states, expected, slack)
    mean, median, high = (_interval(squares[there], figure) for figure in (np.mean, np.median, _p95))
    lost = int(np.sum(status == LOST))
    return Merit(mean, median, high, len(status), lost, nis, nees, expected, interval, around)


def ratio_of(before: Lot, after: Lot, level: float = 0.95) -> Interval:
    """Mean squared error after over before, on the dies that neither lost, with its interval of `level`."""
    pair = np.stack([squared_errors(before), squared_errors(after)], axis=1)
    pair = pair[np.all(np.isfinite(pair), axis=1)]
    return _interval(
        pair, lambda rows, axis: np.mean(rows[..., 1], axis=axis) / np.mean(rows[..., 0], axis=axis), level
    )


def _interval(values: np.ndarray, figure: Any, level: float = 0.95) -> Interval:
    if len(values) == 0:
        return Interval(float("nan"), float("nan"), float("nan"))
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(len(values), size=(_RESAMPLED, len(values)))]
    low, high = np.percentile(figure(drawn, axis=1), [50.0 * (1.0 - level), 50.0 * (1.0 + level)])
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
    low, high = merit.nees_interval
    return f"{merit.nees:.3g} of {merit.nees_expected:.3g} (right ones: {max(low, 0.0):.3g} to {high:.3g})"
