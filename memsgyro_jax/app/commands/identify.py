"""What `memsgyro identify` does: read, identify, print, write."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.couplings.identify import identify
from memsgyro_jax.couplings.identify_ratio import identify_by_ratio
from memsgyro_jax.couplings.record import read_sweep
from memsgyro_jax.measurement.experiments import Noise, PolarNoise


def run(
    sweeps: Sequence[Path],
    *,
    method: Literal["likelihood", "ratio"],
    mass: float | None,
    amplitude_noise: float | None,
    phase_noise: float | None,
    effects: Sequence[str],
    drive_axis: Literal["x", "y"] | None,
    conjugated: bool,
    json: Path | None,
    report: Path | None,
) -> None:
    """Identify, print the result, and write what was asked for; everything is computed before the first file is
    written.
    """
    axis = None if drive_axis is None else "xy".index(drive_axis)
    records = [read_sweep(path, axis=axis, conjugated=conjugated) for path in sweeps]
    noise = _noise(amplitude_noise, phase_noise)
    if noise is not None and not all(record.polar for record in records):
        raise InputError(
            "Options `--amplitude-noise` and `--phase-noise` must go with amplitude and phase columns, "
            "but the file holds I and Q; leave them out."
        )
    if method == "ratio":
        result = identify_by_ratio(records, noise=noise, mass=mass)
    else:
        result = identify(records, noise=noise, mass=mass, effects=tuple(effects))
    print(result)
    page = None
    if report is not None:
        from ..report.identification import page as build

        page = build(result).html()
    for path, text in ((json, result.to_json() + "\n" if json else None), (report, page)):
        if path is not None:
            write_whole(path, text)


def _noise(amplitude: float | None, phase: float | None) -> Noise | None:
    if (amplitude is None) != (phase is None):
        raise InputError("Options `--amplitude-noise` and `--phase-noise` must be given together, but one is missing.")
    if amplitude is None or phase is None:
        return None
    for name, value in (("--amplitude-noise", amplitude), ("--phase-noise", phase)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"Option `{name}` must be a positive number, but is {value:g}.")
    return PolarNoise.from_peak_to_peak(amplitude, float(np.radians(phase)))
