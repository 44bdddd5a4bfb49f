"""The page of `memsgyro sweep`: result, pictures, the worst dies, and the settings that repeat it."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from memsgyro_jax.base.text import rounded
from memsgyro_jax.montecarlo.status import DIVERGED, STATUS

from . import figures
from .page import Page


if TYPE_CHECKING:
    from memsgyro_jax.base.provenance import Settings
    from memsgyro_jax.montecarlo.sweep import Lot

    from ..study import Study

_WORST = 10
_DIGITS = 6  # of a setting
_SHOWN = 16384  # dies that are shown one by one; more are summarised


def sweep_page(lot: "Lot", study: "Study") -> Page:
    """The report of `lot`, a sweep of `study`."""
    summary, lot = lot.summary, lot.first(_SHOWN)
    page = Page(
        "Sweep over fabricated dies", f"{summary.dies} dies of {study.source.name}, seed {summary.settings.seed}"
    )
    page.section("Result").text(_headline(lot)).table(["figure", "value"], summary.rows())
    if summary.dies > _SHOWN:
        page.text(f"What follows shows the first {_SHOWN} dies.")
    page.section("Rate error at the end")
    page.figure(figures.error_figure(lot), "Estimated minus true rate of each die at the end of the run.")
    page.section("Convergence")
    page.figure(
        figures.convergence_figure(lot), "The estimated rate of the dies over time, as means over short windows."
    )
    _add_parameters(page, lot)
    page.section(f"The {min(_WORST, summary.dies)} worst dies").table(*_worst(lot))
    page.section("Settings")
    page.text(
        "These settings repeat the sweep, on any number of cores; summary.json beside this page has all their digits."
    )
    return with_settings(page, study, summary.settings, "tune.")


def _headline(lot: "Lot") -> str:
    summary = lot.summary
    lost = "none was lost" if summary.failed == 0 else f"{summary.failed} were lost (out of travel or not finite)"
    share, low, high = (100.0 * part for part in (summary.good.value, summary.good.low, summary.good.high))
    if summary.divergence.dies:
        lost += f", and the filters of {len(summary.divergence.dies)} diverged (impossible under their claims)"
    text = f"Of {summary.dies} dies {lost}; {share:.1f} % ({low:.1f} to {high:.1f} % with 95 % confidence) are good: "
    text += f"{summary.good.criterion}. "
    if summary.unsettled:
        text += f"The yield is not to be trusted: {summary.unsettled}. "
    text += "" if summary.all_lost else f"The rate error is {np.degrees(summary.end.rms):.3g} deg/s rms."
    if summary.reached is not None:
        text += (
            f" It is {summary.reached.value:.2f} times ({summary.reached.low:.2f} to {summary.reached.high:.2f}) what "
            "any use of the same data and prior could reach at best on each die."
        )
    return text


def _add_parameters(page: Page, lot: "Lot") -> None:
    figure = figures.parameter_figure(lot)
    page.section("Rate error against the drawn parameters")
    if figure is None:
        page.text("No parameter was varied.")
        return
    page.text(
        "A tilted cloud is a parameter whose spread becomes a rate error; a funnel is one that makes the rate harder "
        "to see. Rank correlations below about "
        f"{2.0 / np.sqrt(max(lot.summary.dies - lot.summary.failed, 1)):.2f} are what chance gives."
    )
    page.figure(figure, "Each point is a die; parameters in falling order of rank correlation.")
    across = figures.parallel_figure(lot)
    if across is not None:
        page.figure(
            across, "Each line is a die: by rank in every parameter, then the size of its error (99 % at the top)."
        )


def _worst(lot: "Lot") -> tuple[list[str], list[list[str]]]:
    """Lost dies first, in the order in which they were lost, then by the size of the error."""
    data = lot.data
    error, lost = np.degrees(data["rate_error_end"].values), data["lost_at"].values
    astray = data[STATUS].values == DIVERGED
    order = np.lexsort((-np.abs(error), lost))[:_WORST]
    names = [str(name) for name in data.coords["parameter"].values] if data.sizes.get("parameter") else []
    middle, spread = (of(data["drawn"].values, axis=0) if names else np.empty(0) for of in (np.median, np.std))
    header = ["die", "rate error [deg/s]", "claimed std [deg/s]", "converged after [ms]", "unusual in"]
    rows = []
    for die in order:
        values = data["drawn"].values[die] if names else np.empty(0)
        size = f"{error[die]:+.3g}" + (", diverged" if astray[die] else "")
        fate = f"lost at {1e3 * lost[die]:.3g} ms" if np.isfinite(lost[die]) else size
        claimed = np.degrees(float(data["rate_std_end"].values[die]))
        converged = 1e3 * float(data["convergence_time"].values[die])
        unusual = _unusual(names, values, middle, spread)
        rows.append([str(die), fate, _or_dash(claimed), _or_dash(converged, "never"), unusual])
    return header, rows


def _unusual(names: list[str], values: np.ndarray, middle: np.ndarray, spread: np.ndarray) -> str:
    """The two parameters farthest from the median, in standard deviations of the lot."""
    away = (values - middle) / np.where(spread > 0.0, spread, np.inf)
    far = np.argsort(-np.abs(away))[:2]
    return ", ".join(f"{figures.short(names[i])} {away[i]:+.1f} σ" for i in far) or "–"


def _or_dash(value: float, otherwise: str = "–") -> str:
    return f"{value:.3g}" if np.isfinite(value) else otherwise


def with_settings(page: Page, study: "Study", made: "Settings | None", *unused: str) -> Page:
    """The page and tables of the settings of a study, without entries that begin as one of the `unused`, and of what
    computed it.
    """
    entries = settings(study.file.model_dump(by_alias=True, exclude_none=True))
    page.table(["entry", "value"], [(name, value) for name, value in entries if not name.startswith(unused)],
               stacked=True)  # fmt: skip
    if made is None:
        return page
    return page.table(["made with", "version"], [*made.versions, ("fingerprint", made.fingerprint)], stacked=True)


def settings(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Dotted name and text of every entry of nested settings, numbers to six digits; empty ones are left out."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from settings(entry, f"{name}.{key}" if name else key)
    elif isinstance(value, list | tuple) and any(isinstance(entry, dict | list | tuple) for entry in value):
        for number, entry in enumerate(value):
            yield from settings(entry, f"{name}.{number}" if len(value) > 1 else name)
    elif isinstance(value, list | tuple):
        if value:
            told = [rounded(str(entry), _DIGITS) for entry in value]
            yield name, told[0] if len(set(told)) == 1 else ", ".join(told)
    else:
        yield name, rounded(str(value), _DIGITS)
