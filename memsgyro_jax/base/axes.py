"""Axes that the caller may give."""

from typing import TYPE_CHECKING

import numpy as np


if TYPE_CHECKING:
    from matplotlib.axes import Axes


def axes(ax: "Axes | None") -> "Axes":
    """`ax`, or new axes of a comfortable size."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(7.0, 3.6), layout="constrained")[1]


def settled_limits(values: np.ndarray) -> tuple[float, float]:
    """Limits that show the settled part, whatever the first samples did."""
    low, high = np.nanpercentile(values, [1.0, 99.0])
    margin = 0.3 * (high - low) + 1e-9
    return float(low - margin), float(high + margin)
