"""The page of `memsgyro simulate`: one run in pictures, and the settings that repeat it."""

from typing import TYPE_CHECKING

from . import figures
from .page import Page
from .sweep_page import settings


if TYPE_CHECKING:
    from ..study import Study
    from ..trace import Trace


def trace_page(trace: "Trace", study: "Study", rows: list[tuple[str, str]]) -> Page:
    """The report of `trace`, a run of `study`; `rows` are its figures as name and value."""
    page = Page("One run of the closed loop", f"{study.source.name}, seed {trace.settings.seed}")
    page.section("Result").table(["figure", "value"], rows)
    page.section("Rate")
    page.figure(figures.trace_figure(trace, "rate"), "Estimated and true rate over time.")
    page.section("Motion")
    page.figure(figures.trace_figure(trace, "motion"), "Estimated displacement; true displacement dashed.")
    page.section("Coefficients")
    page.figure(figures.coefficients_figure(trace), "Estimate over truth, minus one; linear within ± 0.1 %.")
    page.section("Settings")
    page.table(["entry", "value"], list(settings(study.file.model_dump(by_alias=True, exclude_none=True))))
    page.table(["made with", "version"], [*trace.settings.versions, ("fingerprint", trace.settings.fingerprint)])
    return page
