"""Tunes a closed loop by gradient over a lot of dies: gains, noises and bandwidths, in two stages by default.

A squared rate error sees only ratios of a filter's noises and does not know when they are wrong together; the
likelihood of the innovations fixes their scale but is blind to what follows the filter. Hence first the observer's own
numbers by likelihood, then the rest by the error.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity, refuse_traced, whole
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.provenance import Settings, fingerprint
from memsgyro_jax.loop.blocks.run import prepared
from memsgyro_jax.loop.loop import ClosedLoop, as_loop
from memsgyro_jax.loop.observers.base import check_claims
from memsgyro_jax.loop.operation import run_of
from memsgyro_jax.loop.port_shapes import check_loss, check_ports
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario, as_scenario
from memsgyro_jax.loop.trace import count_steps
from memsgyro_jax.montecarlo.parts import parts_tones
from memsgyro_jax.montecarlo.spread import Spread, as_spread
from memsgyro_jax.montecarlo.sweep import sweep

from .caveats import margin_eaten, warnings_of
from .descent import Descent, DescentStep, Judged, descend, sought
from .fates import null_directions, tuned_numbers
from .grid import rescued, scanned
from .losses import AbstractLoss, InnovationLikelihood, SquaredRateError
from .objective import Objective, Timing, Values, evaluated, noise_of
from .result import StageResult, TunedNumber, Tuning, merit_of, ratio_of
from .right import LEVEL
from .tunable import Group, Tunables, resolved


TRAINING, VALIDATION = 2**20, 2**21  # numbers of the first dies; those of a report or a sweep begin at 0
_LOST = 10.0  # a lost die counts like the worst die at the start and this many times its size


@dataclass(frozen=True)
class TuningStage:
    """A loss, the numbers that it moves (their places in the tree), and why."""

    loss: AbstractLoss
    which: tuple[bool, ...]
    reason: str


def tune(
    loop: ClosedLoop,
    scenario: Scenario | AbstractProfile | float = 1.0,
    *,
    free: Group,
    spread: Spread | None = None,
    loss: AbstractLoss | None = None,
    dies: int = 128,
    validation_dies: int = 64,
    report_dies: int = 256,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    settle: float | str | None = None,
    seed: int = 0,
    evaluations: int = 40,
    progress: Callable[[str], None] | None = None,
    keep: str | Path | None = None,
) -> Tuning:
    """Move what is `free` (see `free`) of `loop` until the dies of `spread` (15 % by default) fare best.

    Without a `loss` there are two stages: numbers of a Kalman filter by the likelihood of its innovations, what is left
    by the squared rate error, both over the time from `settle` [s] on (default: half the duration; `sample_rate` and
    `duration` follow the device where they are left out, as in `Operation`). With one it judges all. Training,
    validation and report run on different dies, all of the lot `seed`: the report on dies 0 to `report_dies` - 1, as
    `sweep` runs them. Every setting is tried on the same dies with the same noise. A stage ends when the loss or the
    validation dies gain no more, or after `evaluations` gradients; the best on validation counts.
    A loop in blocks is tuned in blocks: a loss then counts their ends, a likelihood their statistics.
    A free number that `spread` varies is the design value its dies lie around (design centring). A lost die counts as a
    large finite loss and is reported. `progress` is told what happens, in sentences. With
    `keep`, a folder, evaluations and the dies of the report are kept there: the same call goes on where another
    was killed, to the same bits.

    Raises `InputError` for what is free but unknown, for bounds that do not hold the start, for settings that cannot be
    run, for a loss that is no number at the start, for numbers of a filter under a loss that believes what it claims,
    and outside float64.
    """
    runtime.require_float64("tune")
    refuse_traced("`tune` decides by what it finds and", "plain numbers, or the gradient of `simulate`", loop, scenario)
    loop, seed = as_loop(loop), whole("seed", seed)
    dies, validation_dies = whole("dies", dies, 2), whole("validation_dies", validation_dies, 1)
    report_dies, evaluations = whole("report_dies", report_dies, 1), whole("evaluations", evaluations, 1)
    sample_rate, duration = run_of(loop, sample_rate, duration)
    scenario, loop = as_scenario(scenario), loop.sampled_at(sample_rate, duration=duration)
    spread = Spread.relative(0.15) if spread is None else as_spread(spread)
    settle = 0.5 * duration if settle is None else quantity("settle", settle, "s")
    tunables = resolved(loop, free, sample_rate, duration)
    varied = (item.path for item in spread.resolved(loop))
    loop, hindered = prepared(loop, apart=parts_tones((*tunables.paths, *varied)))
    _check(dies, validation_dies)
    check_ports(loop, scenario, 1.0 / sample_rate)
    check_loss(loss, loop, scenario, 1.0 / sample_rate)
    check_claims(loop.observer)
    stages = _stages(loop, tunables, loss, settle)
    _check_priors(stages, tunables)
    _check_claims(loss, tunables)
    timing = timing_of(sample_rate, duration, max(float(stage.loss.begins()) for stage in stages))
    told = progress or (lambda sentence: None)
    for sentence in hindered:
        told(sentence)
    drawn = partial(
        Objective.of,
        scenario=scenario,
        spread=spread,
        timing=timing,
        seed=seed,
        keep=None if keep is None else Path(keep),
    )
    work = _Work(drawn, (dies, validation_dies), evaluations, told)
    numbers, results = np.array(tunables.values), []
    rows: dict[str, TunedNumber] = {}
    for stage in stages:
        tuned = tunables.applied(loop, numbers)
        outcome, found = work.run(stage, tuned, tunables.chosen(stage.which, numbers))
        numbers[np.asarray(stage.which)] = [row.value for row in found]
        results.append(outcome)
        rows |= {row.path: row for row in found}
    tuned = tunables.applied(loop, numbers)
    told("before and after on unseen dies")
    common = {"dies": report_dies, "sample_rate": sample_rate, "duration": duration, "settle": settle, "seed": seed}
    lots = tuple(
        sweep(each, spread, scenario, bound_dies=0, **common, **_kept(keep, each, spread, scenario, common))
        for each in (loop, tuned)
    )
    before, after = (merit_of(lot, ran) for lot, ran in zip(lots, (loop, tuned), strict=True))
    settings = Settings.of(loop, scenario, spread, loss, tunables.paths, dies, sample_rate=sample_rate,
                           duration=duration, seed=seed)  # fmt: skip
    return Tuning(
        loop=tuned,
        numbers=tuple(rows[path] for path in tunables.paths),
        stages=tuple(results),
        before=before,
        after=after,
        ratio=ratio_of(*lots),
        warnings=(
            *warnings_of(after, before.lost, ratio_of(*lots, level=1.0 - 0.5 * LEVEL)),
            *margin_eaten(loop, tuned),
        ),
        settings=settings,
        lots=lots,
    )


def _kept(keep: str | Path | None, *what: object) -> dict[str, Any]:
    """Where a sweep goes that is never run again, several processes sharing its dies; nowhere without `keep`."""
    return {} if keep is None else {"out": Path(keep) / fingerprint(*what), "resume": True}


def _stages(loop: ClosedLoop, tunables: Tunables, loss: AbstractLoss | None, settle: float) -> tuple[TuningStage, ...]:
    everything = (True,) * len(tunables.paths)
    if loss is not None:
        return (TuningStage(loss, everything, "the loss that was asked for"),)
    own = tuple(path.startswith("observer.") for path in tunables.paths)
    error = SquaredRateError(settle)
    if not loop.observer.claims_innovation:
        return (TuningStage(error, everything, "this observer claims no variance, so there is no likelihood"),)
    stages = (
        TuningStage(InnovationLikelihood(settle), own, _scale_of(tunables)),
        TuningStage(error, tuple(not o for o in own), "the likelihood does not see what follows the filter"),
    )
    return tuple(stage for stage in stages if any(stage.which))


def _scale_of(tunables: Tunables) -> str:
    """Why a filter's numbers are judged by the likelihood."""
    told = "it weighs what the filter claims against what it sees"
    noise = any("noise" in path for path in tunables.paths)
    return f"{told}, and so fixes the scale of the noises, which the error leaves open" if noise else told


@dataclass(frozen=True)
class _Work:
    """What all stages share: how a lot is drawn, how many dies train and judge, evaluations, and who is told."""

    drawn: Callable[..., Objective]
    dies: tuple[int, int]
    evaluations: int
    told: Callable[[str], None]

    def run(
        self, stage: TuningStage, loop: ClosedLoop, tunables: Tunables
    ) -> tuple[StageResult, tuple[TunedNumber, ...]]:
        """The stage's outcome, and what became of each number."""
        name = type(stage.loss).__name__
        self.told(f"{name} over {len(tunables.paths)} numbers, {self.dies[0]} dies: compiling")
        training, validation = (
            self.drawn(loop, tunables=tunables, loss=stage.loss, dies=first + np.arange(count))
            for first, count in zip((TRAINING, VALIDATION), self.dies, strict=True)
        )
        penalty = _penalty(training.values(tunables.values), name)
        descent = self._sought(name, training, validation, penalty)
        found = tunables.numbers(descent.coordinates)
        values = training.slopes(found)
        outcome = StageResult(
            name,
            stage.reason,
            *zip(*((step.evaluations, step.training, step.validation) for step in descent.steps), strict=True),
            best=descent.best,
            lost=int(np.sum(~values.alive)),
            status=descent.status,
            nulls=null_directions(tunables, found, values),
        )
        return outcome, tuned_numbers(tunables, found, values, name)

    def _sought(self, name: str, training: Objective, validation: Objective, penalty: float) -> Descent:
        """The way down from the best of coarse grids, with rescues."""
        tunables = training.tunables
        readings = training.readings

        def told(step: DescentStep) -> None:
            losses = f"training {step.training:.8g}, validation {step.validation:.8g}"
            self.told(f"{name} after {step.evaluations}: {losses}")

        def loss(at: np.ndarray) -> Judged:
            return evaluated(training, training.slopes(tunables.numbers(at)), at, penalty, readings)

        def judged(at: np.ndarray) -> float:
            return validation.total(validation.values(tunables.numbers(at)), penalty)[0]

        def down(start: np.ndarray, left: int) -> Descent:
            return descend(loss, judged, start, evaluations=left, told=told)

        def moved(end: np.ndarray) -> np.ndarray | None:
            found = rescued(training, tunables.numbers(end), penalty, self.told)
            return None if found is None else tunables.starting(found).coordinates

        first = scanned(training, tunables.values, penalty, self.told)
        start, of_grid = tunables.starting(first).coordinates, bool(np.any(first != tunables.values))
        return sought(down, moved, start, self.evaluations, of_grid=of_grid)


def _penalty(values: Values, name: str) -> float:
    if not values.alive.any():
        raise InputError(
            f"The loss `{name}` must be a finite number at the start, but it is for none of {len(values.alive)} dies: "
            "all are lost or give no number; start from a loop that works on some."
        )
    loss = values.loss[values.alive]
    return float(np.max(loss) + _LOST * max(np.max(np.abs(loss)), noise_of(values)))


def timing_of(sample_rate: float, duration: float, begins: float) -> Timing:
    """That of a run whose derivative goes backwards; a loss must have something to judge."""
    if not 0.0 <= begins < duration:
        raise InputError(
            f"Argument `settle` must lie within the duration of {duration:g} s, but {begins:g} s was given."
        )
    return Timing.of(1.0 / sample_rate, count_steps(sample_rate, duration))


def _check_priors(stages: tuple[TuningStage, ...], tunables: Tunables) -> None:
    """What is known beforehand is weighed against readings, so a likelihood must judge them."""
    for stage in stages:
        for path, (known, _), used in zip(tunables.paths, tunables.priors, stage.which, strict=True):
            if used and np.isfinite(known) and not isinstance(stage.loss, InnovationLikelihood):
                raise InputError(
                    f"A prior must belong to a number that is tuned by likelihood, but `{path}` is tuned by "
                    f"{type(stage.loss).__name__}; give it bounds instead."
                )


def _check_claims(loss: AbstractLoss | None, tunables: Tunables) -> None:
    """Refuse a filter's numbers under a loss by which one that claims less error is better."""
    own = [path for path in tunables.paths if path.startswith("observer.")]
    if loss is not None and loss.believes_claims and own:
        raise InputError(
            f"The loss `{type(loss).__name__}` believes whatever the filter claims of its error, so `free` must hold "
            f"no number of the filter, but holds `{own[0]}`; tune that by likelihood first (without `loss`), and with "
            "this loss what makes the motion tell more, tones or the device."
        )


def _check(dies: int, validation_dies: int) -> None:
    if max(dies, validation_dies) > TRAINING:
        raise InputError(f"Argument `dies` must be at most {TRAINING}, but {max(dies, validation_dies)} was given.")
