"""A datasheet of a simulated lot in the terms of IEEE Std 528 and 1431: the tests of a laboratory, run in the model."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity, whole
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.loop.loop import ClosedLoop, as_loop
from memsgyro_jax.loop.scenario import Scenario, Step, as_scenario
from memsgyro_jax.loop.trace import count_steps
from memsgyro_jax.montecarlo.spread import Spread

from .datasheet_rows import Datasheet, DatasheetRow
from .datasheet_tests import (
    around_the_axes,
    noises,
    record_needed,
    scale_and_bias,
    start_up,
    step_answer,
    temperature_rows,
    with_trim,
)
from .lot_outputs import Outputs, lot_outputs


_POINTS = 9  # rates of the table, from minus to plus full scale
_WINDOWS = 400  # of a run


class RateTests(NamedTuple):
    """What the tests share: `run(scenario)` without noise, `noisy(scenario, time)`, surroundings at a rate, times."""

    run: Callable[[Scenario], Outputs]
    noisy: Callable[[Scenario, float], Outputs]
    at: Callable[..., Scenario]
    loop: ClosedLoop
    full_scale: float
    settle: float
    duration: float


def datasheet(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Any = 0.0,
    *,
    full_scale: float | str = "300 deg/s",
    dies: int = 64,
    sample_rate: float | str = 100e3,
    duration: float | str = 0.1,
    settle: float | str | None = None,
    noise_duration: float | str | None = None,
    temperatures: tuple[float, ...] = (233.15, 298.15, 358.15),
    trim: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Datasheet:
    """Test `dies` dies of `spread` around `loop` as a laboratory would, and tell every figure over the lot.

    The rate of `scenario` is replaced, all else of it stays. Nine constant rates from minus to plus `full_scale`
    [rad/s] without read-out noise give zero-rate output, scale factor and non-linearity, each from `settle` [s] (half
    the duration when left out) to `duration` [s]; a step of a tenth of the full scale gives bandwidth and delay; a run
    with noise of `noise_duration` [s] (left out: 200 periods of the bandwidth, ten to a hundred times the duration)
    densities and Allan deviation. Frame acceleration and cross rates act where the device keeps its frame terms,
    `temperatures` [K] where an effect of it depends on them; a figure that the model cannot give says "not modelled"
    and why. With `trim` each die gets the offset and scale that its outputs at half the full scale, both ways, ask for,
    and figures are told before and after.
    `progress` is told what happens.

    Raises `InputError` for settings that cannot be run, and outside float64.
    """
    runtime.require_float64("datasheet")
    loop, seed, dies = as_loop(loop), whole("seed", seed), whole("dies", dies, 3)
    sample_rate, duration = quantity("sample_rate", sample_rate, "Hz"), quantity("duration", duration, "s")
    full_scale, settle = quantity("full_scale", full_scale, "rad/s"), _settle(settle, duration)
    noise_duration = noise_duration if noise_duration is None else quantity("noise_duration", noise_duration, "s")
    if not full_scale > 0.0:
        raise InputError(f"Argument `full_scale` must be positive, but {full_scale:g} rad/s was given.")
    surroundings, loop = as_scenario(scenario), replace(loop, blocks=None).sampled_at(sample_rate, duration=duration)
    told = progress or (lambda sentence: None)
    quiet = eqx.tree_at(lambda made: made.readout.noise_density, loop, (jnp.zeros(()), jnp.zeros(())))
    window = max(1, count_steps(sample_rate, duration) // _WINDOWS)
    many = partial(lot_outputs, spread=spread, dies=dies, seed=seed, sample_rate=sample_rate, window=window)
    windows = round(sample_rate * duration) // window

    def at(rate: float, after: float | None = None, **changes: Any) -> Scenario:
        step = Step(0.5 * duration, rate if after is None else after, rate)
        return replace(surroundings, rate=step, **changes)

    bench = RateTests(
        run=lambda scenario: many(quiet, scenario=scenario, windows=windows),
        noisy=lambda scenario, time: many(loop, scenario=scenario, windows=round(sample_rate * time) // window),
        at=at, loop=loop, full_scale=full_scale, settle=settle, duration=duration,
    )  # fmt: skip
    told("constant rates")
    rates = np.linspace(-full_scale, full_scale, _POINTS)
    table = [bench.run(at(rate)) for rate in rates]
    told("step of the rate")
    answer, step_rows = step_answer(bench, table[_POINTS // 2])
    told("noise")
    noise_rows = noises(bench, answer.bandwidth, noise_duration or record_needed(answer.bandwidth, duration))
    told("other axes, acceleration, temperature")
    outputs, static = scale_and_bias(bench, rates, table)
    rows = (*static, *noise_rows, *step_rows, start_up(bench, table[-1]), *around_the_axes(bench, table))
    rows = (*rows, *temperature_rows(bench, temperatures))
    alive = np.all([run.alive for run in table], axis=0) & answer.alive
    rows = tuple(replace(row, values=np.where(alive, row.values, np.nan)) for row in rows)
    return Datasheet(
        rows=with_trim(rows, rates, outputs, full_scale) if trim else rows,
        dies=dies,
        lost=int(np.sum(~alive)),
        full_scale=full_scale,
        rates=rates,
        outputs=outputs,
        times=answer.times,
        answers=answer.values,
        settings=Settings.of(
            loop, surroundings, spread, full_scale, sample_rate=sample_rate, duration=duration, seed=seed
        ),
        notes=_notes(alive, rows),
    )


def _settle(given: float | str | None, duration: float) -> float:
    settle = 0.5 * duration if given is None else quantity("settle", given, "s")
    if not 0.0 <= settle < duration:
        raise InputError(f"Argument `settle` must lie within the duration of {duration:g} s, but is {settle:g} s.")
    return settle


def _notes(alive: np.ndarray, rows: tuple[DatasheetRow, ...]) -> tuple[str, ...]:
    lost = int(np.sum(~alive))
    said = [f"{lost} of {len(alive)} dies were lost (out of travel or not finite) and count nowhere."] if lost else []
    return (*said, "Simulated, not measured: what the model leaves out is not in these figures.")
