"""The page of `memsgyro datasheet`: figures with their definitions, two pictures, and the settings."""

from typing import TYPE_CHECKING

import numpy as np

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
    page.table(["figure", "unit", "minimum", "typical", "maximum", "5 to 95 % of the dies"], sheet.table())
    for note in sheet.notes:
        page.text(note)
    page.section("Curves")
    page.figure(_curves(sheet), "Left: output less the best line of each die. Right: answer to a step of the rate.")
    page.section("Definitions and conditions")
    page.table(["figure", "definition", "condition"], [(row.name, row.definition, row.condition) for row in sheet.rows])
    page.section("Settings")
    return with_settings(page, study, sheet.settings)


def _curves(sheet: "Datasheet") -> "Figure":
    from memsgyro_jax.measurement.datasheet_tests import best_line

    figure = blank(3.4)
    left, right = figure.subplots(1, 2)
    some = slice(0, _CURVES)
    offset, slope = best_line(sheet.rates, sheet.outputs)
    error = 100.0 * (sheet.outputs - offset - slope * sheet.rates[:, None]) / sheet.full_scale
    left.plot(np.degrees(sheet.rates), error[:, some], color="C0", lw=0.8, alpha=0.5)
    left.set_xlabel("rate [deg/s]")
    left.set_ylabel("distance from the best line [% of full scale]")
    right.plot(1e3 * sheet.times, sheet.answers[some].T, color="C0", lw=0.8, alpha=0.5)
    right.set_xlabel("time after the step [ms]")
    right.set_ylabel("output over step [1]")
    return plain(figure)
