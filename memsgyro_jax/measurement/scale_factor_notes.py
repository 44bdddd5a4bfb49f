"""What a rate-table test shows from run to run, which plateau stands alone, and what its sequence leaves open."""

from dataclasses import replace

import numpy as np
from scipy import stats

from .rate_design import RUN, RUN_RATE, TREND
from .rate_line import PPM, Line
from .scale_factor_figures import WITHIN_NOISE
from .scale_factor_result import MeasuredFigure


_OUTLYING = 0.01  # chance of naming a plateau of a test in which none stands alone
_EARTH = 15.041 / 3600.0  # deg/s
_DRIFT = 1e-3  # of the full scale, for which a note tells what a drift would count as


def with_runs(line: Line, figures: dict[str, MeasuredFigure]) -> tuple[dict[str, MeasuredFigure], tuple[str, ...]]:
    """The figures with the repeatability between runs; where runs differ by more than the noise, a figure's interval is
    that of the mean of so many runs.
    """
    runs = int(line.read.run.max()) + 1
    if runs < 2:
        return figures, ()
    if {RUN, RUN_RATE} & {*line.design.left}:
        return figures, ("Repeatability is not told: the sequence does not tell runs from temperature or time.",)
    rows, said = dict(figures), []
    per_rate = np.degrees(np.max(np.abs(line.read.rate)))
    for name, title, unit, effect, factor in (
        ("scale_factor", "scale-factor repeatability", "ppm", RUN_RATE, PPM / (line.scale_factor * per_rate)),
        ("zero_rate_line", "zero-rate repeatability", "deg/s", RUN, 1.0 / line.scale_factor),
    ):
        value, draws = _of_runs(line, effect)
        spread = float(np.std(value, ddof=1))
        alone = float(np.quantile(np.std(draws - value, axis=1, ddof=1), 0.95)) if line.known else np.inf
        ends = spread * np.sqrt((runs - 1) / stats.chi2.ppf([0.975, 0.025], runs - 1))
        beyond = spread > alone
        verdict = f"standard deviation over {runs} runs" + ("" if beyond else f", {WITHIN_NOISE}")
        rows[name.replace("_line", "") + "_repeatability"] = MeasuredFigure(
            title, abs(factor) * spread, abs(factor) * float(ends[0]) if beyond else 0.0,
            abs(factor) * max(float(ends[1]), alone), unit, verdict,
        )  # fmt: skip
        if beyond:
            rows[name], sentence = _over_runs(figures[name], spread / (per_rate if effect == RUN_RATE else 1.0), runs)
            said.append(sentence)
    return rows, tuple(said)


def _of_runs(line: Line, effect: str) -> tuple[np.ndarray, np.ndarray]:
    """What each run adds to the mean over all, and its draws, (runs,) and (draws, runs)."""
    numbers = np.arange(1, line.read.run.max() + 1)
    share = np.array([np.mean(line.read.run == number) for number in numbers])
    places = [k for k, name in enumerate(line.design.names) if name == effect]
    adds = (np.arange(len(numbers) + 1)[:, None] == numbers) - share
    return adds @ line.found.effects[places], line.found.effect_draws[:, places] @ adds.T


def _over_runs(figure: MeasuredFigure, spread: float, runs: int) -> tuple[MeasuredFigure, str]:
    assert figure.value is not None
    reach = spread / np.sqrt(runs) * float(stats.t.ppf(0.975, runs - 1))
    reach = max(float(reach), 0.5 * (figure.high - figure.low))
    what = figure.title.split(",")[0]
    said = f"Runs differ in {what} by more than the noise: its interval is that of a mean of {runs} runs."
    return replace(figure, low=figure.value - reach, high=figure.value + reach), said


def sequence_notes(line: Line) -> tuple[str, ...]:
    """What rates and their sequence cannot tell."""
    said, rate = [], line.rate
    count = len(np.unique(rate))
    if count < 3:
        said.append(f"{count} rates tell no nonlinearity; the scale factor is that of the line between them.")
    if rate.min() >= 0.0 or rate.max() <= 0.0:
        way = "positive" if rate.max() > 0.0 else "negative"
        said.append(f"All rates are {way} or zero: nothing is told of others.")
    if TREND in line.design.left and len(rate) > 2:
        said.append(_TOGETHER if line.design.by_temperature else _confounded(line))
    if count > 3 and line.cubic_holds_drift and line.of(line.powers()[3]).told:
        said.append(
            "The greater the rates the later they come: a scale factor that drifts, with temperature say, cannot be "
            "told from the cubic part; mix the order of the rates."
        )
    if not line.known:
        said.append("Nothing tells the noise of the means: repeat plateaus, or give the raw log; no interval is told.")
    elif not line.found.spare:
        said.append("Intervals are of the noise within plateaus alone: what moves the output between does not show.")
    if line.read.unit == "deg/s" and line.scale_factor < 0.0:
        said.append(
            "The output falls as the rate rises: the gyro stands upside down on the table, or one of the two counts "
            "the other way round; negate the rate's column if it is the table."
        )
    bias = line.of(line.weights[0])
    if bias.reach / abs(line.scale_factor) < _EARTH:
        said.append(
            f"The zero-rate output holds the rate of the earth about the axis, at most {_EARTH:.4f} deg/s, unless the "
            "rates of the table do."
        )
    if line.read.voltage is not None and np.ptp(line.read.voltage) > 1e-3 * np.max(np.abs(line.read.voltage)):
        low, high = line.read.voltage.min(), line.read.voltage.max()
        said.append(f"The bias voltage runs from {low:.6g} to {high:.6g} V in this test, which is not taken out.")
    return tuple(said)


_TOGETHER = "Time and temperature run together: what drifts is told as the temperature's, and may be the time's."


def _confounded(line: Line) -> str:
    """Which drift the sequence hides, and what it would count as."""
    since = line.design.since
    full = float(np.degrees(line.full_scale))
    hidden = _DRIFT * full
    if line.holds_drift:
        counts = PPM * _DRIFT * full * abs(float(line.weights[1] @ since))
        way = "in one way, so" if abs(np.corrcoef(since, line.rate)[0, 1]) > 0.9 else "so"
        return (
            f"Rates follow each other {way} that a drift of the bias cannot be told from the scale factor: "
            f"{hidden:.3g} deg/s from begin to end would count as {counts:.3g} ppm; return to zero between rates, or "
            "sweep back."
        )
    return (
        "Rates follow each other so that a bias which drifts along a bent course, as in warm-up, cannot be told from "
        f"nonlinearity and scale factor; return to zero between rates, or sweep twice ({hidden:.3g} deg/s of it are "
        "1000 ppm of full scale)."
    )


def lone_plateaus(line: Line) -> list[int]:
    """Plateaus that the others do not expect."""
    found, freedom = line.found, line.found.spare
    if freedom < 3:
        return []
    square = np.minimum(found.misfit**2, freedom * (1.0 - 1e-12))
    apart = np.abs(found.misfit) * np.sqrt((freedom - 1) / (freedom - square))
    chance = 2.0 * len(apart) * stats.t.sf(apart, freedom - 1)
    worst = int(np.argmin(chance))
    return [worst] if chance[worst] < _OUTLYING else []
