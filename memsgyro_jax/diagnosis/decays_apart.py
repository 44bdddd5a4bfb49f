"""Records over time that are explained by themselves, at another frequency than the sweeps: two clocks, not a law."""

from dataclasses import replace

import numpy as np

from memsgyro_jax.base.text import beside
from memsgyro_jax.measurement.least_squares import gate

from .drives import without_rows
from .fit import CaseFit
from .fitted import FITTED, within_gates
from .joint_residual import Joint
from .optimum import optimise


SURE = 5.0  # standard deviations of the difference
ALIKE = 0.01  # of a quality factor
WIDTH = 1.0  # of the resonance: what differs by more is another mode, or another device

SAME_CLOCK = (
    "take the reference of one clock for sweeps and for what is recorded over time, and sweep once more behind it, at "
    "its temperature"
)


def decays_apart(fit: CaseFit) -> str:
    """A sentence on each record over time that a linear device explains by itself, where all sweeps are explained;
    empty where there is none.
    """
    records, fine = fit.case.records, dict.fromkeys((e.name for e in fit.errors), True)
    fine |= {e.name: False for e, well in zip(fit.errors, within_gates(fit.errors, {}), strict=True) if not well}
    stepped = [r.name for r in records if r.stepped and r.name in fine]
    left = [k for k, r in enumerate(records) if not fine.get(r.name, True)]
    if not stepped or not all(fine[name] for name in stepped) or any(records[k].stepped for k in left):
        return ""
    found = [alone for k in left if (alone := _alone(fit, k))]
    if not found or len(found) < len(left):
        return ""
    whole = "all sweeps are explained, and so is what was recorded over time, each by itself"
    cause = "another clock, temperature, bias or amplitude there; no law that the sweeps show"
    return f" But {whole}: {'; '.join(found)}. That is {cause}."


def _alone(fit: CaseFit, number: int) -> str:
    """How the device that one record shows by itself differs from that of the fit; empty where it is not explained, or
    does not differ.
    """
    joint, record = fit.joint, fit.case.records[number]
    others = {k: tuple(range(r.rows)) for k, r in enumerate(fit.case.records) if k != number}
    mine = [r for r in joint.readings if np.any(r.record == number)]
    alone = Joint(joint.model, [replace(r, fitted=True) for r in without_rows(mine, others)], joint.programs)
    end = optimise(alone, fit.optimum.vector, alone.base(), alone.fitted)
    if not end.converged or end.chi2 > gate(end.dof, FITTED) * end.dof:
        return ""
    here, there = (_resonances(fit, vector) for vector in (end.vector, fit.optimum.vector))
    axis = int(np.argmax(np.abs(here[0] / there[0] - 1.0)))
    place = [p.name for p in joint.parameters].index("k/m" if len(here[0]) == 1 else f"k{'xy'[axis] * 2}/m")
    spread = [one.std[one.free == place] / (2.0 * one.vector[place]) for one in (end, fit.optimum)]
    off, std = here[0][axis] / there[0][axis] - 1.0, float(np.hypot(*(np.max(s, initial=0.0) for s in spread)))
    if not SURE * std < abs(off) < WIDTH / there[1][axis]:
        return ""
    way = "higher" if off > 0 else "lower"
    ppm = f"{beside(1e6 * abs(off), 1e6 * std)} ± {1e6 * std:.2g} ppm {way}"
    times = here[1][axis] / there[1][axis]
    quality = "the same quality factor" if abs(times - 1.0) < ALIKE else f"{times:.3g} times the quality factor"
    return f"{record.name} with a resonance {ppm} and {quality}"


def _resonances(fit: CaseFit, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [rad/s] of the axes and their quality factors."""
    device = fit.joint.at(vector).device
    axes = fit.joint.model.axes
    omega = np.sqrt(np.asarray(device.stiffness)[:axes])
    return omega, omega / np.asarray(device.damping)[:axes]
