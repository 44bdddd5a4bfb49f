"""What the temperature beside a rate log explains of its slow changes, and the noises without that."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from .allan_result import MEANING, Allan, NoiseTerm


if TYPE_CHECKING:
    from .rate_log import RateLog

_PARTS = 64  # of the record: their means are what is slow
_FEWEST = 16  # samples of one
_CHANCE = 1e-4  # that a rate which does not go with the temperature seems to
_TOLD = 0.2  # of the squared slow changes, that the temperature must explain to be worth a word


def beside_temperature(found: Allan, log: "RateLog", again: Callable[["RateLog"], Allan]) -> Allan:
    """The same with a note on each series that goes with the temperature: by how much, and its noises without that.

    Args:
        found: of the log.
        log: with a temperature, or none.
        again: the analysis of another log.
    """
    samples = log.rate.shape[1]
    if log.temperature is None or samples < _PARTS * _FEWEST or not np.ptp(log.temperature) > 0.0:
        return found
    told = [_slope(rate, log.temperature) for rate in log.rate]
    if not any(told):
        return found
    slopes = np.array([one[0] if one else 0.0 for one in told])
    rest = again(log._replace(rate=log.rate - slopes[:, None] * (log.temperature - log.temperature.mean())))
    notes = [_sentence(name, one, rest, k) for k, (name, one) in enumerate(zip(log.names, told, strict=True)) if one]
    return replace(found, notes=(*found.notes, *notes))


def _slope(rate: np.ndarray, temperature: np.ndarray) -> tuple[float, float, float] | None:
    """Rate by temperature [rad/s/K], its standard deviation, and the share of the squared slow changes that it
    explains; `None` where chance would do as well.

    Of changes from part to part: those of a random walk are independent of one another, where its values seem to go
    with anything that is slow as well.
    """
    length = rate.size // _PARTS
    slow = [np.diff(values[: _PARTS * length].reshape(_PARTS, length).mean(axis=1)) for values in (rate, temperature)]
    if not np.any(slow[1]):
        return None
    line = stats.linregress(slow[1], slow[0])
    share = float(line.rvalue) ** 2
    if share < _TOLD or line.pvalue > _CHANCE:
        return None
    return float(line.slope), float(line.stderr), share


def _sentence(name: str, one: tuple[float, float, float], rest: Allan, k: int) -> str:
    unit, factor = MEANING["B"][1:3]
    slope, std, share = one
    without = ", ".join(f"{key} {_spoken(term)}" for key, term in rest.terms[k].items() if key in ("N", "B", "K", "R"))
    return (
        f"`{name}` goes with the temperature, by {factor * slope:.4g} ± {factor * std:.2g} {unit} a kelvin, which is "
        f"{100.0 * share:.2g} % of its slow changes squared; without that: {without} (χ²/dof "
        f"{rest.chi2_per_dof[k]:.3g})."
    )


def _spoken(term: NoiseTerm) -> str:
    return "not told" if term.value is None else f"{term.value:.4g} {term.unit}"
