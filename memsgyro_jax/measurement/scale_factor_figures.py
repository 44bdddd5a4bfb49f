"""Figures of a rate-table test in the terms of IEEE Std 1431 and 528, from the response and its draws."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from .plateau_noise import Response
from .rate_design import DIRECTION, TEMPERATURE, TEMPERATURE_RATE, TREND, Design
from .rate_plateaus import RatePlateaus
from .scale_factor_result import MeasuredFigure


_LEVEL = 0.95
PPM = 1e6
_HOUR = 3600.0
_FREEDOM = 13.0  # of the overlapping Allan variance of white noise at a tenth of its record
_SIDES = 3  # rates on each side of zero, from which on a kink there is told from a curve
WITHIN_NOISE = "within the noise"


class Ranged(NamedTuple):
    """A figure with half of its 95 % interval, infinite where nothing tells it."""

    value: float
    reach: float

    @property
    def told(self) -> bool:
        """Whether it is not zero."""
        return abs(self.value) > self.reach

    def figure(self, title: str, unit: str, verdict: str = "") -> MeasuredFigure:
        """As it is printed."""
        return MeasuredFigure(title, self.value, self.value - self.reach, self.value + self.reach, unit, verdict)


@dataclass(frozen=True)
class Line:
    """The least-squares line over all plateaus, and what leaves it.

    Args:
        read, design, found: plateaus, their columns, and the response to the rate.
        full_scale: [rad/s].
    """

    read: RatePlateaus
    design: Design
    found: Response
    full_scale: float

    @cached_property
    def rate(self) -> Float[np.ndarray, " n"]:
        """Of each plateau, the same for those of one rate [deg/s]."""
        return np.degrees(self.design.place * np.max(np.abs(self.read.rate)))

    @cached_property
    def weights(self) -> Float[np.ndarray, "2 n"]:
        """What the response is multiplied with to be zero-rate output and scale factor."""
        return np.linalg.pinv(np.column_stack([np.ones(len(self.rate)), self.rate]))

    @cached_property
    def scale_factor(self) -> float:
        """[unit per deg/s]."""
        return float(self.weights[1] @ self.found.output)

    @property
    def ppm(self) -> float:
        """What an output is multiplied with to be ppm of the full scale."""
        return PPM / (abs(self.scale_factor) * float(np.degrees(self.full_scale)))

    def of(self, weights: np.ndarray) -> Ranged:
        """A figure that is linear in the response."""
        return self.of_draws(float(weights @ self.found.output), self.found.outputs @ weights)

    def of_draws(self, value: float, draws: np.ndarray) -> Ranged:
        """A figure by its draws."""
        if not self.known:
            return Ranged(value, np.inf)
        return Ranged(value, float(np.quantile(np.abs(draws - value), _LEVEL)))

    @property
    def known(self) -> bool:
        """Whether anything tells the noise of the means."""
        return self.found.spare > 0 or bool(np.any(self.read.within > 0.0))

    @property
    def holds_drift(self) -> bool:
        """Whether a straight drift of the bias would count as scale factor, a twentieth of it at least."""
        free = TREND in self.design.left and not self.design.by_temperature and len(self.rate) > 2
        since = self.design.since
        return free and abs(float(self.weights[1] @ since)) * float(np.degrees(self.full_scale)) > 0.05

    def effect(self, name: str) -> Ranged | None:
        """Of a column beside; `None` where the sequence does not tell it."""
        if name not in self.design.names:
            return None
        place = self.design.names.index(name)
        return self.of_draws(float(self.found.effects[place]), self.found.effect_draws[:, place])

    @cached_property
    def leaving(self) -> Float[np.ndarray, "n n"]:
        """What the response is multiplied with to be its deviation from the line."""
        line = np.column_stack([np.ones(len(self.rate)), self.rate]) @ self.weights
        return np.eye(len(self.rate)) - line

    @cached_property
    def by_level(self) -> Float[np.ndarray, "levels n"]:
        """What the response is multiplied with to be the mean deviation at each rate."""
        here = self.design.level == np.arange(self.design.level.max() + 1)[:, None]
        return (here / here.sum(axis=1, keepdims=True)) @ self.leaving

    def powers(self, *more: np.ndarray) -> Float[np.ndarray, "columns n"]:
        """What the response is multiplied with to be powers of rate over full scale, and `more`."""
        x = self.rate / float(np.degrees(self.full_scale))
        degree = min(3, int(self.design.level.max()))
        return np.linalg.pinv(np.column_stack([x**k for k in range(degree + 1)] + list(more)))


def scale_factor_rows(line: Line) -> dict[str, MeasuredFigure]:
    """Scale factor, and the zero-rate output by the line and by the plateaus at zero."""
    unit, slope = line.read.unit, line.of(line.weights[1])
    is_rate = unit == "deg/s"
    per_rate = "1" if is_rate else f"{unit}/(deg/s)" if unit != "1" else "1/(deg/s)"
    off = f"{PPM * (slope.value - 1.0):+.4g} ppm off 1" if is_rate else ""
    hidden = "with any drift of the bias in it" if line.holds_drift else ""
    rows = {"scale_factor": slope.figure("scale factor", per_rate, ", ".join(filter(None, (off, hidden))))}
    zero = line.of(line.weights[0])
    in_rate = lambda one: "" if is_rate else f"{one.value / line.scale_factor:.4g} deg/s"  # noqa: E731
    outside = not line.rate.min() <= 0.0 <= line.rate.max()
    beyond = "extrapolated: no rate beyond zero" if outside else ""
    rows["zero_rate_line"] = zero.figure(
        "zero-rate output, by the line", unit, ", ".join(filter(None, (in_rate(zero), beyond)))
    )
    at_zero = line.rate == 0.0
    title = "zero-rate output, by plateaus at zero"
    if not at_zero.any():
        none = MeasuredFigure(title, None, -np.inf, np.inf, unit, "no plateau at zero rate")
        return {**rows, "zero_rate_plateaus": none}
    mean = at_zero / at_zero.sum()
    read, apart = line.of(mean), line.of(mean - line.weights[0])
    agree = "agrees with the line"
    if apart.told:
        agree = f"{apart.value:+.3g} ± {apart.reach:.2g} {unit} off the line, as by a nonlinearity"
    said = ", ".join(filter(None, (in_rate(read), agree if len(np.unique(line.rate)) > 2 else "")))
    return {**rows, "zero_rate_plateaus": read.figure(title, unit, said)}


def nonlinearity_rows(line: Line) -> tuple[dict[str, MeasuredFigure], np.ndarray, np.ndarray]:
    """Largest and root mean square deviation, and the curve that explains them; deviation at each rate and its reach.

    One test holds for the deviations of all rates and the two coefficients together: their largest, each over its
    spread, beside that of draws.
    """
    count = int(line.design.level.max()) + 1
    titles = ("scale-factor nonlinearity, largest", "scale-factor nonlinearity, rms")
    if count < 3:
        why = f"{count} rates make a line; a nonlinearity takes three or more"
        none = [MeasuredFigure(title, None, -np.inf, np.inf, "ppm of full scale", why) for title in titles]
        return dict(zip(_NONLINEAR, none, strict=True)), np.zeros(count), np.full(count, np.inf)
    by_level = line.ppm * line.by_level
    value, draws = by_level @ line.found.output, line.found.outputs @ by_level.T
    powers = line.ppm * line.powers()[2:]
    bent = powers @ line.found.output
    bent_draws = line.found.outputs @ powers.T
    every, every_draws = np.concatenate([value, bent]), np.hstack([draws, bent_draws])
    spread = np.maximum(np.std(every_draws - every, axis=0), 1e-12)
    off = np.abs(every_draws - every) / spread
    told = line.known and np.max(np.abs(every) / spread) > np.quantile(off.max(axis=1), _LEVEL)
    level_off = off[:, :count].max(axis=1)
    reach = spread[:count] * (np.quantile(level_off, _LEVEL) if line.known else np.inf)
    largest, rms = float(np.max(np.abs(value))), float(np.sqrt(np.mean(value**2)))
    alone = float(np.quantile(np.max(np.abs(draws - value), axis=1), _LEVEL))
    noise_square = float(np.mean(np.var(draws - value, axis=0)))
    where = float(np.degrees(0.0) + np.unique(line.rate)[int(np.argmax(np.abs(value)))])
    verdict = f"at {where:.6g} deg/s" if told else f"{WITHIN_NOISE}, which alone makes up to {alone:.3g}"
    if not line.known:
        verdict = f"at {where:.6g} deg/s; nothing tells how much of it is noise"
    low = float(np.max(np.abs(value) - reach)) if told else 0.0
    high = float(np.max(np.abs(value) + reach))
    clean = f"without the noise {np.sqrt(max(rms**2 - noise_square, 0.0)):.3g}" if told else WITHIN_NOISE
    spread_rms = np.sqrt(np.mean((draws - value) ** 2, axis=1))
    far = float(np.quantile(spread_rms, _LEVEL)) if line.known else np.inf
    rows = {
        "nonlinearity_max": MeasuredFigure(titles[0], largest, max(low, 0.0), high, "ppm of full scale", verdict),
        "nonlinearity_rms": MeasuredFigure(
            titles[1], rms, max(rms - far, 0.0) if told else 0.0, rms + far, "ppm of full scale",
            clean if line.known else "",
        ),
    }  # fmt: skip
    for name, title, number, each in zip(("quadratic", "cubic"), _CURVES, bent, bent_draws.T, strict=False):
        one = line.of_draws(float(number), each)
        rows[name] = one.figure(title, "ppm of full scale", "" if one.told or not line.known else WITHIN_NOISE)
    return rows, value, reach


_NONLINEAR = ("nonlinearity_max", "nonlinearity_rms")
_CURVES = ("quadratic part at full scale", "cubic part at full scale")


def asymmetry_row(line: Line) -> MeasuredFigure:
    """Scale factor of positive rates less that of negative ones over their mean, and whether a kink at zero makes it
    or a curve (IEEE Std 528 calls only a kink asymmetry).
    """
    title, unit = "scale-factor asymmetry", "ppm"
    sides = [line.rate >= 0.0, line.rate <= 0.0]
    if any(len(np.unique(line.rate[side])) < 2 for side in sides) or not (line.rate.min() < 0.0 < line.rate.max()):
        return MeasuredFigure(title, None, -np.inf, np.inf, unit, "takes two rates a side, zero among them")
    weights = np.zeros((2, len(line.rate)))
    for row, side in zip(weights, sides, strict=True):
        row[side] = np.linalg.pinv(np.column_stack([np.ones(side.sum()), line.rate[side]]))[1]
    one = line.of(PPM / line.scale_factor * (weights[0] - weights[1]))
    if not line.known or not one.told:
        return one.figure(title, unit, WITHIN_NOISE if line.known else "")
    enough = all(len(np.unique(line.rate[side & (line.rate != 0.0)])) >= _SIDES for side in sides)
    if not enough:
        return one.figure(title, unit, f"a kink at zero or a curve: {_SIDES} rates on each side would tell")
    x = line.rate / float(np.degrees(line.full_scale))
    bent = line.of(line.ppm * line.powers(np.abs(x))[2])
    kink = line.of(line.ppm * line.powers(np.abs(x))[-1])
    said = "a kink at zero" if kink.told else "of a curve, not of a kink at zero" if bent.told else "a kink or a curve"
    return one.figure(title, unit, said)


def hysteresis_row(line: Line) -> MeasuredFigure:
    """Output of rates that are approached from below less that from above."""
    title, unit = "hysteresis, from below less from above", "ppm of full scale"
    one = line.effect(DIRECTION)
    if one is not None:
        scaled = Ranged(line.ppm * one.value, line.ppm * one.reach)
        return scaled.figure(title, unit, WITHIN_NOISE if line.known and not scaled.told else "")
    both = np.any(line.read.direction > 0) and np.any(line.read.direction < 0)
    why = "the sequence does not tell it from other figures" if both else "rates are approached from one side only"
    return MeasuredFigure(title, None, -np.inf, np.inf, unit, why)


def drift_row(line: Line, trend: Ranged | None, bent: bool) -> MeasuredFigure:
    """Drift of the bias over time, by a line; `bent` says whether a curved one is told apart, too."""
    timed = line.read.timed
    unit = "deg/s/h" if timed else "deg/s over the test"
    title = "drift of the zero-rate output"
    if trend is None:
        together = line.design.by_temperature
        why = "runs with the temperature, and is told there" if together else _CONFOUNDED
        return MeasuredFigure(title, None, -np.inf, np.inf, unit, why)
    hours = float(np.ptp(line.read.time)) / _HOUR if timed else 1.0
    scale = 1.0 / (line.scale_factor * max(hours, 1e-12))
    one = Ranged(scale * trend.value, abs(scale) * trend.reach)
    said = f"{one.value * hours:.3g} deg/s over the test" if one.told and timed else ""
    said = said if one.told or not line.known else WITHIN_NOISE
    bends = "" if bent else "a bent course is not told apart"
    return one.figure(title, unit, ", ".join(filter(None, (said, bends))))


def temperature_sensitivities(line: Line) -> dict[str, MeasuredFigure]:
    """Temperature sensitivities of zero-rate output and scale factor, where the temperature differs."""
    read = line.read
    if read.temperature is None:
        return {}
    span = float(np.ptp(read.temperature))
    full = np.max(np.abs(read.rate))
    kinds = (
        ("zero_rate_temperature", "zero-rate output over temperature", "deg/s/K", TEMPERATURE, 1.0 / line.scale_factor),
        (
            "scale_factor_temperature", "scale factor over temperature", "ppm/K", TEMPERATURE_RATE,
            PPM / (line.scale_factor * float(np.degrees(full))),
        ),
    )  # fmt: skip
    rows = {}
    for name, title, unit, effect, scale in kinds:
        one = line.effect(effect)
        if one is None:
            why = f"the temperature differs by {span:.2g} K only" if effect not in line.design.left else _CONFOUNDED
            rows[name] = MeasuredFigure(title, None, -np.inf, np.inf, unit, why)
            continue
        per = Ranged(scale / span * one.value, abs(scale) / span * one.reach)
        rows[name] = per.figure(title, unit, "" if per.told or not line.known else WITHIN_NOISE)
    return rows


_CONFOUNDED = "the sequence does not tell it from other figures"


def trend_of(line: Line, other: Callable[[], Line]) -> Ranged | None:
    """The straight drift, by columns with it where the first have none."""
    return line.effect(TREND) or other().effect(TREND)


def noise_rows(line: Line) -> dict[str, MeasuredFigure]:
    """Noise of samples and its dependence on the rate, and the angle random walk that the means of batches tell."""
    read, rows = line.read, {}
    scatter = read.scatter
    if not np.all(np.isfinite(scatter)) or not np.all(scatter > 0.0):
        return {}
    typical = float(np.sqrt(np.mean(scatter**2))) / abs(line.scale_factor)
    x = np.abs(line.rate) / np.max(np.abs(line.rate))
    said, spread = "", np.inf
    if len(scatter) >= 6 and np.ptp(x) > 0.0:
        fit = stats.linregress(x, np.log(scatter))
        spread = typical * float(np.std(np.log(scatter), ddof=1)) * 1.96 / np.sqrt(len(scatter))
        ends = np.exp(fit.slope + np.array([-1.0, 1.0]) * stats.t.ppf(0.975, len(scatter) - 2) * fit.stderr)
        grows = not ends[0] <= 1.0 <= ends[1]
        said = f"at the greatest rate {np.exp(fit.slope):.3g} times that at zero ({ends[0]:.3g} to {ends[1]:.3g})"
        said += "" if grows else ": does not depend on the rate"
    rows["noise"] = Ranged(typical, spread).figure("noise of samples, rms", "deg/s", said)
    if np.all(read.walk > 0.0):
        walk = 60.0 * float(np.sqrt(np.mean(read.walk))) / abs(line.scale_factor)
        freedom = _FREEDOM * len(scatter)
        low, high = (walk * np.sqrt(freedom / stats.chi2.ppf(tail, freedom)) for tail in (0.975, 0.025))
        rows["angle_random_walk"] = MeasuredFigure(
            "angle random walk, by the Allan deviation",
            walk,
            float(low),
            float(high),
            "deg/√h",
            "of tenths of the plateaus",
        )
    return rows
