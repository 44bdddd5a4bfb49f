"""What `memsgyro diagnose --json` writes, schema `memsgyro-diagnosis/1`; a number that is not finite is null."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class JudgedRecord:
    """An experiment beside a model: `error` is the rms of the deviation over the noise, explained up to `gate`;
    `noise_std` is that noise of each channel that was recorded, in the unit of the record.
    """

    name: str
    role: Literal["fit", "validation"]
    count: int
    chi2_per_n: float | None
    error: float | None
    gate: float | None
    explained: bool
    noise_std: dict[str, float | None]


@dataclass(frozen=True)
class FittedNumber:
    """A parameter of a model."""

    name: str
    value: float | None
    std: float | None
    unit: str


@dataclass(frozen=True)
class FittedModel:
    """A model beside the case."""

    chi2_per_dof: float | None
    status: str
    per_experiment: list[JudgedRecord]
    parameters: list[FittedNumber]


@dataclass(frozen=True)
class FurtherNumber:
    """A number of an effect beside its strength."""

    value: float | None
    std: float | None
    unit: str


@dataclass(frozen=True)
class NeededEffect:
    """An effect that the model needs, with the validation error before and after it was added."""

    name: str
    axis: str | None
    estimate: float | list[float | None] | None
    std: float | list[float | None] | None
    unit: str
    p_value: float | None
    validation_error_before: float | None
    validation_error_after: float | None
    confused_with: list[str]
    numbers: dict[str, FurtherNumber]


@dataclass(frozen=True)
class TriedEffect:
    """An effect that was tried beside a model."""

    label: str
    unit: str
    score: float | None
    p_value: float | None
    explained_share: float | None
    kept_share: float | None
    smallest_visible: float | None
    excited: bool


@dataclass(frozen=True)
class Feasible:
    """An experiment and what it would decide."""

    experiment: str
    decides: str
    chi2: float | None
    shown: int
    where: str


@dataclass(frozen=True)
class AddedEffect:
    """The fit after one more effect."""

    added: str
    chi2_per_dof: float | None
    validation_error: float | None


@dataclass(frozen=True)
class DiagnosisAnswer:
    """The whole file."""

    schema: Literal["memsgyro-diagnosis/1"]
    case: str
    level: float
    verdict: Literal["nothing_missing", "instrument_only", "found", "cannot_tell", "partly_explained", "unknown_effect"]
    sentence: str
    base: FittedModel
    final: FittedModel
    effects: list[NeededEffect]
    instrument: list[NeededEffect]
    candidates: list[TriedEffect]
    candidates_of_base: list[TriedEffect]
    groups: list[list[str]]
    next_experiment: str | None
    next_experiments: list[Feasible]
    residual: dict[str, float | None]
    steps: list[AddedEffect]
    tried: list[AddedEffect]
    std_scale: float | None
    outlying: dict[str, list[int]]
    versions: dict[str, str]
