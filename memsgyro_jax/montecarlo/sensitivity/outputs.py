"""The figures of a die whose sensitivity is asked for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.errors import InputError

from .. import batch


DEGREES = 180.0 / np.pi
Rows = Mapping[str, Any]


@dataclass(frozen=True)
class Output:
    """A figure of every die of a sweep.

    Args:
        name: as it is printed.
        unit: in which it is printed.
        of: makes it (dies,) of the rows of a sweep (`rate_error_end`, `rate_error_rms`... in SI, dies on the first
            axis; see `sweep`); NaN for a die that has none.
        factor: from SI to `unit`.
        counts: whether it is 0 or 1, and lost dies have it too.
        of_loop: whether `of` is given the dies' `ClosedLoop`, one value per die in what varies, and no rows: a
            stiffness by the process, `Output("kxx", "N/m", lambda loop: loop.device.made.kxx, of_loop=True)`.
    """

    name: str
    unit: str
    of: Callable[[Any], Float[Array, " dies"]]
    factor: float = 1.0
    counts: bool = False
    of_loop: bool = False


# Made once: a program is compiled for each set of functions that it differentiates.
END = Output("rate error at the end", "deg/s", lambda rows: rows["rate_error_end"], DEGREES)
SETTLED = Output("rms rate error", "deg/s", lambda rows: rows["rate_error_rms"], DEGREES)
LOST = Output("lost", "share", lambda rows: _share(rows[batch.STATUS] == batch.LOST), counts=True)


def outputs(tolerance: float) -> tuple[Output, ...]:
    """What is looked at where nothing else is asked for: errors of the rate, lost dies, and dies whose error at the end
    is beyond `tolerance` [rad/s], lost ones included.
    """

    def missed(rows: Rows) -> Any:
        return _share(~(abs(rows["rate_error_end"]) <= tolerance))

    return END, SETTLED, LOST, Output("out of tolerance", "share", missed, counts=True)


@cache
def mean_error(after: float = 0.5) -> Output:
    """The mean of the rate given out less the true one, from the share `after` of the run on: what a die is off by, of
    its noise only the mean. At a rate of zero it is the zero-rate output. Raises `InputError` for another share than
    one from 0 to below 1.
    """
    if not 0.0 <= after < 1.0:
        raise InputError(f"Argument `after` must be a share of the run, 0 to below 1, but is {after:g}.")

    def mean(rows: Rows) -> Any:
        off = rows["rate_estimate"] - rows["rate_true"]
        return off[:, min(round(after * off.shape[1]), off.shape[1] - 1) :].mean(axis=1)

    return Output("mean rate error", "deg/s", mean, DEGREES)


def values_of(rows: Rows, dies: Callable[[], Any], chosen: Sequence[Output]) -> Float[np.ndarray, "outputs dies"]:
    """Every output of every die in its printed unit, by the rows or by the loop of the `dies`, made when asked for."""
    found = [np.asarray(output.of(dies() if output.of_loop else rows), float) for output in chosen]
    return np.stack(
        [
            output.factor * np.broadcast_to(each, rows[batch.STATUS].shape)
            for output, each in zip(chosen, found, strict=True)
        ]
    )


def mean(values: Float[np.ndarray, "... dies"]) -> Float[np.ndarray, "..."]:
    """Over the dies that have a value; NaN where none has."""
    return np.ma.filled(np.ma.masked_invalid(values).mean(axis=-1), np.nan)


def standard_deviation(values: Float[np.ndarray, "... dies"]) -> Float[np.ndarray, "..."]:
    """Over the dies that have a value; NaN where fewer than two have."""
    return np.ma.filled(np.ma.masked_invalid(values).std(axis=-1, ddof=1), np.nan)


def standard_error(values: Float[np.ndarray, "... dies"]) -> Float[np.ndarray, "..."]:
    """Of that mean."""
    return standard_deviation(values) / np.sqrt(np.maximum(np.sum(np.isfinite(values), axis=-1), 1))


def _share(condition: Any) -> Any:
    return condition.astype(float)
