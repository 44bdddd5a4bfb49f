"""The tests behind a datasheet: each runs the lot and gives rows."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.noise_budget import noise_budget
from memsgyro_jax.loop.scenario import Constant

from .allan import analysed
from .datasheet_rows import FEWEST, NOT_MODELLED, DatasheetRow
from .lot_outputs import Outputs
from .over_temperature import CELSIUS, OverTemperature, depends_on_temperature, held_at
from .rate_log import RateLog
from .rate_tests import Dies, RateTests, settled_mean
from .step_spectrum import first_half_power, flat_up_to, resonance_in_band, spectrum_of


_GRAVITY = 9.80665  # m/s²
_BAND = 0.01  # of the full scale: an output within it of its end has started
_STEADY = 0.01  # of a step: how far the last two tenths of the answer may differ
_REST = 0.8  # of a run: what still moves by a start's band later has no end to start towards
_SHOWN = 0.1  # of the rate: an output below it has not started
_ALIKE = 1.5  # ratio of noise powers early and late that is still one noise
_SHARE = 0.25  # of the bandwidth: up to where the noise counts as flat
_LINES = 8  # fewest lines of a spectrum that make a density
_PER_ROOT_HOUR = 60.0 / np.sqrt(2.0)  # angle random walk [deg/√h] of a one-sided density [deg/s/√Hz]
_FROM_DENSITY = (
    "The angle random walk is that of the noise density, N = density/√2, as if the noise stayed white towards longer "
    "averaging times: the record is too short for an Allan deviation, which would show drift beside it."
)
_RECORD = 3.0 * 2.0**5  # times the first of six octaves of averaging times: a record that tells an Allan deviation
_NOISES = (
    ("noise density", "deg/s/√Hz", "One-sided density of the output where it is flat"),
    ("angle random walk", "deg/√h", "Coefficient N of the Allan deviation"),
    ("bias instability", "deg/h", "Least Allan deviation of the fitted noises over 0.664"),
)
_FRAME = "the device leaves out the terms of its rotating frame (`rotating_frame` brings them in)"


class Answer(NamedTuple):
    """The answer to a step of the rate, over that step: `values` (dies, times) from `times` [s] after it on, which dies
    were never lost, their -3 dB `bandwidth` [Hz], NaN where not shown, and why it is not known, if so.
    """

    times: Float[np.ndarray, " times"]
    values: Float[np.ndarray, "dies times"]
    alive: Bool[np.ndarray, " dies"]
    bandwidth: Dies
    unknown: str


def best_line(rates: np.ndarray, outputs: Float[np.ndarray, "rates dies"]) -> Float[np.ndarray, "two dies"]:
    """Offset and slope of the best straight line of each die."""
    return np.linalg.pinv(np.stack([np.ones_like(rates), rates], axis=1)) @ outputs  # each die by itself, lost ones too


def scale_and_bias(
    bench: RateTests, rates: np.ndarray, table: list[Outputs]
) -> tuple[Float[np.ndarray, "rates dies"], tuple[DatasheetRow, ...]]:
    """The settled outputs at each rate, and zero-rate output, scale factor, non-linearity and quadrature."""
    outputs = np.array([settled_mean(run, bench.settle) for run in table])
    zero, full = len(rates) // 2, np.degrees(bench.full_scale)
    constant = f"constant rate, mean from {bench.settle:.3g} to {bench.duration:.3g} s after power-on, no noise"
    line = best_line(rates, outputs)
    quadrature = np.degrees(settled_mean(table[zero], bench.settle, "quadrature"))
    unread = "" if np.isfinite(quadrature).any() else f"{NOT_MODELLED}: this loop reads no quadrature"
    return outputs, (
        DatasheetRow(
            "full scale", "deg/s", "Greatest rate, either way, over which the figures below hold", "declared",
            np.full(outputs.shape[1], full),
        ),
        DatasheetRow(
            "zero-rate output", "deg/s", "Output without input rate (bias)", constant, np.degrees(outputs[zero])
        ),
        DatasheetRow(
            "scale factor", "1", "Slope of the best straight line of output over input rate",
            f"{len(rates)} rates over ± full scale, {constant}", line[1],
        ),
        DatasheetRow(
            "scale-factor non-linearity", "% of full scale",
            "Greatest distance of the output from the best straight line", f"{len(rates)} rates over ± full scale",
            non_linearity(rates, outputs, bench.full_scale), positive=True,
        ),
        DatasheetRow(
            "quadrature", "deg/s", "Output in phase with displacement, as the rate whose force has its size",
            constant, quadrature, unread,
        ),
    )  # fmt: skip


def non_linearity(rates: np.ndarray, outputs: np.ndarray, full_scale: float) -> Dies:
    """Greatest residual of the best line in percent of the full scale."""
    offset, slope = best_line(rates, outputs)
    return 100.0 * np.max(np.abs(outputs - offset - slope * rates[:, None]), axis=0) / full_scale


def with_trim(
    rows: tuple[DatasheetRow, ...], rates: np.ndarray, outputs: np.ndarray, full_scale: float
) -> tuple[DatasheetRow, ...]:
    """The rows with their figures after each die has been given its own offset and scale: those of the line through its
    outputs at minus and plus half the full scale.
    """
    low, high = (outputs[int(np.argmin(np.abs(rates - place)))] for place in (-0.5 * full_scale, 0.5 * full_scale))
    scale, offset = (high - low) / full_scale, 0.5 * (low + high)
    trimmed = (outputs - offset) / scale
    found = {
        "zero-rate output": np.degrees(trimmed[len(rates) // 2]),
        "scale factor": best_line(rates, trimmed)[1],
        "scale-factor non-linearity": non_linearity(rates, trimmed, full_scale),
    }
    scaled = ("noise density", "angle random walk", "bias instability")
    return tuple(
        replace(row, trimmed=found[row.name] if row.name in found else row.values / np.abs(scale))
        if not row.missing and (row.name in found or row.name in scaled)
        else row
        for row in rows
    )


def start_up(bench: RateTests, turning: Outputs) -> DatasheetRow:
    """Time from power-on until the output of a `turning` lot stays near its end."""
    late = settled_mean(turning, bench.duration - 10.0 * turning.period)
    away = np.abs(turning.rate - late[:, None]) > _BAND * bench.full_scale
    last = turning.rate.shape[1] - 1 - np.argmax(away[:, ::-1], axis=1)
    time = np.where(away.any(axis=1), (last + 1) * turning.period, 0.0)
    never = time > _REST * bench.duration
    reason = "the output has not come to rest within the run" if np.mean(never) > 0.5 else ""
    shown = np.abs(late) / bench.full_scale
    if not reason and np.mean(shown < _SHOWN) > 0.5:
        reason = (
            f"at full scale the output shows {100.0 * np.nanmedian(shown):.2g} % of the rate: a drive that has not "
            "swung up within the run, or a scale factor to be repaired"
        )
    return DatasheetRow(
        "start-up time", "s", "From power-on until the output stays within 1 % of full scale of its end",
        f"rate of full scale, run of {bench.duration:.3g} s, no noise",
        np.where(never | (shown < _SHOWN), np.nan, time), reason, positive=True,
    )  # fmt: skip


def step_size(bench: RateTests) -> float:
    """A small step of the rate [rad/s]."""
    return 0.1 * bench.full_scale


def step_answer(bench: RateTests, still: Outputs, run: Outputs) -> tuple[Answer, tuple[DatasheetRow, ...]]:
    """Bandwidth and group delay by a small step of the rate in the middle of a `run`, beside one that stays `still`."""
    size = step_size(bench)
    first = round(0.5 * bench.duration / run.period)
    answer = (run.rate - still.rate)[:, first:] / size
    times = (np.arange(answer.shape[1]) + 0.5) * run.period
    tenth = max(1, answer.shape[1] // 10)
    end, before = np.mean(answer[:, -tenth:], axis=1), np.mean(answer[:, -2 * tenth : -tenth], axis=1)
    settled = (np.abs(end - before) < _STEADY * np.abs(end)) & (np.abs(end) > 0.1)
    reason = (
        ""
        if np.mean(settled) > 0.5
        else f"the output does not settle at a new rate within {times[-1]:.3g} s: a longer run tells it"
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.where(settled[:, None], answer / end[:, None], np.nan)
    bandwidth = first_half_power(over, run.period)
    delay = 1e3 * np.sum(1.0 - over, axis=1) * run.period
    past = "" if np.isfinite(bandwidth).any() else f"it lies beyond {0.4 / run.period:.4g} Hz, which this run shows"
    condition = f"step of {np.degrees(size):.3g} deg/s after {0.5 * bench.duration:.3g} s, no noise"
    found = Answer(times, answer, run.alive & still.alive, bandwidth, reason)
    return found, (
        DatasheetRow(
            "bandwidth",
            "Hz",
            "Frequency of the rate at which the output has lost 3 dB",
            condition,
            bandwidth,
            reason or past,
            note=resonance_in_band(over, run.period),
            positive=True,
        ),
        DatasheetRow("group delay", "ms", "Delay of a slowly varying rate", condition, delay, reason),
    )


def allan_record(bandwidth: float, period: float) -> float:
    """The record [s] of means over a `period` [s] that tells an Allan deviation from two periods of `bandwidth` on."""
    return float(_RECORD * period * 2.0 ** np.ceil(np.log2(max(1.0, 2.0 / (bandwidth * period)))))


def record_needed(bench: RateTests, bandwidth: Dies, period: float) -> float:
    """How long a run with noise should last [s]: until an Allan deviation is told, from ten to a hundred durations."""
    known = bandwidth[np.isfinite(bandwidth)]
    whole = bench.settle + 1.01 * allan_record(float(np.median(known)), period) if known.size else 0.0
    return float(np.clip(whole, 10.0 * bench.duration, 100.0 * bench.duration))


def no_noise(bench: RateTests, answer: Answer, duration: float) -> tuple[DatasheetRow, ...]:
    """The rows of the noise where a record of `duration` [s] can tell nothing of it; none where it is to be run."""
    readout, still = bench.loop.readout, bench.loop.device.temperature is None
    if still and readout.flicker is None and all(float(np.max(np.asarray(d))) == 0.0 for d in readout.noise_density):
        return _noise_rows(bench, duration, (f"{NOT_MODELLED}: the read-out has no noise",) * 3)
    if answer.unknown:
        unknown = f"nothing tells up to where the noise is flat: {answer.unknown}"
        return _noise_rows(bench, duration, tuple(f"{unknown}{more}" for more in (*_by_formula(bench), "")))
    return ()


def stopped_noise(bench: RateTests, duration: float) -> tuple[DatasheetRow, ...]:
    """The rows of the noise before its record is there."""
    why = f"stopped before the record of {duration:.3g} s with noise was there: a shorter `noise_duration` takes less"
    return _noise_rows(bench, duration, tuple(f"{why}{more}" for more in (*_by_formula(bench), "")))


def noises(
    bench: RateTests, answer: Answer, duration: float, progress: Callable[[float], None] | None = None
) -> tuple[DatasheetRow, ...]:
    """Noise density, angle random walk and bias instability of the output at rest; `progress` is told the share."""
    if rows := no_noise(bench, answer, duration):
        return rows
    bandwidth = answer.bandwidth
    run = bench.noisy(bench.at(0.0), duration, progress)
    rate = run.rate[:, round(bench.settle / run.period) :]
    nothing = np.full(len(rate), np.nan)
    if not run.alive.any():
        return _noise_rows(bench, duration, ("every die was lost",) * 3)
    half = rate.shape[1] // 2
    early, late = (np.median(np.var(np.diff(part[run.alive]), axis=1)) for part in (rate[:, :half], rate[:, half:]))
    if early == late == 0.0:
        return _noise_rows(bench, duration, ("no noise comes through: it does not cross a step of the converter",) * 3)
    if not late / _ALIKE < early < _ALIKE * late:
        less, more = sorted((early, late))
        change = f"{'falls to 1/' if early > late else 'rises to '}{more / max(less, np.finfo(float).tiny):.3g}"
        change += " times" if early < late else ""
        moving = f"the output is no stationary noise: from one half of the record to the other its power {change}, "
        moving += (
            "as its observer still learns"
            if bench.loop.observer.learns
            else "as the loop is still starting, or still rings from it: a longer `settle` leaves that out"
        )
        beside = _by_formula(bench)
        reasons = tuple(f"{NOT_MODELLED}: {moving}{more}" for more in (*beside, ""))
        return _noise_rows(bench, duration, reasons)
    widest = float(np.nanmedian(bandwidth)) if np.isfinite(bandwidth).any() else 0.4 / run.period
    density, walk, instability = nothing.copy(), nothing.copy(), nothing.copy()
    said = ["", "", ""]
    frequencies, power = spectrum_of(rate, run.period)
    top = flat_up_to(frequencies, power[run.alive], _SHARE * widest)
    flat = (frequencies > 0.0) & (frequencies <= top)
    if flat.sum() >= _LINES:
        density = np.degrees(np.sqrt(np.mean(power[:, flat], axis=1)))
    else:
        rises = "" if top == _SHARE * widest else f"the noise rises above {top:.3g} Hz, and "
        said[0] = (
            f"{rises}the record is too short: {_LINES} lines below {top:.3g} Hz take {_LINES / top:.3g} s"
            f"{_by_formula(bench)[0]}"
        )
    try:
        log = RateLog(tuple(map(str, np.flatnonzero(run.alive))), rate[run.alive], run.period)
        terms = analysed(log, (2.0 / widest, np.inf), low_pass=True).terms
    except InputError:
        said[2] = (
            f"the record is too short: averaging times from {2.0 / widest:.3g} s on take "
            f"{allan_record(widest, run.period):.3g} s"
        )
        known = np.isfinite(density).any()
        said[1] = "" if known else f"{said[2]}{_by_formula(bench)[1]}"
        rows = _noise_rows(bench, duration, tuple(said), (density, _PER_ROOT_HOUR * density, instability))
        return (rows[0], replace(rows[1], note=_FROM_DENSITY if known else ""), rows[2])
    for name, values in (("N", walk), ("bias_instability", instability)):
        values[run.alive] = [term[name].for_mean for term in terms]
    if np.sum(np.isfinite(walk)) < FEWEST:
        said[1] = f"the Allan deviation tells no white part on {FEWEST} dies or more{_by_formula(bench)[1]}"
    if np.mean(np.isfinite(instability)) < 0.5:
        said[2] = f"{NOT_MODELLED}: no flicker shows in {duration:.3g} s, the Allan deviation falls to its end"
    return _noise_rows(bench, duration, tuple(said), (density, walk, instability))


def _by_formula(bench: RateTests) -> tuple[str, str]:
    """Density and walk of the design in closed form, to be told where no record tells them; empty without a swing."""
    try:
        walk = np.degrees(float(noise_budget(bench.loop, sample_rate=bench.sample_rate).total))
    except InputError:
        return "", ""
    about = "of the design by the closed form (`noise_budget`)"
    return f"; {np.sqrt(2.0) * walk:.4g} deg/s/√Hz {about}", f"; {60.0 * walk:.4g} deg/√h {about}"


def _noise_rows(
    bench: RateTests, duration: float, reasons: tuple[str, ...], values: tuple[Dies, ...] = (np.full(1, np.nan),) * 3
) -> tuple[DatasheetRow, ...]:
    condition = f"no input rate, {duration - bench.settle:.4g} s from {bench.settle:.3g} s after power-on"
    return tuple(
        DatasheetRow(name, unit, definition, condition, value, reason, positive=True)
        for (name, unit, definition), value, reason in zip(_NOISES, values, reasons, strict=True)
    )


def around_the_axes(bench: RateTests, table: list[Outputs]) -> tuple[DatasheetRow, ...]:
    """Sensitivity to rates about the other axes and to acceleration of the frame."""
    zero = settled_mean(table[len(table) // 2], bench.settle)
    keeps = getattr(bench.loop.device, "rotating_frame", False)
    rows = []
    for axis, name in enumerate("xy"):
        for kind, unit, size, what in (
            ("cross-axis sensitivity", "%", bench.full_scale, "a rate of full scale about"),
            ("sensitivity to acceleration", "deg/s/g", _GRAVITY, "an acceleration of 1 g of the frame along"),
        ):
            if keeps:
                applied = tuple(Constant(size if axis == n else 0.0) for n in (0, 1))
                field = "cross_rate" if unit == "%" else "acceleration"
                moved = settled_mean(bench.run(bench.at(0.0, **{field: applied})), bench.settle) - zero
                values = 100.0 * moved / size if unit == "%" else np.degrees(moved)
            else:
                values = np.full(len(zero), np.nan)
            rows.append(
                DatasheetRow(
                    f"{kind}, {name}", unit, f"Change of the zero-rate output by {what} {name}",
                    "constant, no noise", values, "" if keeps else f"{NOT_MODELLED}: {_FRAME}",
                )
            )  # fmt: skip
    return tuple(rows)


def temperature_rows(
    bench: RateTests, temperatures: tuple[float, ...], told: Callable[[str], None]
) -> tuple[OverTemperature | None, tuple[DatasheetRow, ...]]:
    """Zero-rate output and scale factor over temperature, half of greatest less least."""
    names = ("zero-rate output over temperature", "scale factor over temperature")
    definition = "(max - min)/2 over the temperatures"
    degrees = ", ".join(f"{kelvin - CELSIUS:.4g}" for kelvin in temperatures)
    drifts = held_at(bench, temperatures, told) if depends_on_temperature(bench.loop) else None
    values, reason = (np.full(1, np.nan),) * 2, f"{NOT_MODELLED}: nothing in the device depends on temperature"
    if drifts is not None:
        values, reason = (np.degrees(drifts.zero_rate_drift), 100.0 * drifts.scale_factor_drift), ""
    return drifts, tuple(
        DatasheetRow(name, unit, definition, f"constant at {degrees} °C, no noise", value, reason, positive=True)
        for name, unit, value in zip(names, ("deg/s", "%"), values, strict=True)
    )
