"""The scale factor test of a finished gyro on a rate table, in the terms of IEEE Std 1431-2004 and 528."""

from typing import Any

import numpy as np

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.errors import InputError

from .plateau_noise import response
from .rate_design import TREND, design_of
from .rate_line import PPM, Line
from .rate_plateaus import RatePlateaus, levels, read_plateaus
from .scale_factor_figures import (
    asymmetry_row,
    drift_row,
    hysteresis_row,
    noise_rows,
    nonlinearity_rows,
    scale_factor_rows,
    temperature_sensitivities,
    trend_of,
)
from .scale_factor_notes import lone_plateaus, sequence_notes, with_runs
from .scale_factor_result import MeasuredFigure, ScaleFactorTest


def scale_factor_test(
    source: Any,
    *,
    rate_column: str | None = None,
    output_column: str | None = None,
    settle: float | str | None = None,
    full_scale: float | str | None = None,
) -> ScaleFactorTest:
    """What a test on a rate table says of a gyro that puts out a rate, volts or counts.

    Args:
        source: a CSV file with a header like ``t [s],table rate [deg/s],output [V]``, or columns by such headers (a
            dict of arrays, a frame of pandas): a raw log, whose plateaus are found, or one row a plateau. The output
            may have any unit, LSB too. Further columns that are known by name and unit: standard deviation of each row,
            temperature, bias voltage, run (turn-on), direction.
        rate_column, output_column: names of the columns, where they do not tell themselves.
        settle: [s] to leave out at the begin of each plateau of a raw log; without it until a step has died away to a
            millionth, as the log shows it.
        full_scale: [rad/s] of which nonlinearity is told; the greatest rate of the test without it.

    The scale factor is the slope of the least-squares line over all plateaus (IEEE Std 1431). Drift of the
    bias, temperature and runs are fitted beside it where the sequence of rates tells them apart, and notes say where
    not. Intervals of 95 % hold the noise within plateaus, also where it is no white one, a scatter from plateau to
    plateau, and a random walk of the bias.

    Raises:
        InputError: with file, line and column for what `log_table` refuses, columns that cannot be told, samples that
            are missing within a plateau, and fewer than two rates.
    """
    read = read_plateaus(source, rate_column, output_column, settle)
    greatest = float(np.max(np.abs(read.rate)))
    full = greatest if full_scale is None else float(quantity("full_scale", full_scale, "rad/s"))
    if not full > 0.0 or not np.isfinite(full):
        raise InputError(f"Argument `full_scale` must be positive and finite, but {full:g} rad/s was given.")
    return judge_plateaus(read, full)


def judge_plateaus(read: RatePlateaus, full_scale: float) -> ScaleFactorTest:
    """The figures of plateaus that are read."""
    if len(levels(read.rate)[0]) < 2:
        raise InputError(
            f"{read.where}: a scale factor takes plateaus at two rates or more, but the rate of all "
            f"{len(read.rate)} is {np.degrees(read.rate[0]):.6g} deg/s."
        )
    if not np.ptp(read.output):
        raise InputError(f"{read.where}: the output must follow the rate, but is {read.output[0]:g} at all of them.")
    line = fitted_line(read, full_scale)
    nonlinear, by_level, reach = nonlinearity_rows(line)
    figures, said = scale_factor_rows(line), (*read.notes, _UNMOVED)
    follows = not line.known or line.of(line.weights[1]).told
    if follows:
        figures, told = _figures(line, {**figures, **nonlinear})
        said = (*read.notes, *sequence_notes(line), *told, *_alone(line))
    missing = np.full(len(read.rate), np.nan)
    return ScaleFactorTest(
        figures, read.rate, read.output, line.found.output, line.ppm * (line.leaving @ line.found.output), read.time,
        read.run, read.direction, missing if read.temperature is None else read.temperature,
        np.unique(np.radians(line.rate)), by_level, reach, read.unit, full_scale, int(read.run.max()) + 1,
        "completed" if follows else _UNMOVED, said,
    )  # fmt: skip


_UNMOVED = "The output does not follow the rate beyond its noise: is its column, or the axis, another one?"


def _figures(line: Line, first: dict[str, MeasuredFigure]) -> tuple[dict[str, MeasuredFigure], tuple[str, ...]]:
    """All figures, behind those that come `first`, and sentences on the runs."""
    bent = TREND in line.design.names
    trend = trend_of(line, lambda: fitted_line(line.read, line.full_scale, with_trend=True))
    figures = {
        **first,
        "asymmetry": asymmetry_row(line),
        "hysteresis": hysteresis_row(line),
        "drift": drift_row(line, trend, bent),
        **temperature_sensitivities(line),
        **noise_rows(line),
    }
    return with_runs(line, figures)


def fitted_line(read: RatePlateaus, full_scale: float, **options: bool) -> Line:
    """The line through plateaus."""
    design = design_of(read, **options)
    return Line(read, design, response(design.means), full_scale)


def _alone(line: Line) -> list[str]:
    """A sentence on each plateau that stands alone, with what it does to the scale factor."""
    read, said = line.read, []
    for number in lone_plateaus(line):
        rest = fitted_line(read.without(number), line.full_scale)
        more = PPM * (rest.scale_factor / line.scale_factor - 1.0)
        size = f"{abs(more):.3g} ppm {'more' if more > 0.0 else 'less'}"
        said.append(
            f"The plateau of {np.degrees(read.rate[number]):.6g} deg/s that begins in line {read.lines[number]} lies "
            f"far off what all others say; without it the scale factor would be {size}."
        )
    return said
