"""Pictures of a diagnosis. No text of a case enters them: names stand in captions, which the page escapes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullFormatter

from memsgyro_jax.base.text import spoken
from memsgyro_jax.diagnosis.findings import Stage
from memsgyro_jax.measurement.experiments import AbstractRecord, Deviation
from memsgyro_jax.measurement.experiments.deviation import View

from .figures import blank, plain


MEASURED, BASE, FINAL, QUIET = "#1d2530", "#c2571a", "#1f5fa8", "#8a94a0"
_POINTS = 250  # of a long record in a picture
_SEVERAL = 1.1  # times the least drive: from there on there are several


def steps_figure(steps: Sequence[Stage]) -> Figure:
    """How χ²/dof of the fitted and the error of the other readings fell with every effect that was added."""
    figure = blank(2.4)
    ax, place = figure.subplots(), np.arange(len(steps))
    ax.plot(place, [np.sqrt(s.chi2_per_dof) for s in steps], "o-", color=FINAL, label="fitted readings")
    ax.plot(place, [s.validation_error for s in steps], "s--", color=BASE, label="readings that were not fitted")
    _noise_line(ax)
    log_scale(ax)
    ax.set_xticks(place, ["base model", *(f"step {k}" for k in place[1:])])
    ax.margins(x=0.2 if len(steps) < 3 else 0.05)
    ax.set_ylabel("error / noise")
    ax.legend(frameon=False, fontsize="small")
    return faint(figure)


def overlay_figure(record: AbstractRecord, base: Deviation, final: Deviation, views: Sequence[View]) -> Figure:
    """Measured points between the curves of base and final model, residual over noise below; a column per view."""
    white, phasors = [one.size for one in (base, final)], np.iscomplexobj(record.readings)
    measured, *curves = (np.abs(v) if phasors else v for v in (record.readings, base.predicted, final.predicted))
    figure = blank(4.6)
    grid = figure.subplots(2, len(views), squeeze=False, sharex="col", height_ratios=(3, 2))
    for view, (upper, lower) in zip(views, grid.T, strict=True):
        for rows in view.curves:
            upper.plot(view.across[rows], measured[rows, view.channel], ".", color=MEASURED, ms=3.5, mew=0, zorder=3)
            for values, colour, style in zip(curves, (BASE, FINAL), ("--", "-"), strict=True):
                upper.plot(view.across[rows], values[rows, view.channel], style, color=colour, lw=1.1)
        for values, colour, marker in zip(white, (BASE, FINAL), ("x", "."), strict=True):
            shown = np.maximum(values[view.rows, view.channel], 0.1)
            lower.plot(view.across[view.rows], shown, marker, color=colour, ms=3.5, mew=0.7, alpha=0.7)
        _noise_line(lower)
        if phasors and not view.near:
            log_scale(upper)
        log_scale(lower)
        upper.set_title(f"channel {'xy'[view.channel]}" + (", where base is worst" if view.near else ""))
        lower.set_xlabel(view.heading)
        lower.ticklabel_format(axis="x", useOffset=False)
        lower.xaxis.set_major_locator(MaxNLocator(4))
    grid[0, 0].set_ylabel(f"{'amplitude' if phasors else 'reading'} [{base.declared.readout.unit}]")
    grid[1, 0].set_ylabel("residual / noise")
    _keys(figure)
    return faint(figure)


def per_drive_figure(found: Sequence[tuple[Any, Deviation]], axis: int, unit: str) -> Figure | None:
    """Sweeps of one axis at several drives, each over its drive: what is linear falls on one curve; points are
    measured, lines the model. `None` where there are no two drives.
    """
    curves = [
        (float(np.mean(record.setting[rows])), record.frequency[rows] / (2 * np.pi), record.readings[rows, axis],
         deviation.predicted[rows, axis])
        for record, deviation in found if hasattr(record, "setting") and record.axis == axis
        for rows in record.courses
    ]  # fmt: skip
    levels = np.array([level for level, *_ in curves])
    if not curves or levels.max() < _SEVERAL * levels.min():
        return None
    figure = blank(3.2)
    ax, seen = figure.subplots(), set[str]()
    for (level, hertz, measured, predicted), shade in zip(curves, colours(levels), strict=True):
        label = spoken(level, unit, 3)
        ax.plot(hertz, np.abs(measured) / level, ".", color=shade, ms=3.5, mew=0, label="_" * (label in seen) + label)
        ax.plot(hertz, np.abs(predicted) / level, "-", color=shade, lw=0.9)
        seen.add(label)
    ax.ticklabel_format(axis="x", useOffset=False)
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("amplitude / drive")
    ax.legend(frameon=False, fontsize="small", title="drive", markerscale=2.0)
    return faint(figure)


def residual_figure(base: Deviation, final: Deviation, views: Sequence[View]) -> Figure:
    """Residual over noise alone, as root mean square of short stretches; a column per view."""
    figure = blank(2.3)
    grid = figure.subplots(1, len(views), squeeze=False, sharey=True)[0]
    for view, ax in zip(views, grid, strict=True):
        for one, colour, style in ((base, BASE, "--"), (final, FINAL, "-")):
            ax.plot(*_stretches(view.across, one.size[:, view.channel]), style, color=colour, lw=1.1)
        _noise_line(ax)
        log_scale(ax)
        ax.set_ylim(0.3, max(5.0, 1.5 * ax.get_ylim()[1]))
        ax.set_title(f"channel {'xy'[view.channel]}")
        ax.set_xlabel(view.heading)
    grid[0].set_ylabel("residual / noise")
    _keys(figure, measured=False)
    return faint(figure)


def _stretches(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    seen = np.isfinite(values)
    time, values = time[seen], values[seen]
    count = min(_POINTS, max(1, len(values) // 10))
    pieces = np.array_split(np.arange(len(values)), count)
    return np.array([time[p].mean() for p in pieces]), np.array([np.sqrt(np.mean(values[p] ** 2)) for p in pieces])


def colours(values: np.ndarray) -> np.ndarray:
    """One colour per row (n, 4) for an ordered quantity."""
    _, place = np.unique(values, return_inverse=True)
    return colormaps["viridis"](0.85 * place / max(1, place.max()))


def log_scale(ax: Axes) -> None:
    """A logarithmic axis that is labelled at whole decades, or, where there are hardly two, in between."""
    low, high = ax.dataLim.y0, ax.dataLim.y1
    ax.set_yscale("log")
    ax.yaxis.set_minor_formatter(NullFormatter())
    if low > 0 and high < 30 * low:
        near = (1.0, 1.2, 1.5, 2.0, 3.0, 5.0) if high < 4 * low else (1.0, 2.0, 5.0)
        ax.yaxis.set_major_locator(LogLocator(subs=near))
        ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))


def _noise_line(ax: Axes) -> None:
    ax.axhline(1.0, color=QUIET, lw=1.0, ls=":", label="noise")


def _keys(figure: Figure, measured: bool = True) -> None:
    from matplotlib.lines import Line2D

    keys = [Line2D([], [], ls="", marker=".", color=MEASURED, label="measured")] if measured else []
    keys += [Line2D([], [], ls="--", color=BASE, label="base model"), Line2D([], [], color=FINAL, label="final model")]
    keys.append(Line2D([], [], ls=":", color=QUIET, label="noise"))
    figure.legend(handles=keys, loc="outside lower center", ncols=4, frameon=False, fontsize="small")


def faint(figure: Figure) -> Figure:
    """The figure with less around its curves: small titles and a faint grid, too."""
    for ax in figure.axes:
        ax.grid(alpha=0.25, lw=0.6)
        ax.set_title(ax.get_title(), fontsize="medium")
    return plain(figure)
