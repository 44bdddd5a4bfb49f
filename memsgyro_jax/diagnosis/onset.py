"""From which drive on something unknown shows: up to there the model, fitted to lower drives alone, leaves noise.

A fit to all drives shares what only the strongest show out over all of them, so that it seems to be everywhere.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from memsgyro_jax.base.text import spoken
from memsgyro_jax.measurement.drive_levels import ALIKE, clear_drives

from .drives import FAR, stages
from .fit import CaseFit, beside_case
from .fitted import RecordError, within_gates
from .optimum import optimise


@dataclass(frozen=True, eq=False)
class Onset:
    """A model of lower drives.

    Args:
        fit: the model fitted to them alone, beside every record.
        upto, since: the highest drive that it explains, and the next, in words.
    """

    fit: CaseFit
    upto: str
    since: str

    @property
    def whence(self) -> str:
        """What the base model is that of."""
        return f"the base model is that of the drives up to {self.upto}, which it explains to their noise"


def onset_of(fit: CaseFit) -> Onset | None:
    """The model of a fit, fitted to as many of the lower drives as it explains every reading of to its noise; `None`
    where it explains none, or there is but one.
    """
    case, joint = fit.case, fit.joint
    levels, steps = clear_drives(case), stages(case, joint.fitted)
    unit, found, vector = case.words.force, None, joint.start
    for level, following, step in zip(levels, levels[1:], steps, strict=False):
        lower = optimise(joint, vector, fit.optimum.free, step)
        if lower.chi2 > FAR * lower.dof:
            break
        beside = optimise(joint, lower.vector, lower.free, joint.fitted, max_evaluations=0)
        whole = beside_case(case, joint, replace(beside, converged=lower.converged))
        vector = lower.vector
        # Few rows may miss by the uncertainty of the fit, which more of them end.
        if all(within_gates(_driven_no_harder(whole, level), {})):
            found = Onset(whole, spoken(level, unit), spoken(following, unit))
    return found


def _driven_no_harder(fit: CaseFit, level: float) -> list[RecordError]:
    """How far those rows of sweeps lie from the model that are driven no harder, per record and role."""
    out = []
    sweeps: list[tuple[int, Any]] = [(k, r) for k, r in enumerate(fit.case.records) if hasattr(r, "setting")]
    for number, record in sweeps:
        for role, rows in (("fit", fit.fitted[number]), ("validation", ~fit.fitted[number])):
            values = fit.whitened[number][rows & (record.setting <= (1 + ALIKE) * level)]
            values = values[np.isfinite(values)]
            if values.size:
                out.append(RecordError(record.name, role, values.size, float(values @ values), record.noise_freedom))
    return out
