"""Pictures of a run, on axes that the caller may give."""

from typing import TYPE_CHECKING

import numpy as np

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.errors import InputError


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .trace import Trace


def trace(result: "Trace", quantity: str, ax: "Axes | None") -> "Axes":
    """Estimate beside truth over time for `rate`, `motion`, `offset` or a coefficient."""
    names = ("rate", "motion", "offset", *(n for n in result.coefficients if n != "rate"))
    if quantity not in names:
        raise InputError(f"Argument `quantity` must be one of {', '.join(names)}, but `{quantity}` was given.")
    ax, time = axes(ax), result.time * 1e3
    if quantity == "rate":
        estimate, spread = np.degrees(result.rate_unfiltered), np.degrees(result.rate_std)
        ax.fill_between(time, estimate - spread, estimate + spread, color="C0", alpha=0.25, lw=0, label="± claimed std")
        label = "estimate before the filter" if result.filtered else "estimate"
        ax.plot(time, estimate, color="C0", lw=1.0, alpha=0.4 if result.filtered else 1.0, label=label)
        if result.filtered:
            ax.plot(time, np.degrees(result.rate_estimate), color="C1", lw=1.4, label="output")
        ax.plot(time, np.degrees(result.rate_true), color="k", lw=1.2, ls="--", label="true")
        ax.set_ylabel("rate [deg/s]")
        ax.set_ylim(*_limits(np.degrees(np.concatenate([result.rate_true, result.rate_estimate[len(time) // 4 :]]))))
    elif quantity in ("motion", "offset"):
        factor, unit = (1e6, "displacement [µm]") if quantity == "motion" else (1e3, "offset [mV]")
        for axis, name in enumerate("xy"):
            ax.plot(
                time, factor * getattr(result, f"{quantity}_estimate")[:, axis], color=f"C{axis}", lw=1.0, label=name
            )
            ax.plot(time, factor * getattr(result, quantity)[:, axis], color="k", lw=0.8, ls="--")
        ax.set_ylabel(unit)
    else:
        index = result.coefficients.index(quantity)
        ax.plot(time, result.theta_estimate[:, index] / result.theta[index] - 1.0, color="C0", lw=1.0, label="estimate")
        ax.axhline(0.0, color="k", lw=1.0, ls="--")
        ax.set_ylabel(f"relative error of {quantity} [1]")
    ax.set_xlabel("time [ms]")
    ax.legend(loc="best", frameon=False)
    return ax


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Limits that show the settled part, whatever the first samples did."""
    low, high = np.nanpercentile(values, [1.0, 99.0])
    margin = 0.3 * (high - low) + 1e-9
    return float(low - margin), float(high + margin)
