"""The paper's chain from record to coefficients: peaks, half-power points, corrections, ratio, least squares, goodness
of fit.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.experiments import Noise
from memsgyro_jax.measurement.outliers import lone_rows

from .bench import Bench, LockIn
from .identify import RELATIVE, sweep_of
from .modal import half_power
from .modes import CoupledModes, mirrored
from .ratio import TruncatedRatio, conversion_ratio, goodness_of_fit, phase_offset, relative_error
from .record import SweepRecord
from .result import CouplingCoefficient, Identification


VALIDITY_LIMIT = 0.02  # of the theoretical relative error, section 2.2.1


def identify_by_ratio(
    records: Sequence[SweepRecord], *, noise: Noise | None = None, mass: float | None = None
) -> Identification:
    """λyx, cxy, kxy as published (and λxy where y was driven too), to be laid beside `identify`.

    Modes come from peak and half-power points, of the sense mode from the y-driven sweep where there is one, else from
    the ratio of the channels. Conversion ratio and phase correction need the y-driven sweep; without it both channels
    are taken as equal.

    **Raises:** `InputError` without exactly one x-driven sweep, or where a resonance with its half-power points is not
    in the band.
    """
    by_axis = {record.axis: record for record in records}
    if len(by_axis) != len(records) or 0 not in by_axis:
        raise InputError(
            "Argument `records` must hold one sweep with x driven and at most one with y driven "
            "for the ratio method, but does not."
        )
    wrong = {axis: _lone(record) for axis, record in by_axis.items()}
    x = _ascending(by_axis[0], wrong[0])
    y = _ascending(by_axis[1], wrong[1]) if 1 in by_axis else None
    modes = _modes(x, y)
    notes = [_sentence(by_axis[axis], row) for axis, rows in sorted(wrong.items()) for row in rows]
    notes.append(RELATIVE)
    asymmetry, gain_ratio = 0.0, 1.0
    if y is None:
        notes.append("Without a sweep with y driven, both channels are taken as equal in gain and phase.")
    else:
        gain_ratio = float(conversion_ratio(x[1], y[1], modes))
        asymmetry = float(
            phase_offset(y[0], y[1][:, 1], modes.omega[1]) - phase_offset(x[0], x[1][:, 0], modes.omega[0])
        )
        asymmetry = (asymmetry + np.pi) % (2 * np.pi) - np.pi
    correction = gain_ratio * np.exp(1j * asymmetry)
    estimate = TruncatedRatio()(x[0], x[1][:, 1] / x[1][:, 0] / correction, modes)
    cross = None if y is None else TruncatedRatio()(y[0], y[1][:, 0] / y[1][:, 1] * correction, mirrored(modes))
    device = CoupledModes(
        modes.omega,
        modes.quality,
        estimate.damping_coupling,
        estimate.stiffness_coupling,
        estimate.force,
        0.0 if cross is None else cross.force,
    )
    bench, goodness = _fitted(device, gain_ratio, asymmetry, x)
    sweep = sweep_of(by_axis[0], noise)
    chi2 = float(jnp.mean(sweep.residual(bench) ** 2)) if noise is not None else float("nan")
    notes += [
        f"R_NL of {name} {value:.4f}: it cannot tell whether a coefficient is right."
        for name, value in goodness.items()
    ]
    return Identification(
        coefficients=_coefficients(device, estimate, cross, x[0], mass),
        modal=_modal(modes),
        readout={
            "gain_ratio": CouplingCoefficient(gain_ratio, None, "1", "sense over drive channel"),
            "phase_asymmetry_deg": CouplingCoefficient(
                float(np.degrees(asymmetry)), None, "deg", "sense less drive channel"
            ),
        },
        chi2_per_dof=chi2,
        dof=4 * len(x[0]) - 3,
        method="ratio of responses as published",
        notes=tuple(notes),
        status="least squares",
    )


def _rows(record: SweepRecord) -> np.ndarray:
    """Those of the highest drive level, in ascending order of frequency."""
    rows = np.flatnonzero(record.drive == record.drive.max())
    return rows[np.argsort(record.frequency[rows], kind="stable")]


def _lone(record: SweepRecord) -> list[int]:
    """Rows that stand alone among their neighbours, as a wrong digit or sign leaves them."""
    rows = _rows(record)
    rows = rows[np.unique(record.frequency[rows], return_index=True)[1]]
    place = record.frequency[rows]
    return sorted({int(rows[k]) for channel in record.phasors.T for k, _ in lone_rows(place, channel[rows], 0.0)})


def _sentence(record: SweepRecord, row: int) -> str:
    line = f"line {record.lines[row]}" if record.lines is not None else f"row {row + 1}"
    return f"{record.name}, {line}: the row stands alone among its neighbours and was left out; is a digit wrong?"


def _ascending(record: SweepRecord, wrong: list[int]) -> tuple[jnp.ndarray, jnp.ndarray]:
    """Frequency and response per drive of the highest drive level, in ascending order, without the wrong rows."""
    rows = np.array([row for row in _rows(record) if row not in wrong])
    return jnp.asarray(record.frequency[rows]), jnp.asarray(record.phasors[rows] / record.drive[rows, None])


def _modes(x: tuple, y: tuple | None) -> CoupledModes:
    drive = half_power(x[0], jnp.abs(x[1][:, 0]))
    sense = (
        half_power(y[0], jnp.abs(y[1][:, 1])) if y is not None else half_power(x[0], jnp.abs(x[1][:, 1] / x[1][:, 0]))
    )
    for name, mode in (("drive", drive), ("sense", sense)):
        if not np.isfinite(float(mode.quality)):
            raise InputError(
                f"The ratio method must see the {name} resonance with both half-power points, "
                "but the sweep does not hold them; "
                "sweep both resonances, or use the likelihood method."
            )
    return CoupledModes(jnp.stack([drive.omega, sense.omega]), jnp.stack([drive.quality, sense.quality]))


def _fitted(device: CoupledModes, gain_ratio: float, asymmetry: float, x: tuple) -> tuple[Bench, dict[str, float]]:
    """The model curve through the record, with the overall gain that fits the drive channel best, and R_NL per curve as
    in Table 5.
    """
    response = device.response(x[0], 0)
    gain = jnp.vdot(response[:, 0], x[1][:, 0]) / jnp.vdot(response[:, 0], response[:, 0])
    bench = Bench(device, LockIn(jnp.abs(gain), jnp.angle(gain), gain_ratio, asymmetry))
    fitted = response * bench.readout.channels(0)
    curves = {}
    for channel, name in enumerate(("drive", "sense")):
        for part, label in ((jnp.abs, "amplitude"), (lambda z: jnp.unwrap(jnp.angle(z)), "phase")):
            curves[f"{name} {label}"] = float(goodness_of_fit(part(x[1][:, channel]), part(fitted[:, channel])))
    return bench, curves


def _coefficients(
    device: CoupledModes, estimate, cross, frequency: jnp.ndarray, mass: float | None
) -> dict[str, CouplingCoefficient]:
    scale = np.array([1.0, mass or 1.0, mass or 1.0])
    value, std = np.asarray(estimate.values()) * scale, np.asarray(estimate.std) * scale
    error = np.abs(np.asarray(relative_error(TruncatedRatio(), device, frequency)))
    units = ("1", "N*s/m", "N/m") if mass else ("1", "1/s", "1/s^2")
    out = {
        name: CouplingCoefficient(float(value[i]), float(std[i]), units[i], _verdict(error[i]))
        for i, name in enumerate(("lambda_yx", "c_xy", "k_xy"))
    }
    missing = CouplingCoefficient(None, None, "1", "not identified by this sweep: drive the y electrode too")
    seen = (
        missing
        if cross is None
        else CouplingCoefficient(float(cross.force), float(cross.std[0]), "1", "least squares, scatter only")
    )
    return {"lambda_yx": out["lambda_yx"], "lambda_xy": seen, "c_xy": out["c_xy"], "k_xy": out["k_xy"]}


def _verdict(error: float) -> str:
    """The paper's own criterion, on the noise-free error of the method at the identified point."""
    inside = "within" if error <= VALIDITY_LIMIT else "beyond"
    return (
        f"theoretical error {100 * error:.3g} %, {inside} the method's limit of 2 % (calibration and noise not counted)"
    )


def _modal(modes: CoupledModes) -> dict[str, CouplingCoefficient]:
    out = {}
    for axis, letter in enumerate("xy"):
        out[f"f_{letter}"] = CouplingCoefficient(float(modes.omega[axis] / (2 * np.pi)), None, "Hz", "peak")
        out[f"q_{letter}"] = CouplingCoefficient(float(modes.quality[axis]), None, "1", "half-power points")
    return out
