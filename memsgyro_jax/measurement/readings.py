"""From a measurement case to experiments that predict it, reading by reading.

Records of one kind that run through one program are laid together, and experiments are named by their kind (a name is
structure), so that few programs have to be compiled. Every reading keeps the number of its record and whether it may be
fitted: what is not fitted validates.
"""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy import signal

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.normalised import NormalisedDevice

from .case import Case, FrequencySweepRecord, RateTableRecord, RingDownRecord
from .case import TimeRecord as RawRecord
from .case.device import resonances
from .experiments import CartesianNoise, Experiment, HarmonicSweep, RateTable, RealNoise, RingDown, TimeRecord
from .model import Conditions, Model
from .noise_level import noise_level


PHASE_STEP = 0.1  # of the highest mode per integration step where a nonlinear part is integrated [rad]
RING_TIMES = 12  # amplitude time constants after which an unknown start has died out


@dataclass(frozen=True)
class Readings:
    """An experiment, the record that each of its rows belongs to (−1: padding), the row there, whether it is fitted."""

    experiment: Experiment
    record: np.ndarray
    row: np.ndarray
    fitted: bool

    @property
    def axes(self) -> int:
        """Number of channels."""
        return self.experiment.measured.shape[1]

    @property
    def size(self) -> int:
        """Real numbers in the residual."""
        values = self.experiment.measured
        return values.size * (2 if jnp.iscomplexobj(values) else 1)


def readings_of(case: Case) -> tuple[Readings, ...]:
    """The readings of a case, in SI, each with its noise.

    Fitted are records with the role "fit", and without a declared role: every second row of a frequency sweep, rate
    tables, raw captures; ring-downs only where nothing else holds the device. The others validate.
    """
    sweeps = [(i, r) for i, r in enumerate(case.records) if isinstance(r, FrequencySweepRecord)]
    out = [*_sweeps(case, sweeps)] if sweeps else []
    others = any(r.role != "validation" and not isinstance(r, RingDownRecord) for r in case.records)
    for index, record in enumerate(case.records):
        if isinstance(record, FrequencySweepRecord):
            continue
        undeclared = not (isinstance(record, RingDownRecord) and others)
        fitted = undeclared if record.role is None else record.role == "fit"
        experiment = _EXPERIMENTS[type(record)](case, index, record)
        rows = np.arange(record.rows)[-experiment.measured.shape[0] :]
        out.append(Readings(experiment, np.full(rows.size, index), rows, fitted))
    return tuple(out)


def _sweeps(case: Case, records: list[tuple[int, FrequencySweepRecord]]) -> list[Readings]:
    """All rows of all sweeps as one experiment to fit and one, of the same shape, to validate."""
    record = np.concatenate([np.full(r.rows, i) for i, r in records])
    row = np.concatenate([np.arange(r.rows) for _, r in records])
    roles = np.concatenate([_sweep_roles(r) for _, r in records])
    groups = [np.flatnonzero(roles), np.flatnonzero(~roles)]
    size = max(map(len, groups))
    out = []
    for rows, fitted in zip(groups, (True, False), strict=True):
        if rows.size == 0:
            continue
        padded = np.concatenate([rows, np.full(size - rows.size, rows[-1])])
        real = np.arange(size) < rows.size
        experiment = _harmonic_sweep(case, records, padded, real)
        out.append(Readings(experiment, np.where(real, record[padded], -1), row[padded], fitted))
    return out


def _sweep_roles(record: FrequencySweepRecord) -> np.ndarray:
    """Which rows are fitted."""
    if record.role is not None:
        return np.full(record.rows, record.role == "fit")
    return np.arange(record.rows) % 2 == 0


def _harmonic_sweep(case, records, rows: np.ndarray, real: np.ndarray) -> HarmonicSweep:
    def joined(values) -> np.ndarray:
        return np.concatenate([np.asarray(values(i, r)) for i, r in records])[rows]

    measured = joined(lambda _, r: r.phasors)
    noise = joined(lambda _, r: np.full(r.rows, noise_level(r)))
    return HarmonicSweep(
        name="frequency sweeps",
        frequency=jnp.asarray(joined(lambda _, r: r.frequency)),
        force=jnp.asarray(joined(lambda _, r: np.outer(r.drive, np.eye(case.channels)[r.axis])) + 0j),
        measured=jnp.asarray(measured),
        noise=CartesianNoise(np.where(real, noise, np.inf)[:, None]),
        surroundings=Conditions(
            rate=joined(lambda _, r: r.rate),
            temperature=joined(lambda _, r: r.temperature),
            bias_voltage=joined(lambda _, r: r.bias_voltage),
            record=joined(lambda i, r: np.full(r.rows, float(i))),
        ).rows(len(rows)),
        near=jnp.asarray(measured / case.readout.scale),
        direction=jnp.asarray(joined(_direction)),
    )


def _direction(_: int, record: FrequencySweepRecord) -> np.ndarray:
    """+1 in sweeps whose frequency rises, −1 in those where it falls."""
    out = np.ones(record.rows)
    for rows in record.sweeps:
        out[rows] = -1.0 if record.frequency[rows][-1] < record.frequency[rows][0] else 1.0
    return out


def _ring_down(case: Case, index: int, record: RingDownRecord) -> RingDown:
    cycles = int(np.floor(record.drive_duration * record.drive_frequency / (2 * np.pi) + 1e-9))
    if cycles < 1:
        raise InputError(
            f"{case.folder}, experiment `{record.name}`: `drive_duration` must hold at least one drive cycle, "
            f"but holds {record.drive_duration * record.drive_frequency / (2 * np.pi):.3g}."
        )
    return RingDown(
        name="ring-downs",
        time=jnp.asarray(record.time),
        measured=jnp.asarray(record.signals),
        noise=RealNoise(noise_level(record)),
        frequency=jnp.asarray(record.drive_frequency),
        force=jnp.asarray(record.drive_force * np.eye(case.channels)[record.axis]),
        surroundings=jax.tree.map(lambda leaf: leaf[0], _surroundings(case, index, 1, 0.0)),
        cycles=cycles,
        late=bool(record.time[0] > 0),
    )


def _rate_table(case: Case, index: int, record: RateTableRecord) -> RateTable:
    surroundings = _surroundings(case, index, record.rows, record.rate, time=record.time)
    slope = np.gradient(record.rate, record.period) if record.rows > 1 else np.zeros(1)
    surroundings = eqx.tree_at(
        lambda c: (c.angular_acceleration, c.rate_trusted),
        surroundings,
        (jnp.asarray(slope), jnp.full(record.rows, float(record.rate_calibrated))),
    )
    return RateTable(
        name="rate tables",
        time=jnp.asarray(record.time),
        measured=jnp.asarray(record.phasors),
        noise=CartesianNoise(noise_level(record)),
        frequency=jnp.asarray(record.drive_frequency),
        force=jnp.asarray(record.drive_force * np.eye(case.channels)[record.axis]),
        surroundings=surroundings,
        block_cycles=record.lock_in_cycles,
    )


def _time_record(case: Case, index: int, record: RawRecord) -> TimeRecord:
    _, highest = resonances(case.design)
    held = record.hold == "zero_order"
    substeps = max(1, int(np.ceil(0.9 * highest * record.period / PHASE_STEP)))
    fine = np.repeat(record.forces, substeps, axis=0) if held else _between(record.forces, substeps, record.hold)
    following = np.concatenate([fine[1:], fine[-1:]])
    surroundings = _surroundings(
        case, index, fine.shape[0], np.repeat(record.rate, substeps), time=np.repeat(record.time, substeps)
    )
    skipped = _unknown_start(case, record)
    return TimeRecord(
        name="raw captures",
        time=jnp.asarray(record.time[skipped:]),
        measured=jnp.asarray(record.signals[skipped:]),
        noise=RealNoise(noise_level(record)),
        forces=jnp.asarray(fine),
        increments=jnp.asarray(np.zeros_like(fine) if held else following - fine),
        step=jnp.asarray(record.period / substeps),
        surroundings=surroundings,
        substeps=substeps,
        skipped=skipped,
    )


_EXPERIMENTS: dict[type, Callable[..., Experiment]] = {
    RingDownRecord: _ring_down,
    RateTableRecord: _rate_table,
    RawRecord: _time_record,
}


def _between(forces: np.ndarray, substeps: int, hold: str) -> np.ndarray:
    """Input on a grid `substeps` times finer: on straight lines, or as a band-limited signal.

    The integration takes the fine grid as straight lines, which weakens a sine by (ωh)²/12; the band-limited signal is
    strengthened by as much.
    """
    count = forces.shape[0]
    if hold == "linear" or substeps == 1:
        place = np.arange(count * substeps) / substeps
        return np.stack([np.interp(place, np.arange(count), column) for column in forces.T], axis=1)
    fine = signal.resample_poly(forces, substeps, 1, axis=0, window=("kaiser", 12.0), padtype="line")
    curvature = np.zeros_like(fine)
    curvature[1:-1] = fine[2:] - 2 * fine[1:-1] + fine[:-2]
    return fine - curvature / 12


def _unknown_start(case: Case, record: RawRecord) -> int:
    """Samples until an unknown start has died out."""
    if record.start == "rest":
        return 0
    slowest = 2 * _quality(case) / resonances(case.design)[0]
    skipped = int(np.ceil(RING_TIMES * slowest / record.period))
    if skipped > record.rows // 2:
        raise InputError(
            f"{case.folder}, experiment `{record.name}`: a record with an unknown start must be longer than twice the "
            f"{RING_TIMES * slowest:.3g} s in which the start dies out, but lasts {record.period * record.rows:.3g} s; "
            'begin it at rest and write `start = "rest"`.'
        )
    return skipped


def _quality(case: Case) -> float:
    """Largest quality factor that the design allows."""
    if "quality_factor" in case.design:
        return case.design["quality_factor"].high
    d = case.design
    return float(np.sqrt(d["kxx"].high * d["mass"].high) / min(d["dxx"].low, d["dyy"].low))


def _surroundings(case: Case, index: int, count: int, rate, *, time=0.0) -> Conditions:
    return Conditions(
        rate=rate,
        temperature=case.environment.temperature,
        bias_voltage=case.environment.bias_voltage,
        time=time,
        progress=np.linspace(0.0, 1.0, count),
        record=float(index),
    ).rows(count)


def _offset(case: Case) -> np.ndarray:
    """Constant voltage of each channel as the waveforms show it, where a record has any: a start for the fit, and the
    value where only records that are not fitted see it.
    """
    tails = [r.signals[r.rows // 2 :] for r in case.records if isinstance(r, RingDownRecord | RawRecord)]
    return np.mean([tail.mean(axis=0) for tail in tails], axis=0) if tails else np.zeros(case.channels)


def model_of(case: Case, device, **more) -> Model:
    """The base model of a case around `device`, with the declared read-out and reference conditions.

    **Raises:** `InputError` where the device has another number of axes than the case has channels.
    """
    axes = NormalisedDevice.of(device).axes
    if axes != case.channels:
        raise InputError(
            f"Argument `model` must have as many axes as the case {case.name} has channels, {case.channels}, "
            f"but has {axes}."
        )
    return Model(
        device,
        scale=case.readout.scale,
        offset=more.pop("offset", _offset(case)),
        reference_temperature=case.environment.temperature,
        reference_bias=case.environment.bias_voltage,
        **more,
    )
