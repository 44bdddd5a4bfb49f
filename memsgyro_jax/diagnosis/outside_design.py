"""Numbers of a fitted base device that lie where its design does not expect them."""

import numpy as np

from memsgyro_jax.base.text import beside, said_in
from memsgyro_jax.measurement.case import Case

from .fitted import ParameterEstimate
from .optimum import Optimum


SURE = 3.0  # standard deviations beyond an end of the interval

_Interval = tuple[float, float]


def outside_design(case: Case, optimum: Optimum, scale: float = 1.0) -> tuple[str, ...]:
    """A sentence for each resonance and quality factor of an axis that lies outside what `[design]` declares, by more
    than three standard deviations (times `scale`); none for what it does not declare, or the records do not hold.
    """
    std = np.full(optimum.vector.size, np.inf)
    std[optimum.free] = scale * optimum.std
    axes = 1 if case.device == "resonator" else 2
    damping = 1 if axes == 1 else 3  # place of the first damping, behind the springs
    said = []
    for axis, name in enumerate([""] if axes == 1 else [" of x", " of y"]):
        spring, slowed = float(optimum.vector[axis]), float(optimum.vector[damping + axis])
        if not (spring > 0.0 and slowed > 0.0):
            continue
        hertz, quality = np.sqrt(spring) / (2.0 * np.pi), np.sqrt(spring) / slowed
        for what, value, share, unit, interval in (
            ("resonance", hertz, std[axis] / (2.0 * spring), "Hz", _resonance(case, axis)),
            ("quality factor", quality, std[damping + axis] / slowed, "", _quality(case, axis)),
        ):
            found = ParameterEstimate(what + name, float(value), float(value * share), unit)
            said += [_sentence(found, interval)] if interval is not None and _outside(found, interval) else []
    return tuple(said)


def _outside(found: ParameterEstimate, interval: _Interval) -> bool:
    return bool(max(interval[0] - found.value, found.value - interval[1]) > SURE * found.std)


def _sentence(found: ParameterEstimate, interval: _Interval) -> str:
    told = said_in(f"{beside(found.value, found.std)} ± {found.std:.2g}", found.unit)
    meant = said_in("{:.5g} to {:.5g}".format(*interval), found.unit)
    return f"{found.name}: {told}, where `[design]` has {meant}"


def _resonance(case: Case, axis: int) -> _Interval | None:
    """In Hz, of an axis by itself."""
    if case.device == "resonator":
        ends = _declared(case, "resonance")
        return None if ends is None else (ends[0] / (2.0 * np.pi), ends[1] / (2.0 * np.pi))
    spring, mass = _declared(case, "kxx" if axis == 0 else "kyy"), case.design["mass"]
    if spring is None:
        return None
    low, high = np.sqrt(spring[0] / mass.high), np.sqrt(spring[1] / mass.low)
    return float(low / (2.0 * np.pi)), float(high / (2.0 * np.pi))


def _quality(case: Case, axis: int) -> _Interval | None:
    """Of an axis by itself."""
    if case.device == "resonator":
        return _declared(case, "quality_factor")
    spring, damping = (_declared(case, kind + "xy"[axis] * 2) for kind in "kd")
    if spring is None or damping is None or not damping[0] > 0.0:
        return None
    mass = case.design["mass"]
    return (
        float(np.sqrt(spring[0] * mass.low) / damping[1]),
        float(np.sqrt(spring[1] * mass.high) / damping[0]),
    )


def _declared(case: Case, key: str) -> _Interval | None:
    design = case.design[key]
    return None if design.unknown else (design.low, design.high)
