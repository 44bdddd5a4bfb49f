"""The page of `memsgyro identify --report`: result, verdicts, curves, fit and residual."""

import numpy as np
from matplotlib.figure import Figure

from memsgyro_jax.base.text import beside
from memsgyro_jax.couplings.figures import plot_amplitude, plot_phase, plot_residual
from memsgyro_jax.couplings.result import CouplingCoefficient, Identification
from memsgyro_jax.measurement.least_squares import gate

from .page import Page


def identification_page(result: Identification) -> Page:
    """Build the page of an identification."""
    names = ", ".join(sweep.name for sweep in result.sweeps)
    out = Page("Coupling errors from a frequency sweep", f"{names}, by {result.method}")
    out.section("Result").text(_summary(result))
    out.table(["coefficient", "value", "± 1 σ", "unit", "verdict"], _rows(result.coefficients))
    for note in result.notes:
        out.text(note)
    if result.repairs:
        out.section("What the record holds beyond two linear modes")
        out.text(
            "χ²/dof after adding each known artefact; the one that brings it to 1 explains the record "
            "(add it with --effects)."
        )
        out.table(
            ["effect", "χ²/dof with it"],
            [[name, f"{value:.3f}"] for name, value in sorted(result.repairs.items(), key=lambda i: i[1])],
        )
    out.section("Modes, read-out and effects")
    everything = {**result.modal, **result.readout, **result.effect_values}
    out.table(["parameter", "value", "± 1 σ", "unit", "meaning"], _rows(everything))
    if result.fit is not None:
        out.section("Curves and fit")
        for plot, caption in (
            (plot_amplitude, "Amplitude of both channels: broad lines measured, thin lines fitted."),
            (plot_phase, "Phase of both channels, convention e^{+iωt}."),
            (
                plot_residual,
                "What the fit leaves over, in standard deviations of the noise. Structure is missing physics.",
            ),
        ):
            figure = Figure(figsize=(9, 3.6))
            plot(result, figure.subplots())
            out.figure(figure, caption)
    return out


def _summary(result: Identification) -> str:
    if not np.isfinite(result.chi2_per_dof):
        return f"χ² unknown, because no noise was given; {result.status}."
    text = f"χ²/dof {result.chi2_per_dof:.3f} for {result.dof} degrees of freedom "
    text += f"(noise alone stays below {gate(result.dof):.3f}); {result.status}."
    if not result.explained:
        text += " The model does not explain this record: look at the residual below before using any coefficient."
    if result.effects:
        text += f" Modelled beyond two linear modes: {', '.join(result.effects)}."
    return text


def _rows(values: dict[str, CouplingCoefficient]) -> list[list[str]]:
    return [
        [
            name,
            "–" if c.value is None else beside(c.value, c.std or 0.0, 7),
            "–" if c.std is None else f"{c.std:.2g}",
            c.unit,
            c.verdict,
        ]
        for name, c in values.items()
    ]
