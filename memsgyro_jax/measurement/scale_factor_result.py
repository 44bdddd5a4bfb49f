"""What a rate-table test says of a gyro: figures with intervals, printable, as JSON, xarray or picture."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.files import finite, json_text
from memsgyro_jax.base.labelled import Tabular, labelled
from memsgyro_jax.base.provenance import versions
from memsgyro_jax.base.text import aligned, beside, said_in


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


SCHEMA = "memsgyro-scale-factor-test/1"


@dataclass(frozen=True)
class MeasuredFigure:
    """A figure in `unit` with its 95 % interval; value `None` means that the test cannot tell it, and `verdict` why.

    A figure that lies within the noise has its value and says so there.
    """

    title: str
    value: float | None
    low: float
    high: float
    unit: str
    verdict: str = ""

    def cells(self) -> tuple[str, str, str]:
        """Value, interval and verdict as text."""
        if self.value is None:
            return "-", "", self.verdict
        std = 0.5 * (self.high - self.low)
        if not np.isfinite(std):
            return said_in(f"{self.value:.5g}", self.unit), "", self.verdict or "no interval: too few plateaus"
        number, low, high = (beside(end, std, 3) for end in (self.value, self.low, self.high))
        return said_in(number, self.unit), f"{low} to {high}", self.verdict


@dataclass(frozen=True, repr=False)
class ScaleFactorTest(Tabular):
    """Figures of a rate-table test in the terms of IEEE Std 1431 and 528.

    Args:
        figures: by name, in the order in which they print.
        rate: of the table at each plateau [rad/s].
        output: mean of each plateau, in `unit`.
        response: of it what the rate makes, without drift, temperature and runs, in `unit`.
        deviation: of the response from the line, in ppm of the full scale.
        time: middle of each plateau [s], or its number where the times are not known.
        run, direction: of each plateau, from zero on; +1 up, -1 down.
        temperature: of each plateau [K], NaN where it is not known.
        levels: the different rates [rad/s].
        nonlinearity: mean deviation at each of them [ppm of full scale]; `reach` is half of an interval that holds all
            of them at once in 95 % of tests.
        unit: of the output.
        full_scale: [rad/s].
        runs: how many.
        notes: what was assumed, what cannot be told and what is amiss, one sentence each.
    """

    along = "plateau"

    figures: Mapping[str, MeasuredFigure]
    rate: Float[np.ndarray, " plateau"]
    output: Float[np.ndarray, " plateau"]
    response: Float[np.ndarray, " plateau"]
    deviation: Float[np.ndarray, " plateau"]
    time: Float[np.ndarray, " plateau"]
    run: Int[np.ndarray, " plateau"]
    direction: Int[np.ndarray, " plateau"]
    temperature: Float[np.ndarray, " plateau"]
    levels: Float[np.ndarray, " level"]
    nonlinearity: Float[np.ndarray, " level"]
    reach: Float[np.ndarray, " level"]
    unit: str
    full_scale: float
    runs: int
    status: str = "completed"
    notes: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=lambda: dict(versions()))

    def __str__(self) -> str:
        low, high = np.degrees([self.rate.min(), self.rate.max()])
        several = f" in {self.runs} runs" if self.runs > 1 else ""
        head = (
            f"Scale factor test: {len(self.rate)} plateaus{several} at {len(self.levels)} rates from {low:.6g} to "
            f"{high:.6g} deg/s, output in {'numbers' if self.unit == '1' else self.unit}; 95 % intervals"
        )
        rows = [(f"  {figure.title}", *figure.cells()) for figure in self.figures.values()]
        return "\n".join([head, aligned(rows), *(f"  note: {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """The machine-readable result, schema `memsgyro-scale-factor-test/1`: rates in deg/s."""
        names = ("output", "response", "deviation", "time", "run", "direction")
        return finite(
            {
                "schema": SCHEMA,
                "status": self.status,
                "output_unit": self.unit,
                "full_scale_dps": float(np.degrees(self.full_scale)),
                "figures": {name: asdict(figure) for name, figure in self.figures.items()},
                "plateaus": {
                    "rate_dps": np.degrees(self.rate).tolist(),
                    **{name: getattr(self, name).tolist() for name in names},
                },
                "levels": {
                    "rate_dps": np.degrees(self.levels).tolist(),
                    "nonlinearity_ppm": self.nonlinearity.tolist(),
                    "reach_ppm": self.reach.tolist(),
                },
                "notes": list(self.notes),
                "versions": dict(self.versions),
            }
        )

    def to_json(self) -> str:
        """`to_dict` as text; no NaN or infinity in it."""
        return json_text(self.to_dict())

    def to_xarray(self) -> "xr.Dataset":
        """Plateaus over `plateau`, deviations from the line over `level`, figures over `figure`, NaN where not told."""
        unit = self.unit if _is_known(self.unit) else "1"
        number = lambda value: np.nan if value is None else value  # noqa: E731
        return labelled(
            self,
            {
                "rate": ("plateau", self.rate, "rad/s"),
                "output": ("plateau", self.output, unit, f"mean output [{self.unit}]"),
                "response": ("plateau", self.response, unit, f"output by the rate alone [{self.unit}]"),
                "deviation": ("plateau", self.deviation, "ppm", "deviation from the line, of full scale"),
                "time": ("plateau", self.time, "s"),
                "run": ("plateau", self.run, None),
                "direction": ("plateau", self.direction, None),
                "temperature": ("plateau", self.temperature, "K"),
                "level_rate": ("level", self.levels, "rad/s"),
                "nonlinearity": ("level", self.nonlinearity, "ppm", "mean deviation from the line, of full scale"),
                "nonlinearity_reach": ("level", self.reach, "ppm", "half of its 95 % interval, for all rates at once"),
                "value": ("figure", [number(one.value) for one in self.figures.values()], None),
                "low": ("figure", [one.low for one in self.figures.values()], None),
                "high": ("figure", [one.high for one in self.figures.values()], None),
                "verdict": ("figure", [one.verdict for one in self.figures.values()], None),
            },
            {
                "figure": list(self.figures),
                "figure_unit": ("figure", [one.unit for one in self.figures.values()], None),
            },
            {"schema": SCHEMA, "status": self.status, "output_unit": self.unit, "notes": list(self.notes)},
        )

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Deviation of each plateau from the line over the rate, by run and direction, and the mean at each rate with
        the interval that holds all of them at once.
        """
        ax = axes(ax)
        at, known = np.degrees(self.levels), np.where(np.isfinite(self.reach), self.reach, 0.0)
        ax.axhline(0.0, color="0.6", lw=0.8)
        ax.fill_between(at, self.nonlinearity - known, self.nonlinearity + known, color="C0", alpha=0.2, lw=0)
        ax.plot(at, self.nonlinearity, color="C0", lw=1.0, label="mean at each rate, 95 % for all")
        kinds = ((1, "^", "from below"), (-1, "v", "from above"), (0, "o", "first"))
        for number in range(self.runs):
            for sense, marker, words in kinds:
                here = (self.run == number) & (self.direction == sense)
                if here.any():
                    label = words if number == 0 and sense else None
                    x, y = np.degrees(self.rate[here]), self.deviation[here]
                    ax.plot(x, y, marker, color=f"C{(number + 1) % 10}", ms=4, ls="", label=label)
        ax.set_xlabel("rate [deg/s]")
        ax.set_ylabel("deviation from the line [ppm of full scale]")
        ax.legend(loc="best", frameon=False)
        return ax


def _is_known(unit: str) -> bool:
    from memsgyro_jax.base.errors import InputError
    from memsgyro_jax.base.units import base_powers

    try:
        base_powers(unit)
    except InputError:
        return False
    return True
