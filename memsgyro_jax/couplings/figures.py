"""Pictures of an identified sweep: curves with their fit, phase, and what the fit leaves over."""

import numpy as np

from memsgyro_jax.measurement.experiments import PolarNoise

from .frequency_sweep import FrequencySweep


X_COLOUR, Y_COLOUR, FIT_COLOUR = "#1f5fa8", "#c2571a", "#1d2530"


def plot_amplitude(result, ax=None):
    """Measured amplitude of both channels over frequency [Hz] and the fitted curves, one pair per sweep; returns the
    axes.
    """
    return _curves(result, _axes(ax), np.abs, "amplitude [record unit]", log=True)


def plot_phase(result, ax=None):
    """Measured and fitted phase [deg] of both channels over frequency [Hz]; returns the axes."""
    return _curves(result, _axes(ax), lambda z: _unbroken(np.degrees(np.angle(z))), "phase [deg]", log=False)


def plot_residual(result, ax=None):
    """Whitened residual of every reading over frequency [Hz]: structure here is physics that the model lacks; returns
    the axes.
    """
    ax = _axes(ax)
    parts = ("amplitude", "phase") if isinstance(result.sweeps[0].noise, PolarNoise) else ("I", "Q")
    position = 0
    for sweep in result.sweeps:
        size = 4 * len(sweep.frequency)
        rows = np.asarray(result.fit.residual[position : position + size]).reshape(-1, 2, 2)
        position += size
        for channel, colour in enumerate((X_COLOUR, Y_COLOUR)):
            for part, marker in enumerate((".", "x")):
                label = f"{'xy'[channel]} {parts[part]}, {'xy'[sweep.axis]} driven"
                shown = slice(None, None, max(1, len(rows) // 400))  # a point is a tag in the SVG
                ax.plot(
                    _hertz(sweep)[shown],
                    rows[shown, channel, part],
                    marker,
                    color=colour,
                    ms=3,
                    alpha=0.45,
                    mew=0.6,
                    label=label,
                )
    limit = max(5.0, 1.1 * float(np.abs(np.asarray(result.fit.residual)).max()))
    ax.set(xlabel="frequency [Hz]", ylabel="residual / noise", ylim=(-limit, limit))
    ax.axhspan(-2, 2, color="#8a94a0", alpha=0.15, lw=0)
    _finish(ax)
    return ax


def _curves(result, ax, shown, label: str, log: bool):
    bench = result.fit.values
    for sweep in result.sweeps:
        predicted = np.asarray(sweep.predict(bench))
        order = np.argsort(np.asarray(sweep.frequency), kind="stable")
        for channel, colour in enumerate((X_COLOUR, Y_COLOUR)):
            name: str | None = f"{'xy'[channel]}, {'xy'[sweep.axis]} driven"
            for level in np.unique(np.asarray(sweep.drive)):
                rows = order[np.asarray(sweep.drive)[order] == level]
                measured = shown(np.asarray(sweep.measured)[rows, channel])
                ax.plot(_hertz(sweep)[rows], measured, "-", lw=3, alpha=0.45, color=colour, label=name)
                ax.plot(_hertz(sweep)[rows], shown(predicted[rows, channel]), "-", lw=0.9, color=FIT_COLOUR)
                name = None  # one entry of the legend for all drive levels
    if log:
        ax.set_yscale("log")
    ax.set(xlabel="frequency [Hz]", ylabel=label)
    ax.plot([], [], "-", lw=1, color=FIT_COLOUR, label="fit")
    _finish(ax)
    return ax


def _unbroken(values: np.ndarray) -> np.ndarray:
    """A gap instead of a vertical line where a phase wraps."""
    out = np.array(values)
    out[1:][np.abs(np.diff(values)) > 300] = np.nan
    return out


def _hertz(sweep: FrequencySweep) -> np.ndarray:
    return np.asarray(sweep.frequency) / (2 * np.pi)


def _finish(ax) -> None:
    ax.ticklabel_format(axis="x", useOffset=False)
    ax.grid(alpha=0.25, lw=0.6)
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8, markerscale=2)
    ax.spines[["top", "right"]].set_visible(False)


def _axes(ax):
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(8, 4))[1]
