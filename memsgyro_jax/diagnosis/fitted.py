"""What a fit leaves of each record, and the parameters it found."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.text import beside, said_in
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.measurement.least_squares import gate


if TYPE_CHECKING:
    from matplotlib.axes import Axes

FITTED = 4.5  # standard deviations of χ² in a fitted record that count as noise: these are many, and tested anyway
PINNED = 0.01  # of a bound: a number so near stands at it
AT_BOUND = "at its bound"
ROUGHLY = 30.0  # standard deviations that a value without them may be off, for its digits


@dataclass(frozen=True)
class RecordError:
    """How far a record, or the part of it with one role, lies from the model.

    Args:
        name: of the record.
        role: "fit" or "validation".
        count: real readings.
        chi2: sum of their squared deviations over the noise.
        freedom: degrees of freedom with which the noise is known; infinite where it is declared.
    """

    name: str
    role: str
    count: int
    chi2: float
    freedom: float = np.inf

    @property
    def rms(self) -> float:
        """Root mean square of deviation over noise; 1 is the noise floor."""
        return float(np.sqrt(self.chi2 / self.count))

    @property
    def gate(self) -> float:
        """χ²/N up to which noise alone explains the record: 1 + 3·√(2/N), and more where the noise is an estimate."""
        return gate(self.count, freedom=self.freedom)

    @property
    def explained(self) -> bool:
        """Whether χ²/N is within the gate."""
        return bool(self.chi2 / self.count <= self.gate)

    def to_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return {
            "name": self.name,
            "role": self.role,
            "readings": self.count,
            "error": self.rms,
            "chi2_per_reading": self.chi2 / self.count,
            "gate": float(self.gate),
            "explained": self.explained,
        }


def within_gates(errors: Sequence[RecordError], noise: Mapping[str, float]) -> list[bool]:
    """Of each entry, whether χ²/N is within the gate of a diagnosis, wider for what was fitted; in units of another
    `noise` of some records than they have.
    """
    widths = [FITTED if error.role == "fit" else 3.0 for error in errors]
    return [
        bool(e.chi2 / noise.get(e.name, 1.0) ** 2 / e.count <= gate(e.count, width, e.freedom))
        for e, width in zip(errors, widths, strict=True)
    ]


def with_calibration(share: float) -> str:
    """What stands behind a number whose calibration is unsure by that share; empty for none."""
    return f" (statistical), ± {100 * share:.2g} % with the calibration" if share else ""


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter of the model with its standard deviation (infinite where the records do not hold it, NaN where none
    can be told), and the share of it that the calibration of read-out and drive leaves unsure beside; whether a bound
    has stopped it; and of what is told from below alone, above what it lies (95 %; `None` for others).
    """

    name: str
    value: float
    std: float
    unit: str
    calibration: float = 0.0
    stopped: bool = False
    above: float | None = None

    def __str__(self) -> str:
        if self.stopped:
            return f"{self.name:<24} {said_in(f'{self.value:>7.6g}', self.unit)}, {AT_BOUND}"
        if self.above is not None:
            return f"{self.name:<24} {self.at_least}"
        if np.isinf(self.std):
            return f"{self.name:<24} not determined by these records"
        if np.isnan(self.std):
            return f"{self.name:<24} {said_in(f'{self.value:>7.6g}', self.unit)}"
        told = said_in(f"{beside(self.value, self.std):>7} ± {self.std:.2g}", self.unit)
        return f"{self.name:<24} {told}{with_calibration(self.calibration)}"

    @property
    def at_least(self) -> str:
        """What is told from below alone."""
        return f"above {said_in(f'{self.above:.2g}', self.unit)} (95 %), as its damping is not told from none"

    @property
    def roughly(self) -> str:
        """The same with the digits that hold where a model leaves more than the noise, which no ± and no bound says."""
        if self.above is not None:
            return str(replace(self, above=None))
        if self.stopped or not np.isfinite(self.std):
            return str(self)
        return f"{self.name:<24} {said_in(about(self.value, self.std), self.unit)}"

    def to_dict(self) -> dict[str, Any]:
        """The entry of a JSON file."""
        return asdict(self)


def about(value: float, std: float) -> str:
    """A value whose standard deviation says little."""
    return f"about {beside(value, ROUGHLY * std, 4)}"


def at_bounds(values: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], places: Sequence[int]) -> tuple[bool, ...]:
    """Which of the values at some places stand at one of their bounds; zero, where an effect is absent, is none."""

    def stands_at(value: float, bound: float) -> bool:
        return bool(np.isfinite(bound) and bound != 0.0 and abs(value - bound) <= PINNED * abs(bound))

    return tuple(any(stands_at(float(values[i]), float(bound[i])) for bound in bounds) for i in places)


def of_energy(device: NormalisedDevice) -> str:
    """What is said of a damping that feeds some motion, as no device does; empty where it slows them all."""
    if device.is_slowed:
        return ""
    return (
        "the damping feeds a motion of both axes, as no device does, and no study takes it: these records do not hold "
        "it, or something is missing"
    )


def errors_figure(errors: Sequence[RecordError], ax: "Axes | None", before: Sequence[RecordError] = ()) -> "Axes":
    """Deviation over noise of every record, fitted and not, on a logarithmic scale; lines lead there from `before`."""
    ax = axes(ax)
    names = list(dict.fromkeys(e.name for e in errors))
    first = {(e.name, e.role): e.rms for e in before}
    for role, marker, colour in (("fit", "o", "C0"), ("validation", "s", "C1")):
        chosen = [e for e in errors if e.role == role]
        if chosen:
            places = [names.index(e.name) for e in chosen]
            label = "fitted" if role == "fit" else "not fitted"
            ax.plot([e.rms for e in chosen], places, marker, color=colour, ms=6, label=label, alpha=0.8)
            from_ = [first.get((e.name, e.role), e.rms) for e in chosen]
            ax.hlines(places, [e.rms for e in chosen], from_, color=colour, lw=1.0, alpha=0.6)
    ax.axvline(1.0, color="k", lw=1.0, ls="--", label="noise")
    ax.set_xscale("log")
    ax.set_xlabel("rms of deviation over noise" + (", from the base model to the final one" if before else ""))
    # A dollar would start a formula of matplotlib's.
    ax.set_yticks(range(len(names)), [name.replace("$", r"\$") for name in names])
    ax.invert_yaxis()
    ax.legend(loc="best", frameon=False)
    return ax
