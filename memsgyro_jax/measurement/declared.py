"""What a case declares of one device before anything is recorded: its design, its read-out, and what they are called.

Names are those of files: design keys with their units, columns with theirs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import to_si
from memsgyro_jax.device.normalised import NormalisedDevice

from .section import Amount


QUANTITIES = ("displacement", "velocity", "acceleration")
UNSURE = 3.0  # factor within which a design value that only the records tell is believed


@dataclass(frozen=True)
class DesignValue:
    """A design parameter: what the maker meant, and the interval in which the die may lie, in SI.

    One that the maker does not know is found from the records, `unknown`, and believed within a factor of three.
    """

    value: float
    low: float
    high: float
    unknown: bool = False

    @classmethod
    def found(cls, value: float) -> "DesignValue":
        """What the records tell of a number that nobody declared."""
        low, high = (
            sorted((value / UNSURE, value * UNSURE)) if value > 0 else (-UNSURE * abs(value), UNSURE * abs(value))
        )
        return cls(value, low, high, unknown=True)


@dataclass(frozen=True)
class Readout:
    """The declared read-out: record = scale · dⁿ/dtⁿ displacement + an unknown offset.

    Args:
        scale: record unit per unit of displacement, or of its derivative: V/m (single mass), V/V (resonator), V/(m/s).
        adc_range: the converter's largest reading, ± this much in the record unit; `None` where it is not declared.
        unit: of the records, "V", or "1" (digital units), or any other that they are in.
        order: n, what is read: 0 displacement, 1 velocity, 2 acceleration.
        displacement: unit of the displacement; empty where it is the usual one of the device.
        tolerance: relative standard deviation of the scale; zero where it is taken for exact.
    """

    scale: float
    adc_range: float | None = None
    unit: str = "V"
    order: int = 0
    displacement: str = ""
    tolerance: float = 0.0

    def motion(self, phasors: np.ndarray, omega: np.ndarray | float) -> np.ndarray:
        """Displacement phasors that phasors (n, channels) of the record stand for at `omega` (n,) [rad/s]."""
        return phasors / (self.scale * (1j * np.asarray(omega)[..., None]) ** self.order)


@dataclass(frozen=True)
class Drive:
    """What drives the device, as the records have it.

    Args:
        unit: "N", "V" or "A"; records hold it in newtons once `scale` is known.
        scale: newtons per `unit`; `None` where it is not known, and then part of the gain that a fit finds.
        tolerance: relative standard deviation of the scale; zero where it is taken for exact.
    """

    unit: str
    scale: float | None = None
    tolerance: float = 0.0


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
        pairs: further names of the two columns of a phasor, for instruments of one channel.
        amplitudes: further names of amplitude and phase.
    """

    design: Mapping[str, str]
    positive: tuple[str, ...]
    displacement: str
    force: str
    signals: tuple[tuple[str, ...], ...]
    forces: tuple[tuple[str, ...], ...]
    drives: tuple[tuple[str, ...], ...]
    pairs: tuple[tuple[str, str], ...] = ()
    amplitudes: tuple[tuple[str, str], ...] = ()


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
        signals=(("y",), ("Vx",), ("x",), ("signal",)),
        forces=(("u",), ("u_x",), ("drive",)),
        drives=(("F",), ("F_x",), ("drive",)),
        pairs=(("X", "Y"), ("I", "Q")),
        amplitudes=(("R", "theta"), ("amp", "phase")),
    ),
}


def vocabulary(device: str, readout: Readout, drive: Drive | None) -> Vocabulary:
    """Names and units of a device with its read-out and what drives it."""
    words = VOCABULARIES[device]
    words = replace(words, displacement=readout.displacement or words.displacement)
    if drive is not None:
        words = replace(words, force="N" if drive.scale else drive.unit)
    if "static_gain" in words.design and words.force != words.displacement:
        words = replace(words, design={**words.design, "static_gain": f"{words.displacement}/({words.force})"})
    return words


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
            quality_factor [1], static_gain [record unit per input unit], and mass [kg] where that gives it.
        readout: what is declared about the read-out.
        environment: what holds where a record does not say otherwise.
        conventions: free text by topic.
        drive: what drives the device; `None` where it is a force [N], or an input [V] of a resonator.
    """

    folder: Path
    name: str
    description: str
    device: Literal["single_mass", "resonator"]
    design: Mapping[str, DesignValue]
    readout: Readout
    environment: Environment
    conventions: Mapping[str, str]
    drive: Drive | None = None

    @property
    def channels(self) -> int:
        """Two for a single mass, one for a resonator."""
        return 2 if self.device == "single_mass" else 1

    @property
    def words(self) -> Vocabulary:
        """What the device is called by in files."""
        return vocabulary(self.device, self.readout, self.drive)

    @property
    def holds_gain(self) -> bool:
        """Whether it is the displacement per force at rest that stands where no drive tells it, and not a mass."""
        return self.device == "resonator" and "mass" not in self.design

    @property
    def resonances(self) -> tuple[float, float]:
        """Lowest and highest angular frequency [rad/s] at which a die within the design may resonate."""
        design = self.design
        if "resonance" in design:
            return design["resonance"].low, design["resonance"].high
        coupling = max(abs(design["kxy"].low), abs(design["kxy"].high))
        (lightest, heaviest), (soft, stiff) = self._sizes("mass"), self._sizes("kxx", "kyy")
        low = max(soft - coupling, 0.25 * soft)  # a coupling that would nearly buckle the die is no resonance to expect
        return float(np.sqrt(low / heaviest)), float(np.sqrt((stiff + coupling) / lightest))

    @property
    def shortest_decay(self) -> float:
        """Shortest time constant of the amplitude [s] that the design allows."""
        d = self.design
        if "quality_factor" in d:
            return 2 * d["quality_factor"].low / d["resonance"].high
        return 2 * self._sizes("mass")[0] / self._sizes("dxx", "dyy")[1]

    @property
    def largest_quality(self) -> float:
        """Largest quality factor that the design allows."""
        d = self.design
        if "quality_factor" in d:
            return d["quality_factor"].high
        stiffest = self._sizes("kxx")[1] * self._sizes("mass")[1]
        return float(np.sqrt(stiffest)) / self._sizes("dxx", "dyy")[0]

    def _sizes(self, *keys: str) -> tuple[float, float]:
        """Smallest and largest of design values that are positive; records of a pick-off that is turned round tell
        all of them with a minus sign, which is that of the gain.
        """
        some = [self.design[key] for key in keys]
        ends = [(-v.value / UNSURE, -v.value * UNSURE) if v.value < 0 else (v.low, v.high) for v in some]
        return min(low for low, _ in ends), max(high for _, high in ends)


def check_temperature(kelvin: float) -> float:
    """The temperature of a device on a bench; raises `InputError` for one that none has: a wrong unit, most likely."""
    if not 1.0 <= kelvin <= 1700.0:
        raise InputError(
            f"must lie between 1 K and 1700 K, where silicon melts, but is {kelvin:g} K; is the unit right?"
        )
    return kelvin


def design_device(declared: Declared) -> NormalisedDevice:
    """The device as designed."""
    d = {name: entry.value for name, entry in declared.design.items()}
    if declared.device == "resonator":
        w = d["resonance"]
        return NormalisedDevice(np.array([w**2]), np.array([w / d["quality_factor"]]), d["static_gain"] * w**2)
    m = d["mass"]
    stiffness = np.array([d["kxx"], d["kyy"], d["kxy"]]) / m
    return NormalisedDevice(stiffness, np.array([d["dxx"], d["dyy"], d["dxy"]]) / m, 1 / m)
