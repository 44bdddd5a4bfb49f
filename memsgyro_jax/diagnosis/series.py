"""The residual of each record of a case beside what is known about its rows: what a misfit is tested against."""

from collections.abc import Callable, Sequence
from functools import singledispatch

import numpy as np

from memsgyro_jax.measurement.case import AbstractRecord, FrequencySweepRecord, RateTableRecord

from .fit import CaseFit
from .misfit import Band, Part, Series, Variable


SEGMENTS = 8  # of the time of a record
NEAR = 2.0  # full widths of a resonance that count as "at" it in a sweep
AROUND = 0.1  # of a mode's frequency that counts as "at" it in a spectrum
SETTINGS = 24  # at most, to judge each on its own
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))


def spoken(value: float, unit: str, digits: int = 4) -> str:
    """A quantity in SI for people: `spoken(1.5e-7, "N")` is "150 nN"; kelvin become °C, rad/s of rate deg/s."""
    if unit == "K":
        return f"{round(value - 273.15, 6):.{digits}g} °C"  # 273.15 itself is not exact in binary
    if unit == "rad/s":
        return f"{np.degrees(value):.{digits}g} deg/s"
    factor, prefix = next(((f, p) for f, p in _PREFIXES if abs(value) >= 0.9995 * f), (1.0, ""))
    return f"{value / factor:.{digits}g} {prefix}{unit}".rstrip()


def series_of(fit: CaseFit) -> tuple[Series, ...]:
    """The whitened residual of every compared record, with its channels, conditions and variables."""
    out = []
    for number, record in enumerate(fit.case.records):
        white = fit.whitened[number]
        if np.isfinite(white).any():
            out.append(_series(record, white, fit.predicted(number), fit))
    return tuple(out)


@singledispatch
def _series(record: AbstractRecord, white: np.ndarray, predicted: np.ndarray, fit: CaseFit) -> Series:
    """A signal sample by sample: a ring-down or a raw capture."""
    period, axes = record.period, fit.model.axes  # type: ignore[attr-defined]
    motion = (predicted - np.asarray(fit.model.offset)) / np.asarray(fit.model.scale)
    speed = np.gradient(motion, period, axis=0)
    modes = fit.model.device.resonances() * period / (2 * np.pi)
    low, high = (1 - AROUND) * modes[0], (1 + AROUND) * modes[-1]
    names = _names(axes)
    variables = [Variable(f"displacement {n}".strip(), motion[:, i]) for i, n in enumerate(names)]
    variables += [Variable(f"velocity {n}".strip(), speed[:, i]) for i, n in enumerate(names)]
    bands = (Band("below resonance", 0.0, low), Band("at resonance", low, high), Band("above resonance", high, 0.5))
    return Series(
        record.name,
        _channels(axes),
        white,
        white,
        (slice(None),),
        _segments(record.time),  # type: ignore[attr-defined]
        bands,
        tuple(variables),
    )


@_series.register
def _(record: FrequencySweepRecord, white: np.ndarray, predicted: np.ndarray, fit: CaseFit) -> Series:
    motion = np.abs(predicted[:, record.axis] / np.asarray(fit.model.scale)[record.axis])
    force = "V" if fit.case.device == "resonator" else "N"
    named: list[tuple[str, np.ndarray, str]] = [
        ("drive", record.drive, force),
        ("temperature", record.temperature, "K"),
        ("bias voltage", record.bias_voltage, "V"),
        ("rate", record.rate, "rad/s"),
    ]
    parts = [part for heading, values, unit in named for part in _settings(heading, values, unit, record.sweeps)]
    variables = [Variable("displacement", motion), Variable("frequency", record.frequency)]
    variables += [Variable(heading, values) for heading, values, _ in named]
    if record.time is not None:
        variables.append(Variable("time", record.time))
    bands = _around_modes(record.frequency, fit)
    return Series(
        record.name, _channels(fit.model.axes), white, turned(white, predicted), record.sweeps,
        (*parts, *bands), (), tuple(variables),
    )  # fmt: skip


@_series.register
def _(record: RateTableRecord, white: np.ndarray, predicted: np.ndarray, fit: CaseFit) -> Series:
    slope = np.gradient(record.rate, record.period) if record.rows > 1 else np.zeros(1)
    variables = (
        Variable("time", record.time),
        Variable("rate", record.rate),
        Variable("angular acceleration", slope),
    )
    # Both channels by the phase of the drive: that of the sense channel turns over with the rate.
    driven = predicted[:, record.axis : record.axis + 1]
    parts = (*_segments(record.time), *_settings("rate", record.rate, "rad/s", (slice(None),)))
    return Series(
        record.name, _channels(fit.model.axes), white, turned(white, driven), (slice(None),), parts, (), variables
    )


def turned(white: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Residual phasors (n, channels, 2) turned by the predicted phase: in phase with displacement, with velocity."""
    size = np.abs(predicted)
    unit = np.where(size > 0, predicted, 1.0) / np.where(size > 0, size, 1.0)
    error = (white[..., 0] + 1j * white[..., 1]) * unit.conj()
    return np.stack([error.real, error.imag], axis=-1)


def _channels(axes: int) -> tuple[str, ...]:
    return ("x", "y")[:axes]


def _names(axes: int) -> tuple[str, ...]:
    return ("x", "y") if axes == 2 else ("",)


def _settings(heading: str, values: np.ndarray, unit: str, sweeps: Sequence[slice]) -> list[Part]:
    """One part per setting of a condition: sweeps whose labels agree stand together; none where all rows agree."""
    digits = 3 if unit in ("K", "rad/s") else 4
    labels = np.empty(len(values), dtype=object)
    for piece in sweeps if len(sweeps) > 1 else [slice(i, i + 1) for i in range(len(values))]:
        labels[piece] = spoken(float(np.mean(values[piece])), unit, digits)
    found = list(dict.fromkeys(labels))
    return [Part(heading, label, labels == label) for label in found] if 1 < len(found) <= SETTINGS else []


def _segments(time: np.ndarray) -> tuple[Part, ...]:
    """Equal segments of the time of a record."""
    place = np.minimum(SEGMENTS * np.arange(len(time)) // max(len(time), 1), SEGMENTS - 1)
    span: Callable[[np.ndarray], str] = lambda t: f"{spoken(t[0], 's', 3)} to {spoken(t[-1], 's', 3)}"  # noqa: E731
    return tuple(Part("time", span(time[place == k]), place == k) for k in range(SEGMENTS) if np.any(place == k))


def _around_modes(frequency: np.ndarray, fit: CaseFit) -> tuple[Part, ...]:
    """Rows of a sweep below, at, between and above the resonances of the fitted device."""
    modes = fit.model.device.resonances()
    width = float(np.max(np.diag(np.asarray(fit.model.device.damping_matrix))))
    at = np.min(np.abs(frequency[:, None] - modes), axis=1) <= NEAR * width
    below, above = frequency < modes[0], frequency > modes[-1]
    parts = (
        ("below resonance", below & ~at),
        ("at resonance", at),
        ("between the resonances", ~(at | below | above)),
        ("above resonance", above & ~at),
    )
    return tuple(Part("frequency", label, rows) for label, rows in parts if rows.any() and not rows.all())
