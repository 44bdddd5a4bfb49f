"""What the records of a device show at once beside what its design says, before anything is fitted."""

import numpy as np

from memsgyro_jax.base.text import spoken

from .case import Case
from .case_of_records import SPREADS
from .declared import QUANTITIES
from .experiments.base import Phasors
from .further_peaks import said_of_peaks
from .linear_start import starting_device
from .one_place import in_one_place
from .phasor_fit import device_of_phasors


_ALIKE = 1.01  # of the weakest drive: the same level
_OFF = 2.0  # degrees of phase that are worth a sentence
_SURE = 2.0  # times its tolerance, within which a scale may be
_DIGITS = 12  # of a resonance, which records tell no better
_NO_WIDTH = 1e10  # of a quality factor: a resonance between two rows, or none
_PART = 0.1  # of the width of a resonance, below which a band shows nothing of it
_FAR = 2.0  # half widths from the resonance, beyond which a bent peak counts for nothing


def beside_design(case: Case) -> tuple[str, ...]:
    """A sentence for each number of a resonator as the records show it, beside that of its design where one is
    declared, with a warning where they lie outside its interval; and one where the phase far from resonance is none
    that a resonator has.
    """
    if case.device != "resonator":
        return ()
    rows = _weakest(case)
    device = (device_of_phasors(rows) if rows else None) or starting_device(case)
    omega = float(np.sqrt(device.stiffness[0]))
    shown = {
        "resonance": omega,
        "quality_factor": omega / float(device.damping[0]),
        "static_gain": float(device.mobility) / omega**2,
    }
    said = []
    if rows and case.design["resonance"].unknown and (band := _too_narrow(rows, float(device.damping[0]))):
        where = f"over their band of {spoken(band, 'Hz')} the readings are straight, as far beside one"
        return (f"resonance: the records show none: {where}.",)
    for key, value in shown.items():
        design = case.design[key]
        if key == "static_gain" and (design.unknown or not rows):
            continue
        seen = _number(key, value, shown["quality_factor"])
        if design.unknown:
            said.append(f"{key}: the records show {seen}.")
            continue
        outside = not design.low <= value <= design.high
        meant = _number(key, design.value, shown["quality_factor"])
        if key == "static_gain" and case.words.design[key] == "m/(N)":  # a length for a force: 1/(mass ω²)
            own = omega if case.design["resonance"].unknown else case.design["resonance"].value
            seen = f"{seen} m/N (a mass of {1.0 / (value * omega**2):.4g} kg)"
            meant = f"{meant} ({1.0 / (design.value * own**2):.4g} kg)"
        if _of_import(case, key) and not outside:
            said.append(f"{key}: the records show {seen}{'' if seen == meant else f', `import` wrote {meant}'}.")
            continue
        beside = "as `[design]` has it" if seen == meant else f"the design {meant}"
        text = f"{key}: the records show {seen}, {beside}"
        agrees = _scale_that_agrees(case, value / design.value) if key == "static_gain" and outside else ""
        said.append(text + (f", which lies outside its tolerance{agrees}." if outside else "."))
    said += said_of_peaks(rows, omega, float(device.damping[0]), case)
    return (*said, *_phases(_weakest(case, True), QUANTITIES[case.readout.order], omega, float(device.damping[0])))


def _scale_that_agrees(case: Case, ratio: float) -> str:
    """Which scale of the case, within what it is known to, would give a gain that is `ratio` times that of the design;
    empty where none would.
    """
    drive, readout = case.drive, case.readout
    of_drive = drive.tolerance if drive is not None and drive.scale is not None else 0.0
    if abs(np.log(ratio)) > _SURE * np.hypot(of_drive, readout.tolerance):
        return ""
    if drive is not None and drive.scale is not None and of_drive >= readout.tolerance:
        right = f"a drive of {drive.scale * ratio:.4g} N/{drive.unit}"
    else:
        right = f"a read-out of {readout.scale * ratio:.4g} {readout.unit}/{case.words.displacement}"
    return f": {right}, within its tolerance, would agree with it; what is told in newtons is by the scales as written"


def _of_import(case: Case, key: str) -> bool:
    """Whether a number of the design is one that `import` wrote from decays: nobody knew it beforehand."""
    design, spread = case.design[key], SPREADS.get(key)
    if spread is None or not case.description.startswith("imported from"):
        return False
    return bool(np.allclose([design.low * spread, design.high / spread], design.value, rtol=1e-12, atol=0.0))


def _number(key: str, value: float, quality_factor: float) -> str:
    """A resonance to a hundredth of its width."""
    digits = min(max(4, int(np.ceil(np.log10(max(quality_factor, 1.0)))) + 2), _DIGITS)
    if key == "quality_factor" and value > _NO_WIDTH:
        return "no width of the resonance (are the levels of the drives right?)"
    return spoken(value / (2.0 * np.pi), "Hz", digits) if key == "resonance" else f"{value:.4g}"


def _too_narrow(rows: list[Phasors], width: float) -> float:
    """The band [Hz] that rows cover where it is far narrower than the width [rad/s] of the resonance that explains them
    best; zero elsewhere.
    """
    places = np.concatenate([row.omega for row in rows])
    return float(np.ptp(places)) / (2.0 * np.pi) * float(np.ptp(places) < _PART * width)


def _weakest(case: Case, read: bool = False) -> list[Phasors]:
    """The rows of the records that are driven least, which bend least; of those alone whose phasors were `read`, as the
    lines of a record over time are spectra under a window.
    """
    records = [r for r in in_one_place(case.environment, case.records) if not read or np.iscomplexobj(r.readings)]
    offered = [record.starting_phasors(case) for record in records]
    rows = [one for one in offered if one is not None and np.any(one.force[:, 0])]
    levels = [float(np.max(np.abs(one.force[:, 0]))) for one in rows]
    return [one for one, level in zip(rows, levels, strict=True) if level <= _ALIKE * min(levels, default=0.0)]


def _phases(rows: list[Phasors], read: str, omega: float, width: float) -> list[str]:
    """A sentence where rows aside of the resonance are turned against those of a resonator."""
    gains = [np.zeros(0, complex)]
    for one in rows:
        if one.modulus:  # a phase of zero stands there for none
            continue
        away = omega**2 - one.omega**2
        far = (np.abs(away) > _FAR * omega * width) & (np.abs(one.force[:, 0]) > 0)
        gains.append(((away + 1j * one.omega * width) * one.motion[:, 0])[far] / one.force[far, 0])
    every = np.concatenate(gains)
    turned = (
        np.median(every.real) + 1j * np.median(every.imag) if every.size else 0.0
    )  # which a wrong row does not move
    angle = float(np.degrees(np.angle(turned)))
    if turned == 0 or min(abs(angle), 180.0 - abs(angle)) < _OFF:
        return []
    angle -= 180.0 * np.sign(angle) * (abs(angle) > 90.0)
    article = "an" if read.startswith("a") else "a"
    turn = f"turned by about {angle:+.2g}° against {article} {read}"
    cause = "the reference, a delay, or what couples into the read-out; `memsgyro diagnose` tells which"
    return [f"phase: aside of the resonance the weakest sweeps are {turn}: by {cause}."]
