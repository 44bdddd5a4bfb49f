"""Experiments that a laboratory could add to a case: the same records, driven, biased, heated or turned otherwise.

They have the shapes of records that were taken, so that the compiled programs predict them at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.experiments import Experiment, HarmonicSweep, RateTable, TimeRecord
from memsgyro_jax.measurement.readings import Readings


@dataclass(frozen=True, eq=False)
class Plan:
    """A feasible experiment: what to do, and its readings as they would be predicted."""

    text: str
    readings: Readings


def plans(case: Case, readings: Sequence[Readings]) -> tuple[Plan, ...]:
    """Feasible experiments, the least effort first."""
    out: list[Plan] = []
    for taken in readings:
        if not taken.fitted:
            continue
        name = case.records[int(taken.record[0])].name
        for kind, text, change in _CHANGES:
            if isinstance(taken.experiment, kind):
                other = change(taken.experiment)
                if other is not None:
                    changed = Readings(other, taken.record, taken.row, True)
                    out.append(Plan(text.format(name=name), changed))
    return tuple(out)


def _calibrated(table: RateTable) -> RateTable:
    """Steps of ±100 deg/s and sines that are known from a calibrated reference."""
    count = table.time.shape[0]
    phase = np.arange(count) / count
    rate = np.radians(100.0) * np.sign(np.sin(2 * np.pi * 4 * phase)) * (phase < 0.5)
    rate = rate + np.radians(100.0) * np.sin(2 * np.pi * 10 * phase) * (phase >= 0.5)
    seconds = float(table.time[-1] - table.time[0]) / max(count - 1, 1)
    return eqx.tree_at(
        lambda t: (t.surroundings.rate, t.surroundings.angular_acceleration, t.surroundings.rate_trusted),
        table,
        (jnp.asarray(rate), jnp.asarray(np.gradient(rate, seconds)), jnp.ones(count)),
    )


def _shaken(table: RateTable) -> RateTable:
    """Fast sine of 20 Hz."""
    rate = np.radians(100.0) * np.sin(2 * np.pi * 20.0 * np.asarray(table.time))
    slope = np.radians(100.0) * 2 * np.pi * 20.0 * np.cos(2 * np.pi * 20.0 * np.asarray(table.time))
    return eqx.tree_at(
        lambda t: (t.surroundings.rate, t.surroundings.angular_acceleration),
        table,
        (jnp.asarray(rate), jnp.asarray(slope)),
    )


def _driven(factor: float) -> Callable:
    def change(experiment):
        if isinstance(experiment, HarmonicSweep):
            return eqx.tree_at(
                lambda s: (s.force, s.near), experiment, (experiment.force * factor, experiment.near * factor)
            )
        if isinstance(experiment, RateTable):
            return eqx.tree_at(lambda s: s.force, experiment, experiment.force * factor)
        return eqx.tree_at(
            lambda s: (s.forces, s.increments), experiment, (experiment.forces * factor, experiment.increments * factor)
        )

    return change


def _other_axis(sweep: HarmonicSweep) -> HarmonicSweep | None:
    if sweep.force.shape[1] == 1:
        return None
    return eqx.tree_at(lambda s: (s.force, s.near), sweep, (sweep.force[:, ::-1], sweep.near[:, ::-1]))


def _heated(sweep: HarmonicSweep) -> HarmonicSweep:
    steps = 40.0 * np.sign(np.arange(sweep.frequency.shape[0]) % 4 - 1.5)
    warmer = sweep.surroundings.temperature + jnp.asarray(steps)
    return eqx.tree_at(lambda s: s.surroundings.temperature, sweep, warmer)


def _biased(sweep: HarmonicSweep) -> HarmonicSweep:
    factor = np.where(np.arange(sweep.frequency.shape[0]) % 4 < 2, 0.5, 1.5)
    volts = jnp.where(sweep.surroundings.bias_voltage == 0, 5.0, sweep.surroundings.bias_voltage)
    return eqx.tree_at(lambda s: s.surroundings.bias_voltage, sweep, volts * factor)


_CHANGES: tuple[tuple[type[Experiment], str, Callable], ...] = (
    (
        RateTable,
        "repeat `{name}` at known rate: steps and sines of 100 deg/s, calibrated",
        _calibrated,
    ),
    (HarmonicSweep, "repeat the frequency sweeps at 3 times the drive", _driven(3.0)),
    (HarmonicSweep, "repeat the frequency sweeps with the other axis driven", _other_axis),
    (HarmonicSweep, "repeat the frequency sweeps 40 K below and above the temperature", _heated),
    (HarmonicSweep, "repeat the frequency sweeps at half and 1.5 times the bias voltage", _biased),
    (RateTable, "repeat `{name}` with a rate sine of 100 deg/s at 20 Hz", _shaken),
    (RateTable, "repeat `{name}` at 3 times the drive", _driven(3.0)),
    (TimeRecord, "repeat `{name}` at 3 times the drive", _driven(3.0)),
)
