"""The result of an identification: coefficients with uncertainty and verdict, printable, and as JSON, xarray or
picture.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import finite, json_text
from memsgyro_jax.base.joint_normal import JointNormal
from memsgyro_jax.base.labelled import Tabular, labelled
from memsgyro_jax.base.provenance import versions
from memsgyro_jax.base.text import beside
from memsgyro_jax.base.transforms import from_vector, to_vector
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.measurement.least_squares import gate

from .frequency_sweep import FrequencySweep
from .sense_view import SeenBench
from .tree_fit import Fit


if TYPE_CHECKING:
    import xarray as xr

SCHEMA = "memsgyro-identify/1"


@dataclass(frozen=True)
class CouplingCoefficient:
    """A value with its standard deviation (`None` where none is known), unit and verdict; value `None` means that these
    sweeps cannot see it.
    """

    value: float | None
    std: float | None
    unit: str
    verdict: str

    def __str__(self) -> str:
        if self.value is None:
            return f"{'-':>16} {'':<10} {self.unit:<6} {self.verdict}"
        spread = f"± {self.std:.2g}" if self.std is not None else ""
        return f"{beside(self.value, self.std or 0.0, 6):>16} {spread:<10} {self.unit:<6} {self.verdict}"


@dataclass(frozen=True, repr=False)
class Identification(Tabular):
    """What a set of sweeps says about a gyroscope.

    Args:
        coefficients: `lambda_yx`, `lambda_xy`, `c_xy`, `k_xy`.
        modal: uncoupled `f_x` [Hz], `q_x`, `f_y`, `q_y` and the coupled resonances `pole_x` [Hz], `pole_q_x`, ... they
            are mistaken for.
        readout: `gain_ratio` and `phase_asymmetry_deg`; where the sweeps tell the gain ratio worse than to a tenth
            also the products of it and the couplings that they hold, such as `gain_ratio*lambda_yx`.
        chi2_per_dof: 1 where model and noise explain the record; with estimated noise, misfit over neighbour scatter.
        method: how it was obtained.
        effects: what was modelled beyond two linear modes.
        repairs: χ²/dof after adding each effect, where the record is not explained without.
        notes: what was assumed, one sentence each.
        fit, sweeps: the fit and the records behind it, for plots and further use.
        mass: of the mode [kg], where it was given.
    """

    coefficients: Mapping[str, CouplingCoefficient]
    modal: Mapping[str, CouplingCoefficient]
    readout: Mapping[str, CouplingCoefficient]
    chi2_per_dof: float
    dof: int
    method: str
    effects: tuple[str, ...] = ()
    repairs: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    effect_values: Mapping[str, CouplingCoefficient] = field(default_factory=dict)
    status: str = "converged"
    fit: Fit | None = None
    sweeps: tuple[FrequencySweep, ...] = ()
    mass: float | None = None
    versions: Mapping[str, str] = field(default_factory=lambda: dict(versions()))
    along: ClassVar[str] = "coefficient"

    @property
    def device(self) -> SingleMassGyro:
        """The gyro that was identified, with its coupling errors and effects, as a loop runs it; a force coupling that
        no sweep could see is left out.

        **Raises:** `InputError` without a mass, or for the ratio method, which fits no device.
        """
        fit, mass = self._fitted()
        return _gyro(fit.values, mass, self._labels())

    @property
    def uncertainty(self) -> JointNormal:
        """Numbers of `device` that were fitted, by their paths there, with their joint uncertainty; the mass is given.

        **Raises:** `InputError` as `device` does.
        """
        fit, mass = self._fitted()
        labels = self._labels()
        paths = ["kxx", "kyy", "kxy", "dxx", "dyy", "dxy"]
        paths += [f"effects.{label.replace(' ', '_')}.strength" for label in labels]
        vector = np.asarray(to_vector(fit.values, fit.spec))
        root, loose = np.asarray(fit.information.root), np.asarray(fit.information.loose)
        return JointNormal.of(
            paths, lambda at: _gyro(from_vector(at, fit.values, fit.spec), mass, labels), vector, root, loose
        )

    def _fitted(self) -> tuple[Fit, float]:
        if self.fit is None:
            raise InputError(f"A device must be fitted to be handed on, but {self.method} fits none; use `identify`.")
        if self.mass is None:
            raise InputError("A device must have a mass to be handed on, but none is known; pass `mass` to `identify`.")
        return self.fit, self.mass

    def _labels(self) -> tuple[str, ...]:
        """Effects of the device that the sweeps can see."""
        fit, mass = self._fitted()
        axes = {sweep.axis for sweep in self.sweeps}
        effects = fit.values.bench().gyro(mass).effects
        return tuple(effect.label for effect in effects if getattr(effect, "source", min(axes)) in axes)

    @property
    def explained(self) -> bool:
        """Whether χ²/dof is within 1 + 3 √(2/dof)."""
        return self.chi2_per_dof <= gate(self.dof)

    def __str__(self) -> str:
        chi2 = f"χ²/dof {self.chi2_per_dof:.3f}" if np.isfinite(self.chi2_per_dof) else "χ² unknown"
        lines = [f"Coupling errors by {self.method}: {chi2} ({self.status})"]
        for group in (self.coefficients, self.modal, self.readout, self.effect_values):
            lines += [f"  {name:<22}{value}" for name, value in group.items()]
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

    def to_xarray(self) -> "xr.Dataset":
        """Value, standard deviation and verdict over `coefficient`; over `reading` what the sweeps measured and the fit
        predicts, real and imaginary part.
        """
        every = {**self.coefficients, **self.modal, **self.readout, **self.effect_values}
        number = lambda part: [np.nan if (v := getattr(c, part)) is None else v for c in every.values()]  # noqa: E731
        variables: dict[str, tuple] = {part: ("coefficient", number(part), None) for part in ("value", "std")}
        coordinates: dict[str, Any] = {
            "coefficient": list(every),
            "unit": ("coefficient", [c.unit for c in every.values()], None),
            "verdict": ("coefficient", [c.verdict for c in every.values()], None),
            "part": ["real", "imaginary"],
            "channel": ["x", "y"],
        }
        if self.sweeps:
            held = lambda field: np.concatenate([np.asarray(getattr(s, field)) for s in self.sweeps])  # noqa: E731
            seen = {"measured": held("measured")}
            if self.fit is not None:
                seen["predicted"] = np.concatenate([np.asarray(s.predict(self.fit.values)) for s in self.sweeps])
            dimensions, about = ("reading", "channel", "part"), "phasor, in the unit of the record"
            for name, phasors in seen.items():
                parts = np.stack([phasors.real, phasors.imag], axis=-1)
                variables[name] = dimensions, parts, None, f"{name} {about}"
            names = np.concatenate([np.full(len(s.frequency), s.name) for s in self.sweeps])
            coordinates |= {
                "frequency": ("reading", held("frequency"), "rad/s"),
                "drive": ("reading", held("drive"), None),
                "sweep": ("reading", names, None),
            }
        told = self.to_dict()
        kept = {name: told[name] for name in ("schema", "chi2_per_dof", "dof", "notes", "versions")}
        return labelled(self, variables, coordinates, kept | {"method": self.method, "status": self.status})

    def plot(self, ax=None):
        """Measured points and fitted curves of every sweep, amplitude over frequency; returns the axes."""
        from . import figures as sweep_figures

        return sweep_figures.plot_amplitude(self, ax)


def _gyro(seen: SeenBench, mass: float, labels: tuple[str, ...]) -> SingleMassGyro:
    gyro = seen.bench().gyro(mass)
    return gyro.with_only(effect for effect in gyro.effects if effect.label in labels)


def _number(value: CouplingCoefficient) -> dict[str, Any]:
    return {"value": value.value, "std": value.std, "unit": value.unit}
