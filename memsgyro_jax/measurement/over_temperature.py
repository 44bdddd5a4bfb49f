"""Zero-rate output and scale factor of a lot over temperature, in a chamber held at one temperature after another."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned
from memsgyro_jax.effects.trial import feels_warmth
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import Constant
from memsgyro_jax.montecarlo.spread import Spread

from .rate_tests import Dies, RateTests, settled_mean


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


CELSIUS = 273.15  # K at 0 °C


@dataclass(frozen=True, repr=False)
class OverTemperature(Shown):
    """What each die gives out at each of `temperatures` [K]: `zero_rate` [rad/s] and `scale_factor` (1), of shape
    (temperatures, dies); dies that were lost at one of them are NaN throughout.
    """

    temperatures: Float[np.ndarray, " temperatures"]
    zero_rate: Float[np.ndarray, "temperatures dies"]
    scale_factor: Float[np.ndarray, "temperatures dies"]
    full_scale: float

    @property
    def zero_rate_drift(self) -> Dies:
        """Half of greatest less least zero-rate output [rad/s]."""
        return 0.5 * np.ptp(self.zero_rate, axis=0)

    @property
    def scale_factor_drift(self) -> Dies:
        """Half of greatest less least scale factor (1)."""
        return 0.5 * np.ptp(self.scale_factor, axis=0)

    @property
    def alive(self) -> Bool[np.ndarray, " dies"]:
        """Dies that came through all temperatures."""
        return np.isfinite(self.zero_rate).all(axis=0)

    def __str__(self) -> str:
        rows = [("temperature", "zero-rate output [deg/s]", "scale factor")]
        known = self.alive
        for kelvin, *values in zip(self.temperatures, np.degrees(self.zero_rate), self.scale_factor, strict=True):
            told = [f"{np.mean(v[known]):.5g} ± {np.std(v[known], ddof=1):.2g}" for v in values]
            rows.append((f"{kelvin - CELSIUS:.4g} °C", *told))
        zero, scale = np.degrees(self.zero_rate_drift[known]), 100.0 * self.scale_factor_drift[known]
        rows.append(("(max - min)/2", f"{np.mean(zero):.4g} ± {np.std(zero, ddof=1):.2g}", f"{np.mean(scale):.4g} %"))
        lost = f", of which {int(np.sum(~known))} were lost" if not known.all() else ""
        return f"Over temperature, mean and standard deviation of {len(known)} dies{lost}\n{aligned(rows)}"

    def to_xarray(self) -> "xr.Dataset":
        """Both over temperature and die, units in the attributes."""
        import xarray as xr

        over = ("temperature", "die")
        return xr.Dataset(
            {
                "zero_rate": (over, self.zero_rate, {"units": "rad/s"}),
                "scale_factor": (over, self.scale_factor, {"units": "1"}),
            },
            {"temperature": ("temperature", self.temperatures, {"units": "K"})},
        )

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Zero-rate output of every die over temperature."""
        ax = axes(ax)
        ax.plot(self.temperatures - CELSIUS, np.degrees(self.zero_rate), lw=0.8)
        ax.set(xlabel="temperature [°C]", ylabel="zero-rate output [deg/s]")
        return ax


def over_temperature(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Any = 0.0,
    *,
    temperatures: Sequence[float] = (233.15, 298.15, 358.15),
    full_scale: float | str = "300 deg/s",
    dies: int = 64,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    settle: float | str | None = None,
    seed: int = 0,
) -> OverTemperature:
    """Hold `dies` dies of `spread` around `loop` at each of `temperatures` [K], at rest and at `full_scale` [rad/s],
    without read-out noise, and take the mean output from `settle` [s] (half the duration when left out) to `duration`.

    Rate and temperature of `scenario` are replaced, all else of it stays. Left out, `sample_rate` and `duration` follow
    the device (`Operation`). Self-heating begins cold at power-on: give it
    the time it takes.

    **Raises:** `InputError` for settings that cannot be run, for fewer than two temperatures, for a device in which
    nothing depends on the temperature, and outside float64.
    """
    bench = RateTests.of(
        "over_temperature", loop, spread, scenario, full_scale=full_scale, dies=dies, sample_rate=sample_rate,
        duration=duration, settle=settle, seed=seed,
    )  # fmt: skip
    check_temperatures(temperatures)
    if not depends_on_temperature(bench.loop):
        raise InputError(
            "The device of `loop` must carry an effect that depends on temperature, such as "
            "`effects.ThermalStiffness(-6e-5)`, but nothing in it does."
        )
    return held_at(bench, temperatures)


def check_temperatures(temperatures: Sequence[float]) -> None:
    """Raises `InputError` unless there are two or more, in K, that are above absolute zero and finite."""
    if len(temperatures) < 2 or not all(0.0 < kelvin < np.inf for kelvin in temperatures):
        raise InputError(
            "Argument `temperatures` must hold two or more temperatures above absolute zero, but holds "
            f"{', '.join(f'{kelvin:g}' for kelvin in temperatures)} K."
        )


def depends_on_temperature(loop: ClosedLoop) -> bool:
    """Whether any effect of the device feels the temperature of its surroundings."""
    return any(feels_warmth(effect) for effect in loop.device.effects)


def held_at(
    bench: RateTests, temperatures: Sequence[float], told: Callable[[str], None] | None = None
) -> OverTemperature:
    """The lot at each temperature [K]; `told` is told of each."""
    outputs: list[list[np.ndarray]] = []
    for kelvin in temperatures:
        if told is not None:
            told(f"{kelvin - CELSIUS:.4g} °C")
        runs = [bench.run(bench.at(rate, temperature=Constant(kelvin))) for rate in (0.0, bench.full_scale)]
        outputs.append([np.where(run.alive, settled_mean(run, bench.settle), np.nan) for run in runs])
    still, turning = np.moveaxis(np.array(outputs), 1, 0)
    lost = ~np.isfinite(still + turning).all(axis=0)
    zero, scale = (np.where(lost, np.nan, part) for part in (still, (turning - still) / bench.full_scale))
    return OverTemperature(np.asarray(temperatures, float), zero, scale, bench.full_scale)
