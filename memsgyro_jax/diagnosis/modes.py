"""Resonances and quality factors of a fitted device, and what the records leave unsure of them."""

from dataclasses import replace

import numpy as np

from .fitted import ParameterEstimate
from .optimum import Optimum


_MODES = {1: ("",), 2: ("lower mode ", "upper mode ")}
_STEP = 1e-3  # of a standard deviation, for differences
_PAIRS = {1: 1, 2: 3}
_SEEN = 2.0  # standard deviations from none, from which on a damping tells a quality factor
_SURELY = 1.645  # the same, beyond which a number lies with 5 %


def mode_estimates(optimum: Optimum, axes: int) -> tuple[ParameterEstimate, ...]:
    """Frequency [Hz] and quality factor of each undamped mode of the base device that a fit found, to first order in
    the joint uncertainty of its numbers; the standard deviation is infinite where the records do not hold one of them.
    Of a damping that is not told from none the quality factor has no standard deviation but a bound.
    """
    held, size = optimum.information, 2 * _PAIRS[axes]
    values = _modes(optimum.vector, axes)  # of which the losses, unlike quality factors, are straight in the dampings
    variance = np.zeros_like(values)
    moved = np.zeros_like(optimum.vector)
    for column in np.asarray(held.root).T:
        moved[optimum.free] = _STEP * column
        with np.errstate(invalid="ignore"):  # of a spring that pushes
            step = _modes(optimum.vector + moved, axes) - _modes(optimum.vector - moved, axes)
        variance += (step / (2 * _STEP)) ** 2
    if np.any(np.asarray(held.loose) & (optimum.free < size)):
        variance[:] = np.inf
    std = np.sqrt(variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        std[axes:] /= values[axes:] ** 2
        values[axes:] = 1.0 / values[axes:]
    frequencies = ["lower undamped frequency", "upper undamped frequency"] if axes == 2 else ["resonance frequency"]
    names = [*frequencies, *(f"{mode}quality factor" for mode in _MODES[axes])]
    units = ["Hz"] * axes + ["1"] * axes
    found = [
        ParameterEstimate(name, float(value), float(one), unit)
        for name, value, one, unit in zip(names, values, std, units, strict=True)
    ]
    return (*found[:axes], *map(_told_of_quality, found[axes:]))


def coupling_estimates(optimum: Optimum, axes: int) -> tuple[ParameterEstimate, ...]:
    """What couples two axes, over the mass: a stiffness [rad²/s²] and a damping [1/s]; nothing of one axis."""
    if axes < 2:
        return ()
    std = dict(zip(optimum.free.tolist(), optimum.std.tolist(), strict=True))
    return tuple(
        ParameterEstimate(name, float(optimum.vector[place]), std.get(place, np.nan), unit)
        for name, place, unit in (("kxy/m", 2, "rad²/s²"), ("dxy/m", 5, "1/s"))
    )


def _told_of_quality(mode: ParameterEstimate) -> ParameterEstimate:
    """A quality factor whose damping the records do not tell from none, as "above" what that can be at most."""
    if not (np.isfinite(mode.std) and mode.value) or mode.value > _SEEN * mode.std:
        return mode
    damping, std = 1.0 / mode.value, mode.std / mode.value**2
    most = damping + _SURELY * std
    return replace(mode, std=np.inf, above=1.0 / most if most > 0.0 else None)


def _modes(vector: np.ndarray, axes: int) -> np.ndarray:
    """Frequencies [Hz], then losses, one over each quality factor."""
    stiffness, damping = (_matrix(part) for part in np.split(vector[: 2 * _PAIRS[axes]], 2))
    squares, shapes = np.linalg.eigh(stiffness)
    omega = np.sqrt(np.maximum(squares, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        losses = np.einsum("ai,ab,bi->i", shapes, damping, shapes) / omega
    return np.concatenate([omega / (2 * np.pi), losses])


def _matrix(entries: np.ndarray) -> np.ndarray:
    if entries.size == 1:
        return entries[:, None]
    xx, yy, xy = entries
    return np.array([[xx, xy], [xy, yy]])
