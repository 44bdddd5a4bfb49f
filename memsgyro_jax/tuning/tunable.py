"""What tuning may change of a loop, named by dotted paths as a spread names what varies, and within which bounds.

    free(observer=("noise_density", "process_noise.rate"), filter={"bandwidth": (5.0, 5e3)})

`resolved` finds the numbers that the names mean, `tree` puts them into the tree of `base.transforms` beside the loop.
"""

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy import special

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.display import stated_at
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import excerpt, suggestion
from memsgyro_jax.base.transforms import Free, GaussianPrior, Logit, LogLogit, to_vector
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.operation import run_of


Bounds = tuple[float | str, float | str]
_DECADES = 1e3  # default bounds of a positive number: this factor to both sides
_EDGE = 1e-12  # of the range: nearer to a bound the coordinate stays finite, to go on from there
_NYQUIST = 0.45  # of the sample rate: the most that a filter's bandwidth gets by default


@dataclass(frozen=True)
class Tunable:
    """A number of the loop that may move, or all numbers below a path, within `low`..`high`, SI or text with a unit.

    None leaves a bound to a default. `prior` is (value, factor): what is known beforehand, ln(value) ± ln(factor).
    """

    path: str
    low: float | str | None = None
    high: float | str | None = None
    prior: tuple[float | str, float] | None = None


_FILTERS = ("observer.inner.", "observer.filter.", "observer.")  # where a loop has one; the last begins all of them

Named = str | Tunable
Group = Named | Sequence[Named] | Mapping[str, Bounds | None]


def free(*items: Group, **parts: Group) -> tuple[Tunable, ...]:
    """What `tune` may change: paths from the loop, alone, in lists, or as {path: (low, high)}.

    A keyword names the part of the loop where its paths begin: `filter="bandwidth"` is `"filter.bandwidth"`. A path to
    several numbers, `"observer.noise_density"`, frees each of them; a coefficient may stand by its name,
    `"observer.process_noise.rate"`. Bounds are in SI or text with a unit; without them a positive number may move by a
    factor of 1000, a process noise from next to nothing to a walk of ten prior deviations in a run.
    """
    found = [tunable for group in items for tunable in _spelled(group, "")]
    for part, group in parts.items():
        found += _spelled(group, f"{part}.")
    if not found:
        raise InputError("Argument `free` must name at least one number of the loop, but names none.")
    return tuple(found)


def _spelled(group: Group, prefix: str) -> list[Tunable]:
    if not isinstance(group, str | Tunable | Mapping | Sequence):
        raise InputError(
            'Argument `free` must hold paths such as "observer.noise_density", lists of them, or {path: (low, high)}, '
            f"but holds {excerpt(group)}."
        )
    if isinstance(group, str):
        return [Tunable(prefix + group)]
    if isinstance(group, Tunable):
        return [Tunable(prefix + group.path, group.low, group.high, group.prior)]
    if isinstance(group, Mapping):
        return [Tunable(prefix + path, *(bounds or (None, None))) for path, bounds in group.items()]
    return [tunable for item in group for tunable in _spelled(item, prefix)]


@dataclass(frozen=True)
class Tunables:
    """The free numbers of a loop in the order of its tree: `paths`, `labels` for people, start `values`, bounds `low`
    and `high`, all SI and (n,), and `priors`, value and factor as in `Tunable`, NaN where nothing is known.

    Coordinates are unbounded; a step of one is about a factor e in the middle of the range.
    """

    paths: tuple[str, ...]
    labels: tuple[str, ...]
    values: Float[np.ndarray, " n"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]
    priors: Float[np.ndarray, "n 2"]

    @property
    def coordinates(self) -> Float[np.ndarray, " n"]:
        """Of the start."""
        return special.logit(np.clip(self.places(self.values), _EDGE, 1.0 - _EDGE)) * self._units

    def numbers(self, coordinates: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Values at coordinates."""
        return self.at_places(special.expit(coordinates / self._units))

    def stretch(self, coordinates: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Derivative of the values by the coordinates."""
        place, back = special.expit(coordinates / self._units), special.expit(-coordinates / self._units)
        return np.where(self.logarithmic, self.at_places(place), 1.0) * self._range * place * back / self._units

    @property
    def logarithmic(self) -> Bool[np.ndarray, " n"]:
        """Which numbers move on a logarithmic scale."""
        return self.low > 0.0

    def _scaled(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, values, 1.0)), values)

    @property
    def _range(self) -> Float[np.ndarray, " n"]:
        return self._scaled(self.high) - self._scaled(self.low)

    @property
    def _units(self) -> Float[np.ndarray, " n"]:
        return np.where(self.logarithmic, self._range / 4.0, 1.0)

    def prior(self, coordinates: Float[np.ndarray, " n"]) -> tuple[float, Float[np.ndarray, " n"]]:
        """Negative log-density of what is known beforehand, in nats but for a constant, and its gradient."""
        value, factor = self.priors.T
        known = np.isfinite(value)
        mean = self.starting(np.where(known, value, self.values)).coordinates
        # The prior is one of ln(value); beside it the coordinate is a straight line.
        std = np.where(known, np.log(factor) * value / self.stretch(mean), np.inf)
        away = (coordinates - mean) / std
        return 0.5 * float(np.sum(away**2)), away / std

    def places(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Where values stand between their bounds, 0 to 1, on their own scale."""
        return (self._scaled(values) - self._scaled(self.low)) / self._range

    def at_places(self, places: Float[np.ndarray, "*some n"]) -> Float[np.ndarray, "*some n"]:
        """The values that stand there."""
        logarithmic = self.low * np.exp(np.where(self.logarithmic, places * self._range, 0.0))
        return np.where(self.logarithmic, logarithmic, self.low + places * self._range)

    def applied(self, loop: ClosedLoop, values: Sequence[float] | np.ndarray) -> ClosedLoop:
        """The loop with these values."""
        alike = [_alike(leaf_at(loop, path), value) for path, value in zip(self.paths, values, strict=True)]
        return placed(loop, self.paths, alike)

    def starting(self, values: Float[np.ndarray, " n"]) -> "Tunables":
        """The same numbers, starting at `values`."""
        return replace(self, values=np.asarray(values))

    def chosen(self, which: Sequence[bool], values: Float[np.ndarray, " n"]) -> "Tunables":
        """Some of them, starting at `values`."""
        paths, labels = (tuple(itertools.compress(names, which)) for names in (self.paths, self.labels))
        rows = (np.asarray(row)[np.asarray(which)] for row in (values, self.low, self.high, self.priors))
        return Tunables(paths, labels, *rows)


def resolved(loop: ClosedLoop, named: Group, sample_rate: float, duration: float) -> Tunables:
    """The named numbers of `loop` with their bounds, as `free` takes them; a run has `duration` [s] at `sample_rate`
    [Hz].

    Raises `InputError` for a path that leads nowhere or twice to a number, inverted bounds, a start outside them, or a
    number that needs bounds and has none.
    """
    leaves = jax.tree_util.tree_leaves_with_path(loop)
    place = {_dotted(path): order for order, (path, _) in enumerate(leaves)}
    found: dict[str, tuple[float, ...]] = {}
    for tunable in free(named):
        for path in _numbers_at(loop, tunable.path, place):
            if path in found:
                raise InputError(f"A number must be freed once, but `{tunable.path}` is freed twice.")
            value = float(leaf_at(loop, path))
            low, high = _bounds(loop, path, value, tunable, sample_rate, duration)
            start = low if value == 0.0 and low > 0.0 else value  # "off": as good as its lower bound
            if not low <= start <= high:
                raise InputError(
                    f"The start of `{path}` must lie within its bounds {low:g} to {high:g}, but is {value:g}."
                )
            found[path] = (start, low, high, *_prior(loop, low, high, tunable, path))
    paths = tuple(sorted(found, key=place.__getitem__))
    values, low, high, *priors = np.array([found[path] for path in paths]).T
    return Tunables(paths, tuple(_label(loop, path) for path in paths), values, low, high, np.stack(priors, axis=1))


def numbers_at(loop: ClosedLoop, path: str) -> dict[str, float]:
    """All numbers at or below a path as `free` takes it, by the path of each; raises `InputError` for none."""
    known = [_dotted(at) for at, _ in jax.tree_util.tree_leaves_with_path(loop)]
    return {name: float(leaf_at(loop, name)) for name in _numbers_at(loop, path, known)}


def placed(loop: ClosedLoop, paths: Sequence[str], values: Sequence[Array] | np.ndarray) -> ClosedLoop:
    """The loop with `values` at `paths`, each a number or one per die."""
    return eqx.tree_at(lambda tree: [leaf_at(tree, path) for path in paths], loop, [jnp.asarray(v) for v in values])


def _alike(leaf: Array, value: float) -> Array:
    """The value as an array of the leaf's kind: a strong type in the place of a weak one compiles everything anew."""
    return jnp.asarray(float(value)) if leaf.weak_type else jnp.asarray(np.float64(value))


def _dotted(path: tuple) -> str:
    parts = (getattr(key, "name", None) or str(getattr(key, "idx", getattr(key, "key", ""))) for key in path)
    return ".".join(parts)


def leaf_at(tree: Any, path: str) -> Array:
    """What stands at a dotted path."""
    here = tree
    for part in path.split("."):
        here = here[int(part)] if part.isdigit() else getattr(here, part)
    return here


def _numbers_at(loop: ClosedLoop, path: str, known: Collection[str]) -> list[str]:
    """The paths of all numbers at or below `path`, coefficients by name or position, effects by label or position."""
    names, spelled = loop.observer.model.names, path
    for number, effect in enumerate(loop.device.effects):
        called = f"device.effects.{effect.label.replace(' ', '_')}"
        if path == called or path.startswith(f"{called}."):
            spelled = path.replace(called, f"device.effects.{number}", 1)
    tables = ("process_noise.theta.", "process_noise.", "prior.theta_std.")
    for prefix in (f"{filter_}{table}" for filter_ in _FILTERS for table in tables):
        name = path.removeprefix(prefix)
        if name != path and name in names:
            table = prefix if "theta" in prefix else f"{prefix}theta."
            spelled = f"{table}{names.index(name)}"
            break
    found = [name for name in known if name == spelled or name.startswith(f"{spelled}.")]
    found = [name for name in found if eqx.is_inexact_array(leaf_at(loop, name)) and jnp.ndim(leaf_at(loop, name)) == 0]
    if found:
        return found
    short = [*known, *(f"observer.process_noise.{name}" for name in names)]
    raise InputError(f"What is free must be a number of the loop, but `{path}` is none ({suggestion(path, short)}).")


def _bounds(
    loop: ClosedLoop, path: str, value: float, tunable: Tunable, sample_rate: float, duration: float
) -> tuple[float, float]:
    low, high = _default_bounds(loop, path, value, sample_rate, duration)
    given = zip((low, high), (tunable.low, tunable.high), strict=True)
    low, high = (usual if bound is None else _in_si(loop, path, bound) for usual, bound in given)
    if math.isnan(low) or math.isnan(high):
        raise InputError(f"`{path}` must be given bounds, because it is {value:g} and none follow from that.")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"The bounds of `{path}` must rise, but {low:g} to {high:g} were given.")
    return float(low), float(high)


def _in_si(loop: ClosedLoop, path: str, given: float | str) -> float:
    """What `free` was given for the number at `path`, by its own unit where that is text."""
    unit = stated_at(loop, path)
    if isinstance(given, str) and not unit:
        raise InputError(
            f"`{path}` has no unit that text could name; give it as a number, but {excerpt(given)} was given."
        )
    return quantity(path, given, unit)


def _default_bounds(
    loop: ClosedLoop, path: str, value: float, sample_rate: float, duration: float
) -> tuple[float, float]:
    own = loop.observer.bounds(path.removeprefix("observer."), duration) if path.startswith("observer.") else None
    if own is not None:
        return (own[0] if value == 0.0 else min(own[0], value)), max(own[1], value)
    if not value > 0.0:
        return math.nan, math.nan
    high = value * _DECADES
    return value / _DECADES, max(value, min(high, _NYQUIST * sample_rate)) if path.startswith("filter.") else high


def _prior(loop: ClosedLoop, low: float, high: float, tunable: Tunable, path: str) -> tuple[float, float]:
    if tunable.prior is None:
        return math.nan, math.nan
    value, factor = _in_si(loop, path, tunable.prior[0]), tunable.prior[1]
    if not (low > 0.0 and low < value < high and factor > 1.0):
        raise InputError(
            f"The prior of `{path}` must be a value within its positive bounds and a factor above 1, "
            f"but {value:g}, {factor:g} were given."
        )
    return value, factor


def _label(loop: ClosedLoop, path: str) -> str:
    """The path with a coefficient by its name."""
    head, _, last = path.rpartition(".theta.")
    return f"{head}.{loop.observer.model.names[int(last)]}" if head and last.isdigit() else path


def tree(
    loop: ClosedLoop,
    tunables: Sequence[Tunable],
    *,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
):
    """The tree (`base.transforms`) beside `loop` in which the named numbers are free; arguments as of `resolved`."""
    found = resolved(loop, tunables, *run_of(loop, sample_rate, duration))
    rows = zip(found.low, found.high, *found.priors.T, strict=True)
    free_numbers = dict(zip(found.paths, (_free(*row) for row in rows), strict=True))
    spec = jax.tree_util.tree_map_with_path(lambda path, _: free_numbers.get(_dotted(path)), loop)
    to_vector(loop, spec)
    return spec


def _free(low: float, high: float, value: float, factor: float) -> Free:
    transform = LogLogit(low, high) if low > 0.0 else Logit(low, high)
    if math.isnan(value):
        return Free(transform)
    along = jax.grad(transform.forward)(value) * value
    return Free(transform, GaussianPrior(transform.forward(jnp.asarray(value)), math.log(factor) * along))
