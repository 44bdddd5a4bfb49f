"""The result of an identification: coefficients with uncertainty and verdict, printable, and as JSON, xarray or
picture.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.files import finite, json_text
from memsgyro_jax.base.provenance import versions
from memsgyro_jax.measurement.least_squares import gate

from .frequency_sweep import FrequencySweep
from .tree_fit import Fit


SCHEMA = "memsgyro-identify/1"


@dataclass(frozen=True)
class Coefficient:
    """A value with its standard deviation (`None` where none is known), unit and verdict; value `None` means that these
    sweeps cannot see it.
    """

    value: float | None
    std: float | None
    unit: str
    verdict: str

    def __str__(self) -> str:
        if self.value is None:
            return f"{'-':>25}  {self.verdict}"
        spread = f"± {self.std:.2g}" if self.std is not None else ""
        return f"{self.value:>14.6g} {spread:<10} {self.unit:<6} {self.verdict}"


@dataclass(frozen=True, repr=False)
class Identification(Shown):
    """What a set of sweeps says about a gyroscope.

    Args:
        coefficients: `lambda_yx`, `lambda_xy`, `c_xy`, `k_xy`.
        modal: uncoupled `f_x` [Hz], `q_x`, `f_y`, `q_y` and the coupled resonances `pole_x` [Hz], `pole_q_x`, ... they
            are mistaken for.
        readout: `gain_ratio` and `phase_asymmetry_deg`.
        chi2_per_dof: 1 where model and noise explain the record; with estimated noise, misfit over neighbour scatter.
        method: how it was obtained.
        effects: what was modelled beyond two linear modes.
        repairs: χ²/dof after adding each effect, where the record is not explained without.
        notes: what was assumed, one sentence each.
        fit, sweeps: the fit and the records behind it, for plots and further use.
    """

    coefficients: Mapping[str, Coefficient]
    modal: Mapping[str, Coefficient]
    readout: Mapping[str, Coefficient]
    chi2_per_dof: float
    dof: int
    method: str
    effects: tuple[str, ...] = ()
    repairs: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    effect_values: Mapping[str, Coefficient] = field(default_factory=dict)
    status: str = "converged"
    fit: Fit | None = None
    sweeps: tuple[FrequencySweep, ...] = ()
    versions: Mapping[str, str] = field(default_factory=lambda: dict(versions()))

    @property
    def explained(self) -> bool:
        """Whether χ²/dof is within 1 + 3 √(2/dof)."""
        return self.chi2_per_dof <= gate(self.dof)

    def __str__(self) -> str:
        chi2 = f"χ²/dof {self.chi2_per_dof:.3f}" if np.isfinite(self.chi2_per_dof) else "χ² unknown"
        lines = [f"Coupling errors by {self.method}: {chi2} ({self.status})"]
        for group in (self.coefficients, self.modal, self.readout, self.effect_values):
            lines += [f"  {name:<20}{value}" for name, value in group.items()]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """The machine-readable result, schema `memsgyro-identify/1`."""
        entries = {
            "schema": SCHEMA,
            "method": self.method,
            "status": self.status,
            "coefficients": {
                name: {**_number(value), "verdict": value.verdict} for name, value in self.coefficients.items()
            },
            "modal": {name: _number(value) for name, value in self.modal.items()},
            "gain_ratio": self.readout["gain_ratio"].value,
            "gain_ratio_std": self.readout["gain_ratio"].std,
            "phase_asymmetry_deg": self.readout["phase_asymmetry_deg"].value,
            "phase_asymmetry_deg_std": self.readout["phase_asymmetry_deg"].std,
            "chi2_per_dof": self.chi2_per_dof,
            "dof": self.dof,
            "effects": {name: _number(value) for name, value in self.effect_values.items()},
            "repairs": dict(self.repairs),
            "notes": list(self.notes),
            "versions": dict(self.versions),
        }
        return finite(entries)

    def to_json(self) -> str:
        """`to_dict` as text; no NaN or infinity in it."""
        return json_text(self.to_dict())

    def to_xarray(self):
        """Value and standard deviation of every coefficient, labelled, with verdicts and units in the attributes."""
        import xarray as xr

        every = {**self.coefficients, **self.modal, **self.readout, **self.effect_values}
        table = [[np.nan if v is None else v for v in (c.value, c.std)] for c in every.values()]
        return xr.DataArray(
            table,
            dims=("coefficient", "statistic"),
            coords={
                "coefficient": list(every),
                "statistic": ["value", "std"],
                "unit": ("coefficient", [c.unit for c in every.values()]),
                "verdict": ("coefficient", [c.verdict for c in every.values()]),
            },
            name="identification",
            attrs={"method": self.method, "chi2_per_dof": self.chi2_per_dof, "schema": SCHEMA},
        )

    def plot(self, ax=None):
        """Measured points and fitted curves of every sweep, amplitude over frequency; returns the axes."""
        from . import figures as sweep_figures

        return sweep_figures.plot_amplitude(self, ax)


def _number(value: Coefficient) -> dict[str, Any]:
    return {"value": value.value, "std": value.std, "unit": value.unit}
