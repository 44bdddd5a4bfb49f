"""A measured rate-table test beside the simulated lot at the same rates: which figures the model gives, which not."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.files import finite, json_text
from memsgyro_jax.base.labelled import Labelled, labelled
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned, said_in
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.montecarlo.spread import Spread, as_spread

from .rate_tests import FEWEST, RateTests
from .scale_factor_result import MeasuredFigure, ScaleFactorTest


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


SCHEMA = "memsgyro-beside-lot/1"
_PPM = 1e6
_SETTLED = 20.0  # ppm of full scale, by which the halves of what counts of a run may differ
_ROUNDING = 1e-6  # of a figure, below which dies are the same
_SHAPES = ("quadratic", "cubic")
OUTSIDE, WITHIN, NOT_COMPARED = "outside", "within", "not compared"


class LotRow(NamedTuple):
    """A measured figure and what the lot gives: `typical` die, and `low` to `high`, in which 95 % of its dies lie.

    `verdict` is "within", "outside" or "not compared".
    """

    measured: MeasuredFigure
    typical: float
    low: float
    high: float
    verdict: str

    def cells(self) -> tuple[str, ...]:
        """As they are printed."""
        unit = self.measured.unit
        if not np.isfinite(self.typical):
            return (f"  {self.measured.title}", *self.measured.cells()[:2], "-", "", self.verdict)
        typical, low, high = (_without_rounding(one, unit) for one in (self.typical, self.low, self.high))
        lot = said_in(typical, unit), f"{low} to {high}"
        return (f"  {self.measured.title}", *self.measured.cells()[:2], *lot, self.verdict)


@dataclass(frozen=True, repr=False)
class BesideLot(Labelled):
    """Figures of a rate-table test beside those of a simulated lot.

    Args:
        test: what was measured.
        rows: by name of the figure.
        outputs: of the lot without noise at each rate of the test [rad/s], NaN for dies that are lost or do not settle.
        deviation: of these from each die's line [ppm of full scale].
        notes: what was assumed and what the model lacks, one sentence each.
        settings: of the runs.
    """

    test: ScaleFactorTest
    rows: Mapping[str, LotRow]
    outputs: Float[np.ndarray, "dies levels"]
    deviation: Float[np.ndarray, "dies levels"]
    notes: tuple[str, ...]
    settings: Settings

    @property
    def status(self) -> str:
        """Whether the figures that can be compared are such as a die of the lot has."""
        verdicts = [row.verdict for row in self.rows.values()]
        return OUTSIDE if OUTSIDE in verdicts else WITHIN if WITHIN in verdicts else NOT_COMPARED

    def __str__(self) -> str:
        dies = int(np.sum(np.isfinite(self.outputs[:, 0])))
        head = (
            f"Measured beside {dies} dies of the model at the same rates; 95 % intervals, of the lot 95 % of its dies"
        )
        titles = ("  figure", "measured", "", "model", "", "measured lies")
        table = aligned([titles, *(row.cells() for row in self.rows.values())])
        return "\n".join([head, table, *(f"  note: {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """The machine-readable result, schema `memsgyro-beside-lot/1`."""
        rows = {
            name: {**asdict(row.measured), "model": row.typical, "model_low": row.low, "model_high": row.high,
                   "lies": row.verdict}
            for name, row in self.rows.items()
        }  # fmt: skip
        return finite(
            {
                "schema": SCHEMA,
                "status": self.status,
                "figures": rows,
                "rate_dps": np.degrees(self.test.levels).tolist(),
                "model_deviation_ppm": self.deviation.tolist(),
                "notes": list(self.notes),
                "settings": self.settings.as_dict(),
            }
        )

    def to_json(self) -> str:
        """`to_dict` as text; no NaN or infinity in it."""
        return json_text(self.to_dict())

    def to_xarray(self) -> "xr.Dataset":
        """Outputs and deviations over (die, level), the measured deviation over `level`."""
        return labelled(
            self,
            {
                "output": (("die", "level"), self.outputs, "rad/s"),
                "deviation": (("die", "level"), self.deviation, "ppm", "deviation from the line, of full scale"),
                "measured": ("level", self.test.nonlinearity, "ppm", "measured deviation from the line"),
                "rate": ("level", self.test.levels, "rad/s"),
            },
            {},
            {"schema": SCHEMA, "status": self.status, **self.settings.as_dict()},
        )

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """The measured deviation from the line over the rate, and that of each die of the model."""
        ax = self.test.plot(axes(ax))
        for number, one in enumerate(self.deviation):
            label = "dies of the model" if number == 0 else None
            ax.plot(np.degrees(self.test.levels), one, color="k", lw=0.6, alpha=0.5, label=label)
        ax.legend(loc="best", frameon=False)
        return ax


def beside_lot(
    test: ScaleFactorTest,
    loop: ClosedLoop,
    spread: Spread,
    scenario: Any = 0.0,
    *,
    dies: int = 16,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    settle: float | str | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> BesideLot:
    """Lay a measured rate-table test beside `dies` dies of `spread` around `loop`, run without noise at its rates.

    Each die's line goes through the rates as often as the test holds them, so that figures are those of one definition.
    Scale factor and zero-rate output are compared where the output was a rate; of volts and counts, whose conversion
    the model does not hold, only what is relative. Arguments are those of `datasheet`.

    Raises:
        InputError: for settings that cannot be run, and outside float64.
    """
    bench = RateTests.of(
        "beside_lot", loop, as_spread(spread), scenario, full_scale=test.full_scale, dies=dies,
        sample_rate=sample_rate, duration=duration, settle=settle, seed=seed,
    )  # fmt: skip
    outputs = np.empty((dies, len(test.levels)))
    settled = np.ones(dies, bool)
    for number, rate in enumerate(test.levels):
        if progress is not None:
            progress(f"{dies} dies at {np.degrees(rate):.6g} deg/s, rate {number + 1} of {len(test.levels)}")
        run = bench.run(bench.at(float(rate)))
        kept = run.rate[:, round(bench.settle / run.period) :]
        half = kept.shape[1] // 2
        moved = np.abs(kept[:, :half].mean(axis=1) - kept[:, half:].mean(axis=1)) / test.full_scale
        settled &= run.alive & (moved * _PPM < _SETTLED)
        outputs[:, number] = kept.mean(axis=1)
    outputs[~settled] = np.nan
    settings = Settings.of(
        bench.loop, bench.surroundings, spread, test.levels, sample_rate=bench.sample_rate, duration=bench.duration,
        seed=seed,
    )  # fmt: skip
    return laid_beside(test, outputs, settings)


def laid_beside(test: ScaleFactorTest, outputs: Float[np.ndarray, "dies levels"], settings: Settings) -> BesideLot:
    """The comparison with outputs [rad/s] of dies at the rates of the test, NaN for dies that do not count."""
    figures, deviation = _of_dies(test, np.degrees(outputs))
    is_rate = test.unit == "deg/s"
    rows = {}
    for name, values in figures.items():
        measured = test.figures.get(name)
        if measured is not None:
            rows[name] = _row(measured, values if is_rate or name not in _ABSOLUTE else np.full(len(values), np.nan))
    return BesideLot(test, rows, outputs, deviation, tuple(_notes(test, rows, outputs)), settings)


_ABSOLUTE = ("scale_factor", "zero_rate_line", "zero_rate_plateaus")  # of which the conversion to volts is a part


def _of_dies(test: ScaleFactorTest, outputs: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Figures of each die [deg/s, ppm], as the test defines them, and its deviation at each rate."""
    levels, full = np.degrees(test.levels), float(np.degrees(test.full_scale))
    which = np.argmin(np.abs(test.rate[:, None] - test.levels), axis=1)
    rate = levels[which]
    straight = lambda at: np.linalg.pinv(np.column_stack([np.ones(len(at)), at]))  # noqa: E731
    offset, slope = straight(rate) @ outputs[:, which].T
    ppm = _PPM / (slope * full)
    deviation = ppm[:, None] * (outputs - offset[:, None] - slope[:, None] * levels)
    found = {"scale_factor": slope, "zero_rate_line": offset}
    if np.any(levels == 0.0):
        found["zero_rate_plateaus"] = outputs[:, int(np.flatnonzero(levels == 0.0)[0])]
    if len(levels) < 3:
        return found, deviation
    found["nonlinearity_max"] = np.max(np.abs(deviation), axis=1)
    found["nonlinearity_rms"] = np.sqrt(np.mean(deviation**2, axis=1))
    powers = np.linalg.pinv(np.column_stack([(rate / full) ** k for k in range(min(3, len(levels) - 1) + 1)]))
    found |= dict(zip(_SHAPES, ppm * (powers[2:] @ outputs[:, which].T), strict=False))
    sides = [which[rate >= 0.0], which[rate <= 0.0]]
    if all(len(np.unique(side)) > 1 for side in sides):
        up, down = ((straight(levels[side]) @ outputs[:, side].T)[1] for side in sides)
        found["asymmetry"] = _PPM * (up - down) / slope
    return found, deviation


def _row(measured: MeasuredFigure, values: np.ndarray) -> LotRow:
    """A figure beside that of the dies: 95 % of such dies lie within Student's t of their mean and spread."""
    known = values[np.isfinite(values)]
    if measured.value is None or len(known) < FEWEST:
        return LotRow(measured, np.nan, np.nan, np.nan, NOT_COMPARED)
    typical, spread = float(np.mean(known)), float(np.std(known, ddof=1))
    reach = spread * np.sqrt(1.0 + 1.0 / len(known)) * float(stats.t.ppf(0.975, len(known) - 1))
    low, high = typical - reach, typical + reach
    apart = measured.low > high or measured.high < low
    verdict = OUTSIDE if apart else WITHIN if np.isfinite(measured.high - measured.low) else NOT_COMPARED
    return LotRow(measured, typical, low, high, verdict)


def _without_rounding(value: float, unit: str) -> str:
    """A figure of the model, of ppm no more digits than a run without noise has."""
    return f"{round(value, 2) + 0.0:.4g}" if unit.startswith("ppm") else f"{value:.4g}"


def _notes(test: ScaleFactorTest, rows: Mapping[str, LotRow], outputs: np.ndarray) -> list[str]:
    """What was left out, and what the model lacks."""
    said, lost = [], int(np.sum(~np.isfinite(outputs[:, 0])))
    if lost:
        said.append(
            f"{lost} of {len(outputs)} dies are lost, or still move by more than {_SETTLED:g} ppm of full scale in "
            "what counts of a run, and are left out; a longer duration settles them."
        )
    if test.unit != "deg/s":
        said.append(f"The conversion to {test.unit} is not in the model: only what is relative is compared.")
    for name, kind in zip(_SHAPES, ("even", "odd"), strict=True):
        row = rows.get(name)
        if row is not None and row.verdict == OUTSIDE:
            said.append(
                f"The measured response has an {kind} part of {row.measured.value:.3g} ppm, dies of the model one of "
                f"{_without_rounding(row.typical, 'ppm')}: nothing in the study makes the rest of it."
            )
    if "scale_factor" in rows and rows["scale_factor"].verdict == OUTSIDE:
        said.append("A scale factor outside the lot may be the trim of the gyro, which the study does not hold.")
    same = [row for row in rows.values() if row.high - row.low <= _ROUNDING * abs(row.typical)]
    if same and len(same) == sum(np.isfinite(row.typical) for row in rows.values()):
        said.append("The dies of the study are alike: any difference that is known lies outside; give it a spread.")
    said.append("The model is at the temperature of its study, without the drift and noise of the test.")
    return said
