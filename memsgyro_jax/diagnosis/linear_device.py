"""Resonance and quality factor of a device, also where the model of it leaves more than noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from memsgyro_jax.base.text import beside, said_in
from memsgyro_jax.measurement.drive_levels import clear_drives
from memsgyro_jax.measurement.one_place import nearest_in_words, place_in_words

from .fit import CaseFit
from .fitted import ParameterEstimate, about
from .modes import mode_estimates
from .outside_design import outside_design
from .residual_force import lowest_drive


MAYBE_NONE = " (a mode whose damping is not told may be noise, of records that do not show it)"


@dataclass(frozen=True)
class LinearDevice:
    """The modes of a base device.

    Args:
        modes: frequencies [Hz], then quality factors; with standard deviations as what is left makes them.
        whence: of which records, in words; empty for all.
        held: whether the model leaves noise alone of them, so that the standard deviations say how sure they are.
        outside: a sentence for each number of an axis that lies outside its design.
    """

    modes: tuple[ParameterEstimate, ...]
    whence: str
    held: bool
    outside: tuple[str, ...] = ()

    @property
    def estimates(self) -> tuple[ParameterEstimate, ...]:
        """The modes, with NaN in place of standard deviations that would say nothing."""
        return self.modes if self.held else tuple(replace(mode, std=np.nan) for mode in self.modes)

    @property
    def told(self) -> tuple[str, ...]:
        """A line for each mode that the records hold."""
        out = []
        for m in self.modes:
            if m.above is not None:
                out.append(f"{m.name}: {m.at_least}")
            if not np.isfinite(m.std):
                continue
            value = f"{beside(m.value, m.std)} ± {m.std:.2g}" if self.held else about(m.value, m.std)
            out.append(f"{m.name}: {said_in(value, m.unit)}")
        return tuple(out)

    @property
    def about(self) -> str:
        """Of what they are and why they have no ±, in words; empty where nothing needs to be said."""
        why = "" if self.held else "without ±, as a linear device leaves more than the noise there too"
        return ", ".join(filter(None, (self.whence, why)))


def linear_device(fit: CaseFit, base: CaseFit, *, explained: bool) -> LinearDevice:
    """That of a fit that explains the records; else that of the lowest drive, in the surroundings nearest to those
    declared, fitted to it alone as the base model.

    A model that lacks something is dragged by the drives that show it most.
    """
    around, records = fit.case.environment, fit.case.records
    if explained:
        there = place_in_words(around, records)
        outside = outside_design(fit.case, fit.optimum, fit.scale)
        if any(mode.above is not None for mode in fit.modes):
            outside = tuple(one + MAYBE_NONE for one in outside)
        return LinearDevice(_scaled(fit.modes, fit.scale), f"at {there}" if there else "", True, outside)
    lowest = lowest_drive(base)
    if lowest is None:
        return LinearDevice(_scaled(fit.modes, fit.scale), "", False)
    place = nearest_in_words(around, records)
    drive = "of the lowest drive" if len(clear_drives(fit.case)) > 1 else "of the records"
    whence = f"{drive}{f' at {place}' if place else ''} alone"
    scale = 1.0 if lowest.leaves_noise else float(np.sqrt(lowest.chi2 / lowest.dof))
    return LinearDevice(_scaled(mode_estimates(lowest, base.model.axes), scale), whence, lowest.leaves_noise)


def _scaled(modes: Sequence[ParameterEstimate], scale: float) -> tuple[ParameterEstimate, ...]:
    return tuple(replace(mode, std=scale * mode.std) for mode in modes)
