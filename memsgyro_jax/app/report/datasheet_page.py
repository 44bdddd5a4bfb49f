"""The page of `memsgyro datasheet`: figures with their definitions, two pictures, and the settings."""

from typing import TYPE_CHECKING

import numpy as np

from memsgyro_jax.measurement.over_temperature import CELSIUS

from .figures import blank, plain
from .page import Page
from .sweep_page import with_settings


if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from memsgyro_jax.measurement.datasheet_rows import Datasheet

    from ..study import Study

_CURVES = 40  # dies in a picture


def datasheet_page(sheet: "Datasheet", study: "Study") -> Page:
    """The page of a datasheet of `study`."""
    lost = f", of which {sheet.lost} were lost and left out" if sheet.lost else ""
    page = Page("Datasheet of a simulated lot", f"{sheet.dies} dies of {study.source.name}{lost}")
    page.section("Figures")
    page.text(
        "Typical is the mean over dies with its 95 % interval; minimum and maximum are the mean less and plus three "
        "standard deviations of the lot."
    )
    columns = ["figure", "unit", "minimum", "typical", "maximum", "5 to 95 % of the dies"]
    page.table(columns, sheet.table(), stacked=True)
    for note in sheet.notes:
        page.text(note)
    page.section("Curves").figures(_curves(sheet))
    page.section("Definitions and conditions")
    rows = [(row.name, row.definition, row.condition) for row in sheet.rows]
    page.table(["figure", "definition", "condition"], rows, stacked=True)
    page.section("Settings")
    unused = "tune.", "sweep.dies", "sweep.tolerance", "sweep.chunk", "scenario.rate"  # it has its own dies and rates
    return with_settings(page, study, sheet.settings, *unused)


def _curves(sheet: "Datasheet") -> "list[tuple[Figure, str]]":
    from memsgyro_jax.measurement.datasheet_tests import best_line

    some = slice(0, _CURVES)
    offset, slope = best_line(sheet.rates, sheet.outputs)
    error = 100.0 * (sheet.outputs - offset - slope * sheet.rates[:, None]) / sheet.full_scale
    curves = [
        (np.degrees(sheet.rates), error[:, some], "rate [deg/s]", "distance from the line [% of full scale]",
         "Output less the best line of each die."),
        (1e3 * sheet.times, sheet.answers[some].T, "time after the step [ms]", "output over step [1]",
         "Answer to a step of the rate."),
    ]  # fmt: skip
    if (held := sheet.over_temperature) is not None:
        celsius, moved = held.temperatures - CELSIUS, held.zero_rate - np.mean(held.zero_rate, axis=0)
        words = "zero-rate output less its mean [deg/s]", "Zero-rate output over temperature, of each die."
        curves.append((celsius, np.degrees(moved)[:, some], "temperature [°C]", *words))
    return [(_curve(*curve), caption) for *curve, caption in curves if np.isfinite(curve[1]).any()]


def _curve(along: np.ndarray, values: np.ndarray, below: str, beside: str) -> "Figure":
    figure = blank(3.4, 4.6)
    ax = figure.subplots()
    ax.plot(along, values, color="C0", lw=0.8, alpha=0.5)
    ax.set(xlabel=below, ylabel=beside)
    return plain(figure)
