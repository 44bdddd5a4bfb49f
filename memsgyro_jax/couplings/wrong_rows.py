"""Rows of a sweep that no device explains, as a wrong digit leaves them: found, named, and left out of the fit."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.measurement.experiments import PolarNoise
from memsgyro_jax.measurement.outliers import LEVEL, lone_residuals, lone_rows

from .frequency_sweep import FrequencySweep
from .record import SweepRecord
from .sense_view import SeenBench
from .tree_fit import Fit


ROUNDS = 5  # of leaving out what stands alone, as the largest hides others
SETTLING = 3  # fits in which a row that is left out finds its place
MOST = 0.01  # share of the rows beyond which it is the noise that has such rows
Fitted = tuple[Fit, tuple[FrequencySweep, ...]]


class WrongRow(NamedTuple):
    """Row of a sweep, both by number, with the reading that is most off and by how many standard deviations."""

    sweep: int
    row: int
    column: int
    sigmas: float


def without_wrong_rows(
    sweeps: tuple[FrequencySweep, ...],
    records: Sequence[SweepRecord],
    fit: Callable[[tuple[FrequencySweep, ...]], Fitted],
    refit: Callable[[SeenBench, tuple[FrequencySweep, ...]], Fitted],
) -> tuple[Fitted, tuple[str, ...]]:
    """The fit with every row left out that stands alone, and a sentence about each.

    A row is left out by what the fit without it predicts in its place, so that no program is compiled anew. Rows that
    stand alone in the record itself could pull the first fit to where they are a resonance: it is made without them.
    """
    smooth = tuple(_smoothed(sweep) for sweep in sweeps)
    pulled = any(one is not other for one, other in zip(smooth, sweeps, strict=True))
    outcome, fitted = fit(smooth)
    if pulled:
        fitted = tuple(f.with_measured(sweep.measured) for f, sweep in zip(fitted, sweeps, strict=True))
    residuals = _residuals(outcome, fitted) if pulled else _split(outcome.residual, fitted)
    named: dict[tuple[int, int], WrongRow] = {}
    for number in range(ROUNDS):
        new = [found for found in _found(residuals, fitted) if (found.sweep, found.row) not in named]
        if not new and not (pulled and number == 0):
            break
        # The largest of a sweep first: it pulls the fit, and makes its neighbours look wrong.
        largest = {n: max(f.sigmas for f in new if f.sweep == n) for n in {f.sweep for f in new}}
        named |= {(f.sweep, f.row): f for f in new if f.sigmas > largest[f.sweep] / 3}
        for _ in range(SETTLING if named else 1):
            outcome, fitted = refit(outcome.values, _mended(outcome, fitted, named))
        residuals = _split(outcome.residual, fitted)
    crowded = {
        n for n, record in enumerate(records) if sum(s == n for s, _ in named) > max(MOST * len(record.drive), 3)
    }
    notes = [_sentence(records[n], found) for (n, _), found in sorted(named.items()) if n not in crowded]
    notes += [
        f"{records[n].name}: {sum(s == n for s, _ in named)} rows lie beyond normal noise and were left out; is the "
        "noise another, or are there spikes? The uncertainties rest on normal noise."
        for n in sorted(crowded)
    ]
    return (outcome, fitted), tuple(notes)


def _smoothed(sweep: FrequencySweep) -> FrequencySweep:
    """The sweep with the rows that stand alone in it replaced by what lies between their neighbours; itself if none."""
    measured, place = np.array(sweep.measured), np.arange(len(sweep.frequency))
    lone = [[row for row, _ in lone_rows(place.astype(float), channel, 0.0)] for channel in measured.T]
    for channel, rows in zip(measured.T, lone, strict=True):
        others = np.setdiff1d(place, rows)
        channel[rows] = np.interp(rows, others, channel[others])
    return sweep.with_measured(jnp.asarray(measured)) if any(lone) else sweep


@eqx.filter_jit
def _whitened(seen: SeenBench, sweeps: tuple[FrequencySweep, ...]) -> jnp.ndarray:
    return jnp.concatenate([sweep.residual(seen) for sweep in sweeps])


def _residuals(outcome: Fit, sweeps: tuple[FrequencySweep, ...]) -> list[np.ndarray]:
    return _split(_whitened(outcome.values, sweeps), sweeps)


def _split(residual: jnp.ndarray, sweeps: tuple[FrequencySweep, ...]) -> list[np.ndarray]:
    """(n, 4) of each sweep."""
    ends = np.cumsum([4 * len(sweep.frequency) for sweep in sweeps])
    return [part.reshape(-1, 4) for part in np.split(np.asarray(residual)[: ends[-1]], ends[:-1])]


def _found(residuals: Sequence[np.ndarray], sweeps: tuple[FrequencySweep, ...]) -> list[WrongRow]:
    out = []
    for number, (residual, sweep) in enumerate(zip(residuals, sweeps, strict=True)):
        size = np.repeat(_usual_size(np.abs(np.asarray(sweep.measured))), 2, axis=1)
        size = size if isinstance(sweep.noise, PolarNoise) else 1 / size
        out += [WrongRow(number, *found) for found in lone_residuals(residual, size)]
    return out


def _usual_size(amplitude: np.ndarray) -> np.ndarray:
    """(n, 2) modulus of each reading, by the median of five rows: a wrong one is none of its own measure."""
    padded = np.pad(amplitude, ((2, 2), (0, 0)), mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0), axis=-1)


@eqx.filter_jit
def _predicted(seen: SeenBench, sweeps: tuple[FrequencySweep, ...]) -> list[jnp.ndarray]:
    return [sweep.predict(seen) for sweep in sweeps]


def _mended(
    outcome: Fit, sweeps: tuple[FrequencySweep, ...], named: dict[tuple[int, int], WrongRow]
) -> tuple[FrequencySweep, ...]:
    out = []
    for number, (sweep, prediction) in enumerate(zip(sweeps, _predicted(outcome.values, sweeps), strict=True)):
        measured, rows = np.array(sweep.measured), [row for n, row in named if n == number]
        measured[rows] = np.asarray(prediction)[rows]
        out.append(sweep.with_measured(jnp.asarray(measured)))
    return tuple(out)


def _sentence(record: SweepRecord, found: WrongRow) -> str:
    ends = ("_amp", "_phase") if record.polar else ("_I", "_Q")
    column = f"V{'xy'[found.column // 2]}{ends[found.column % 2]}"
    line = f"line {record.lines[found.row]}" if record.lines is not None else f"row {found.row + 1}"
    return (
        f"{record.name}, {line}, column `{column}`: the row lies {found.sigmas:.0f} standard deviations off what all "
        f"others say and was left out; is a digit or a sign wrong? (Of right records {LEVEL:.1%} are told so.)"
    )
