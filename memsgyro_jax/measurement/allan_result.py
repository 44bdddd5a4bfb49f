"""What an Allan deviation says of a rate sensor: curve and noise terms, printable, as JSON, xarray or picture."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.files import finite, json_text
from memsgyro_jax.base.provenance import versions
from memsgyro_jax.base.text import aligned

from .rate_noise import FALL


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


SCHEMA = "memsgyro-allan/1"
_DEGREE = 180.0 / np.pi
_PER_HOUR = 3600.0 * _DEGREE  # deg/h in a rad/s, the unit of the terms of a rate
MEANING = {  # name, and unit with what one in SI is in it; powers of the sample period in a value
    "N": ("angle random walk", "deg/√h", 60.0 * _DEGREE, 0.5),
    "B": ("flicker", "deg/h", _PER_HOUR, 0.0),
    "K": ("rate random walk", "deg/h/√h", 60.0 * 3600.0 * _DEGREE, -0.5),
    "R": ("rate ramp", "deg/h²", 3600.0**2 * _DEGREE, -1.0),
    "Q": ("quantisation", "deg", _DEGREE, 1.0),
}


@dataclass(frozen=True)
class NoiseTerm:
    """A figure of one series with its 95 % interval, in `unit`; value `None` means that the record cannot tell it, and
    then `high`, where it is finite, is the most that it may be.
    """

    value: float | None
    low: float
    high: float
    unit: str
    verdict: str

    @property
    def for_mean(self) -> float:
        """The value for a mean over many records, NaN where there is none: the root of a variance that scatters is low
        by half the square of its own relative scatter, 1 to 4 % in records of some hundred periods of the bandwidth.
        """
        if self.value is None or not self.low > 0.0:
            return float("nan")
        return self.value * (1.0 + 0.5 * (np.log(self.high / self.low) / (2.0 * np.sqrt(FALL))) ** 2)

    def cells(self) -> tuple[str, str, str]:
        """Value, interval and verdict as text."""
        if self.value is None:
            most = f"; below {self.high:.3g} {self.unit}" if np.isfinite(self.high) else ""
            return "-", "", f"{self.verdict}{most}"
        return f"{self.value:.4g} {self.unit}", f"{self.low:.4g} to {self.high:.4g}", self.verdict


@dataclass(frozen=True, repr=False)
class Allan(Shown):
    """Overlapping Allan deviation of one or several series, and the noise model of IEEE Std 952 fitted to it.

    Args:
        series: names.
        tau: averaging times [s].
        deviation: [rad/s]; `low` to `high` is its 95 % interval.
        terms: of each series, by name: `N`, `B`, `K`, `R`, `Q` of the fitted model, `arw_1s` as read at 1 s, and
            `bias_instability`, the minimum of the fitted curve over 0.664.
        fitted: deviation of the fitted model [rad/s].
        band: averaging times of the fit [s].
        chi2_per_dof: of the fit, one number per series; near 1 where the five terms describe the record.
        period, samples: [s] from sample to sample, and how many.
        notes: what was assumed, and what is amiss, one sentence each.
    """

    series: tuple[str, ...]
    tau: Float[np.ndarray, " factors"]
    deviation: Float[np.ndarray, "series factors"]
    low: Float[np.ndarray, "series factors"]
    high: Float[np.ndarray, "series factors"]
    fitted: Float[np.ndarray, "series factors"]
    terms: tuple[Mapping[str, NoiseTerm], ...]
    band: tuple[float, float]
    chi2_per_dof: Float[np.ndarray, " series"]
    period: float
    samples: int
    notes: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=lambda: dict(versions()))

    @property
    def status(self) -> str:
        """A sentence on how the fit went."""
        return next((note for note in self.notes if "do not describe" in note), "completed")

    def __str__(self) -> str:
        head = (
            f"Allan deviation, overlapping: {self.samples} samples at {1.0 / self.period:g} Hz, averaging times "
            f"{self.tau[0]:.4g} to {self.tau[-1]:.4g} s; 95 % intervals"
        )
        body = self._detailed() if len(self.series) <= 6 else self._summary()
        return "\n".join([head, *body, *(f"  note: {note}" for note in self.notes)])

    def _detailed(self) -> list[str]:
        lines = []
        for name, terms, chi2 in zip(self.series, self.terms, self.chi2_per_dof, strict=True):
            rows = [(f"  {_title(key)}", *term.cells()) for key, term in terms.items()]
            lines += [f"{name}: χ²/dof {chi2:.3g}", aligned(rows)]
        return lines

    def _summary(self) -> list[str]:
        rows = [("  term", "told in", "median", "5 to 95 % of the series")]
        for key in self.terms[0]:
            told = [t for terms in self.terms if (t := terms[key]).value is not None]
            spread = np.percentile([t.value for t in told], [50, 5, 95]) if told else ()
            cells = (f"{spread[0]:.4g} {told[0].unit}", f"{spread[1]:.4g} to {spread[2]:.4g}") if told else ("-", "")
            rows.append((f"  {_title(key)}", f"{len(told)} of {len(self.series)}", *cells))
        return [aligned(rows)]

    def to_dict(self) -> dict[str, Any]:
        """The machine-readable result, schema `memsgyro-allan/1`: rates in deg/s, terms in their units."""
        curves = ("deviation", "low", "high", "fitted")
        entries = {
            "schema": SCHEMA,
            "status": self.status,
            "sample_rate_hz": 1.0 / self.period,
            "samples": self.samples,
            "band_s": list(self.band),
            "tau_s": self.tau.tolist(),
            "series": [
                {
                    "name": name,
                    "chi2_per_dof": float(self.chi2_per_dof[k]),
                    "terms": {key: vars(term) for key, term in self.terms[k].items()},
                    **{f"{curve}_deg_s": np.degrees(getattr(self, curve)[k]).tolist() for curve in curves},
                }
                for k, name in enumerate(self.series)
            ],
            "notes": list(self.notes),
            "versions": dict(self.versions),
        }
        return finite(entries)

    def to_json(self) -> str:
        """`to_dict` as text; no NaN or infinity in it."""
        return json_text(self.to_dict())

    def to_xarray(self) -> "xr.Dataset":
        """Curves over (series, tau) in rad/s, and terms over (series, term) in their units, NaN where not told."""
        import xarray as xr

        names = list(self.terms[0])
        curves = {
            name: (("series", "tau"), getattr(self, name), {"units": "rad/s"})
            for name in ("deviation", "low", "high", "fitted")
        }
        number = lambda part: [  # noqa: E731
            [np.nan if getattr(terms[n], part) is None else getattr(terms[n], part) for n in names]
            for terms in self.terms
        ]
        tables = {f"term_{part}": (("series", "term"), number(part)) for part in ("value", "low", "high")}
        coordinates = {
            "series": list(self.series),
            "tau": ("tau", self.tau, {"units": "s"}),
            "term": names,
            "unit": ("term", [self.terms[0][name].unit for name in names]),
        }
        return xr.Dataset({**curves, **tables}, coordinates, {"schema": SCHEMA, "status": self.status})

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Deviation [deg/h] over averaging time with its interval, and the fitted model, both axes logarithmic."""
        ax = axes(ax)
        for k, name in enumerate(self.series):
            color = f"C{k % 10}"
            ax.fill_between(self.tau, *_PER_HOUR * np.array([self.low[k], self.high[k]]), color=color, alpha=0.2, lw=0)
            ax.plot(self.tau, _PER_HOUR * self.deviation[k], color=color, marker=".", ms=4, lw=1.0, label=name)
            ax.plot(self.tau, _PER_HOUR * self.fitted[k], color="k", ls="--", lw=0.8, label="" if k else "fitted model")
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlabel("averaging time [s]")
        ax.set_ylabel("Allan deviation [deg/h]")
        ax.legend(loc="best", frameon=False)
        return ax


def _title(key: str) -> str:
    named = {"arw_1s": "angle random walk at 1 s", "bias_instability": "bias instability, least of the fit/0.664"}
    return named[key] if key in named else f"{key}  {MEANING[key][0]}"
