"""A model beside measurements: how far apart, and where."""

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import finite, json_text
from memsgyro_jax.base.provenance import versions
from memsgyro_jax.base.runtime import make_room
from memsgyro_jax.base.text import aligned
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.measurement.case import AbstractRecord, Case
from memsgyro_jax.measurement.experiments.deviation import Series
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import model_of

from .drives import Rows
from .estimates import told_of, with_std_if_held
from .fit import CaseFit, fit_case
from .fit_uncertainty import beside_uncertainty
from .fitted import RecordError
from .instrument import beside_case_of
from .misfit import LEVEL, Check, check_all
from .offset_left import with_offset_left
from .outlying import as_left_out, few_outlying, of_rows, outlying


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import DataTree

SCHEMA = "memsgyro-comparison/1"
STANDS_OUT = 1.3  # times the variance of the whole record from which a part is named
_SMALLEST = 1e-12  # p-values below are said to be below


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Shown):
    """A model beside a case, with every test of where it fails.

    Args:
        fit: the model, fitted or held, and its residuals.
        series: the residual of each record as it was tested.
        checks: every test made.
        level: probability that a right model fails any of them.
        fitted: whether the model was fitted to the case, or only evaluated.
        left_out: rows of records, by number, that stand alone and without which the model explains the case.
        versions: of what computed it.
    """

    fit: CaseFit
    series: tuple[Series, ...]
    checks: tuple[Check, ...]
    level: float
    fitted: bool
    left_out: Rows = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=lambda: dict(versions()))

    @property
    def case(self) -> Case:
        """What was measured."""
        return self.fit.case

    @property
    def model(self) -> Model:
        """What was compared."""
        return self.fit.model

    @property
    def errors(self) -> tuple[RecordError, ...]:
        """Deviation over noise per record and role."""
        return self.fit.errors

    @property
    def explained(self) -> bool:
        """Whether no test fails, of predictions that are resolved: noise alone explains the difference."""
        return not (self.fit.unsure or any(check.failed for check in self.checks))

    @property
    def status(self) -> str:
        """A sentence: how the fit ended."""
        return self.fit.status if self.fitted else "the model was taken as it is"

    @cached_property
    def failures(self) -> tuple[str, ...]:
        """Where the model fails, one sentence per record and channel, the worst first."""
        found = []
        for series in self.series:
            for channel in series.channels:
                mine = [c for c in self.checks if c.record == series.record and c.channel == channel]
                if any(c.failed for c in mine):
                    found.append((-mine[0].statistic, _sentence(self.case.record(series.record), series, mine)))
        return tuple(text for _, text in sorted(found))

    @property
    def alone(self) -> str:
        """Rows that stand alone in what a model leaves that fails, in words; empty where none do."""
        rows = outlying(self.fit) if self.failures else {}
        return f"standing alone, as outlying rows do: {of_rows(self.case, rows)}" if rows else ""

    def __str__(self) -> str:
        head = ("experiment", "role", "readings", "rms/noise", "noise alone below")
        rows = [(e.name, e.role, str(e.count), as_times(e.rms), f"{np.sqrt(e.gate):.3g}") for e in self.errors]
        lines = [f"{self.case.name}: {self.status}", aligned([head, *rows]), self.verdict]
        lines += [f"  {text}" for text in self.failures]
        if self.alone:
            lines.append(f"  {self.alone}")
        if self.fitted:
            lines += ["Fitted:", *told_of(self.fit)]
        return "\n".join(lines)

    @property
    def verdict(self) -> str:
        """One sentence."""
        failed = sum(c.failed for c in self.checks)
        alarm = f"with probability {self.level:g} noise alone fails any"
        alone = as_left_out(self.case, self.left_out)
        if failed:
            nor = f", not even without {alone}" if alone else ""
            return f"The model does not explain the records{nor}: {failed} of {len(self.checks)} tests fail ({alarm}):"
        if self.fit.unsure:
            return (
                f"Whether the model explains the records is not sure: none of {len(self.checks)} tests fails, but "
                f"{self.fit.resolution}."
            )
        but = f", but for {alone}" if alone else ""
        return f"The model explains the records{but}: none of {len(self.checks)} tests fails ({alarm})."

    @property
    def beside_size(self) -> str:
        """What the tests say where every record is left at the size of its noise, on which a diagnosis rests; empty
        where they agree.
        """
        failed = sum(check.failed for check in self.checks)
        if not (failed and all(error.explained for error in self.errors)):
            return ""
        return (
            f"What is left has the size of the noise, on which the verdict rests, but is not noise alone: {failed} of "
            f"{len(self.checks)} finer tests fail (with probability {self.level:g} noise alone fails any)."
        )

    def without(self, records: Container[str]) -> "Comparison":
        """The same without the tests of some records, of which something else was said."""
        return replace(self, checks=tuple(check for check in self.checks if check.record not in records))

    def to_dict(self) -> dict[str, Any]:
        """The machine-readable result, schema `memsgyro-comparison/1`; numbers that are not finite become null."""
        entries = {
            "schema": SCHEMA,
            "case": self.case.name,
            "status": self.status,
            "explained": self.explained,
            "verdict": self.verdict,
            "level": self.level,
            "chi2_per_dof": self.fit.chi2_per_dof if self.fitted else None,
            "experiments": [e.to_dict() for e in self.errors],
            "failures": list(self.failures),
            "outlying": {self.case.records[number].name: list(rows) for number, rows in self.left_out.items()},
            "tests": [_check_dict(c) for c in self.checks],
            "parameters": [p.to_dict() for p in (with_std_if_held(self.fit) if self.fitted else ())],
            "effects": [e.label for e in self.model.present.effects],
            "versions": dict(self.versions),
        }
        return finite(entries)

    def to_json(self) -> str:
        """`to_dict` as text."""
        return json_text(self.to_dict())

    def to_xarray(self) -> "DataTree":
        """One node per record: measured, predicted and whitened, over row, channel and part, with units."""
        import xarray as xr

        nodes = {}
        for number, record in enumerate(self.case.records):
            # A slash separates nodes of a tree; the record's own name stands in the attributes.
            nodes[f"{record.name.replace('/', '∕')}"] = _dataset(self.fit, number, record)
        tree = xr.DataTree.from_dict(nodes)
        tree.attrs.update(schema=SCHEMA, case=self.case.name, status=self.status, versions=json_text(self.versions))
        return tree

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Deviation over noise of every record, fitted and not, on a logarithmic scale; returns the axes."""
        return self.fit.plot(ax)


def compare(
    model: Model | SingleMassGyro | Resonator | NormalisedDevice | None,
    case: Case,
    *,
    fitted: bool = True,
    level: float = LEVEL,
) -> Comparison:
    """Where a model fails to explain a measurement case.

    Args:
        model: with its effects, or a device, which gets the declared read-out of the case; `None` takes the base model
            and finds its start in the records.
        case: from `load_case`.
        fitted: fit it to the records first, starting from its values; `False` takes it as it is. The constant voltage
            of waveforms, of which a device says nothing, is then what a device leaves of them in the mean.
        level: probability that a right model fails any of the tests; 0 < level < 1.

    **Raises:** `InputError` if the model does not suit the case, if `level` is out of range, or in float32.
    """
    make_room()
    if not 0.0 < level < 1.0:
        raise InputError(f"Argument `level` must lie between 0 and 1, but is {level:g}.")
    if model is None and not fitted:
        raise InputError("Argument `model` must be given where `fitted` is false, but is None; pass a model or fit it.")
    whole = None if model is None else model if isinstance(model, Model) else model_of(case, model)
    if whole is not None and whole.axes != case.channels:
        raise InputError(
            f"Argument `model` must have as many axes as the case {case.name} has channels, {case.channels}, "
            f"but has {whole.axes}."
        )
    if whole is not None:
        whole = beside_case_of(case, whole)
    tells_offset = any(record.offset is not None for record in case.records)
    if whole is not None and tells_offset and not (fitted or isinstance(model, Model)):
        whole = with_offset_left(fit_case(case, model=whole, held=True))
    result = judged(fit_case(case, model=whole, held=not fitted), level=level, fitted=fitted)
    return beside_outlying(result, lambda rows: fit_case(case, model=whole, held=not fitted, left_out=rows))


def beside_outlying(result: Comparison, again: Callable[[Rows], CaseFit]) -> Comparison:
    """The same without the few rows that stand alone, where each record then has the size of its noise; else as it is.

    Args:
        result: of all rows.
        again: the fit without some.
    """
    for rows in () if result.explained else few_outlying(result.fit):
        fewer = judged(again(rows), level=result.level, fitted=result.fitted)
        if fewer.explained or fewer.beside_size:
            return replace(fewer, left_out=rows)
    return result


def judged(fit: CaseFit, *, level: float = LEVEL, fitted: bool = True) -> Comparison:
    """Every test on the residuals of a fit; records that it has not seen it may also miss by its uncertainty."""

    def made(left: CaseFit) -> Comparison:
        series = tuple(r.series(d).compared for r, d in left.deviations)
        return Comparison(fit, series, check_all(series, level), level, fitted)

    raw = made(fit)
    allowed = raw if raw.explained or not fitted else made(beside_uncertainty(fit))
    return allowed if allowed.explained else raw


def as_times(ratio: float) -> str:
    """A ratio to the noise, with digits enough and no power of ten below a million."""
    if ratio < 99.95:
        return f"{ratio:#.3g}"
    return f"{ratio:.0f}" if ratio < 1e6 else f"{ratio:.3g}"


def _check_dict(check: Check) -> dict[str, Any]:
    return {
        "experiment": check.record,
        "channel": check.channel,
        "test": check.kind,
        "of": check.heading or None,
        "at": check.label or None,
        "statistic": check.statistic,
        "readings": check.count,
        "p_value": check.p_value,
        "threshold": check.threshold,
        "failed": check.failed,
    }


def _sentence(record: AbstractRecord, series: Series, checks: list[Check]) -> str:
    """What fails in one channel of a record; the first check is the variance of the whole."""
    channel = f", channel {checks[0].channel}" if len(series.channels) > 1 else ""
    failed = [c for c in checks if c.failed]
    variances = [c for c in failed if c.kind == "variance"]
    said = []
    if variances:
        place, worst = _place(record, series, checks[0], variances)
        said.append(f"{as_times(worst.statistic)} × noise variance")
    else:
        place = ""
    said += [f"residual not white ({_p(c.p_value)})" for c in failed if c.kind == "whiteness"]
    depends = [c for c in failed if c.kind == "dependence"]
    if depends:
        names = ", ".join(dict.fromkeys(c.heading for c in sorted(depends, key=lambda c: c.p_value)))
        said.append(f"depends on {names} ({_p(max(c.p_value for c in depends))})")
    return f"{record.name} fails{place}{channel}: {'; '.join(said)}"


def _place(record: AbstractRecord, series: Series, whole: Check, failed: list[Check]) -> tuple[str, Check]:
    """The setting, and the frequency or time, at which the misfit is largest."""
    settings = [
        c for c in failed if c.label and c.heading != "frequency" and c.statistic > STANDS_OUT * whole.statistic
    ]
    bands = [c for c in failed if c.heading == "frequency"]
    worst = max(settings or [whole], key=lambda c: c.statistic)
    rows = np.ones(len(series.white), bool)
    words = []
    for part in series.parts:
        if worst.label and (part.heading, part.label) == (worst.heading, worst.label):
            rows = part.rows
            words.append(f" from {part.label}" if part.heading == "time" else f" at {part.heading} {part.label}")
    number = series.channels.index(whole.channel)
    if where := record.at(_peak(np.where(rows[:, None], series.white[:, number], np.nan))):
        words.append(f", {where}")
    elif bands and not worst.label:
        most = max(bands, key=lambda c: c.statistic)
        words.append(f", {most.label}")
        worst = most if most.statistic > worst.statistic else worst
    return "".join(words), worst


def _peak(white: np.ndarray) -> int:
    """The row around which (n, parts) are largest, over five rows."""
    power = np.nansum(white**2, axis=1)
    return int(np.argmax(np.convolve(power, np.ones(5), mode="same") * (power > 0)))


def _p(value: float) -> str:
    return f"p < {_SMALLEST:g}" if value < _SMALLEST else f"p = {value:.2g}"


def _dataset(fit: CaseFit, number: int, record: AbstractRecord):
    import xarray as xr

    unit, channels = fit.case.readout.unit, ["x", "y"][: fit.model.axes]
    white = fit.whitened[number]
    parts = ["I", "Q"] if white.shape[-1] == 2 else ["signal"]
    values = {
        "measured": (("row", "channel"), record.readings, {"unit": unit}),
        "predicted": (("row", "channel"), fit.predicted(number), {"unit": unit}),
        "whitened": (("row", "channel", "part"), white, {"unit": "1"}),
        "fitted": (("row",), fit.fitted[number], {"unit": "1"}),
    }
    coords: dict[str, Any] = {"channel": channels, "part": parts}
    for known in record.known(fit.case):
        coords[known.name.replace(" ", "_")] = (("row",), known.values, {"unit": known.unit})
    attrs = {"name": record.name, "kind": record.kind, "role": record.role or "", "noise_std": record.noise_level}
    return xr.Dataset(values, coords=coords, attrs=attrs)
