"""What a diagnosis finds: effects that are needed, candidates that were tried, how the error fell, what to measure."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from memsgyro_jax.base.text import beside, said_in

from .fitted import AT_BOUND


NOTHING = " from nothing"  # ends what an experiment decides where no two models are left to be told apart
NOT_HELD = "not held"
VANISHED = 1e-9  # of the largest of several numbers: one that no row holds is left at rounding
SIGMAS_SEEN = 4.45  # strength over its standard deviation that is found nine times in ten among some fifty candidates


@dataclass(frozen=True)
class Accepted:
    """An effect that the model needs.

    Args:
        name, where: as in the catalogue.
        estimate, std: strength and standard deviation, one number each or one per component, in `unit`; NaN in place of
            a standard deviation that is not told, as the model leaves more than noise.
        p_value: of the final model without it.
        error_before, error_after: root mean square of validation residual over noise before and after it was added.
        confused_with: labels of effects that these records cannot tell from it.
        numbers: its further numbers by name: value, standard deviation and unit.
        calibration: share of the strength that the declared tolerances of the scales leave unsure, beside `std`.
        chi2: that the final model would leave more without it, to first order.
        stopped: of each component, whether it stands at its bound, where no standard deviation says how sure it is.
    """

    name: str
    where: str
    estimate: tuple[float, ...]
    std: tuple[float, ...]
    unit: str
    p_value: float
    error_before: float
    error_after: float
    confused_with: tuple[str, ...] = ()
    numbers: Mapping[str, tuple[float, float, str]] = field(default_factory=dict)
    calibration: float = 0.0
    chi2: float = np.nan
    stopped: tuple[bool, ...] = ()

    @property
    def label(self) -> str:
        """Name and variant."""
        return f"{self.name} {self.where}".rstrip()

    @property
    def told_in_unit(self) -> str:
        """All components of the strength with their unit, behind the last one that is held."""
        told, held = list(self.told()), np.flatnonzero(~np.isinf(self.std))
        if held.size:
            told[held[-1]] = said_in(told[held[-1]], self.unit)
        return ", ".join(told)

    def scaled(self, factor: float) -> "Accepted":
        """The same with all standard deviations multiplied."""
        numbers = {name: (value, factor * std, unit) for name, (value, std, unit) in self.numbers.items()}
        return replace(self, std=tuple(factor * s for s in self.std), numbers=numbers)

    def told(self, digits: int = 5) -> tuple[str, ...]:
        """Each component of the strength, for people."""
        ends = self.stopped or (False,) * len(self.estimate)
        least = VANISHED * max(map(abs, self.estimate), default=0.0)
        values = [0.0 if np.isnan(s) and abs(e) <= least else e for e, s in zip(self.estimate, self.std, strict=True)]
        every = zip(values, self.std, ends, strict=True)
        return tuple(f"{e:.3g} {AT_BOUND}" if end else told_with(e, s, digits) for e, s, end in every)


def told_with(value: float, std: float, digits: int = 5) -> str:
    """A number with its standard deviation, as many digits as that leaves it; a number alone with few."""
    if np.isinf(std):
        return NOT_HELD
    return f"{value:.3g}" if np.isnan(std) else f"{beside(value, std, digits)} ± {std:.2g}"


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried beside the final model (in the first round: the base model).

    Args:
        label, unit: of the effect.
        score: χ² it would explain.
        p_value: family-wise.
        explained_share: part of the misfit above noise that it explains.
        kept_share: part of its sensitivity that no other free parameter can take over.
        smallest_visible: strength that would have been found about nine times in ten; infinite where nothing
            shows it, NaN where that model does not explain the records, as only one that does can tell.
        excited: whether the records can show it at all.
    """

    label: str
    unit: str
    score: float
    p_value: float
    explained_share: float
    kept_share: float
    smallest_visible: float
    excited: bool


@dataclass(frozen=True)
class Stage:
    """The fit after one more effect: χ² per degree of freedom of the fitted readings and error of the validation."""

    added: str
    chi2_per_dof: float
    validation_error: float


@dataclass(frozen=True)
class Prospect:
    """A feasible experiment and what it would decide.

    Args:
        experiment: what to do.
        decides: what it would tell, "A from B", or show.
        chi2: expected Δχ² between the two once it is added to the records, everything free refitted; NaN where what it
            would record cannot be predicted.
        shown: how many effects it would show that the records cannot.
        where: how few of its rows hold half of that, and the best of them.
    """

    experiment: str
    decides: str
    chi2: float
    shown: int = 0
    where: str = ""

    @property
    def weaker(self) -> tuple[str, float] | None:
        """Where there is nothing to tell apart: the effect that gains most, and how many times weaker it would show."""
        if not self.decides.endswith(NOTHING):
            return None
        return self.decides.removesuffix(NOTHING), float(np.sqrt(self.chi2)) / SIGMAS_SEEN

    @property
    def told(self) -> str:
        """What it decides, in words."""
        if self.weaker is None:
            return self.decides
        return f"{self.weaker[0]}, {self.weaker[1]:.2g} times weaker" if self.weaker[0] else "nothing new"
