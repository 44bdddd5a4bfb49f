"""Picture of a tuning, on axes that the caller may give."""

from typing import TYPE_CHECKING

import numpy as np

from memsgyro_jax.base.axes import axes


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .result import Tuning


def tuning(result: "Tuning", ax: "Axes | None") -> "Axes":
    """Share of the unseen dies whose root mean square error is below a value, before and after."""
    ax = axes(ax)
    for name, lot, colour in zip(("before", "after"), result.lots, ("0.5", "C0"), strict=True):
        error = np.sort(np.degrees(lot.data["rate_error_rms"].values))
        share = 100.0 * np.arange(1, error.size + 1) / error.size  # lost dies sort last, as NaN, and leave the top open
        ax.step(error, share, where="post", color=colour, lw=1.5, label=name)
    ax.set(
        xlabel="rms rate error of the settled part [deg/s]", ylabel="dies below [%]", xlim=(0.0, None), ylim=(0, 100)
    )
    ax.legend(loc="lower right", frameon=False)
    return ax
