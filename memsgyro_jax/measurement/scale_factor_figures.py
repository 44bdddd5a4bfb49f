"""Figures of a rate-table test in the terms of IEEE Std 1431 and 528, from the response and its draws."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from .rate_design import DIRECTION, TEMPERATURE, TEMPERATURE_RATE, TREND
from .rate_line import LEVEL, PPM, Line, Ranged
from .scale_factor_result import MeasuredFigure


_HOUR = 3600.0
_FREEDOM = 13.0  # of the overlapping Allan variance of white noise at a tenth of its record
_SIDES = 3  # rates on each side of zero, from which on a kink there is told from a curve
WITHIN_NOISE = "within the noise"
_OF_FULL_SCALE = "ppm of full scale"
_CONFOUNDED = "the sequence does not tell it from other figures"
_NONLINEAR = {
    "nonlinearity_max": "scale-factor nonlinearity, largest",
    "nonlinearity_rms": "scale-factor nonlinearity, rms",
}
_CURVES = {"quadratic": "quadratic part at full scale", "cubic": "cubic part at full scale"}


def scale_factor_rows(line: Line) -> dict[str, MeasuredFigure]:
    """Scale factor, and the zero-rate output by the line and by the plateaus at zero."""
    unit, slope = line.read.unit, line.of(line.weights[1])
    is_rate = unit == "deg/s"
    per_rate = "1" if is_rate else f"{unit}/(deg/s)" if unit != "1" else "1/(deg/s)"
    one = np.copysign(1.0, slope.value)
    off = f"{PPM * (abs(slope.value) - 1.0):+.4g} ppm off {one:.0f}" if is_rate else ""
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


class Deviations(NamedTuple):
    """Mean deviation from the line at each rate [ppm of full scale].

    Args:
        value: (levels,).
        noise: (draws, levels) what it may be off by.
        reach: (levels,) half of an interval that holds all rates at once; infinite where nothing tells it.
        told: whether they are more than noise.
    """

    value: Float[np.ndarray, " levels"]
    noise: Float[np.ndarray, "draws levels"]
    reach: Float[np.ndarray, " levels"]
    told: bool


def deviations(line: Line) -> Deviations:
    """Of each rate, and whether they are more than noise.

    One test holds for all rates and the coefficients of the curve together: the largest of them, each over its spread,
    beside that of draws.
    """
    by_level = line.ppm * np.vstack([line.by_level, line.powers()[2:]])
    count = int(line.design.level.max()) + 1
    value = by_level @ line.found.output
    noise = line.found.outputs @ by_level.T - value
    spread = np.maximum(np.std(noise, axis=0), np.finfo(float).tiny)
    off = np.abs(noise) / spread
    told = line.known and np.max(np.abs(value) / spread) > np.quantile(off.max(axis=1), LEVEL)
    far = float(np.quantile(off[:, :count].max(axis=1), LEVEL)) if line.known else np.inf
    return Deviations(value[:count], noise[:, :count], spread[:count] * far, bool(told))


def nonlinearity_rows(line: Line) -> tuple[dict[str, MeasuredFigure], np.ndarray, np.ndarray]:
    """Largest and rms deviation, and the curve that explains them; deviation at each rate and its reach."""
    count = int(line.design.level.max()) + 1
    if count < 3:
        why = f"{count} rates make a line; a nonlinearity takes three or more"
        none = [MeasuredFigure(title, None, -np.inf, np.inf, _OF_FULL_SCALE, why) for title in _NONLINEAR.values()]
        return dict(zip(_NONLINEAR, none, strict=True)), np.zeros(count), np.full(count, np.inf)
    found = deviations(line)
    rows = {"nonlinearity_max": _largest(line, found), "nonlinearity_rms": _rms(line, found)}
    for name, title, weights in zip(_CURVES, _CURVES.values(), line.powers()[2:], strict=False):
        one = line.of(line.ppm * weights)
        said = "" if one.told or not line.known else WITHIN_NOISE
        if name == "cubic" and one.told and line.cubic_holds_drift:
            said = "or a scale factor that drifts"
        rows[name] = one.figure(title, _OF_FULL_SCALE, said)
    return rows, found.value, found.reach


def _largest(line: Line, found: Deviations) -> MeasuredFigure:
    worst = int(np.argmax(np.abs(found.value)))
    verdict = f"at {np.unique(line.rate)[worst]:.6g} deg/s"
    if not line.known:
        verdict += "; nothing tells how much of it is noise"
    elif not found.told:
        alone = np.quantile(np.max(np.abs(found.noise), axis=1), LEVEL)
        verdict = f"{WITHIN_NOISE}, which alone makes up to {alone:.3g}"
    low = max(float(np.max(np.abs(found.value) - found.reach)), 0.0) if found.told else 0.0
    high = float(np.max(np.abs(found.value) + found.reach))
    return MeasuredFigure(
        _NONLINEAR["nonlinearity_max"], float(abs(found.value[worst])), low, high, _OF_FULL_SCALE, verdict
    )


def _rms(line: Line, found: Deviations) -> MeasuredFigure:
    """The root mean square of what differs lies within that of the differences of what is told."""
    rms = float(np.sqrt(np.mean(found.value**2)))
    reach = float(np.quantile(np.sqrt(np.mean(found.noise**2, axis=1)), LEVEL)) if line.known else np.inf
    clean = np.sqrt(max(rms**2 - float(np.mean(found.noise**2)), 0.0))
    verdict = f"without the noise {clean:.3g}" if found.told else WITHIN_NOISE if line.known else ""
    low = max(rms - reach, 0.0) if found.told else 0.0
    return MeasuredFigure(_NONLINEAR["nonlinearity_rms"], rms, low, rms + reach, _OF_FULL_SCALE, verdict)


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
    title, unit = "hysteresis, from below less from above", _OF_FULL_SCALE
    one = line.effect(DIRECTION)
    if one is not None:
        scaled = Ranged(line.ppm * one.value, abs(line.ppm) * one.reach)
        return scaled.figure(title, unit, WITHIN_NOISE if line.known and not scaled.told else "")
    why = _CONFOUNDED if DIRECTION in line.design.left else "each rate but zero is approached from one side"
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
