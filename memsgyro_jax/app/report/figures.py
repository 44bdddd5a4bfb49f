"""Pictures of the report pages, as figures free of pyplot's state."""

from dataclasses import fields, replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats


if TYPE_CHECKING:
    from memsgyro_jax.loop.trace_result import Trace
    from memsgyro_jax.montecarlo.sweep import Lot

WIDTH = 9.0  # inches; the page scales a figure to its own width
_MANY = 12  # parameters at most in the grid of `parameter_figure`
_ACROSS, _LINES = 7, 400  # parameters and dies at most in `parallel_figure`
_POINTS = 1000  # rows of a trace in a picture
_PERIODS, _FASTEST = 12.0, 4e3  # how many periods of motion are shown, of modes up to this many Hz
_INK, _BAND, _WARN = "#1d2530", "#3b6fb6", "#c2502e"


def blank(height: float, width: float = WIDTH) -> Figure:
    """An empty figure, `height` and `width` in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def error_figure(lot: "Lot") -> Figure:
    """Histogram of the rate error at the end, with the information bound and the tolerance."""
    figure = blank(3.4)
    if not np.isfinite(lot.data["rate_error_end"].values).any():
        return _nothing(figure)
    ax = lot.plot(figure.subplots())
    tolerance = np.degrees(float(lot.data.attrs["tolerance"]))
    low, high = ax.get_xlim()
    for number, edge in enumerate((-tolerance, tolerance)):
        if low < edge < high:
            ax.axvline(edge, color=_WARN, lw=1.0, ls=":", label=None if number else f"tolerance {tolerance:.3g} deg/s")
    ax.legend(loc="best", frameon=False)
    return plain(figure)


def convergence_figure(lot: "Lot") -> Figure:
    """The estimated rate of all dies over time beside the true rate: median and percentiles of window means."""
    figure = blank(3.6)
    time = 1e3 * lot.data["time"].values
    alive = np.isfinite(lot.data["rate_error_end"].values)
    estimate, true = (np.degrees(lot.data[name].values[alive]) for name in ("rate_estimate", "rate_true"))
    if not estimate.size:
        return _nothing(figure)
    ax = figure.subplots()
    for low, high, alpha in ((5.0, 95.0, 0.2), (25.0, 75.0, 0.35)):
        band = np.percentile(estimate, [low, high], axis=0)
        ax.fill_between(time, *band, color=_BAND, alpha=alpha, lw=0, label=f"{low:.0f} to {high:.0f} % of the dies")
    ax.plot(time, np.median(estimate, axis=0), color=_BAND, lw=1.4, label="median estimate")
    ax.plot(time, np.median(true, axis=0), color=_INK, lw=1.2, ls="--", label="true rate")
    settle = 1e3 * float(lot.data.attrs["settle"])
    if time[0] < settle < time[-1]:
        ax.axvline(settle, color="0.6", lw=1.0, ls=":", label="start of the settled part")
    ax.set_ylim(*_limits(estimate, true))
    ax.set_xlabel("time [ms]")
    ax.set_ylabel("rate [deg/s]")
    figure.legend(loc="outside lower center", frameon=False, fontsize="small", ncols=5)
    return plain(figure)


def _limits(estimate: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Limits that show the later two thirds, whatever the acquisition did."""
    late = slice(estimate.shape[1] // 3, None)
    low, high = np.percentile(estimate[:, late], [2.0, 98.0])
    low, high = min(low, true.min()), max(high, true.max())
    margin = 0.25 * (high - low) + 1e-9
    return low - margin, high + margin


def parameter_figure(lot: "Lot") -> Figure | None:
    """Rate error at the end against each drawn parameter; None where nothing was drawn."""
    names, values, error = drawn(lot)
    if not names or error.size < 3:
        return None
    order = np.argsort([-abs(rank) for rank in ranks(values, error)])[:_MANY]
    columns = min(4, len(order))
    rows = -(-len(order) // columns)
    figure = blank(0.4 + 2.1 * rows)
    axes = np.ravel(figure.subplots(rows, columns, sharey=True, squeeze=False))
    for ax, index in zip(axes, order, strict=False):
        _scatter(ax, names[index], values[:, index], error)
    for ax in axes[len(order) :]:
        ax.set_axis_off()
    for ax in axes[::columns]:
        ax.set_ylabel("rate error [deg/s]")
    return plain(figure)


def _scatter(ax: Axes, name: str, values: np.ndarray, error: np.ndarray) -> None:
    middle = np.median(values)
    relative = abs(middle) > 0.1 * np.ptp(values)
    across = 100.0 * (values / middle - 1.0) if relative else values
    ax.scatter(across, error, s=7, color=_BAND, alpha=0.55, lw=0, rasterized=error.size > 3000)
    ax.axhline(0.0, color="0.7", lw=0.8, zorder=0)
    ax.set_xlabel(f"{short(name)} [% of median]" if relative else f"{short(name)} [SI]", fontsize="small")
    ax.set_title(f"rank correlation {_rank(values, error):+.2f}", fontsize="small")


def parallel_figure(lot: "Lot") -> Figure | None:
    """Every die as a line across the parameters that matter most and its error; None where nothing was drawn.

    A parameter is shown by its rank among the dies, the error as it is: lines of the worst tenth that meet on an axis
    say where bad dies come from.
    """
    names, values, error = drawn(lot)
    if not names or error.size < 10:
        return None
    order = np.argsort([-abs(rank) for rank in ranks(values, error)])[:_ACROSS]
    places = np.stack([stats.rankdata(column) / len(column) for column in values[:, order].T], axis=1)
    size = np.abs(error)
    lines = np.column_stack([places, size / np.percentile(size, 99.0)]).clip(0.0, 1.0)
    bad = size >= np.percentile(size, 90.0)
    figure = blank(3.8)
    ax = figure.subplots()
    good = np.flatnonzero(~bad)[:_LINES]
    ax.plot(lines[good].T, color=_BAND, lw=0.6, alpha=max(0.06, min(0.5, 20.0 / max(len(good), 1))))
    ax.plot(lines[np.flatnonzero(bad)[:_LINES]].T, color=_WARN, lw=1.0, alpha=0.7)
    ax.plot([], [], color=_WARN, label="the worst tenth")
    ax.plot([], [], color=_BAND, label="all others")
    ax.set_xticks(range(lines.shape[1]), [*(short(names[i]) for i in order), "size of\nthe error"], fontsize="small")
    ax.vlines(range(lines.shape[1]), 0.0, 1.0, color="0.8", lw=0.8, zorder=0)
    ax.set_yticks([0.0, 0.5, 1.0], ["smallest", "median", "largest"])
    figure.legend(loc="outside lower center", frameon=False, ncols=2, fontsize="small")
    return plain(figure)


def short(path: str) -> str:
    """A parameter's path without the device's prefix."""
    return path.removeprefix("device.")


def drawn(lot: "Lot") -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, values (dies, parameters) and rate errors [deg/s] of the dies that were not lost."""
    error = np.degrees(lot.data["rate_error_end"].values)
    alive = np.isfinite(error)
    names = [str(name) for name in lot.data.coords["parameter"].values] if lot.data.sizes.get("parameter") else []
    values = lot.data["drawn"].values[alive] if names else np.empty((int(alive.sum()), 0))
    return names, values, error[alive]


def ranks(values: np.ndarray, error: np.ndarray) -> list[float]:
    """Rank correlation of the error with each parameter."""
    return [_rank(column, error) for column in values.T]


def _rank(values: np.ndarray, error: np.ndarray) -> float:
    return float(stats.spearmanr(values, error).statistic) if np.ptp(values) > 0.0 and np.ptp(error) > 0.0 else 0.0


def rate_figure(trace: "Trace") -> Figure:
    """Estimated and true rate over time."""
    figure = blank(3.2)
    _thinned(trace).plot("rate", figure.subplots())
    return plain(figure)


def motion_figure(trace: "Trace") -> Figure | None:
    """Estimated and true displacement over the last periods; None where too few samples were kept to show a period."""
    kept = (len(trace.time) - 1) / (trace.time[-1] - trace.time[0]) if len(trace.time) > 1 else 0.0
    last = min(len(trace.time), round(_PERIODS * kept / _FASTEST))
    if kept < 8.0 * _FASTEST or last < 8:
        return None
    figure = blank(3.2)
    _rows(trace, slice(-last, None)).plot("motion", figure.subplots())
    return plain(figure)


def coefficients_figure(trace: "Trace") -> Figure:
    """Size of the relative error of every coefficient but the rate over time."""
    figure, trace = blank(3.6), _thinned(trace)
    ax = figure.subplots()
    error = 100.0 * np.abs(trace.theta_estimate / trace.theta - 1.0)
    for index, name in enumerate(trace.coefficients):
        if not name.startswith("rate"):
            ax.plot(1e3 * trace.time, np.maximum(error[:, index], 1e-12), lw=1.1, label=name)
    ax.set_yscale("log")
    ax.set_xlabel("time [ms]")
    ax.set_ylabel("relative error [%]")
    figure.legend(loc="outside lower center", frameon=False, ncols=8, fontsize="small")
    return plain(figure)


def _thinned(trace: "Trace") -> "Trace":
    """About `_POINTS` rows: more cannot be seen, but make the page heavy."""
    return _rows(trace, slice(None, None, max(1, len(trace.time) // _POINTS)))


def _rows(trace: "Trace", rows: slice) -> "Trace":
    found = {field.name: getattr(trace, field.name) for field in fields(trace) if field.name != "theta"}
    long = {name: value for name, value in found.items() if isinstance(value, np.ndarray) and value.ndim}
    return replace(trace, **{name: value[rows] for name, value in long.items()})


def _nothing(figure: Figure) -> Figure:
    figure.text(0.5, 0.5, "no die survived", ha="center")
    return figure


def plain(figure: Figure) -> Figure:
    """The figure without the upper and right edge of its boxes."""
    for ax in figure.axes:
        ax.spines[["top", "right"]].set_visible(False)
    return figure
