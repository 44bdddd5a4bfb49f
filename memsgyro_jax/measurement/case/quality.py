"""How good the records of a case are: noise, peak over noise, outliers, and what each kind has to say of itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.text import aligned, spoken

from ..channel_noise import spoken_levels
from ..exchanged_axes import all_exchanged, exchanged_axes, refuse, surely_exchanged
from ..experiments import AbstractRecord
from ..experiments.base import Phasors
from ..one_place import in_one_place
from ..opposite_phase import said_of_phase
from ..phasor_fit import device_of_phasors
from ..records_apart import out_of_line
from ..sign_conventions import disagreements
from .content import Case
from .lone import lone_sentences


_CLEAR, _STANDS_OUT = 20.0, 1.5  # standard deviations, and times the middle reading, of what counts as a resonance
_APART = 1.1  # between two resonances that are not one: more than it moves with temperature, bias or amplitude
_DISAGREE = 2.0  # factor between declared and estimated noise that is worth a sentence


@dataclass(frozen=True)
class RecordQuality:
    """What the rows of one record tell of its quality.

    Args:
        record: the record.
        noise: estimated standard deviation of each real reading, in the record unit, root mean square over channels
            where they differ; `None` where rows do not tell.
        peak: largest reading.
        warnings: one sentence each, with file and line where there is one.
    """

    record: AbstractRecord
    noise: float | None
    peak: float
    warnings: tuple[str, ...]

    @property
    def ratio(self) -> float:
        """Peak over noise, the declared one where there is one, of the channel that stands clearest; else infinite."""
        levels, seen = self.record.noise_levels, self.record.channels
        if not levels[seen].all():
            return np.inf
        return float(np.max(np.max(np.abs(self.record.readings[:, seen]), axis=0) / levels[seen]))

    @property
    def noise_of_channels(self) -> dict[str, float]:
        """Estimated noise of each channel by its name, where they differ by more than chance; else empty."""
        names = ["xy"[channel] for channel in self.record.channels]
        return dict(zip(names, self.record.told_noise.levels, strict=False))


@dataclass(frozen=True, repr=False)
class CaseQuality(Shown):
    """The quality of all records; printed as a table with the warnings below it.

    Args:
        case: that was looked at.
        records: one by one.
        signs: where records contradict each other in the sign of phase or voltage, or in the device.
    """

    case: Case
    records: tuple[RecordQuality, ...]
    signs: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of all records."""
        return (*(warning for quality in self.records for warning in quality.warnings), *self.signs)

    def __str__(self) -> str:
        unit = "" if self.case.readout.unit == "1" else f" {self.case.readout.unit}"
        head = ("experiment", "peak", "noise", "declared", "peak/noise", "warnings")
        rows = [
            (
                q.record.name,
                f"{q.peak:.3g}{unit}",
                spoken_levels(q.record, unit) or ("-" if q.noise is None else f"{q.noise:.2g}{unit}"),
                f"{q.record.noise_std:.2g}{unit}" if q.record.noise_std else "-",
                f"{q.ratio:.0f}",
                str(len(q.warnings)),
            )
            for q in self.records
        ]
        return "\n".join([aligned([head, *rows]), *(f"Warning: {warning}" for warning in self.warnings)])


def assess(case: Case) -> CaseQuality:
    """The quality of each record of a case."""
    phasors = _phasors(case)
    said = _contradictions(case, phasors)
    said += _resonances(phasors) if case.channels == 1 else []
    said += said_of_phase(case.records, case) + _reference_bias(case)
    alike = {*map(id, in_one_place(case.environment, case.records))}
    told = [one for r, (_, one) in zip(case.records, phasors, strict=True) if one is not None and id(r) in alike]
    if told and np.any([np.any(one.force, axis=0) for one in told], axis=0).all():  # the answer of each axis is known
        device = device_of_phasors(told)
        said += [f"{each}." for record in case.records if device for each in record.beside_device(device, case)]
    every = zip(case.records, lone_sentences(case.records), strict=True)
    return CaseQuality(case, tuple(_assess(record, case, lone) for record, lone in every), tuple(said))


def contradictions(case: Case) -> tuple[str, ...]:
    """A sentence for each record whose phasors contradict those of the others in sign, size or resonance.

    **Raises:** `InputError` where sweeps of one place contradict each other in the sign, or in which axis is which:
    for a resonance that moved from row to row none of this is taken.
    """
    phasors, near = _phasors(case), {*map(id, in_one_place(case.environment, case.records))}
    swept = [
        (name, one)
        for record, (name, one) in zip(case.records, phasors, strict=True)
        if id(record) in near and one is not None and np.ptp(one.omega) > 0.0
    ]
    refuse(surely_exchanged(swept) or disagreements(swept))
    return tuple(_contradictions(case, phasors))


def _phasors(case: Case) -> list[tuple[str, Phasors | None]]:
    """The phasors that each record offers, by name."""
    return [(record.name, record.starting_phasors(case)) for record in case.records]


def _contradictions(case: Case, phasors: Sequence[tuple[str, Phasors | None]]) -> list[str]:
    near = {*map(id, in_one_place(case.environment, case.records))}
    exchanged = exchanged_axes(phasors) if case.channels == 2 else {}
    kept = [id(record) in near and one[0] not in exchanged for record, one in zip(case.records, phasors, strict=True)]
    alike = [one for one, keeps in zip(phasors, kept, strict=True) if keeps]
    others = [(name, one) for name, one in phasors if name not in exchanged]
    found = [*exchanged.values(), *disagreements(others), *out_of_line(alike)]
    found += [said] if case.channels == 2 and (said := all_exchanged(phasors)) else []
    return [sentence if sentence.endswith("?") else f"{sentence}." for sentence in found]


def _resonances(records: Sequence[tuple[str, Phasors | None]]) -> list[str]:
    """A sentence where sweeps show resonances that no device of one axis has together."""
    found = []
    for name, one in records:
        size = np.zeros(0) if one is None else np.abs(one.motion[:, 0])
        if one is None or not size.any():
            continue
        top, omega = int(np.argmax(size)), one.omega
        clear = size[top] > max(_CLEAR / one.weight[top], _STANDS_OUT * np.median(size))
        if clear and omega.min() < omega[top] < omega.max():
            found.append((float(omega[top]) / (2 * np.pi), name))
    (low, first), (high, other) = min(found, default=(1.0, "")), max(found, default=(1.0, ""))
    if high <= _APART * low:
        return []
    where = f"`{first}` resonates at {spoken(low, 'Hz')} and `{other}` at {spoken(high, 'Hz')}"
    return [f"{where}, but a device of one axis has one resonance; are these records of one device?"]


def _reference_bias(case: Case) -> list[str]:
    """A sentence where the numbers of the device are said to hold without a bias, but rows have several others."""
    biases = [np.ravel(record.bias_voltage) for record in case.records if hasattr(record, "bias_voltage")]
    volts = np.concatenate(biases) if biases else np.zeros(1)
    if case.environment.bias_voltage or not volts.all() or not np.ptp(volts):
        return []
    nearest = volts[np.argmin(np.abs(volts))]
    remedy = f'bias_voltage = {{ value = {nearest:g}, unit = "V" }}` in `[environment]` makes it one that was recorded'
    said = (
        "The numbers of the device hold at a bias of 0 V, where nothing was recorded: no gain that goes with the bias"
    )
    return [f"{said} can be found beside it; `{remedy}."]


def _assess(record: AbstractRecord, case: Case, lone: Sequence[str]) -> RecordQuality:
    noise, warnings = record.estimated_noise(), [*lone, *record.warnings(case), *_declared_wrong(record, case)]
    for channel in set(range(record.readings.shape[1])) - set(record.channels):
        warnings.append(
            f"{record.file}: channel {'xy'[channel]} was not recorded; what shows there alone this record cannot tell."
        )
    for name in record.undeclared:
        warnings.append(f"{record.file}: nothing is made of column `{name}`; list it in `carried` if that is meant.")
    return RecordQuality(record, noise, float(np.max(np.abs(record.readings))), tuple(warnings))


def _declared_wrong(record: AbstractRecord, case: Case) -> list[str]:
    """A sentence where the declared noise is not that which the rows tell, of all channels or of one."""
    noise, unit = record.estimated_noise(), case.readout.unit
    if not record.noise_std or not noise:
        return []
    names, told = ["xy"[channel] for channel in record.channels], record.told_noise.levels
    each = record.noise_levels[record.channels] if told else np.array([record.noise_std])
    ratio = np.array(told or (noise,)) / each
    if np.all((ratio > 1 / _DISAGREE) & (ratio < _DISAGREE)):
        return []
    said = f"{noise:.2g} {unit}"
    remedy = ""
    if told:
        said = " and ".join(f"{one:.2g} {unit} in channel {name}" for name, one in zip(names, told, strict=True))
    if told and record.noise_rows is None:
        columns = " and ".join(f"`{case.words.signals[0][channel]}_std`" for channel in record.channels)
        remedy = f"; columns {columns} would declare each, or leave `noise_std` out"
    off = f"the declared noise of {record.noise_std:.2g} {unit} is not that of the rows, about {said}"
    return [f"{record.file}: {off}; estimates and their uncertainty follow the declared one{remedy}."]
