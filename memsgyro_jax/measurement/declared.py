"""What a case declares of one device before anything is recorded: its design, its read-out, and what they are called.

Names are those of files: design keys with their units, columns with theirs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import to_si

from .section import Amount


@dataclass(frozen=True)
class DesignValue:
    """A design parameter: what the maker meant, and the interval in which the die may lie, in SI."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Readout:
    """The declared read-out: record = scale · displacement + an unknown offset.

    Args:
        scale: record unit per unit of displacement, V/m (single mass) or V/V (resonator).
        adc_range: the converter's largest reading, ± this much in the record unit; `None` where it is not declared.
        unit: of the records, "V" or "1" (digital units).
    """

    scale: float
    adc_range: float | None = None
    unit: str = "V"


@dataclass(frozen=True)
class Environment:
    """Where records do not say otherwise: temperature [K] and electrode bias [V]."""

    temperature: float = 298.15
    bias_voltage: float = 0.0


@dataclass(frozen=True)
class Vocabulary:
    """Names and units of one kind of device.

    Args:
        design: SI unit of each design key.
        positive: design keys that must be positive.
        displacement: unit of the displacement that the read-out scale divides by.
        force: unit of forces.
        signals: names of the channels; the first group that a file uses holds.
        forces: names of the raw inputs, likewise.
        drives: names of the drive levels, likewise.
    """

    design: Mapping[str, str]
    positive: tuple[str, ...]
    displacement: str
    force: str
    signals: tuple[tuple[str, ...], ...]
    forces: tuple[tuple[str, ...], ...]
    drives: tuple[tuple[str, ...], ...]


VOCABULARIES = {
    "single_mass": Vocabulary(
        design={"mass": "kg", "kxx": "N/m", "kyy": "N/m", "kxy": "N/m", "dxx": "N*s/m", "dyy": "N*s/m", "dxy": "N*s/m"},
        positive=("mass", "kxx", "kyy", "dxx", "dyy"),
        displacement="m",
        force="N",
        signals=(("Vx", "Vy"),),
        forces=(("u_x", "u_y"),),
        drives=(("F_x", "F_y"),),
    ),
    "resonator": Vocabulary(
        design={"resonance": "rad/s", "quality_factor": "1", "static_gain": "1"},
        positive=("resonance", "quality_factor"),
        displacement="V",
        force="V",
        signals=(("y",), ("Vx",)),
        forces=(("u",), ("u_x",)),
        drives=(("F",), ("F_x",)),
    ),
}


def si(amount: Amount, expected: str, *, positive: bool = True) -> float:
    """The amount in the SI unit `expected`; an angular frequency in rad/s may also be given in Hz."""
    number = angular(amount.number, amount.unit, "the value") if expected == "rad/s" else None
    number = to_si(amount.number, amount.unit, expected, "the value") if number is None else number
    if not np.isfinite(number):
        raise InputError(f"must be a finite number, but is {number:g} {expected}")
    if positive and not number > 0:
        raise InputError(f"must be positive, but is {amount.number:g} {amount.unit}")
    return float(number)


def angular(value: np.ndarray | float, unit: str, name: str) -> np.ndarray | float:
    """Frequency in rad/s, given in any unit of cycles or of angle per time; raises `InputError` for other units."""
    try:
        return 2 * np.pi * to_si(value, unit, "Hz", name)
    except InputError:
        pass
    try:
        return to_si(value, unit, "rad/s", name)
    except InputError as error:
        raise InputError(
            f'Unit of {name} must be one of frequency such as "Hz" or "rad/s", but is "{unit}".'
        ) from error


@dataclass(frozen=True, eq=False)
class Declared:
    """What is said of one device, whatever was recorded.

    Args:
        folder: where the case was read from.
        name: of the case.
        description: free text.
        device: "single_mass" (two axes) or "resonator" (one).
        design: single mass: mass [kg], kxx, kyy, kxy [N/m], dxx, dyy, dxy [N s/m]; resonator: resonance [rad/s],
            quality_factor [1], static_gain [record unit per input unit].
        readout: what is declared about the read-out.
        environment: what holds where a record does not say otherwise.
        conventions: free text by topic.
    """

    folder: Path
    name: str
    description: str
    device: Literal["single_mass", "resonator"]
    design: Mapping[str, DesignValue]
    readout: Readout
    environment: Environment
    conventions: Mapping[str, str]

    @property
    def channels(self) -> int:
        """Two for a single mass, one for a resonator."""
        return 2 if self.device == "single_mass" else 1

    @property
    def words(self) -> Vocabulary:
        """What the device is called by in files."""
        return VOCABULARIES[self.device]

    @property
    def resonances(self) -> tuple[float, float]:
        """Lowest and highest angular frequency [rad/s] at which a die within the design may resonate."""
        design = self.design
        if "resonance" in design:
            return design["resonance"].low, design["resonance"].high
        mass, coupling = design["mass"], max(abs(design["kxy"].low), abs(design["kxy"].high))
        softest = min(design["kxx"].low, design["kyy"].low)
        stiffest = max(design["kxx"].high, design["kyy"].high)
        low = max(
            softest - coupling, 0.25 * softest
        )  # a coupling that would nearly buckle the die is no resonance to expect
        return float(np.sqrt(low / mass.high)), float(np.sqrt((stiffest + coupling) / mass.low))

    @property
    def shortest_decay(self) -> float:
        """Shortest time constant of the amplitude [s] that the design allows."""
        d = self.design
        if "quality_factor" in d:
            return 2 * d["quality_factor"].low / d["resonance"].high
        return 2 * d["mass"].low / max(d["dxx"].high, d["dyy"].high)

    @property
    def largest_quality(self) -> float:
        """Largest quality factor that the design allows."""
        d = self.design
        if "quality_factor" in d:
            return d["quality_factor"].high
        return float(np.sqrt(d["kxx"].high * d["mass"].high) / min(d["dxx"].low, d["dyy"].low))


def check_temperature(kelvin: float) -> float:
    """The temperature of a device on a bench; raises `InputError` for one that none has: a wrong unit, most likely."""
    if not 1.0 <= kelvin <= 1700.0:
        raise InputError(
            f"must lie between 1 K and 1700 K, where silicon melts, but is {kelvin:g} K; is the unit right?"
        )
    return kelvin
