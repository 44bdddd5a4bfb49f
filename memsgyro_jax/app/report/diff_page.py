"""The page of `memsgyro diff --report`: what sets two results apart, in tables, and their errors in one picture."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .figures import blank, plain
from .page import Page


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BINS, _LINES, _FAR = 30, 2000, 8.0


def diff_page(paths: tuple[Path, Path], names: tuple[str, str], tables: dict[str, list[tuple[str, ...]]]) -> Page:
    """The page of two studies or results, called `names`; `tables` are rows that differ, the header first, by what they
    hold.
    """
    page = Page("What sets two results apart", f"A is {names[0]}, B is {names[1]}")
    if not tables:
        page.section("Result").text("Nothing: all settings and figures agree, to four digits.")
    figure = _pictured(paths)
    if figure is not None:
        page.section("Rate").figure(*figure)
    for what, (header, *rows) in tables.items():
        page.section(f"{what[0].upper()}{what[1:]}s that differ")
        split = [(*row[:-1], *f"{row[-1]}, ".split(", ")[:2]) for row in rows]
        kept = [i for i in range(5) if any(row[i] for row in split)]
        columns = (*header[:-1], "change", "intervals of 95 %")
        page.table([columns[i] for i in kept], [[row[i] for i in kept] for row in split])
    return page


def _pictured(paths: tuple[Path, Path]) -> "tuple[Figure, str] | None":
    """Both lots as histograms, or both runs over time; None where the folders hold neither in common."""
    from memsgyro_jax.base.labelled import load

    for store, draw, caption in (
        ("dies.zarr", _histogram, "Estimated minus true rate of each die at the end, as shares of the dies."),
        ("trace.zarr", _course, "Estimated minus true rate over time."),
    ):
        if all((path / store).is_dir() for path in paths):
            figure = blank(3.6)
            draw(figure.subplots(), [load(path / store) for path in paths])
            return plain(figure), caption
    return None


def _histogram(ax: "Axes", lots: "list[xr.Dataset]") -> None:
    errors = [np.degrees(lot["rate_error_end"].values) for lot in lots]
    errors = [error[np.isfinite(error)] for error in errors]
    every = np.concatenate(errors)
    low, middle, high = np.percentile(every, [25.0, 50.0, 75.0]) if every.size else (0.0,) * 3
    near = every[np.abs(every - middle) <= _FAR * (high - low)]  # one die far off would flatten all others
    edges = np.histogram_bin_edges(near, _BINS)
    for name, error, style in zip("AB", errors, ("-", "--"), strict=True):
        share, _ = np.histogram(error, edges)
        label = f"{name}: {error.size} dies"
        ax.stairs(100.0 * share / max(error.size, 1), edges, label=label, ls=style, lw=1.6)
    ax.set(xlabel="rate error at the end [deg/s]", ylabel="dies in a bin [%]")
    ax.legend(frameon=False)


def _course(ax: "Axes", runs: "list[xr.Dataset]") -> None:
    for name, run, style in zip("AB", runs, ("-", "--"), strict=True):
        rows = slice(None, None, max(1, run.sizes["time"] // _LINES))
        error = np.degrees(run["rate_estimate"].values - run["rate_true"].values)[rows]
        ax.plot(1e3 * run["time"].values[rows], error, style, lw=1.0, label=name)
        late = np.abs(error[len(error) // 4 :])
        limit = max(ax.get_ylim()[1] if name == "B" else 0.0, 1.3 * float(np.max(late)) + 1e-9)
        ax.set_ylim(-limit, limit)
    ax.set(xlabel="time [ms]", ylabel="rate error [deg/s]")
    ax.legend(frameon=False)
