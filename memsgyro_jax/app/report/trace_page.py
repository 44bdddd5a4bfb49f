"""The page of `memsgyro simulate`: one run in pictures, and the settings that repeat it."""

from typing import TYPE_CHECKING

from markupsafe import Markup

from . import figures
from .moving import orbit_of
from .page import Page
from .sweep_page import with_settings


if TYPE_CHECKING:
    from memsgyro_jax.loop.trace_result import Trace

    from ..study import Study


def trace_page(trace: "Trace", study: "Study", rows: list[tuple[str, str]]) -> Page:
    """The report of `trace`, a run of `study`; `rows` are its figures as name and value."""
    page = Page("One run of the closed loop", f"{study.source.name}, seed {trace.settings.seed}")
    page.section("Result").table(["figure", "value"], rows)
    page.section("Rate").figure(figures.rate_figure(trace), "Estimated and true rate over time.")
    motion = figures.motion_figure(trace)
    if motion is not None:
        page.section("Motion").figure(motion, "Displacement over the last periods; estimated, and dashed the true one.")
    orbit = orbit_of(trace)
    page.section("Orbit and mode shapes")
    if isinstance(orbit, Markup):
        page.drawing(orbit, "The mass over its last vibrations, and the two ways in which it would swing by itself.")
    else:
        page.text(orbit)
    if trace.loop.observer.learns:  # one that holds the design would draw how far the die is from it
        page.section("Coefficients")
        page.figure(figures.coefficients_figure(trace), "Size of estimate over truth minus one.")
    unused = "tune.", "sweep.dies", "sweep.tolerance", "sweep.chunk"
    return with_settings(page.section("Settings"), study, trace.settings, *unused)
