"""A model fitted to all records of a measurement case at once, and how well it explains each of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.joint_normal import JointNormal
from memsgyro_jax.base.labelled import Tabular
from memsgyro_jax.base.text import combination, suggestion
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.effects import InstrumentTerm
from memsgyro_jax.effects.base import Effect
from memsgyro_jax.measurement.case import AbstractRecord, Case
from memsgyro_jax.measurement.case.quality import contradictions
from memsgyro_jax.measurement.experiments import Deviation
from memsgyro_jax.measurement.experiments.missing_force import MissingForce
from memsgyro_jax.measurement.least_squares import above, gate
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.model import Model, check_effect
from memsgyro_jax.measurement.readings import Readings, model_of, readings_of

from .drives import Rows, without_rows
from .estimates import estimates_of, told_of
from .first_numbers import with_numbers_that_show
from .fit_table import fit_table
from .fitted import ParameterEstimate, RecordError, errors_figure, of_energy, within_gates
from .instrument import beside_case_of, knowledge, with_declared
from .joint_residual import Joint
from .modes import mode_estimates
from .optimum import WHOLE, Optimum, optimise
from .resolved import UNSURE, in_words, sharpened, still_apart
from .valley import in_its_valley


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

_BASE = {1: ("resonance", "quality_factor", "static_gain"), 2: ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy")}


@dataclass(frozen=True, eq=False, repr=False)
class CaseFit(Tabular):
    """A model beside a case.

    Args:
        case: what was measured.
        joint: its readings and the model's structure.
        optimum: where the fit ended.
        whitened: per record of the case (rows, channels, parts): deviation over noise, I and Q or one real part; NaN
            for rows that are not compared.
        fitted: per record, which rows were fitted (rows,).
        apart: standard deviations by which a resolution beyond the last may still move a reading;
            zero where all are resolved.
    """

    case: Case
    joint: Joint
    optimum: Optimum
    whitened: tuple[np.ndarray, ...]
    fitted: tuple[np.ndarray, ...]
    apart: float = 0.0
    along: ClassVar[str] = "reading"

    @cached_property
    def model(self) -> Model:
        """The fitted model."""
        return self.joint.at(self.optimum.vector)

    @property
    def device(self) -> SingleMassGyro | Resonator:
        """The fitted device with its effects, as a loop runs it."""
        return self.model.present.physical()

    @cached_property
    def uncertainty(self) -> JointNormal:
        """Numbers of `device` that were fitted, by their paths there, with their joint uncertainty, times `scale`."""
        joint, free = self.joint, self.optimum.free
        present = {effect.label for effect in self.model.present.effects if not effect.of_instrument}
        paths = list(_BASE[self.model.axes])
        for parameter in (joint.parameters[i] for i in free):
            label = joint.model.effects[parameter.effect].label if parameter.effect is not None else ""
            if label in present:
                paths.append(f"effects.{label.replace(' ', '_')}.{parameter.field}{parameter.index}")

        def device(moved: Array) -> SingleMassGyro | Resonator:
            model = joint.at(jnp.asarray(self.optimum.vector).at[free].set(moved))
            return model.with_only(effect for effect in model.effects if effect.label in present).physical()

        held = self.optimum.information
        root, loose = self.scale * np.asarray(held.root), np.asarray(held.loose)
        return JointNormal.of(paths, device, self.optimum.vector[free], root, loose)

    @property
    def errors(self) -> tuple[RecordError, ...]:
        """One entry per record and role, in the order of the case."""
        out = []
        for record, white, fitted in zip(self.case.records, self.whitened, self.fitted, strict=True):
            for role, rows in (("fit", fitted), ("validation", ~fitted)):
                values = white[rows]
                values = values[np.isfinite(values)]
                if values.size:
                    out.append(
                        RecordError(record.name, role, values.size, float(values @ values), record.noise_freedom)
                    )
        return tuple(out)

    def p_value(self, error: RecordError) -> float:
        """Of an entry of `errors`, the probability of so large a χ² by noise alone."""
        return above(self.beyond_uncertainty(error), error.count, error.freedom)

    def beyond_uncertainty(self, error: RecordError) -> float:
        """χ² of an entry of `errors` beyond the uncertainty of the fit, to first order: what was not fitted also
        differs by that, and the sum of squares that a refit with these readings would leave, itself included, is
        χ²-distributed with as many degrees of freedom as there are readings.
        """
        chi2 = error.chi2
        if error.role == "validation":
            root = np.linalg.qr(self.optimum.jacobian, mode="r")
            values, slopes = (
                np.concatenate(parts) for parts in zip(*self._slopes_of_validation[error.name], strict=True)
            )
            whole, target = np.concatenate([root, slopes]), np.concatenate([np.zeros(len(root)), values])
            size = np.linalg.norm(whole, axis=0)
            whole = whole / np.where(size > 0, size, 1.0)
            chi2 = float(np.sum((target - whole @ np.linalg.lstsq(whole, target)[0]) ** 2))
        return chi2

    @cached_property
    def _slopes_of_validation(self) -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
        """Whitened residual and its sensitivity to the free parameters, of what was not fitted, by record."""
        units = np.eye(self.optimum.vector.size)[self.optimum.free]
        out: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        for readings in (r for r in self.joint.readings if not r.fitted):
            values, slopes = self.joint.linearise(self.optimum.vector, units, [readings])
            rows = np.repeat(readings.record, values.size // readings.record.size)
            for record in np.unique(readings.record[readings.record >= 0]):
                mine = (rows == record) & np.isfinite(values)
                out.setdefault(self.case.records[record].name, []).append((values[mine], slopes[mine]))
        return out

    @property
    def chi2_per_dof(self) -> float:
        """Of the fitted readings, and of what was known beforehand."""
        count = sum(e.count for e in self.errors if e.role == "fit")
        count += sum(r.size for r in self.joint.fitted if r.record.max(initial=-1) < 0)
        return self.optimum.chi2 / (count - self.optimum.free.size)

    @property
    def scale(self) -> float:
        """Factor of standard deviations: what is left over the noise, where it is more than noise."""
        return float(np.sqrt(self.chi2_per_dof)) if self.chi2_per_dof > gate(self.optimum.dof) else 1.0

    @property
    def estimates(self) -> tuple[ParameterEstimate, ...]:
        """The parameters that were free."""
        return estimates_of(self.case, self.joint, self.optimum)

    @cached_property
    def modes(self) -> tuple[ParameterEstimate, ...]:
        """Resonance frequency [Hz] and quality factor of each mode of the base device."""
        return mode_estimates(self.optimum, self.model.axes)

    @property
    def leaves_noise(self) -> bool:
        """Whether noise alone explains what is left of every record that was fitted; a diagnosis tells no ± beyond."""
        return all(within_gates([e for e in self.errors if e.role == "fit"], {}))

    @property
    def null_directions(self) -> tuple[str, ...]:
        """Combinations of parameters that the records do not hold, by name."""
        names = [self.joint.parameters[i].name for i in self.optimum.free]
        return tuple(combination(row * np.sign(row[np.argmax(np.abs(row))]), names) for row in self.optimum.frozen)

    @property
    def status(self) -> str:
        """A sentence for humans."""
        text = "converged" if self.optimum.converged else f"not converged after {self.optimum.evaluations} evaluations"
        text += "".join(f"; {more}" for more in (self.resolution, of_energy(self.model.device)) if more)
        nulls = [null.removeprefix("+1.00·") for null in self.null_directions]
        return text + "".join(f"; {null} is not determined by these records" for null in nulls)

    @property
    def unsure(self) -> bool:
        """Whether predictions are resolved so badly that no reading is surely explained."""
        return self.apart > UNSURE

    @property
    def resolution(self) -> str:
        """How far predictions are resolved, in words; empty where they are."""
        return in_words(self.apart)

    def predicted(self, record: int | str) -> np.ndarray:
        """What the model predicts for a record, by number or name, in the shape and unit of its readings; NaN where not
        compared.
        """
        record = self.case.number(record) if isinstance(record, str) else record
        white, entry = self.whitened[record], self.case.records[record]
        error = white[..., 0] + 1j * white[..., 1] if white.shape[-1] == 2 else white[..., 0]
        return entry.readings - error * entry.noise_of_rows

    def deviation(self, record: int) -> Deviation:
        """How far a record of the case lies from the model, with all that a kind of measurement judges it by."""
        mine = tuple(r for r in self.joint.readings if np.any(r.record == record))
        return Deviation(self.model, self.case, record, self.whitened[record], self.predicted(record), mine)

    @property
    def deviations(self) -> tuple[tuple[AbstractRecord, Deviation], ...]:
        """Every record of which a row is compared, with its deviation."""
        compared = [k for k, white in enumerate(self.whitened) if np.isfinite(white).any()]
        return tuple((self.case.records[k], self.deviation(k)) for k in compared)

    @cached_property
    def missing_forces(self) -> tuple[MissingForce, ...]:
        """The force that the model lacks, as each compared record shows it, in their order."""
        found = (self.stepped_forces[d.number] if r.stepped else r.missing_force(d) for r, d in self.deviations)
        return tuple(one for one in found if one is not None)

    @cached_property
    def stepped_forces(self) -> dict[int, MissingForce | None]:
        """The same of records over frequency, by their number: those over time take longer."""
        return {d.number: record.missing_force(d) for record, d in self.deviations if record.stepped}

    def to_xarray(self) -> "xr.Dataset":
        """Over `reading` what was measured and predicted, over `entry` the errors, over `parameter` what was fitted."""
        return fit_table(self)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Deviation over noise of every record, fitted and not, on a logarithmic scale; returns the axes."""
        return errors_figure(self.errors, ax)

    def __str__(self) -> str:
        width = max(len(e.name) for e in self.errors)
        lines = [f"{self.case.name}: {self.status}; χ²/dof of the fitted readings {self.chi2_per_dof:.4g}"]
        lines += [
            f"  {e.name:<{width}}  {e.role:<10}  {e.rms:10.4g} × noise{'' if e.explained else '  not explained'}"
            for e in self.errors
        ]
        return "\n".join([*lines, *told_of(self)])


def fit(
    model: Model | SingleMassGyro | Resonator | None,
    case: Case,
    *,
    effects: Sequence[Effect] = (),
    fixed: Sequence[str] = (),
) -> CaseFit:
    """The maximum-likelihood fit of a model, with all its effects and further ones, to all records of a case.

    Args:
        model: a `Model`, or a device to start from; `None` takes a start from the data.
        case: from `load_case`.
        effects: beside those of the model or device; their numbers start at the values they carry.
        fixed: names of parameters that keep their value, as a fit prints them: `"1/m"`, `"stop x gap"`.

    **Raises:** `InputError` as `fit_case`.
    """
    whole = model if isinstance(model, Model) or model is None else model_of(case, model)
    if whole is not None:
        whole = beside_case_of(case, whole)
    return fit_case(case, effects, model=whole, fixed=fixed)


def fit_case(
    case: Case,
    effects: Sequence[Effect] = (),
    *,
    model: Model | None = None,
    held: bool = False,
    fixed: Sequence[str] = (),
    left_out: Rows | None = None,
) -> CaseFit:
    """The maximum-likelihood fit of the base model with `effects` to a case.

    Args:
        case: from `load_case`.
        effects: beside the base model; their strengths are free and start at the values they carry.
        model: start from this model (with its effects) instead of one found from the data.
        held: leave the model as it is and only evaluate it.
        fixed: names of parameters that keep their value.
        left_out: rows that are neither fitted nor compared.

    **Raises:** `InputError` in float32, where an effect does not suit the device, for a name that is no parameter, or
    where sweeps contradict each other in the sign or in which axis is which.
    """
    contradictions(case)
    base = model if model is not None else model_of(case, starting_device(case))
    for effect in effects:
        check_effect(effect, base.axes)
    whole = with_declared(case, base.with_effect(*effects))
    known = knowledge([effect for effect in whole.effects if isinstance(effect, InstrumentTerm)])
    joint = Joint(whole, (*without_rows(readings_of(case), left_out or {}), *known))
    vector, places = joint.start, _free_places(joint, fixed)
    if 0 < (alone := np.intersect1d(joint.base(), places)).size < places.size and not held:
        vector, _ = with_numbers_that_show(joint, optimise(joint, vector, alone, joint.fitted), places)
    longest = 0 if held else WHOLE
    optimum = optimise(joint, vector, places, joint.fitted, max_evaluations=longest)
    optimum = optimum if held else in_its_valley(case, joint, optimum)
    readings, apart = sharpened(joint.at(optimum.vector), joint.readings, optimum.residual)
    if readings is not joint.readings:
        joint = Joint(joint.at(optimum.vector), readings)
        optimum = optimise(joint, joint.start, places, joint.fitted, max_evaluations=longest)
        apart = still_apart(joint.at(optimum.vector), readings) if apart else apart
    return beside_case(case, joint, optimum, apart)


def _free_places(joint: Joint, fixed: Sequence[str]) -> np.ndarray:
    """Places of the parameters that may move."""
    names = [p.name for p in joint.parameters]
    for name in fixed:
        if name not in names:
            raise InputError(
                f'Argument `fixed` must name parameters, but "{name}" is none ({suggestion(name, names)}).'
            )
    return np.array([i for i, name in enumerate(names) if name not in fixed and i not in joint.idle], dtype=int)


def beside_case(case: Case, joint: Joint, optimum: Optimum, apart: float = 0.0) -> CaseFit:
    """The model at an optimum beside every record of the case, fitted or not."""
    white = [np.full((*r.readings.shape, 2 if np.iscomplexobj(r.readings) else 1), np.nan) for r in case.records]
    fitted = [np.zeros(r.rows, bool) for r in case.records]
    ends = np.cumsum([r.size for r in joint.fitted])
    for readings, values in zip(joint.fitted, np.split(optimum.residual, ends[:-1]), strict=True):
        put_in_place(readings, values, white, fitted)
    others = [r for r in joint.readings if not r.fitted]
    for readings, values in zip(others, joint.residual(optimum.vector, others), strict=True):
        put_in_place(readings, values, white, fitted)
    return CaseFit(case, joint, optimum, tuple(white), tuple(fitted), apart)


def put_in_place(readings: Readings, values: np.ndarray, white: list[np.ndarray], fitted: list[np.ndarray]) -> None:
    """Puts residuals of some readings where their records have them, and notes which were fitted."""
    rows = values.reshape(readings.record.size, readings.axes, -1)
    std = getattr(readings.experiment.noise, "std", None)
    if std is not None:  # a channel that was not recorded is not compared
        rows = np.where(np.isinf(np.broadcast_to(std, rows.shape[:2]))[..., None], np.nan, rows)
    for record in np.unique(readings.record[readings.record >= 0]):
        mine = readings.record == record
        white[record][readings.row[mine]] = rows[mine]
        fitted[record][readings.row[mine]] = readings.fitted
