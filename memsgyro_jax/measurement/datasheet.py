"""A datasheet of a simulated lot in the terms of IEEE Std 528 and 1431: the tests of a laboratory, run in the model."""

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool
from scipy import stats

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import listed
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.noise_budget import DITHER, noise_in_steps, thermal_left_out
from memsgyro_jax.loop.settling import duration_to_settle
from memsgyro_jax.montecarlo.spread import Spread, as_spread

from .bandwidth_cause import limits
from .datasheet_rows import FEWEST, Datasheet, DatasheetRow
from .datasheet_tests import (
    Answer,
    around_the_axes,
    noises,
    record_needed,
    scale_and_bias,
    start_up,
    step_answer,
    step_size,
    stopped_noise,
    temperature_rows,
    with_trim,
)
from .lot_outputs import Outputs
from .over_temperature import check_temperatures
from .rate_tests import RATE, RateTests


_FEW = 30  # dies beyond which the spread is known to a third
NOT_SETTLED = "not settled: a note says when it would be"
_POINTS = 9  # rates of the table, from minus to plus full scale
_SILENCE = 5.0  # s between two sentences about one run
_LEAST = 0.1  # of the part of a run that counts: the shortest record with noise
_COARSE = 0.05  # of a window's frequency: a bandwidth up to there is told to a percent in spite of what folds back
_OTHERS = 10  # runs about as long as one of the table


def datasheet(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Any = 0.0,
    *,
    full_scale: float | str = "300 deg/s",
    dies: int = 64,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    settle: float | str | None = None,
    noise_duration: float | str | None = None,
    temperatures: tuple[float, ...] = (233.15, 298.15, 358.15),
    trim: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    draft: Callable[[Datasheet], None] | None = None,
) -> Datasheet:
    """Test `dies` dies of `spread` around `loop` as a laboratory would, and tell every figure over the lot.

    The rate of `scenario` is replaced, and its spread left out, all else of it stays; `sample_rate` and `duration`
    follow the device where they are left out (`Operation`). Nine constant rates from minus to plus `full_scale`
    [rad/s] without read-out noise give zero-rate output, scale factor and non-linearity, each from `settle` [s] (half
    the duration when left out) to `duration` [s]; a step of a tenth of the full scale gives bandwidth and delay; a run
    with noise of `noise_duration` [s] (left out: 192 to 384 periods of the bandwidth, ten to a hundred durations)
    densities and Allan deviation. Frame acceleration and cross rates act where the device keeps its frame terms,
    `temperatures` [K] where an effect of it depends on them; a figure that the model cannot give says "not modelled"
    and why. With `trim` each die gets the offset and scale that its outputs at half the full scale, both ways, ask for,
    and figures are told before and after.
    `progress` is told what happens and about how long it takes, `draft` is given all figures but those of the noise
    before the run with noise, which is the longest.

    Raises `InputError` for settings that cannot be run, and outside float64.
    """
    bench = RateTests.of(
        "datasheet", loop, as_spread(spread), scenario, full_scale=full_scale, dies=dies, sample_rate=sample_rate,
        duration=duration, settle=settle, seed=seed,
    )  # fmt: skip
    check_temperatures(temperatures)
    noise_duration = noise_duration if noise_duration is None else quantity("noise_duration", noise_duration, "s")
    check_noise_duration(bench, noise_duration)
    told = progress or (lambda sentence: None)
    rates = np.linspace(-bench.full_scale, bench.full_scale, _POINTS)
    told(f"{dies} dies at {_POINTS} constant rates, {bench.duration:g} s each; the first compiles, some seconds")
    table, pace = _timed(bench, rates, told)
    told("step of the rate")
    stepped, answer, step_rows = step_told(bench, table[_POINTS // 2], told)
    told("other axes, acceleration, temperature")
    outputs, static = scale_and_bias(bench, rates, table)
    drifts, over_temperature = temperature_rows(bench, temperatures, told)
    started, around = start_up(bench, table[-1]), around_the_axes(bench, table)
    alive = np.all([run.alive for run in table], axis=0) & answer.alive
    rest, begun = (alive & (started.values <= begin) for begin in (bench.settle, 0.5 * bench.duration))
    why = unsettled(alive, started, bench)
    if np.sum(begun) < FEWEST:  # what the step shows is of a start
        answer = answer._replace(unknown=answer.unknown or NOT_SETTLED)
    told("what sets the bandwidth")
    limited = limits(stepped, answer)
    step_rows = at_rest(step_rows, begun, why)
    full, settled = static[0], static[1:]  # the full scale is declared
    settled, around, over_temperature = (at_rest(part, rest, why) for part in (settled, around, over_temperature))
    outputs, answers = np.where(rest, outputs, np.nan), np.where(begun[:, None], answer.values, np.nan)
    if drifts is not None:
        known = {name: np.where(rest, getattr(drifts, name), np.nan) for name in ("zero_rate", "scale_factor")}
        drifts = replace(drifts, **known)
    settings = Settings.of(
        bench.loop, bench.surroundings, spread, bench.full_scale, sample_rate=bench.sample_rate,
        duration=bench.duration, seed=seed,
    )  # fmt: skip

    def sheet(noise_rows: tuple[DatasheetRow, ...]) -> Datasheet:
        noise_rows = at_rest(noise_rows, rest, why)
        rows = (full, *settled, *noise_rows, *step_rows, started, *around, *over_temperature)
        rows = tuple(replace(row, values=np.where(alive, row.values, np.nan)) for row in rows)
        rows = with_trim(rows, rates, outputs, bench.full_scale) if trim else rows
        said = (*limited, *(row.note for row in rows if row.note), *impossible_ends(rows))
        return Datasheet(
            rows, dies, int(np.sum(~alive)), bench.full_scale, rates, outputs, answer.times, answers, settings,
            (*said, *_rate_left_out(spread), *notes_of(alive, started, bench)), drifts,
        )  # fmt: skip

    record = noise_duration or record_needed(bench, answer.bandwidth, table[0].period)
    if draft is not None:
        draft(sheet(stopped_noise(bench, record)))
    return sheet(noises(bench, answer, record, _shares(record, pace * record / bench.duration, told)))


def step_told(
    bench: RateTests, still: Outputs, told: Callable[[str], None]
) -> tuple[RateTests, Answer, tuple[DatasheetRow, ...]]:
    """What a step of the rate tells, and the tests that told it: finer ones where windows hide how fast it is."""
    found = step_answer(bench, still, bench.run(bench.at(0.0, step_size(bench))))
    fast = np.nan_to_num(found[0].bandwidth, nan=np.inf) * still.period > _COARSE
    single = still.period * bench.sample_rate < 1.5  # samples in a window
    if bench.finer is None or single or found[0].unknown or np.mean(fast) <= 0.5:
        return bench, *found
    finer = bench.finer()
    told(f"the step again, in means over less than {still.period:.2g} s: its answer is fast")
    return step_told(finer, finer.run(finer.at(0.0)), told)


def check_noise_duration(bench: RateTests, noise_duration: float | None) -> None:
    """Raises `InputError` for a record with noise that ends before its figures count."""
    least = bench.settle + _LEAST * (bench.duration - bench.settle)
    if noise_duration is not None and noise_duration < least:
        raise InputError(
            f"Argument `noise_duration` must be {least:.3g} s or more, as its figures count from {bench.settle:.3g} s "
            f"on (`settle`, half the duration when left out), but is {noise_duration:.3g} s; left out, it is as long "
            "as the bandwidth asks for."
        )


def _timed(bench: RateTests, rates: np.ndarray, told: Callable[[str], None]) -> tuple[list[Outputs], float]:
    """The lot at each rate, and how long one run takes [s] once it is compiled, which is told."""
    table, took = [], []
    for rate in rates:
        began = time.perf_counter()
        table.append(bench.run(bench.at(rate)))
        took.append(time.perf_counter() - began)
        if len(took) == 2:
            rest = (len(rates) + _OTHERS) * took[1] + max(0.0, took[0] - took[1])
            told(f"about {_about(rest)} for all but the noise, which takes {_about(took[1] / bench.duration)} a second")
    return table, min(took)


def _shares(record: float, seconds: float, told: Callable[[str], None]) -> Callable[[float], None]:
    """Tells that a record with noise [s] will take some `seconds`, and returns what tells how far it is."""
    told(f"a record of {record:.3g} s with noise, about {_about(seconds)}; what is known so far is kept")
    last = [time.perf_counter()]
    first: list[tuple[float, float]] = []  # until then it is compiled, which tells nothing of what is left

    def share(done: float) -> None:
        now = time.perf_counter()
        first.append((now, done))
        (began, before), silent = first[0], now - last[0]
        if silent > _SILENCE and done < 1.0:
            last[0] = now
            left = f", about {_about((now - began) * (1.0 - done) / (done - before))} left" if done > before else ""
            told(f"{100.0 * done:.0f} % of the record with noise{left}")

    return share


def _about(seconds: float) -> str:
    return f"{float(f'{seconds:.1g}') if seconds < 10.0 else round(seconds):g} s"


def impossible_ends(rows: Iterable[DatasheetRow]) -> tuple[str, ...]:
    """A sentence that names the figures whose interval passes what any die can be."""
    both = ((row.name, found) for row in rows if row.positive for found in (row.over_dies, row.over_trimmed))
    named = dict.fromkeys(name for name, found in both if found is not None and found.low < 0.0)
    if not named:
        return ()
    return (
        f"The 95 % interval of {', '.join(named)} passes zero, below which no die can be: so few dies do not tell it.",
    )


def at_rest(rows: Iterable[DatasheetRow], rest: Bool[np.ndarray, " dies"], why: str) -> tuple[DatasheetRow, ...]:
    """The rows without the dies that are not at `rest`, and without figures where too few are; `why` is a note."""
    few = "" if np.sum(rest) >= FEWEST else why and NOT_SETTLED
    return tuple(replace(row, values=np.where(rest, row.values, np.nan), missing=row.missing or few) for row in rows)


def unsettled(alive: np.ndarray, started: DatasheetRow, bench: RateTests) -> str:
    """How many of the dies were still starting when the figures began to count, and what would do; empty for none."""
    late = alive & ~(started.values <= bench.settle)
    if not late.any():
        return ""
    seen = started.values[late & np.isfinite(started.values)]
    enough = duration_to_settle(bench.loop, bench.settle, bench.duration, float(np.max(seen, initial=0.0)))
    about = f", and {started.missing}" if started.missing else ""
    return (
        f"{int(np.sum(late))} of {len(alive)} dies have not started by {bench.settle:.3g} s, from which on figures "
        f'count (`settle`, half the duration when left out){about}: `duration = "{enough:g} s"` in the study\'s '
        "`[sweep]` should do"
    )


def _rate_left_out(spread: Spread) -> tuple[str, ...]:
    held = listed((item.path for item in spread.items if item.path.startswith(RATE)), "`")
    return (f"The spread of {held} is left out: the rate is that of each test.",) if held else ()


def notes_of(alive: np.ndarray, started: DatasheetRow, bench: RateTests) -> tuple[str, ...]:
    """What is to be said of the lot beside its rows."""
    lost = int(np.sum(~alive))
    said = [f"{lost} of {len(alive)} dies were lost (out of travel or not finite) and count nowhere."] if lost else []
    if why := unsettled(alive, started, bench):
        said.append(f"{why[0].upper()}{why[1:]}; they are left out of all figures at constant rates.")
    told = len(alive) - lost
    if 1 < told < _FEW:
        low, high = np.sqrt((told - 1) / stats.chi2.ppf([0.975, 0.025], told - 1))
        said.append(
            f"{told} dies are few for a spread: σ is known within {low:.2g} to {high:.2g} times (95 %), and the ends "
            f"at ±3 σ may be what no die can be; take {_FEW} dies or more."
        )
    steps = noise_in_steps(bench.loop, 1.0 / bench.sample_rate)
    if np.isfinite(steps):
        said.append(
            "Figures without noise are told without the steps of the converter, across which noise carries the signal"
            + (f"; a sample's noise is but {steps:.2g} of a step, which may move them." if steps < DITHER else ".")
        )
    if left_out := thermal_left_out(bench.loop, sample_rate=bench.sample_rate):
        said.append(f"{left_out}.")
    return (*said, "Simulated, not measured: what the model leaves out is not in these figures.")
