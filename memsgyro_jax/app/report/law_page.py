"""The page of a drawn law: what an axis does against its amplitude, the forces behind it, and what they help."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from memsgyro_jax.diagnosis.backbone import Backbone
from memsgyro_jax.diagnosis.compare import as_times, judged
from memsgyro_jax.diagnosis.fit import CaseFit
from memsgyro_jax.diagnosis.law import DrawnLaw
from memsgyro_jax.measurement.calibration import per_second

from .diagnosis_figures import BASE, FINAL, QUIET, faint
from .figures import blank
from .page import Page


_SURE = 6.0  # times the middle half of the points around the curve: those beyond would hide the others


def law_page(curve: Backbone, law: DrawnLaw, before: CaseFit, after: CaseFit) -> Page:
    """Build the page of a law."""
    out = Page(f"Law drawn from {law.measured.name}", law.measured.description)
    comparison = judged(after)
    out.text(comparison.beside_size or f"{comparison.verdict.rstrip(':.')}.")
    for line in str(law).splitlines():
        out.text(line.strip())
    out.section("Frequency and damping against amplitude")
    out.figure(
        backbone_figure(curve), "Points: each row or stretch of a record by itself. Band: two standard deviations."
    )
    out.section("Forces")
    out.figure(
        force_figure(curve),
        "Force beyond the straight line through the origin that fits best. Grey: below the smallest amplitude seen, "
        "where the curve extrapolates towards rest; beyond its end nothing was seen.",
    )
    out.section("What the law helps")
    out.table(
        ["experiment", "role", "base model", "with the law"],
        [[b.name, b.role, as_times(b.rms), as_times(a.rms)] for b, a in zip(before.errors, after.errors, strict=True)],
        "Root mean square of deviation over noise; validation was never fitted.",
    )
    out.table(
        ["parameter", "value", "± 1 σ", "unit"],
        [[p.name, f"{p.value:.7g}", f"{p.std:.2g}", p.unit] for p in after.estimates],
    )
    return out


def backbone_figure(curve: Backbone) -> Figure:
    """Frequency and damping over amplitude, a colour per record."""
    figure = blank(3.6)
    left, right = figure.subplots(1, 2)
    amplitude = curve.points[:, 0]
    parts = (
        (
            left,
            curve.omega / (2 * np.pi),
            curve.omega_std / (2 * np.pi),
            curve.points[:, 1] / (2 * np.pi),
            "frequency [Hz]",
        ),
        (right, curve.damping, curve.damping_std, curve.points[:, 2], "damping per mass [1/s]"),
    )
    for ax, values, std, points, label in parts:
        away = points - np.interp(amplitude, curve.amplitude, values)
        near = np.abs(away) <= _SURE * max(float(np.subtract(*np.percentile(away, [75, 25]))), float(np.max(std)))
        for record in dict.fromkeys(curve.records):
            mine = near & (curve.records == record)
            ax.plot(amplitude[mine], points[mine], ".", ms=4, alpha=0.6, label=record)
        _curve(ax, curve.amplitude, values, std)
        ax.set_xlabel(f"amplitude [{curve.length}]")
        ax.set_ylabel(label)
        ax.ticklabel_format(axis="y", useOffset=False)
        ax.ticklabel_format(axis="x", style="sci", scilimits=(-2, 4))
    if len(set(curve.records)) > 1:
        left.legend(frameon=False, fontsize="small")
    return faint(figure)


def force_figure(curve: Backbone) -> Figure:
    """What the restoring and the dissipative force have beyond a straight line, and where it was seen."""
    figure = blank(3.4)
    parts = (
        (
            curve.displacement,
            curve.restoring,
            curve.restoring_std,
            f"displacement [{curve.length}]",
            f"restoring force beyond k·q [{curve.force}]",
        ),
        (
            curve.velocity,
            curve.dissipative,
            curve.dissipative_std,
            f"velocity [{per_second(curve.length)}]",
            f"dissipative force beyond d·v [{curve.force}]",
        ),
    )
    for ax, (place, force, std, name, label), least in zip(figure.subplots(1, 2), parts, curve.least, strict=True):
        slope = float(place @ force) / float(place @ place)
        _curve(ax, place, force - slope * place, std)
        ax.axvspan(0.0, least, color=QUIET, alpha=0.3, lw=0)
        ax.axhline(0.0, color=BASE, lw=0.8, ls=":")
        ax.set_xlabel(name)
        ax.set_ylabel(label)
        ax.ticklabel_format(axis="both", style="sci", scilimits=(-2, 4))
    return faint(figure)


def _curve(ax: Axes, place: np.ndarray, values: np.ndarray, std: np.ndarray) -> None:
    ax.plot(place, values, color=FINAL, lw=1.6)
    ax.fill_between(place, values - 2 * std, values + 2 * std, color=FINAL, alpha=0.2, lw=0)
