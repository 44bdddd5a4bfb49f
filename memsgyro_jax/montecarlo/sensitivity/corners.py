"""The corners of the spread: every parameter at one of its ends at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import linalg

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario

from ..spread import Spread
from .outputs import Output, mean
from .points import inputs_of, repeated, run_at
from .result import Sensitivity


ALL = 7  # parameters up to which every corner is run: 128
SHOWN = 5


@dataclass(frozen=True, eq=False, repr=False)
class Corners(Sensitivity):
    """Outputs at the corners; prints the worst.

    Args:
        signs: of every corner, ±1 (corners, inputs).
        mean: of each output over the noises of a corner whose die was not lost (outputs, corners); NaN for none.
        worst: of the magnitude over those noises (outputs, corners).
        lost: share of dies lost (corners,).
        complete: whether these are all corners, or a balanced part of them (in which no two parameters go together).
        sigmas, repeats: as they were asked for.
    """

    signs: Float[np.ndarray, "corners inputs"]
    mean: Float[np.ndarray, "outputs corners"]
    worst: Float[np.ndarray, "outputs corners"]
    lost: Float[np.ndarray, " corners"]
    complete: bool
    sigmas: float
    repeats: int

    @property
    def status(self) -> str:
        which = "all" if self.complete else "a balanced part of the"
        lost = round(float(np.sum(self.lost)) * self.repeats)
        return f"{which} {len(self.signs)} corners, {self.repeats} noises each, {lost} dies lost"

    def order(self, output: int) -> np.ndarray:
        """Corners by what was lost there, then by the worst magnitude of an output; the worst first."""
        return np.lexsort((-np.nan_to_num(self.worst[output], nan=np.inf), -self.lost))

    def __repr__(self) -> str:
        return f"{super().__repr__()}\nsigns in the order {', '.join(self.inputs)}"

    def _title(self) -> str:
        return f"Corners at ±{self.sigmas:g} standard deviations"

    def _text(self, output: int) -> str:
        name, unit, worst = self.outputs[output], self.units[output], self.worst[output]
        if not np.isfinite(worst).any():
            return f"{name}: every die was lost"
        if np.ptp(np.nan_to_num(worst)) == 0.0:
            return f"{name}: {np.nanmax(worst):.4g} {unit} at every corner"
        rows = [(f"{name} [{unit}]", "mean", "worst", "lost")]
        for c in self.order(output)[:SHOWN]:
            where = "".join("+" if sign > 0 else "-" for sign in self.signs[c])
            rows.append((f"  {where}", f"{self.mean[output, c]:.4g}", f"{worst[c]:.4g}", f"{self.lost[c]:.3g}"))
        return aligned(rows)


def corners(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Scenario | AbstractProfile | float = 1.0,
    *,
    sigmas: float = 3.0,
    repeats: int = 4,
    of: Sequence[Output] | None = None,
    seed: int = 0,
    **settings: Any,
) -> Corners:
    """Every varied parameter at +`sigmas` or -`sigmas` standard deviations at once; one that is not normal stands where
    a normal one is as likely to be beyond, which `notes` tell: a uniform one of `sigmas` 3 all but at its ends.

    All corners for up to seven parameters; beyond, the rows of a Hadamard matrix and their opposites, in which every
    parameter, and every pair of them, takes all its combinations equally often (Plackett and Burman).

    Other arguments are those of `tornado`. Raises `InputError` for what that refuses, and for a corner that no device
    can have.
    """
    inputs = inputs_of(loop, spread)
    if not (sigmas > 0.0 and repeats >= 1):
        raise InputError(f"Arguments `sigmas` and `repeats` must be positive, but are {sigmas:g} and {repeats}.")
    signs, complete = signs_of(len(inputs))
    found = run_at(repeated(sigmas * signs, repeats), loop, spread, scenario, of, seed, settings)
    values = found.at_places(repeats)
    largest = np.max(np.where(np.isfinite(values), np.abs(values), -np.inf), axis=-1)
    return Corners(
        **found.told_at(sigmas, loop, spread),
        inputs=inputs,
        signs=signs,
        mean=mean(values),
        worst=np.where(np.isfinite(largest), largest, np.nan),
        lost=found.lost(repeats),
        complete=complete,
        sigmas=sigmas,
        repeats=repeats,
    )


def signs_of(count: int) -> tuple[Float[np.ndarray, "corners count"], bool]:
    """Signs of the corners of `count` parameters, and whether these are all of them."""
    if count <= ALL:
        return np.array(np.meshgrid(*[[-1.0, 1.0]] * count, indexing="ij")).reshape(count, -1).T, True
    size = 1 << int(np.ceil(np.log2(count + 1)))
    part = linalg.hadamard(size).astype(float)[:, 1 : count + 1]
    return np.concatenate([part, -part]), False
