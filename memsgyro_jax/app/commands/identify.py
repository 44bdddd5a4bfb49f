"""`memsgyro identify`: read, identify, print, write."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from memsgyro_jax.base.errors import InputError

from .flags import Flag, Words


if TYPE_CHECKING:
    from memsgyro_jax.couplings.record import SweepRecord
    from memsgyro_jax.measurement.experiments import Noise

Axes = Annotated[tuple[Literal["x", "y"], ...], cyclopts.Parameter(consume_multiple=True)]


def identify_command(
    *sweeps: Path,
    method: Literal["likelihood", "ratio"] = "likelihood",
    mass: float | None = None,
    amplitude_noise: float | None = None,
    phase_noise: float | None = None,
    effects: Words = (),
    drive_axis: Axes = (),
    conjugated: Flag = False,
    json: Path | None = None,
    report: Path | None = None,
) -> None:
    """Coupling errors of a frequency sweep, with uncertainty and a verdict.

    The CSV has the columns "f [Hz]" and, for both channels,
    "Vx_I [V]", "Vx_Q [V]", "Vy_I [V]", "Vy_Q [V]", or
    "Vx_amp [1]", "Vx_phase [deg]", "Vy_amp [1]", "Vy_phase [deg]".
    "F_x [N]" or "F_y [N]" is the drive level and names the driven electrode.
    Phasors follow e^{+iwt}. The folder of a case, as `memsgyro import` writes it, is read too, with its drive axes.

    Angles and couplings are relative to the axes of the pick-offs: a turn or crosstalk of these counts as lambda and
    k_xy, and a rate during the sweep that the file does not tell as phase asymmetry and c_xy.

    Args:
        sweeps: CSV files or cases of one device, with the x electrode, the y electrode or each of them driven.
        method: maximum likelihood on both complex responses, or the published least squares on their ratio.
        mass: of the mode in kg; without it c_xy and k_xy are per unit mass.
        amplitude_noise: relative, peak to peak; without it the noise is estimated from neighbouring points.
        phase_noise: in degrees, peak to peak.
        effects: also model electrical_feedthrough, finite_sweep_rate, readout_delay, frequency_offset.
        drive_axis: the driven electrode of files without `F_x` and `F_y`, once for all or once for each.
        conjugated: the file follows e^{-iwt}.
        json: file for the machine-readable result.
        report: file for a page with the curves, the fit and the residual.
    """
    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.couplings.identify import identify
    from memsgyro_jax.couplings.identify_ratio import identify_by_ratio

    from .options import require_writable

    require_writable(json, report)
    records = _records(sweeps, drive_axis, conjugated)
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
    if report is not None:  # before the first file is written
        from ..report.identification import identification_page

        page = identification_page(result)
    if json is not None:
        write_json(json, result.to_dict())
    if page is not None and report is not None:
        page.save(report)


def _records(paths: tuple[Path, ...], axes: tuple[str, ...], conjugated: bool) -> list["SweepRecord"]:
    """What files and folders of cases hold; an axis that was given is one for all of them, or one for each."""
    from memsgyro_jax.couplings.of_case import case_sweeps
    from memsgyro_jax.couplings.record import read_sweep

    if len(axes) not in (0, 1, len(paths)):
        raise InputError(
            f"Option `--drive-axis` must be given once for all files or once for each of the {len(paths)}, "
            f"but is given {len(axes)} times."
        )
    cases = [path for path in paths if path.is_dir()]
    if cases and (axes or conjugated):
        name = "--drive-axis" if axes else "--conjugated"
        raise InputError(
            f"Option `{name}` must go with files, but {cases[0]} is a case, which says so itself; leave it out."
        )
    each = axes if len(axes) == len(paths) else (axes or (None,)) * len(paths)
    records = []
    for path, axis in zip(paths, each, strict=True):
        if path.is_dir():
            records += case_sweeps(path)
        else:
            records.append(read_sweep(path, axis=None if axis is None else "xy".index(axis), conjugated=conjugated))
    return records


def _noise(amplitude: float | None, phase: float | None) -> "Noise | None":
    from memsgyro_jax.measurement.experiments import PolarNoise

    if (amplitude is None) != (phase is None):
        raise InputError("Options `--amplitude-noise` and `--phase-noise` must be given together, but one is missing.")
    if amplitude is None or phase is None:
        return None
    for name, value in (("--amplitude-noise", amplitude), ("--phase-noise", phase)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"Option `{name}` must be a positive number, but is {value:g}.")
    return PolarNoise.from_peak_to_peak(amplitude, math.radians(phase))
