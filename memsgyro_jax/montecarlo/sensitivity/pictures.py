"""Bars of sensitivities, on axes that the caller may give."""

from typing import TYPE_CHECKING

import numpy as np

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.errors import InputError


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .sobol import Sobol
    from .tornado import Tornado


def sobol(result: "Sobol", output: str, ax: "Axes | None") -> "Axes":
    """Total and first-order index of every input, the largest on top."""
    ax, k = axes(ax), _place(result.outputs, output)
    order = np.argsort(np.nan_to_num(result.total[k]))
    place = np.arange(len(order))
    for values, interval, colour, offset, label in (
        (result.total[k], result.total_interval[k], "C0", 0.2, "total"),
        (result.first[k], result.first_interval[k], "C1", -0.2, "alone (first order)"),
    ):
        value, ends = np.nan_to_num(values[order]), np.nan_to_num(interval[order])
        error = np.maximum(np.abs(ends.T - value), 0.0)
        ax.barh(place + offset, value, 0.4, xerr=error, color=colour, ecolor="0.4", label=label)
    ax.set_yticks(place, [result.inputs[i] for i in order])
    ax.axvline(0.0, color="k", lw=0.8)
    ax.set_xlabel(f"share of the variance of: {output}")
    ax.legend(loc="lower right", frameon=False)
    return ax


def tornado(result: "Tornado", output: str, ax: "Axes | None") -> "Axes":
    """Change with each input below and above its design, the largest on top."""
    ax, k = axes(ax), _place(result.outputs, output)
    order = result.order(k)[::-1]
    place = np.arange(len(order))
    for values, colour, offset, sign in ((result.low, "C0", 0.2, "-"), (result.high, "C1", -0.2, "+")):
        bars = np.nan_to_num(values[k, order])
        error = np.nan_to_num(result.std[k, order])
        label = f"{sign}{result.sigmas:g} σ"
        ax.barh(place + offset, bars, 0.4, xerr=error, color=colour, ecolor="0.4", label=label)
    if np.isfinite(result.slope[k]).all():
        ax.plot(result.slope[k, order], place - 0.2, "k|", ms=10, label=f"+{result.sigmas:g} σ by the gradient")
    ax.axvline(0.0, color="k", lw=0.8)
    ax.set_yticks(place, [result.inputs[i] for i in order])
    ax.set_xlabel(f"change of {output} [{result.units[k]}] from {result.design[k]:.3g}")
    ax.legend(loc="best", frameon=False)
    return ax


def _place(names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise InputError(f"Argument `output` must be one of {', '.join(names)}, but `{name}` was given.")
    return names.index(name)
