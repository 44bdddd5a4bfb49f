"""The rows of a datasheet: one figure of every die, and what a lot of them says."""

from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned

from .over_temperature import CELSIUS, OverTemperature


SCHEMA = "memsgyro-datasheet/1"
NOT_MODELLED = "not modelled"
_LEAST = {"%": 1e-3, "deg/s": 1e-5}  # size by unit below which a figure is rounding or numerics, and tells of no device
_EXACT = 1e-6  # of a figure: an interval within it is none
FEWEST = 3  # dies of which a spread is told


class OverDies(NamedTuple):
    """Mean over dies with its 95 % interval, mean ± 3 standard deviations (not below zero where no die can be), least
    and greatest die, and percentiles.
    """

    typical: float
    low: float
    high: float
    minimum: float
    maximum: float
    least: float
    greatest: float
    p5: float
    p95: float
    dies: int

    @classmethod
    def of(cls, values: Float[np.ndarray, " dies"], positive: bool = False) -> "OverDies | None":
        """Over the finite values; None with fewer than three."""
        known = values[np.isfinite(values)]
        if len(known) < FEWEST:
            return None
        mean, std = float(np.mean(known)), float(np.std(known, ddof=1))
        reach = std / np.sqrt(len(known)) * float(stats.t.ppf(0.975, len(known) - 1))
        p5, p95 = (float(p) for p in np.percentile(known, [5.0, 95.0]))
        return cls(
            mean, mean - reach, mean + reach, max(mean - 3.0 * std, 0.0) if positive else mean - 3.0 * std,
            mean + 3.0 * std, float(known.min()), float(known.max()), p5, p95, len(known),
        )  # fmt: skip


@dataclass(frozen=True)
class DatasheetRow(Shown):
    """One figure: `values` of the dies in `unit`, what it is in words and under which condition.

    `missing` says why there are none: "not modelled" and what the model leaves out, or what the run did not show.
    `trimmed` are the values once every die has its own offset and scale, None without a trim or where it changes
    nothing. `positive` figures cannot be below zero. `note` is what the figure assumes beyond its definition.
    """

    name: str
    unit: str
    definition: str
    condition: str
    values: Float[np.ndarray, " dies"]
    missing: str = ""
    trimmed: Float[np.ndarray, " dies"] | None = None
    positive: bool = False
    note: str = ""

    @property
    def over_dies(self) -> OverDies | None:
        """What the lot says; None where there is nothing to say."""
        return None if self.missing else OverDies.of(self.values, self.positive)

    @property
    def over_trimmed(self) -> OverDies | None:
        """The same after the trim."""
        return None if self.missing or self.trimmed is None else OverDies.of(self.trimmed, self.positive)

    @property
    def reason(self) -> str:
        """Why there is no figure; empty where there is one."""
        return self.missing or ("" if self.over_dies else f"fewer than {FEWEST} dies tell it")

    def cells(self, found: OverDies | None) -> tuple[str, ...]:
        """Minimum, typical with half its interval, maximum and percentiles as text; the reason alone without them, and
        one bound where all dies lie below what a figure in percent means.
        """
        if found is None:
            return (self.reason,)
        least = _LEAST.get(self.unit.split(" ")[0], 0.0)
        if max(abs(found.minimum), abs(found.maximum), abs(found.least), abs(found.greatest)) < least:
            return ("", f"< {least:g}", "", "")
        half = found.high - found.typical
        within = f" ± {float(f'{half:.2g}'):.4g}" if half > _EXACT * abs(found.typical) else ""
        return (
            f"{found.minimum:.4g}",
            f"{found.typical:.4g}{within}",
            f"{found.maximum:.4g}",
            f"{found.p5:.4g} to {found.p95:.4g}",
        )

    def as_dict(self) -> dict[str, Any]:
        """Entries for JSON; null where there is no figure."""
        told = {"before_trim": self.over_dies, "after_trim": self.over_trimmed}
        return {
            "name": self.name, "unit": self.unit, "definition": self.definition, "condition": self.condition,
            "reason": self.reason or None, **{key: None if o is None else o._asdict() for key, o in told.items()},
        }  # fmt: skip


@dataclass(frozen=True)
class Datasheet(Shown):
    """The datasheet of a simulated lot: `rows`, and the curves behind them, SI.

    `dies` were run, of which `lost` were lost in one of the runs and count nowhere. `rates` [rad/s] were applied in
    turn and gave `outputs` (rates, dies); `times` [s] and `answers` (dies, times) are the answer to a step of the rate,
    over that step; both NaN for lost dies. `notes` say what a reader must know. `over_temperature` is None if nothing
    in the device depends on it.
    """

    rows: tuple[DatasheetRow, ...]
    dies: int
    lost: int
    full_scale: float
    rates: Float[np.ndarray, " rates"]
    outputs: Float[np.ndarray, "rates dies"]
    times: Float[np.ndarray, " times"]
    answers: Float[np.ndarray, "dies times"]
    settings: Settings
    notes: tuple[str, ...] = field(default=())
    over_temperature: OverTemperature | None = None

    def row(self, name: str) -> DatasheetRow:
        """The row called so."""
        return next(row for row in self.rows if row.name == name)

    def table(self) -> list[tuple[str, ...]]:
        """Name, unit, minimum (-3 σ), typical, maximum (+3 σ), 5 to 95 %, or the reason why there are none; a trimmed
        row stands below its own.
        """
        found: list[tuple[str, ...]] = []
        for row in self.rows:
            found.append((row.name, row.unit, *row.cells(row.over_dies)))
            if row.over_trimmed is not None:
                found.append((f"{row.name}, trimmed", row.unit, *row.cells(row.over_trimmed)))
        return found

    def __repr__(self) -> str:
        head = ("figure", "unit", "-3 σ", "typical (95 %)", "+3 σ", "5 to 95 % of the dies")
        lost = f", of which {self.lost} were lost and left out" if self.lost else ""
        table = self.table()
        lines = [f"Datasheet of {self.dies} simulated dies{lost}"]
        lines.append(aligned([head, *(row for row in table if len(row) == len(head))]))
        if missing := [row for row in table if len(row) < len(head)]:
            named: dict[str, list[str]] = {}
            for name, _, reason in missing:
                named.setdefault(reason, []).append(name)
            lines += ["Without a figure", *(f"  {', '.join(names)}: {reason}" for reason, names in named.items())]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, Any]:
        """The machine-readable form."""
        return finite(
            {
                "schema": SCHEMA,
                "dies": self.dies,
                "lost": self.lost,
                "full_scale_dps": float(np.degrees(self.full_scale)),
                "rows": [row.as_dict() for row in self.rows],
                "over_temperature": _drifts(self.over_temperature),
                "notes": list(self.notes),
                "seed": self.settings.seed,
                "sample_rate_hz": self.settings.sample_rate,
                "duration_s": self.settings.duration,
                "fingerprint": self.settings.fingerprint,
                "versions": dict(asdict(self.settings)["versions"]),
            }
        )


def _drifts(found: OverTemperature | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "temperatures_c": (found.temperatures - CELSIUS).tolist(),
        "zero_rate_dps": np.degrees(found.zero_rate).T.tolist(),
        "scale_factor": found.scale_factor.T.tolist(),
    }
