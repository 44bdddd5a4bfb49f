"""The corners of the spread: every parameter at one of its ends at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from scipy import linalg

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario

from ..spread import Points, Spread
from .outputs import Output, mean
from .points import inputs_of, run_at


if TYPE_CHECKING:
    import xarray as xr

ALL = 7  # parameters up to which every corner is run: 128
SHOWN = 5


@dataclass(frozen=True, eq=False)
class Corners(Shown):
    """Outputs at the corners; prints the worst.

    Args:
        outputs, units, inputs: names of outputs, their units, paths of the varied parameters.
        signs: of every corner, ±1 (corners, inputs).
        mean: of each output over the noises of a corner whose die was not lost (outputs, corners); NaN for none.
        worst: of the magnitude over those noises (outputs, corners).
        lost: share of dies lost (corners,).
        complete: whether these are all corners, or a balanced part of them (in which no two parameters go together).
        sigmas, repeats: as they were asked for.
    """

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    inputs: tuple[str, ...]
    signs: Float[np.ndarray, "corners inputs"]
    mean: Float[np.ndarray, "outputs corners"]
    worst: Float[np.ndarray, "outputs corners"]
    lost: Float[np.ndarray, " corners"]
    complete: bool
    sigmas: float
    repeats: int
    settings: Settings

    @property
    def status(self) -> str:
        """A sentence: what was run and what was lost."""
        which = "all" if self.complete else "a balanced part of the"
        lost = round(float(np.sum(self.lost)) * self.repeats)
        return f"{which} {len(self.signs)} corners, {self.repeats} noises each, {lost} dies lost"

    def order(self, output: int) -> np.ndarray:
        """Corners by what was lost there, then by the worst magnitude of an output; the worst first."""
        return np.lexsort((-np.nan_to_num(self.worst[output], nan=np.inf), -self.lost))

    def __repr__(self) -> str:
        lines = [f"Corners at ±{self.sigmas:g} standard deviations: {self.status}"]
        for k, (name, unit) in enumerate(zip(self.outputs, self.units, strict=True)):
            if np.ptp(np.nan_to_num(self.worst[k])) == 0.0:
                lines.append(f"{name}: {np.nanmax(self.worst[k]):.4g} {unit} at every corner")
                continue
            rows = [(f"{name} [{unit}]", "mean", "worst", "lost")]
            for c in self.order(k)[:SHOWN]:
                where = "".join("+" if sign > 0 else "-" for sign in self.signs[c])
                rows.append((f"  {where}", f"{self.mean[k, c]:.4g}", f"{self.worst[k, c]:.4g}", f"{self.lost[c]:.3g}"))
            lines.append(aligned(rows))
        return "\n".join([*lines, f"signs in the order {', '.join(self.inputs)}"])

    def to_xarray(self) -> "xr.Dataset":
        """Dataset over output, corner and input."""
        import xarray as xr

        where = ("output", "corner")
        return xr.Dataset(
            {"mean": (where, self.mean), "worst": (where, self.worst), "lost": ("corner", self.lost),
             "signs": (("corner", "input"), self.signs)},
            coords={"output": list(self.outputs), "input": list(self.inputs), "unit": ("output", list(self.units))},
            attrs={"sigmas": self.sigmas, "repeats": self.repeats, "complete": int(self.complete),
                   **self.settings.as_dict()},
        )  # fmt: skip


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
    """Every varied parameter at +`sigmas` or -`sigmas` standard deviations at once.

    All corners for up to seven parameters; beyond, the rows of a Hadamard matrix and their opposites, in which every
    parameter, and every pair of them, takes all its combinations equally often (Plackett and Burman).

    Args:
        loop, spread, scenario: as in `sweep`.
        sigmas: how far, in standard deviations of the parameter.
        repeats: noises at each corner.
        of: outputs; without, errors of the rate, lost dies, and dies out of tolerance.
        seed: of the noise.
        settings: of the sweep (`sample_rate`, `duration`, `tolerance`, `progress`...).

    Raises:
        InputError: for a spread without variations, `sigmas` or `repeats` that are not positive, a corner that no
            device can have, or settings that `sweep` refuses.
    """
    inputs = inputs_of(loop, spread)
    if not (sigmas > 0.0 and repeats >= 1):
        raise InputError(f"Arguments `sigmas` and `repeats` must be positive, but are {sigmas:g} and {repeats}.")
    signs, complete = signs_of(len(inputs))
    points = Points(np.repeat(sigmas * signs, repeats, axis=0), np.tile(np.arange(repeats), len(signs)))
    lot, chosen, values = run_at(points, loop, spread, scenario, of=of, seed=seed, **settings)
    found = values.reshape(len(chosen), len(signs), repeats)
    status = np.asarray(lot.data["status"]).reshape(len(signs), repeats)
    largest = np.max(np.where(np.isfinite(found), np.abs(found), -np.inf), axis=-1)
    return Corners(
        outputs=tuple(o.name for o in chosen),
        units=tuple(o.unit for o in chosen),
        inputs=inputs,
        signs=signs,
        mean=mean(found),
        worst=np.where(np.isfinite(largest), largest, np.nan),
        lost=np.mean(status != 0, axis=1),
        complete=complete,
        sigmas=sigmas,
        repeats=repeats,
        settings=lot.settings,
    )


def signs_of(count: int) -> tuple[Float[np.ndarray, "corners count"], bool]:
    """Signs of the corners of `count` parameters, and whether these are all of them."""
    if count <= ALL:
        return np.array(np.meshgrid(*[[-1.0, 1.0]] * count, indexing="ij")).reshape(count, -1).T, True
    size = 1 << int(np.ceil(np.log2(count + 1)))
    part = linalg.hadamard(size).astype(float)[:, 1 : count + 1]
    return np.concatenate([part, -part]), False
