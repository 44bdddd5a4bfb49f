"""Why what a fit of sweeps tells cannot be trusted, and what would help: another effect, another sweep, less noise."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from memsgyro_jax.measurement.least_squares import gate

from .frequency_sweep import FrequencySweep
from .modal import coupled_poles
from .tree_fit import Fit


CLEAR = 10.0  # of χ², each number counted as the logarithm of the readings: very strong evidence


class Explanation(NamedTuple):
    """What is left of the sweeps with further effects beside two linear modes.

    Args:
        effects: their names.
        chi2, dof: of the fit.
        couplings: (4,) what it tells, as `SeenBench.couplings`.
    """

    effects: tuple[str, ...]
    chi2: float
    dof: int
    couplings: np.ndarray

    @classmethod
    def of(cls, effects: Sequence[str], fit: Fit) -> "Explanation":
        """What a fit with these effects leaves."""
        return cls(tuple(effects), float(fit.chi2), fit.dof, np.asarray(fit.values.couplings))

    @property
    def chi2_per_dof(self) -> float:
        return self.chi2 / self.dof

    @property
    def explains(self) -> bool:
        """Whether noise alone explains what is left."""
        return self.chi2_per_dof <= gate(self.dof)

    def ahead_of(self, other: "Explanation") -> float:
        """By how much its χ² is smaller, less what its further numbers buy by themselves."""
        return other.chi2 - self.chi2 + (self.dof - other.dof) * math.log(max(self.dof, other.dof))


def rivals(
    own: Explanation, std: np.ndarray, known: Sequence[str], fit: Callable[[tuple[str, ...]], Fit]
) -> list[Explanation]:
    """What explains the sweeps as well as the effects that were modelled, with one of them exchanged for another of
    those known, and tells a coupling that lies more than two of its standard deviations `std` (4,) away.
    """
    others = [name for name in known if name not in own.effects]
    if not own.effects or not own.explains:
        return []
    swapped = [tuple(new if e == old else e for e in own.effects) for old in own.effects for new in others]
    tried = [Explanation.of(effects, fit(effects)) for effects in swapped]
    equal = [one for one in tried if one.explains and one.ahead_of(own) > -CLEAR]
    return [one for one in equal if np.any(np.abs(one.couplings - own.couplings) > 2 * std)]


def doubt(
    outcome: Fit,
    sweeps: Sequence[FrequencySweep],
    repairs: Mapping[str, Explanation],
    others: Sequence[Explanation],
    phase_std: float,
) -> str:
    """Why no coefficient of this fit can be trusted, or the empty string."""
    chi2 = float(outcome.chi2_per_dof)
    if chi2 > gate(outcome.dof):
        return f"not trusted: two linear modes miss the record (chi2/dof {chi2:.3g}){_remedy(repairs)}"
    if others:
        names = " or ".join(" and ".join(one.effects) for one in others)
        return f"not trusted: {names} explains these sweeps as well or better; compare what each tells"
    # A flat likelihood keeps the optimiser walking: what is open then is the data, not the method.
    if not phase_std < 30.0 or outcome.open_parameters() or not (bool(outcome.converged) or _covers(outcome, sweeps)):
        return f"not identified by this sweep: {would_help(outcome, sweeps)}"
    return "" if bool(outcome.converged) else "not trusted: the fit did not converge"


def _covers(outcome: Fit, sweeps: Sequence[FrequencySweep]) -> bool:
    """Whether some sweep passes each of both resonances."""
    poles = np.asarray(coupled_poles(outcome.values.device).imag)
    spans = [(float(sweep.frequency.min()), float(sweep.frequency.max())) for sweep in sweeps]
    return all(any(low < pole < high for low, high in spans) for pole in poles)


def would_help(outcome: Fit, sweeps: Sequence[FrequencySweep]) -> str:
    """What would help: the resonance that the sweeps leave out, the electrode that they leave still, else better
    data.
    """
    if not _covers(outcome, sweeps):
        return "sweep both resonances"
    axes = {sweep.axis for sweep in sweeps}
    if len(axes) == 1:
        return f"drive the {'yx'[axes.pop()]} electrode too"
    return "more points or less noise are needed"


def _remedy(repairs: Mapping[str, Explanation]) -> str:
    """The effects of which each explains the record, that which does it best and with the fewest numbers first."""
    cures = {name: one for name, one in repairs.items() if one.explains}
    if not cures:
        return ""
    first, *others = sorted(cures, key=lambda name: -cures[name].ahead_of(next(iter(cures.values()))))
    if not others:
        return f"; add {first}"
    ahead = min(cures[first].ahead_of(cures[name]) for name in others)
    which = f"{first} does it better" if ahead > CLEAR else "compare what each tells"
    return f"; add {first} or {' or '.join(others)} ({which})"
