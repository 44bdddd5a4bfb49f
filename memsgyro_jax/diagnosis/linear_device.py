"""Resonance and quality factor of a device, also where the model of it leaves more than noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from memsgyro_jax.base.text import beside, said_in
from memsgyro_jax.measurement.drive_levels import clear_drives
from memsgyro_jax.measurement.one_place import nearest_in_words, place_in_words

from .fit import CaseFit
from .fitted import ParameterEstimate, about
from .modes import coupling_estimates, mode_estimates
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
        couplings: of two axes, over the mass.
    """

    modes: tuple[ParameterEstimate, ...]
    whence: str
    held: bool
    outside: tuple[str, ...] = ()
    couplings: tuple[ParameterEstimate, ...] = ()

    @property
    def estimates(self) -> tuple[ParameterEstimate, ...]:
        """The modes, with NaN in place of standard deviations that would say nothing."""
        return self.modes if self.held else tuple(replace(mode, std=np.nan) for mode in self.modes)

    @property
    def told(self) -> tuple[str, ...]:
        """A line for each mode that the records hold, and one for what couples the axes."""
        out = []
        for m in self.modes:
            if m.above is not None and self.held:
                out.append(f"{m.name}: {m.at_least}")
            if not np.isfinite(m.std):
                continue
            out.append(f"{m.name}: {self._said(m)}")
        coupled = [f"{c.name} {self._said(c)}" for c in self.couplings if np.isfinite(c.std)]
        return (*out, f"coupling of the axes: {', '.join(coupled)}") if coupled else tuple(out)

    def _said(self, one: ParameterEstimate) -> str:
        value = f"{beside(one.value, one.std)} ± {one.std:.2g}" if self.held else about(one.value, one.std)
        return said_in(value, one.unit)

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
    around, records, axes = fit.case.environment, fit.case.records, base.model.axes
    if explained:
        there = place_in_words(around, records)
        outside = outside_design(fit.case, fit.optimum, fit.scale)
        if any(mode.above is not None for mode in fit.modes):
            outside = tuple(one + MAYBE_NONE for one in outside)
        coupled = _scaled(coupling_estimates(fit.optimum, axes), fit.scale)
        return LinearDevice(_scaled(fit.modes, fit.scale), f"at {there}" if there else "", True, outside, coupled)
    lowest = lowest_drive(base)
    if lowest is None:
        coupled = _scaled(coupling_estimates(fit.optimum, axes), fit.scale)
        return LinearDevice(_scaled(fit.modes, fit.scale), "", False, couplings=coupled)
    place = nearest_in_words(around, records)
    drive = "of the lowest drive" if len(clear_drives(fit.case)) > 1 else "of the records"
    whence = f"{drive}{f' at {place}' if place else ''} alone"
    scale = 1.0 if lowest.leaves_noise else float(np.sqrt(lowest.chi2 / lowest.dof))
    modes, coupled = (_scaled(told(lowest, axes), scale) for told in (mode_estimates, coupling_estimates))
    return LinearDevice(modes, whence, lowest.leaves_noise, couplings=coupled)


def _scaled(modes: Sequence[ParameterEstimate], scale: float) -> tuple[ParameterEstimate, ...]:
    return tuple(replace(mode, std=scale * mode.std) for mode in modes)
