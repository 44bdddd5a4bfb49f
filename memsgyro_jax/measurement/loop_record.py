"""A run of the closed loop as a measurement case: what a recorder at the electrodes and at the converter would keep."""

import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.device.gyro import AbstractGyro, SingleMassGyro, X, Y
from memsgyro_jax.loop.kicks import kick_error
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.trace_result import Trace

from .case import Case, DesignValue, Environment, TimeRecord, load_case, write_case
from .case.file import FILE
from .declared import Readout
from .experiments.record import Role


HEADING = "[[experiment]]"
SEEN = 10.0  # χ² that the error of kicks adds to a record, from which a fit may take it for physics


def case_of_trace(
    trace: Trace,
    *,
    name: str = "run",
    role: Role | None = None,
    tolerance: float = 0.15,
    design: AbstractGyro | None = None,
    environment: Environment | None = None,
) -> Case:
    """The case that holds one raw record: held forces [N], volts, and the true rate [rad/s], from time zero on.

    Row n holds the reading at its time and the force from then to the next row. Offsets and the motion itself are not
    told; a loop whose mass starts at rest makes a record that does. What a loop beyond its rate and temperature is
    exposed to (drifting offsets, accelerations) no case knows. A warning says where the noise is so low that the record
    shows how the loop computed its effects.

    Args:
        trace: of a single-mass gyro behind a displacement read-out, with every sample kept.
        name: of the record, and of its file.
        role: "fit" or "validation"; None leaves it open.
        tolerance: relative half width of the interval in which each number of the device may lie; zero means known.
        design: the device as its maker meant it; None takes the true one without its effects.
        environment: temperature and bias voltage; None takes those at which the numbers of the device hold.

    **Raises:** `InputError` for a run that cannot be written so, with the reason.
    """
    loop, period = trace.loop, 1.0 / trace.settings.sample_rate
    device, readout = design or loop.device, loop.readout
    require_recordable(loop)
    if len(trace.time) < 2 or not np.isclose(trace.time[1] - trace.time[0], period, rtol=1e-6):
        raise InputError("A case needs every sample of the run, but some were left out; simulate with `decimation=1`.")
    if trace.lost_at is not None:
        raise InputError(f"A case needs a run to its end, but this one was {trace.status}.")
    scale, std = (np.asarray(pair, float) for pair in (readout.scale, readout.noise_std(period)))
    if shown := _kicks_shown(trace, np.abs(scale) / std):
        warnings.warn(shown, stacklevel=2)
    start = np.asarray(loop.start, float)
    noise = np.random.default_rng(trace.settings.seed).standard_normal(2)
    drift = trace.offset[0] - np.asarray(readout.offset, float)
    record = TimeRecord(
        name=name,
        file=f"{name}.csv",
        lines=np.arange(len(trace.time)) + 2,
        role=role,
        note=f"closed loop at {trace.settings.sample_rate:g} Hz, seed {trace.settings.seed}",
        noise_std=float(np.sqrt(np.mean(std**2))) or None,
        noise_rows=np.tile(std, (len(trace.time), 1)) if std.all() and std[0] != std[1] else None,
        hold="zero_order",
        start="unknown" if start.any() else "rest",
        time=np.arange(len(trace.time)) * period,
        forces=trace.force,
        signals=np.vstack([readout.measure(tuple(start), tuple(noise), tuple(drift), period), trace.volts[:-1]]),
        rate=trace.rate_true,
    )
    around = Environment(device.reference_temperature, device.reference_bias)
    return Case(
        folder=Path(),
        name="loop",
        description="the signals of a closed loop",
        device="single_mass",
        design=_design(device, tolerance),
        readout=Readout(float(scale[0]), None if readout.adc is None else float(readout.adc.limit)),
        environment=environment or around,
        conventions={"forces": "held from each row to the next"},
        records=(record,),
    )


def _kicks_shown(trace: Trace, per_metre: np.ndarray) -> str:
    """A sentence where a record tells effects that act as kicks from the same effects at every moment; else nothing.
    `per_metre` are standard deviations of its noise, per channel.
    """
    if not np.all(np.isfinite(per_metre)):
        return ""
    error = per_metre * kick_error(trace.loop, trace.force, trace.rate_true, 1.0 / trace.settings.sample_rate)
    if not np.sum(error**2) > SEEN:
        return ""
    return (
        "The effects of the device acted once in a sample, which moves the record by up to "
        f"{np.max(np.abs(error)):.2g} standard deviations of its noise: a fit may take that for physics. Run the loop "
        'with `discretisation=mg.Integrated()` (in a study `[loop] discretisation = "integrated"`), or at a higher '
        "sample rate."
    )


def require_recordable(loop: ClosedLoop) -> None:
    """Raises `InputError` for a loop whose signals no case can hold, with the reason."""
    if not (isinstance(loop.device, SingleMassGyro) and loop.readout.signals == (X, Y)):
        raise InputError("A case must hold a single-mass gyro with a displacement read-out, but the loop has another.")
    scale = np.asarray(loop.readout.scale, float)
    if scale[0] != scale[1]:
        raise InputError(
            f"A case declares one scale for both channels, but the read-out has {scale[0]:g} and {scale[1]:g} V/m; "
            "give both electrodes the same."
        )


def _design(device: SingleMassGyro, tolerance: float) -> dict[str, DesignValue]:
    """Each number within its tolerance; for a coupling of zero, that of the numbers it couples."""
    out = {}
    for name in ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy"):
        value = size = float(getattr(device, name))
        if value == 0.0:
            size = np.sqrt(float(getattr(device, f"{name[0]}xx")) * float(getattr(device, f"{name[0]}yy")))
        half = tolerance * abs(size)
        out[name] = DesignValue(value, value - half, value + half)
    return out


def append_to_case(case: Case, folder: str | Path) -> Path:
    """Write a case of one record, or add the record to the case that stands in the folder already.

    **Raises:** `InputError` where that one declares another read-out, or has a record of the same name.
    """
    folder = Path(folder)
    target = folder / FILE
    if not target.exists():
        return write_case(case, folder)
    present, (record,) = load_case(folder), case.records
    if present.readout != case.readout or present.device != case.device:
        raise InputError(f"{target}: must declare {case.readout} to take this run, but declares {present.readout}.")
    if record.name in {other.name for other in present.records} or (folder / record.file).exists():
        raise InputError(f"{target}: has an experiment `{record.name}` already; choose another name.")
    with tempfile.TemporaryDirectory(dir=folder, prefix=".") as draft:
        text = write_case(replace(case, records=(record,)), draft).read_text(encoding="utf-8")
        (Path(draft) / record.file).replace(folder / record.file)
    whole = target.read_text(encoding="utf-8").rstrip("\n")
    return write_whole(target, f"{whole}\n\n{text[text.index(HEADING) :]}")
