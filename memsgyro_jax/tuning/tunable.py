"""What tuning may change of a loop, named by dotted paths as a spread names what varies, and within which bounds.

    free(observer=("noise_density", "process_noise.rate"), filter={"bandwidth": (5.0, 5e3)})

`resolved` turns the names into the tree of `memsgyro_jax.base.free` beside the loop.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import suggestion
from memsgyro_jax.base.transforms import Free, GaussianPrior, Logit, LogLogit, to_vector
from memsgyro_jax.loop.loop import ClosedLoop


Bounds = tuple[float, float]
_DECADES = 1e3  # default bounds of a positive number: this factor to both sides
_NYQUIST = 0.45  # of the sample rate: the most that a filter's bandwidth gets by default


@dataclass(frozen=True)
class Tunable:
    """A number of the loop that may move, or all numbers below a path, within `low`..`high`.

    None leaves a bound to a default. `prior` is (value, factor): what is known beforehand, ln(value) ± ln(factor).
    """

    path: str
    low: float | None = None
    high: float | None = None
    prior: tuple[float, float] | None = None


Named = str | Tunable
Group = Named | Sequence[Named] | Mapping[str, Bounds | None]


def free(*items: Group, **parts: Group) -> tuple[Tunable, ...]:
    """What `tune` may change: paths from the loop, alone, in lists, or as {path: (low, high)}.

    A keyword names the part of the loop where its paths begin: `filter="bandwidth"` is `"filter.bandwidth"`. A path to
    several numbers, `"observer.noise_density"`, frees each of them; a coefficient may stand by its name,
    `"observer.process_noise.rate"`. Bounds are in SI; without them a positive number may move by a factor of 1000, a
    process noise from next to nothing to a walk of ten prior deviations in a run.
    """
    found = [tunable for group in items for tunable in _spelled(group, "")]
    for part, group in parts.items():
        found += _spelled(group, f"{part}.")
    if not found:
        raise InputError("Argument `free` must name at least one number of the loop, but names none.")
    return tuple(found)


def _spelled(group: Group, prefix: str) -> list[Tunable]:
    if isinstance(group, str):
        return [Tunable(prefix + group)]
    if isinstance(group, Tunable):
        return [Tunable(prefix + group.path, group.low, group.high, group.prior)]
    if isinstance(group, Mapping):
        return [Tunable(prefix + path, *(bounds or (None, None))) for path, bounds in group.items()]
    return [tunable for item in group for tunable in _spelled(item, prefix)]


@dataclass(frozen=True)
class Tunables:
    """The free numbers of a loop in the order of its tree: `paths`, `labels` for people, the `spec` of
    `memsgyro_jax.base.free`, start `values`, bounds `low` and `high`, all SI and (n,).
    """

    paths: tuple[str, ...]
    labels: tuple[str, ...]
    spec: ClosedLoop = field(repr=False)
    values: Float[np.ndarray, " n"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]
    transforms: tuple[Free, ...] = field(repr=False)

    @property
    def coordinates(self) -> Float[np.ndarray, " n"]:
        """Unbounded coordinates of the start, in which a step of one is about a factor e in the middle of the range."""
        raw = [f.transform.forward(jnp.asarray(v)) for f, v in zip(self.transforms, self.values, strict=True)]
        return np.asarray(raw, float) * self._units

    def numbers(self, coordinates: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Values at unbounded coordinates."""
        raw = np.asarray(coordinates) / self._units
        return np.asarray([f.transform.inverse(u) for f, u in zip(self.transforms, raw, strict=True)])

    def stretch(self, coordinates: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Derivative of the values by the coordinates."""
        raw = np.asarray(coordinates) / self._units
        slopes = [jax.grad(f.transform.inverse)(float(u)) for f, u in zip(self.transforms, raw, strict=True)]
        return np.asarray(slopes) / self._units

    @property
    def _units(self) -> Float[np.ndarray, " n"]:
        return np.where(self.logarithmic, np.log(self.high / np.where(self.logarithmic, self.low, 1.0)) / 4.0, 1.0)

    @property
    def logarithmic(self) -> np.ndarray:
        """Which numbers move on a logarithmic scale."""
        return np.array([isinstance(f.transform, LogLogit) for f in self.transforms])

    def prior(self, coordinates: Float[np.ndarray, " n"]) -> tuple[float, Float[np.ndarray, " n"]]:
        """Negative log-density of what is known beforehand, in nats but for a constant, and its gradient."""
        raw, value, slope = np.asarray(coordinates) / self._units, 0.0, np.zeros(len(self.paths))
        for i, free_number in enumerate(self.transforms):
            if free_number.prior is not None:
                away = (raw[i] - float(free_number.prior.mean)) / float(free_number.prior.std)
                value, slope[i] = value + 0.5 * away**2, away / float(free_number.prior.std) / self._units[i]
        return value, slope

    def places(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Where values stand between their bounds, 0 to 1, on their own scale."""
        log = self.logarithmic
        safe = [np.log(np.where(log, v, 1.0)) for v in (values, self.low, self.high)]
        straight = (values - self.low) / (self.high - self.low)
        return np.where(log, (safe[0] - safe[1]) / np.where(log, safe[2] - safe[1], 1.0), straight)

    def grid(self, index: int, count: int) -> Float[np.ndarray, " count"]:
        """`count` values from bound to bound, even on the number's own scale."""
        inside = (np.arange(count) + 0.5) / count
        if self.logarithmic[index]:
            return self.low[index] * (self.high[index] / self.low[index]) ** inside
        return self.low[index] + inside * (self.high[index] - self.low[index])

    def applied(self, loop: ClosedLoop, values: Sequence[float] | np.ndarray) -> ClosedLoop:
        """The loop with these values."""
        alike = [_alike(_at(loop, path), value) for path, value in zip(self.paths, values, strict=True)]
        return placed(loop, self.paths, alike)

    def chosen(self, which: Sequence[bool], values: np.ndarray) -> "Tunables":
        """Some of them, starting at `values`."""
        keep = [i for i, use in enumerate(which) if use]
        pick = lambda items: tuple(items[i] for i in keep)  # noqa: E731
        return Tunables(
            pick(self.paths), pick(self.labels), self.spec, np.asarray(values)[keep], self.low[keep], self.high[keep],
            pick(self.transforms),
        )  # fmt: skip


def resolved(loop: ClosedLoop, tunables: Sequence[Tunable], sample_rate: float, duration: float) -> Tunables:
    """The named numbers of `loop` with their bounds; a run has `duration` [s] at `sample_rate` [Hz].

    Raises `InputError` for a path that leads nowhere or twice to a number, inverted bounds, a start outside them, or a
    number that needs bounds and has none.
    """
    leaves, treedef = jax.tree_util.tree_flatten_with_path(loop)
    place = {_dotted(path): order for order, (path, _) in enumerate(leaves)}
    found: dict[int, tuple[str, float, Free, Bounds]] = {}
    for tunable in tunables:
        for path in _numbers_at(loop, tunable.path, place):
            value, order = float(_at(loop, path)), place[path]
            if order in found:
                raise InputError(f"A number must be freed once, but `{tunable.path}` is freed twice.")
            low, high = _bounds(loop, path, value, tunable, sample_rate, duration)
            start = low if value == 0.0 and low > 0.0 else value  # "off": as good as its lower bound
            if not low <= start <= high:
                raise InputError(
                    f"The start of `{path}` must lie within its bounds {low:g} to {high:g}, but is {value:g}."
                )
            found[order] = (path, start, _free(low, high, tunable, path), (low, high))
    spec_leaves = [found[i][2] if i in found else None for i in range(len(leaves))]
    rows = [found[i] for i in sorted(found)]
    return Tunables(
        paths=tuple(row[0] for row in rows),
        labels=tuple(_label(loop, row[0]) for row in rows),
        spec=jax.tree.unflatten(treedef, spec_leaves),
        values=np.array([row[1] for row in rows]),
        low=np.array([row[3][0] for row in rows]),
        high=np.array([row[3][1] for row in rows]),
        transforms=tuple(row[2] for row in rows),
    )


def placed(loop: ClosedLoop, paths: Sequence[str], values: Sequence[Array] | np.ndarray) -> ClosedLoop:
    """The loop with `values` at `paths`, each a number or one per die."""
    return eqx.tree_at(lambda tree: [_at(tree, path) for path in paths], loop, [jnp.asarray(v) for v in values])


def _alike(leaf: Array, value: float) -> Array:
    """The value as an array of the leaf's kind: a strong type in the place of a weak one compiles everything anew."""
    return jnp.asarray(float(value)) if leaf.weak_type else jnp.asarray(np.float64(value))


def _dotted(path: tuple) -> str:
    parts = (getattr(key, "name", None) or str(getattr(key, "idx", getattr(key, "key", ""))) for key in path)
    return ".".join(parts)


def _at(tree: Any, path: str) -> Array:
    here = tree
    for part in path.split("."):
        here = here[int(part)] if part.isdigit() else getattr(here, part)
    return here


def _numbers_at(loop: ClosedLoop, path: str, known: Mapping[str, int]) -> list[str]:
    """The paths of all numbers at or below `path`, coefficients by name or position."""
    names, spelled = loop.observer.model.names, path
    for prefix in ("observer.process_noise.theta.", "observer.process_noise.", "observer.prior.theta_std."):
        name = path.removeprefix(prefix)
        if name != path and name in names:
            table = prefix if "theta" in prefix else f"{prefix}theta."
            spelled = f"{table}{names.index(name)}"
            break
    found = [name for name in known if name == spelled or name.startswith(f"{spelled}.")]
    found = [name for name in found if eqx.is_inexact_array(_at(loop, name)) and jnp.ndim(_at(loop, name)) == 0]
    if found:
        return found
    short = [*known, *(f"observer.process_noise.{name}" for name in names)]
    raise InputError(f"What is free must be a number of the loop, but `{path}` is none ({suggestion(path, short)}).")


def _bounds(
    loop: ClosedLoop, path: str, value: float, tunable: Tunable, sample_rate: float, duration: float
) -> tuple[float, float]:
    low, high = _default_bounds(loop, path, value, sample_rate, duration)
    low, high = (low if tunable.low is None else tunable.low), (high if tunable.high is None else tunable.high)
    if math.isnan(low) or math.isnan(high):
        raise InputError(f"`{path}` must be given bounds, because it is {value:g} and none follow from that.")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"The bounds of `{path}` must rise, but {low:g} to {high:g} were given.")
    return float(low), float(high)


def _default_bounds(loop: ClosedLoop, path: str, value: float, sample_rate: float, duration: float) -> Bounds:
    own = loop.observer.bounds(path.removeprefix("observer."), duration) if path.startswith("observer.") else None
    if own is not None:
        return (own[0] if value == 0.0 else min(own[0], value)), max(own[1], value)
    if not value > 0.0:
        return math.nan, math.nan
    high = value * _DECADES
    return value / _DECADES, max(value, min(high, _NYQUIST * sample_rate)) if path.startswith("filter.") else high


def _free(low: float, high: float, tunable: Tunable, path: str) -> Free:
    transform = LogLogit(low, high) if low > 0.0 else Logit(low, high)
    if tunable.prior is None:
        return Free(transform)
    value, factor = tunable.prior
    if not (low > 0.0 and low < value < high and factor > 1.0):
        raise InputError(
            f"The prior of `{path}` must be a value within its positive bounds and a factor above 1, "
            f"but {value:g}, {factor:g} were given."
        )
    # The prior is one of ln(value); beside it the coordinate is a straight line.
    along = jax.grad(transform.forward)(value) * value
    return Free(transform, GaussianPrior(transform.forward(jnp.asarray(value)), math.log(factor) * along))


def _label(loop: ClosedLoop, path: str) -> str:
    """The path with a coefficient by its name."""
    head, _, last = path.rpartition(".theta.")
    return f"{head}.{loop.observer.model.names[int(last)]}" if head and last.isdigit() else path


def tree(loop: ClosedLoop, tunables: Sequence[Tunable], *, sample_rate: float = 100e3, duration: float = 0.1):
    """The tree (`base.transforms`) beside `loop` in which the named numbers are free; arguments as of `resolved`."""
    spec = resolved(loop, tunables, sample_rate, duration).spec
    to_vector(loop, spec)
    return spec
