"""A sweep at chosen points of the spread, which is what every kind of sensitivity is made of."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import special

from memsgyro_jax.base.arguments import refuse_traced
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario, as_scenario

from ..spread import Points, Spread, as_spread
from ..status import LOST
from ..sweep import DEFAULT_TOLERANCE, Lot, sweep
from .outputs import Output, outputs, values_of


_NORMAL = 0.02  # of a step: what the ends of a normal distribution that is cut take off it without a word


class Evaluation(NamedTuple):
    """A lot at chosen points, what was looked at, and the values (outputs, dies) in their printed units."""

    lot: Lot
    chosen: tuple[Output, ...]
    values: Float[np.ndarray, "outputs dies"]

    def at_places(self, repeats: int) -> Float[np.ndarray, "outputs places repeats"]:
        """The values at each of the places that `repeated` has repeated."""
        return self.values.reshape(len(self.chosen), -1, repeats)

    def lost(self, repeats: int) -> Float[np.ndarray, " places"]:
        """The share of dies lost at each of these places."""
        return np.mean(np.asarray(self.lot.data["status"]).reshape(-1, repeats) == LOST, axis=1)

    @property
    def told(self) -> dict[str, Any]:
        """What every result says: names and units of its outputs, settings and notes."""
        names, units = (tuple(getattr(output, part) for output in self.chosen) for part in ("name", "unit"))
        notes = (*self.lot.summary.notes, *self.lot.notes)
        return {"outputs": names, "units": units, "settings": self.lot.settings, "notes": notes}

    def told_at(self, sigmas: float, loop: ClosedLoop, spread: Spread) -> dict[str, Any]:
        """The same of a result with parameters ±`sigmas` standard deviations away, with a note of those of `spread`
        whose steps are none of these.
        """
        told = self.told
        return told | {"notes": (*told["notes"], *not_normal(loop, spread, sigmas))}


def repeated(places: Float[np.ndarray, "places inputs"], repeats: int) -> Points:
    """Each place with the same `repeats` noises."""
    return Points(np.repeat(places, repeats, axis=0), np.tile(np.arange(repeats), len(places)))


def inputs_of(loop: ClosedLoop, spread: Spread) -> tuple[str, ...]:
    """Paths of the varied parameters; raises `InputError` where there is none, and for numbers that are traced."""
    plain = "plain numbers, or map `simulate` over a lot that `Spread.draw` has drawn"
    refuse_traced("A sensitivity is a table of a lot and", plain, loop, spread)
    items = as_spread(spread).resolved(loop)
    if not items:
        raise InputError("Argument `spread` must vary at least one parameter, but varies none.")
    return tuple(item.path for item in items)


def not_normal(loop: ClosedLoop, spread: Spread, sigmas: float) -> tuple[str, ...]:
    """A sentence about the parameters that ±`sigmas` standard deviations are said of, and that stand elsewhere: at the
    same share of a distribution that is not normal; none without any.
    """
    ends = np.array([-sigmas, sigmas])
    items = as_spread(spread).resolved(loop)
    other = [item.path for item in items if not np.allclose(item.distribution.place(ends), ends, rtol=_NORMAL)]
    low, high = (f"{100.0 * share:.4g}" for share in special.ndtr(ends))
    said = f"Of {listed(other, '`')}, not normal or cut near there, ∓{sigmas:g} σ are the {low} and {high} % points."
    return (said,) if other else ()


def run_at(
    points: Points, loop: ClosedLoop, spread: Spread, scenario: Scenario | AbstractProfile | float,
    of: Sequence[Output] | None, seed: int, settings: dict[str, Any],
) -> Evaluation:  # fmt: skip
    """The outputs `of` (without, the default ones) of the dies of `spread` at `points`; `settings` are the sweep's."""
    chosen = tuple(of) if of is not None else outputs(settings.get("tolerance", DEFAULT_TOLERANCE))
    planned = replace(spread, points=points)
    lot = sweep(loop, planned, scenario, dies=len(points.noise), seed=seed, bound_dies=0, **settings)
    drawn = lambda: planned.at(loop, as_scenario(scenario), points.normal).loop  # noqa: E731
    return Evaluation(lot, chosen, values_of(lot.data, drawn, chosen))
