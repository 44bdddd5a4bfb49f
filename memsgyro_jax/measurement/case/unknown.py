"""What a case leaves open, as its files tell it: units of drive and readings, and design values not declared."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed
from memsgyro_jax.base.units import parse_header, to_si
from memsgyro_jax.device.normalised import NormalisedDevice

from ..declared import VOCABULARIES, DesignValue
from ..exchanged_axes import all_exchanged, exchanged_axes
from ..experiments import AbstractRecord
from ..experiments.base import Phasors
from ..one_place import in_one_place
from ..phasor_fit import device_of_phasors, is_seen, most_linear
from .content import Case
from .device import BY_MODES, gain_by_mass
from .file import CaseFile


BY_HAND = {  # how a maker gives them
    **{key: other.key for key, other in BY_MODES.items() if other.positive},
    **{key: key for key in VOCABULARIES["resonator"].design},
}
CLEAR = 10.0  # times the noise: a vibration
_UNITS = ("V", "N", "A", "1", "m", "m/s", "m/s**2", "rad", "Pa")


class OpenDesign(InputError):
    """No record tells what the design leaves open."""


def recorded_units(file: CaseFile, folder: Path) -> tuple[str, str]:
    """SI units of the readings and of the drive, from the first headers and sections that have them; "V" and "" where
    none has."""
    words = VOCABULARIES[file.device]
    read = {name + end for group in words.signals for name in group for end in ("", "_I", "_Q", "_amp")}
    read |= {name for pair in words.pairs for name in pair} | {first for first, _ in words.amplitudes}
    driven = {name for group in (*words.forces, *words.drives) for name in group}
    headers = [column for entry in file.experiment for column in _header(folder / entry.file)]
    force = [amount.unit for e in file.experiment if (amount := getattr(e, "drive_force", None)) is not None]
    units = [unit for name, unit in headers if name in driven]
    return (
        next((_base(unit) for name, unit in headers if name in read), "V") or "V",
        next(map(_base, [*force, *units]), ""),
    )


def _header(path: Path) -> Iterator[tuple[str, str]]:
    """Names and units of a header as far as they can be read; what is wrong with it is told when the file is read."""
    try:
        with path.open(encoding="utf-8") as file:
            line = next((line for line in file if line.strip() and not line.startswith("#")), "")
    except (OSError, ValueError):
        return
    for field in line[:10_000].split(","):
        try:
            yield tuple(parse_header(field))
        except InputError:
            continue


def _base(unit: str) -> str:
    """The SI unit of the same kind; empty for a unit that no reading or drive has."""
    for base in _UNITS:
        try:
            to_si(1.0, unit, base, "the value")
        except InputError:
            continue
        return base
    return ""


def with_found_design(case: Case, file: CaseFile, path: Path) -> Case:
    """The case with a value for every number of its design that was left to the records.

    **Raises:** `InputError` where no record drives the device in a known way, so that none tells.
    """
    open_ = [key for key, value in case.design.items() if value.unknown]
    if not open_:
        return case
    fitted = [record for record in case.records if record.role != "validation"]
    offered = [record.starting_phasors(case) for record in in_one_place(case.environment, fitted)]
    rows = [phasors for phasors in offered if phasors is not None and phasors.axis is None]
    if not rows and case.channels > 1 and (alone := _told_by_one_channel(case, offered)):
        return _with_told(case, file, _all_of(alone, open_, path))
    device = device_of_phasors(rows) if rows else _left_alone(case)
    if rows and (calm := most_linear(rows, device)) and calm is not rows:
        rows, device = calm, device_of_phasors(calm)
    if device is None or (rows and not is_seen(device, rows)):
        if case.channels > 1 and not set(open_) & {"kxx", "kyy", "dxx", "dyy"}:
            return _with_told(case, file, _uncoupled(case, open_))
        needed = ", ".join(BY_HAND[key] for key in open_ if key in BY_HAND) or ", ".join(open_)
        raise OpenDesign(
            f"{path}, `design`: must give {needed}, as no record that may be fitted shows a clear resonance"
            + (f": {said}{'' if said.endswith('?') else '.'}" if (said := _exchanged(case, fitted)) else ".")
        )
    found = _numbers(case, *(np.asarray(part) for part in (device.stiffness, device.damping, device.mobility)))
    told = {key: DesignValue.found(found[key]) for key in open_}
    by_mass = gain_by_mass(file, found["resonance"]) if "static_gain" in told else None
    if by_mass is not None and not by_mass.unknown:
        told["static_gain"] = by_mass
    return _with_told(case, file, told)


def _exchanged(case: Case, fitted: Sequence[AbstractRecord]) -> str:
    """Why none may show it: x and y of a sweep are exchanged, or of all, or decays tell one axis; else empty."""
    if case.channels < 2:
        return ""
    heard = {r.name: np.array(modes) for r in fitted if (modes := r.free_modes(case)) is not None}
    louder = {int(np.argmax(modes[:, 0])) for modes in heard.values()}
    if len(heard) < 2 or len(louder) != 1:
        phasors = [(record.name, record.starting_phasors(case)) for record in fitted]
        return "; ".join(exchanged_axes(phasors).values()) or all_exchanged(phasors) or _of_one_axis(heard)
    loud, other = ("x", "y") if louder == {0} else ("y", "x")
    return (
        f"in {listed(heard, '`')} channel {loud} is the louder one, so that none is a decay of {other}; are the "
        "channels of one exchanged?"
    )


def _of_one_axis(heard: Mapping[str, np.ndarray]) -> str:
    """That both channels of the one decay vibrate at one frequency, with the numbers to give; else empty."""
    for name, modes in heard.items() if len(heard) == 1 else ():
        _, omega, decay = modes.T
        loud = int(np.argmax(modes[:, 0]))
        if not np.all(decay > 0) or np.ptp(omega) >= 2.0 * np.sum(decay):
            break
        axis, other = "xy"[loud], "yx"[loud]
        hertz, quality = omega[loud] / (2 * np.pi), omega[loud] / (2.0 * decay[loud])
        return (
            f"in `{name}` both channels vibrate at one frequency, that of {axis}, the louder one: frequency_{axis} is "
            f"{hertz:.6g} Hz and quality_factor_{axis} {quality:.4g}; those of {other} are told by a sweep, or a decay "
            f"in which {other} is the louder one"
        )
    return ""


def _with_told(case: Case, file: CaseFile, told: dict[str, DesignValue]) -> Case:
    """The case with these values of its design; what was given by a frequency is per mass until the mass is told."""
    if "mass" in told:
        for key, value in case.design.items():
            if key not in told and key not in file.design:
                mass = told["mass"].value
                scaled = replace(value, **{end: getattr(value, end) * mass for end in ("value", "low", "high")})
                told = {**told, key: scaled}
    return replace(case, design={**case.design, **told})


def _told_by_one_channel(case: Case, offered: Iterable[Phasors | None]) -> dict[str, float]:
    """Design values of the axes that sweeps of a device of two show, where the other channel was not recorded."""
    alone = [one for one in offered if one is not None and one.axis is not None]
    told: dict[str, float] = {}
    for axis in sorted({one.axis for one in alone if one.axis is not None}):
        rows = [one for one in alone if one.axis == axis]
        device = device_of_phasors(rows)
        if device is None or not is_seen(device, rows):
            continue
        own = 1.0 / abs(float(device.mobility)) if case.design["mass"].unknown else case.design["mass"].value
        mass = told.setdefault("mass", own)
        told[f"k{2 * 'xy'[axis]}"] = mass * float(device.stiffness[0])
        told[f"d{2 * 'xy'[axis]}"] = mass * float(device.damping[0])
    if {"kxx", "kyy"} <= {*told} and any(one.beside is not None for one in alone):
        told |= {"kxy": told["mass"] * _coupling_of_amplitudes(alone, told), "dxy": 0.0}
    return told


def _coupling_of_amplitudes(alone: Iterable[Phasors], told: dict[str, float]) -> float:
    """The coupling over the mass that amplitudes of both channels ask for: |k_xy| = |Y/X| · |k_yy − ω² + iωd_yy| where
    x is driven. Its sign they do not tell: a positive one is taken.
    """
    found, weights = [np.zeros(0)], [np.zeros(0)]
    for one in alone:
        if one.beside is None or one.axis is None:
            continue
        name = 2 * "xy"[1 - one.axis]
        stiffness, damping = told[f"k{name}"] / told["mass"], told[f"d{name}"] / told["mass"]
        amplitude, held = np.abs(one.motion[:, 0]), np.abs(stiffness - one.omega**2 + 1j * one.omega * damping)
        clear = one.beside * one.weight > CLEAR
        found.append((one.beside / np.maximum(amplitude, 1e-300) * held)[clear])
        weights.append((one.weight * amplitude / held)[clear] ** 2)
    size, weight = np.concatenate(found), np.concatenate(weights)
    return float(np.sum(weight * size) / np.sum(weight)) if size.size else 0.0


def _all_of(alone: dict[str, float], open_: list[str], path: Path) -> dict[str, DesignValue]:
    """Values for all that was left open; raises `InputError` that names what one channel does not tell."""
    if missing := [key for key in open_ if key not in alone]:
        (unseen,) = {"x", "y"} - {key[-1] for key in alone if key != "mass"} or {""}
        channel = f"reads channel {unseen}" if unseen else "reads both channels at once, with its phase"
        other = f" (k{2 * unseen} and d{2 * unseen} also as frequency_{unseen} and quality_factor_{unseen})"
        other = other if f"k{2 * unseen}" in missing else ""
        raise InputError(
            f"{path}, `design`: must give {', '.join(missing)}{other}, as no sweep that may be fitted {channel}; the "
            f"records tell {', '.join(alone)}."
        )
    return {key: DesignValue.found(alone[key]) for key in open_}


def _left_alone(case: Case) -> NormalisedDevice | None:
    """A device of one axis whose free vibration is all that was seen, or its design where not even that is; of its gain
    nothing is known.
    """
    if case.channels > 1:
        return _both_left_alone(case)
    heard = [modes[0] for record in case.records if (modes := record.free_modes(case)) is not None]
    _, omega, decay = max(heard, default=(0.0, 0.0, 0.0))
    if decay > 0:
        return NormalisedDevice([omega**2], [2.0 * decay], omega**2)
    resonance, quality = (case.design[key] for key in ("resonance", "quality_factor"))
    if resonance.unknown or quality.unknown or any(record.kind != "free_decay" for record in case.records):
        return None
    return NormalisedDevice([resonance.value**2], [resonance.value / quality.value], resonance.value**2)


def _both_left_alone(case: Case) -> NormalisedDevice | None:
    """A device of two axes of which each vibrates most at a frequency of its own in a free decay: in the one in which
    both are loud, or each in that in which it is louder than the other by most.
    """
    heard = [(r.noise_level, np.array(m)) for r in case.records if (m := r.free_modes(case)) is not None]
    if not heard:
        return None
    both = max(heard, key=lambda told: min(told[1][:, 0]) / told[0])
    each = [max(heard, key=lambda told, axis=axis: told[1][axis, 0] / told[1][1 - axis, 0]) for axis in (0, 1)]
    for told in ([both, both], each):
        loud, omega, decay = np.transpose([modes[axis] for axis, (_, modes) in enumerate(told)])
        clear = np.all(loud > CLEAR * np.array([noise for noise, _ in told]))
        apart = np.ptp(omega) >= 2.0 * np.sum(decay) and np.min(omega) > np.max(omega) / 10.0  # a slow drift is no mode
        if clear and apart and np.all(decay > 0):
            return NormalisedDevice([*omega**2, 0.0], [*(2.0 * decay), 0.0], 1.0)
    return None


def _uncoupled(case: Case, open_: list[str]) -> dict[str, DesignValue]:
    """What is left open of a device whose axes are known: uncoupled ones, as far as nothing tells otherwise."""
    design = {key: value.value for key, value in case.design.items()}
    least = np.sqrt(design["kxx"] * design["kyy"]) / max(1.0, case.largest_quality)
    reach = {"kxy": max(abs(design["kyy"] - design["kxx"]) / 2.0, least), "dxy": np.sqrt(design["dxx"] * design["dyy"])}
    none = {key: DesignValue(0.0, -float(far), float(far), unknown=True) for key, far in reach.items()}
    return {key: value for key, value in none.items() if key in open_}  # all is per mass where that is open


def _numbers(case: Case, stiffness: np.ndarray, damping: np.ndarray, mobility: np.ndarray) -> dict[str, float]:
    """Design values of a device in coordinates per mass."""
    if case.device == "resonator":
        w = float(np.sqrt(stiffness[0]))
        return {"resonance": w, "quality_factor": w / float(damping[0]), "static_gain": float(mobility) / w**2}
    mass = case.design["mass"]
    m = 1.0 / float(mobility) if mass.unknown else mass.value
    names = ("kxx", "kyy", "kxy", "dxx", "dyy", "dxy")
    return {"mass": m} | {name: float(v * m) for name, v in zip(names, [*stiffness, *damping], strict=True)}
