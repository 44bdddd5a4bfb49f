"""Pictures of the force that is missing from a model; units for people, no text of a case."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from memsgyro_jax.diagnosis.found_force import LawOverAmplitude, LawOverWaveform
from memsgyro_jax.measurement.experiments.missing_force import Binned, RateResidual, SweepForce, TimeForce

from .diagnosis_figures import BASE, FINAL, MEASURED, QUIET, colours, faint
from .figures import blank


_SURE = 0.2  # part of the points that is known best
_SHOWN = 3.0  # times the uncertainty of the worst of these: points that are less certain would hide the others
_SMALL = 0.1  # of a law: points that are less certain are not shown beside it
_NORMAL = 2.0  # mean square over noise from which a force is worth a picture


def shown_axes(found: SweepForce) -> list[int]:
    """Axes on which a sweep sees a force above its noise."""
    squares = np.mean(np.abs(found.force / found.std) ** 2, axis=0) / 2
    return [axis for axis in range(found.force.shape[1]) if squares[axis] > _NORMAL]


def sweep_figure(found: SweepForce, axis: int, motion: tuple[float, str], stiffness: str, damping: str) -> Figure:
    """The stiffness and the damping that the force on an axis amounts to, over what varied in the sweep.

    Args:
        found: the force.
        axis: of the force.
        motion: factor and unit in which a displacement is shown, e.g. (1e6, "µm").
        stiffness, damping: their units.
    """
    views = [(motion[0] * found.amplitude, f"displacement [{motion[1]}]")]
    views.append((found.frequency / (2 * np.pi), "frequency [Hz]"))
    if np.ptp(found.temperature) > 1.0:
        views.append((found.temperature - 273.15, "temperature [°C]"))
    if np.ptp(found.bias_voltage) > 0:
        views.append((found.bias_voltage, "bias voltage [V]"))
    quantities = (
        (found.stiffness[:, axis], found.stiffness_std[:, axis], f"stiffness [{stiffness}]"),
        (found.damping[:, axis], found.damping_std[:, axis], f"damping [{damping}]"),
    )
    figure = blank(4.8)
    grid = figure.subplots(2, len(views), sharex="col", sharey="row", squeeze=False)
    shades = colours(found.drive)
    for row, (values, std, label) in enumerate(quantities):
        sure = std <= _SHOWN * np.quantile(std, _SURE)
        for column, (across, name) in enumerate(views):
            ax = grid[row, column]
            ax.errorbar(across[sure], values[sure], std[sure], fmt="none", ecolor=QUIET, elinewidth=0.6, alpha=0.6)
            ax.scatter(across[sure], values[sure], s=9, c=shades[sure], lw=0, zorder=3)
            ax.axhline(0.0, color=MEASURED, lw=0.8, ls=":")
            if row == 1:
                ax.set_xlabel(name)
                ax.xaxis.set_major_locator(MaxNLocator(5))
                ax.ticklabel_format(axis="x", useOffset=False)
        grid[row, 0].set_ylabel(label)
    return faint(figure)


def time_figure(found: TimeForce, axis: int, motion: tuple[float, str], force: tuple[float, str]) -> Figure:
    """The force on an axis against its displacement, its velocity, and time; factors and units as for a sweep."""
    figure = blank(2.8)
    left, middle, right = figure.subplots(1, 3)
    middle.sharey(left)
    _with_error(left, found.against_displacement(axis), motion[0], force[0])
    _with_error(middle, found.against_velocity(axis), motion[0] * 1e-3, force[0])
    course = found.against_time()
    right.plot(course.centre, force[0] * course.mean[:, axis], color=FINAL, lw=1.1)
    left.set_xlabel(f"displacement [{motion[1]}]")
    middle.set_xlabel(f"velocity [{motion[1]}/ms]")
    right.set_xlabel("time [s]")
    left.set_ylabel(f"mean force [{force[1]}]")
    right.set_ylabel(f"rms force [{force[1]}]")
    for ax in (left, middle, right):
        ax.xaxis.set_major_locator(MaxNLocator(5))
    return faint(figure)


def found_figure(
    found: LawOverWaveform | LawOverAmplitude, factors: tuple[float, float], labels: tuple[str, str]
) -> Figure:
    """The law with its band, and what the records show beyond the base model and beyond the final one."""
    figure = blank(3.4)
    ax = figure.subplots()
    if isinstance(found, LawOverWaveform):
        series, seen = [(one.centre, one.mean, one.error) for one in (found.base, found.final)], "beside the base model"
    else:
        sure = found.std <= _SMALL * np.max(np.abs(found.law))
        series = [(found.amplitude[sure], values[sure], found.std[sure]) for values in (found.seen, found.left)]
        seen = "beside the final model without it"
    keys = ((f"missing {seen}", BASE, "x"), ("missing beside the final model", FINAL, "."))
    for (across, values, std), (label, colour, marker) in zip(series, keys, strict=True):
        bars = {"fmt": marker, "color": colour, "ecolor": QUIET, "ms": 5, "elinewidth": 0.7, "label": label}
        ax.errorbar(factors[0] * across, factors[1] * values, factors[1] * std, **bars)
    place, law, half = factors[0] * found.place, factors[1] * found.law, factors[1] * found.spread * np.abs(found.law)
    ax.plot(place, law, color=MEASURED, lw=1.4, label="the law that was found, 95 % band")
    ax.fill_between(place, law - half, law + half, color=MEASURED, alpha=0.2, lw=0)
    ax.axhline(0.0, color=QUIET, lw=0.8, ls=":")
    ax.set(xlabel=labels[0], ylabel=labels[1])
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    return faint(figure)


def residual_rate_figure(found: RateResidual, unit: str) -> Figure:
    """What is left of a rate table, in phase with displacement and velocity of the driven axis, per channel; volts are
    shown as millivolts.
    """
    size, unit = (1e3, "mV") if unit == "V" else (1.0, unit)
    views = [(found.time, 1.0, "time [s]")]
    if found.rate is not None:
        views.insert(0, (found.rate, np.degrees(1.0), "rate [deg/s]"))
    channels = found.time.mean.shape[1]
    figure = blank(2.4 * channels)
    grid = figure.subplots(channels, len(views), squeeze=False, sharex="col")
    for channel in range(channels):
        for column, (binned, factor, name) in enumerate(views):
            ax = grid[channel, column]
            for part, colour, label in ((0, FINAL, "like displacement"), (1, BASE, "like velocity")):
                mean, error = size * binned.mean[:, channel, part], size * binned.error[:, channel, part]
                ax.errorbar(
                    factor * binned.centre, mean, error, fmt=".", color=colour, ms=4, elinewidth=0.8, label=label
                )
            ax.axhline(0.0, color=MEASURED, lw=0.8, ls=":")
            if channel == channels - 1:
                ax.set_xlabel(name)
        grid[channel, 0].set_ylabel(f"channel {'xy'[channel]} [{unit}]")
    grid[0, 0].legend(frameon=False, fontsize="small")
    return faint(figure)


def _with_error(ax: Axes, binned: Binned, across: float, up: float) -> None:
    ax.errorbar(
        across * binned.centre, up * binned.mean, up * binned.error, fmt=".-", color=FINAL, ms=4, lw=0.8, elinewidth=0.8
    )
    ax.axhline(0.0, color=MEASURED, lw=0.8, ls=":")
