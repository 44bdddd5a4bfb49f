"""A motion design as text, as a picture and as a labelled table."""

from typing import TYPE_CHECKING

import numpy as np

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.units import rate_to_dps
from memsgyro_jax.device.gyro import mode_frequencies

from .errors import ModelErrors


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from .design import MotionDesign


def cases(errors: ModelErrors) -> dict[str, ModelErrors]:
    """The errors one after the other, each beside those before: what a table of designs is read by."""
    cross, gain, delay = errors.cross_damping, errors.force_gain, errors.delay
    steps = ((0.0, 0.0, 0.0), (cross, 0.0, 0.0), (cross, gain, 0.0), (cross, gain, delay))
    made = {str(ModelErrors(*step)): ModelErrors(*step) for step in steps}
    return {"right model" if name == "none" else name: error for name, error in made.items()}


def _designs(design: "MotionDesign") -> dict[str, "MotionDesign"]:
    return {"this design": design} | ({} if design.nominal is None else {"nominal design": design.nominal})


def text(design: "MotionDesign") -> str:
    """The tones, and the bound of the rate under each error of the model."""
    made = design.setting
    bound = rate_to_dps(design.bound())
    lines = [
        (
            f"Designed motion, {len(design.frequency)} tones within {1e6 * made.displacement:.3g} µm: bound of the "
            f"rate {bound:.3g} deg/s after {made.duration:g} s ({design.agreeing} of {design.starts} starts agree)"
        )
    ]
    for frequency, amplitude in zip(design.frequency, design.amplitude, strict=True):
        parts = (
            f"{n} {1e6 * abs(a):.4f} µm at {np.degrees(np.angle(a)):4.0f}°"
            for n, a in zip("xy", amplitude, strict=True)
        )
        lines.append(f"  {frequency:8.1f} Hz  " + ", ".join(parts))
    peak = np.sum(np.abs(design.force), axis=0)
    lines.append(f"  force up to {1e6 * peak[0]:.3g} and {1e6 * peak[1]:.3g} µN")
    others = _designs(design)
    rows = cases(design.errors if np.any(design.errors.std(made.gyro)) else ModelErrors())
    width = max(25, *map(len, rows))
    lines.append(f"  {'bound of the rate [deg/s]':<{width}}" + "".join(f"  {name:>14}" for name in others))
    for name, case in rows.items():
        figures = (f"  {rate_to_dps(other.bound(case)):14.4g}" for other in others.values())
        lines.append(f"  {name:<{width}}" + "".join(figures))
    return "\n".join(lines)


def draw(design: "MotionDesign", ax: "Axes | None") -> "Axes":
    """Amplitudes of both axes, tone by tone; below, how far each tone is from the nearer mode."""
    ax = axes(ax)
    modes, places, labels = mode_frequencies(design.setting.gyro), np.arange(len(design.frequency)), []
    for axis, name in enumerate("xy"):
        size = 1e6 * np.abs(design.amplitude[:, axis])
        ax.bar(places + 0.2 * (2 * axis - 1), size, 0.38, color=f"C{axis}", label=name)
    for frequency in design.frequency:
        near = int(np.argmin(np.abs(modes - frequency)))
        labels.append(f"{frequency:.1f} Hz\nmode {near + 1} {frequency - modes[near]:+.1f} Hz")
    ax.set_xticks(places, labels, fontsize="small")
    ax.set_ylim(0.0, 1.05e6 * design.setting.displacement)
    ax.set_ylabel("displacement [µm]")
    ax.legend(loc="best", frameon=False)
    return ax


def dataset(design: "MotionDesign") -> "xr.Dataset":
    """Tones over (tone, axis), bound of the rate over (design, model_error)."""
    import xarray as xr

    rows, others = cases(ModelErrors() if design.nominal is None else design.errors), _designs(design)
    bounds = [[other.bound(case) for case in rows.values()] for other in others.values()]
    variables = {
        "frequency": ("tone", design.frequency, {"units": "Hz"}),
        "displacement": (("tone", "axis"), np.abs(design.amplitude), {"units": "m"}),
        "phase": (("tone", "axis"), np.angle(design.amplitude), {"units": "rad"}),
        "force": (("tone", "axis"), np.abs(design.force), {"units": "N"}),
        "force_phase": (("tone", "axis"), np.angle(design.force), {"units": "rad"}),
        "bound": (("design", "model_error"), bounds, {"units": "rad/s"}),
    }
    made = design.setting
    settings = {"sample_rate": made.sample_rate, "duration": made.duration, "known": ", ".join(made.known)}
    return xr.Dataset(variables, {"axis": ["x", "y"], "design": list(others), "model_error": list(rows)}, settings)
