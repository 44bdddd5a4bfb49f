"""Pictures of the dies of a sweep, on axes that the caller may give."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.axes import axes


if TYPE_CHECKING:
    from matplotlib.axes import Axes


def error_histogram(error: Float[np.ndarray, " dies"], bound: float | None = None, ax: "Axes | None" = None) -> "Axes":
    """Histogram of the rate error at the end, beside the normal curve of the information bound; both in rad/s."""
    ax = axes(ax)
    error = np.degrees(error[np.isfinite(error)])
    ax.hist(
        error, bins=max(10, round(np.sqrt(error.size))), density=True, color="C0", alpha=0.6, label=f"{error.size} dies"
    )
    if bound is not None:
        bound = np.degrees(bound)
        at = np.linspace(*ax.get_xlim(), 300)
        curve = np.exp(-0.5 * (at / bound) ** 2) / (bound * np.sqrt(2.0 * np.pi))
        ax.plot(at, curve, color="k", lw=1.2, label=f"information bound {bound:.3g} deg/s")
    ax.set_xlabel("rate error at the end [deg/s]")
    ax.set_ylabel("density [s/deg]")
    ax.legend(loc="best", frameon=False)
    return ax
