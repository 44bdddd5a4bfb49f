"""Fabrication spread: which numbers of a loop differ from die to die, and how.

Die `i` is defined by (seed, i) alone: its place in a scrambled Sobol sequence (or its own random key) does not depend
on how many dies are drawn, in which order or on how many machines.
"""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Protocol

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import special, stats

from memsgyro_jax.base.concrete import at_hand
from memsgyro_jax.base.display import UNITS, Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.linalg import semidefinite_root
from memsgyro_jax.base.text import excerpt, listed
from memsgyro_jax.device.gyro import AbstractGyro, Scalar, is_concrete
from memsgyro_jax.device.sizes import numbers_of, with_sizes
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import Scenario

from .distributions import AbstractDistribution as AbstractDistribution
from .distributions import AtLeast
from .distributions import Normal as Normal
from .distributions import Uniform as Uniform
from .impossible import cannot_be, why_none
from .vary import DEVICE_PREFIX
from .vary import Root as Root
from .vary import Vary as Vary


_NOISES = ("readout.noise_density", "readout.flicker", "device.temperature")  # paths of what a silent loop has not
_REDRAWS = 16  # of an impossible die
Seed = int | tuple[int, int]  # of a first draw, and of a later one


class Uncertain(Protocol):
    """Numbers of a device by their paths in it, with values and covariance in SI."""

    paths: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray


class HasUncertainty(Protocol):
    """A result that knows how well it holds the numbers of its device."""

    @property
    def uncertainty(self) -> Uncertain:
        """The numbers with their joint uncertainty."""


@dataclass(frozen=True, eq=False)
class Points:
    """Dies at chosen places: `normal` (dies, items) in standard deviations, and `noise` (dies,), the number of the die
    whose measurement noise each of them gets.
    """

    normal: Float[np.ndarray, "dies items"]
    noise: Int[np.ndarray, " dies"]

    def __repr__(self) -> str:
        return f"Points of {len(self.normal)} dies"


def as_spread(given: object) -> "Spread":
    """A spread as it is; raises `InputError` for anything else, a share say."""
    if not isinstance(given, Spread):
        raise InputError(
            'Argument `spread` must be a `Spread`, `mg.Spread.relative("1 %")` say, but is '
            f"{excerpt(given)} of type {type(given).__name__}."
        )
    return given


@dataclass(frozen=True, repr=False)
class Spread(Shown):
    """Independent or correlated variations of a lot; `correlation` is a matrix over `items` of the underlying normal
    numbers, with ones on its diagonal: how wide an item is, its distribution says.

    `quasi=True` draws a scrambled Sobol sequence (percentiles converge faster), False pseudo-random numbers. With
    `points` nothing is drawn: die i is the i-th of them. `shared`, from 0 to below 1, is the correlation that
    `everywhere` has between numbers of one kind (stiffnesses, dampings, masses), which share their causes on a die.

    **Raises:** `InputError` for what is no variation or distribution, and for a number that two of `items` name.
    """

    items: tuple[Vary, ...] = ()
    correlation: tuple[tuple[float, ...], ...] | None = None
    quasi: bool = True
    everywhere: AbstractDistribution | None = None
    points: Points | None = None
    shared: float = 0.0

    def __post_init__(self):
        if self.everywhere is not None and not isinstance(self.everywhere, AbstractDistribution):
            raise InputError(
                f"Argument `everywhere` must be a distribution, but is {self.everywhere!r}; for a relative standard "
                "deviation write `Normal(relative=...)`, or `Spread.relative(...)`."
            )
        if not isinstance(self.items, tuple | list) or not all(isinstance(item, Vary) for item in self.items):
            raise InputError("Argument `items` must be a tuple of `Vary(path, distribution)`.")
        _require_once([(item.path, item.path) for item in self.items])
        if not 0.0 <= self.shared < 1.0:
            raise InputError(f"Argument `shared` must lie from 0 to below 1, but {self.shared:g} was given.")
        if self.correlation is not None:
            matrix = np.asarray(self.correlation, float)
            if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
                raise InputError(f"Argument `correlation` must be a square matrix, but {matrix.shape} was given.")
            semidefinite_root("correlation", matrix)
            _require_ones(np.diag(matrix))

    @classmethod
    def relative(cls, std: float, *, quasi: bool = True, shared: float = 0.0) -> "Spread":
        """Each physical parameter of the device varies by `std` of itself (normal), a coupling by `std` of at least 1 %
        of the main coefficients; zero means identical dies. `shared` is the correlation of numbers of one kind: 0.99
        keeps modes together that are matched by design.
        """
        return cls(quasi=quasi, everywhere=Normal(relative=std), shared=shared)

    @classmethod
    def from_fit(cls, fit: HasUncertainty, *, quasi: bool = True) -> "Spread":
        """Dies as a fit leaves them possible: the numbers of its device, effects included, about the values of the fit
        and with their joint uncertainty. The loop must have the fit's kind of device and its effects.

        Raises `InputError` where the records do not hold a number, which could then be anything.
        """
        found = fit.uncertainty
        variance = np.diag(found.covariance)
        loose = [path for path, size in zip(found.paths, variance, strict=True) if not np.isfinite(size)]
        if loose:
            raise InputError(
                f"A fit must hold every number that is drawn from it, but its records do not hold {', '.join(loose)}; "
                "add a record that does."
            )
        std = np.sqrt(variance)
        items = tuple(
            Vary(f"{DEVICE_PREFIX}{path}", Normal(std=float(size), mean=float(value)))
            for path, size, value in zip(found.paths, std, found.values, strict=True)
        )
        joint = found.covariance / np.outer(std, std)
        return cls(items, tuple(map(tuple, joint.tolist())), quasi)

    @property
    def of_silent(self) -> "Spread":
        """What of it varies in a loop that is `silent`."""
        return self.without(*_NOISES)

    def without(self, *paths: str) -> "Spread":
        """The same but for items whose path begins with one of `paths`."""
        kept = [n for n, item in enumerate(self.items) if not item.path.startswith(paths)]
        joint = None if self.correlation is None else np.asarray(self.correlation)[np.ix_(kept, kept)].tolist()
        return replace(self, items=tuple(self.items[n] for n in kept), correlation=joint and tuple(map(tuple, joint)))

    def resolved(self, loop: ClosedLoop) -> tuple[Vary, ...]:
        """The variations, with `everywhere` written out over the device's numbers that `items` does not name: those
        that are not zero, and couplings. Raises `InputError` for a device that has none, and for a number of an effect
        that two of `items` name, by label and by number.
        """
        _require_once([(item.spelled_out(loop.device), item.path) for item in self.items])
        if self.everywhere is None:
            return self.items
        device, at_design = loop.device, at_hand(loop.device)
        named = {path for item in self.items for path in (item.path, *_instead(device, item.path))}
        sizes = with_sizes(at_design)
        found = [_sized(Vary(name, self.everywhere), at_design, sizes) for name in numbers_of(device)]
        if not found:
            raise InputError(
                f"A relative spread must have numbers of the device to vary, but a {type(device).__name__} has none of "
                "its own; vary the process of a layout, `process.over_etch`."
            )
        return (*self.items, *(item for item in found if item.path not in named))

    def draw(self, loop: ClosedLoop, scenario: Scenario, seed: int, dies: np.ndarray) -> "Draw":
        """Dies `dies` (their numbers): loop and scenario with one value per die on a trailing axis, and the values.

        A die that no device can be, of negative mass say, is drawn again until it is possible: the spread is cut there.
        Raises `InputError` where that does not help, and for an impossible one of chosen `points`.
        """
        items, dies = self.resolved(loop), np.asarray(dies, int)
        normal, redrawn = np.array(self._together(items, seed, dies)), np.zeros(len(dies), int)
        drawn = _drawn(items, loop, scenario, normal)
        bad = cannot_be(drawn.loop, loop)
        for attempt in range(1, 1 + (0 if self.points is not None else _REDRAWS)):
            places = np.flatnonzero(bad)
            if places.size == 0:
                break
            # By die and attempt alone, as the first draw is: the same die in any company.
            normal[places], redrawn[places] = self._together(items, (seed, attempt), dies[places]), attempt
            bad[places] = cannot_be(_drawn(items, loop, scenario, normal[places]).loop, loop)
        if redrawn.any():
            drawn = _drawn(items, loop, scenario, normal)
        if bad.any():
            raise self._impossible(items, loop, scenario, normal[bad][0], dies[bad][0])
        return replace(drawn, normal=normal, redrawn=redrawn)

    def at(self, loop: ClosedLoop, scenario: Scenario, normal: Float[np.ndarray, "dies items"]) -> "Draw":
        """Dies at given normal numbers, one column per variation; differentiable by the design values in `loop`."""
        return _drawn(self.resolved(loop), loop, scenario, normal)

    def normal(self, count: int, seed: Seed, dies: np.ndarray) -> Float[np.ndarray, "dies items"]:
        """The standard normal numbers, correlated where asked for, that define the dies with these numbers."""
        if self.points is not None:
            return np.asarray(self.points.normal)[dies]
        if count == 0:
            return np.empty((len(dies), 0))
        uniform = self._uniform(count, seed, np.asarray(dies, int))
        normal = special.ndtri(np.clip(uniform, 1e-12, 1.0 - 1e-12))
        if self.correlation is None:
            return normal
        matrix = np.asarray(self.correlation, float)
        if matrix.shape != (count, count):
            raise InputError(
                f"Argument `correlation` must be {count}x{count}, one row per item, but {matrix.shape} was given."
            )
        return normal @ semidefinite_root("correlation", matrix).T

    def _together(self, items: tuple[Vary, ...], seed: Seed, dies: np.ndarray) -> Float[np.ndarray, "dies items"]:
        """The standard normal numbers, numbers of one kind by their shared causes."""
        normal = self.normal(len(items), seed, dies)
        if self.shared == 0.0 or self.points is not None:
            return normal
        kinds = [UNITS.get(item.path.rpartition(".")[2]) for item in items]
        own = np.arange(len(items)) >= len(self.items)
        alike = np.equal.outer(kinds, kinds) & np.logical_and.outer(own, own)
        return normal @ np.linalg.cholesky(np.where(alike, self.shared, 0.0) + np.diag(1.0 - self.shared * own)).T

    def noise(self, dies: np.ndarray) -> Int[np.ndarray, " dies"]:
        """The numbers that key the measurement noise of the dies: their own, but for chosen points."""
        return dies if self.points is None else np.asarray(self.points.noise)[dies]

    def _impossible(
        self, items: tuple[Vary, ...], loop: ClosedLoop, scenario: Scenario, row: np.ndarray, die: int
    ) -> InputError:
        """What is said of a die that no device can be, at the normal numbers `row`: of a chosen point where it is, by
        the numbers that one by one are enough for it, or else by all.
        """
        drawn = _drawn(items, loop, scenario, row[None])
        why = why_none(drawn.loop, loop, drawn.parameters)
        if self.points is None:
            return InputError(
                f"The spread makes die {die} impossible however often it is drawn; lower it, or its `cut`. {why}"
            )
        alone = cannot_be(_drawn(items, loop, scenario, np.diag(row)).loop, loop) if len(row) > 1 else np.ones(1, bool)
        chosen = np.flatnonzero(alone) if alone.any() else np.arange(len(row))
        units = [Root(loop, scenario).unit(item.path) for item in items]
        told = [f"`{items[n].path}` = {drawn.table[0, n]:.7g} {units[n]} ({row[n]:+.3g} σ)" for n in chosen]
        return InputError(
            f"The spread has a corner, or another point that was asked for, at which no device can be: {listed(told)}; "
            f"lower the spread, or the number of standard deviations. {why}"
        )

    def _uniform(self, count: int, seed: Seed, dies: np.ndarray) -> Float[np.ndarray, "dies items"]:
        if not self.quasi:
            return np.stack([np.random.default_rng((*np.atleast_1d(seed), int(die))).random(count) for die in dies])
        first, last = int(dies.min()), int(dies.max())
        sequence = stats.qmc.Sobol(count, scramble=True, rng=np.random.default_rng(seed))
        # The very first call must ask for a power of two (scipy warns of lost balance); the sequence is the same
        # however it is cut.
        points = [sequence.random_base2(0)] if first == 0 else [sequence.fast_forward(first).random(0)]
        rest = last - first + 1 - len(points[0])
        return np.concatenate([*points, sequence.random(rest)])[dies - first]


@dataclass(frozen=True)
class Draw:
    """Drawn dies: `loop` and `scenario` with dies as trailing axis, `table` (dies, parameters) of the drawn values from
    their standard normal numbers `normal`, and how often each die was `redrawn` because it was impossible.
    """

    loop: ClosedLoop
    scenario: Scenario
    parameters: tuple[str, ...]
    table: Float[np.ndarray, "dies parameters"]
    normal: Float[np.ndarray, "dies items"]
    redrawn: Int[np.ndarray, " dies"]


def _require_once(named: list[tuple[str, str]]) -> None:
    """Raise `InputError` where two of these numbers are one; each comes with the path by which it was called."""
    count = Counter(number for number, _ in named)
    twice = dict.fromkeys(path for number, path in named if count[number] > 1)
    if twice:
        raise InputError(
            f"Argument `items` must name each number once, but names one twice: {listed(twice, '`')}; keep one of them."
        )


def _require_ones(diagonal: Float[np.ndarray, " items"]) -> None:
    """Raise `InputError` unless these are those of a correlation, not of a covariance, but for rounding."""
    if (wrong := np.flatnonzero(np.abs(diagonal - 1.0) > 1e-6)).size:
        n = wrong[0]
        raise InputError(
            f"Argument `correlation` must have ones on its diagonal, but entry [{n}][{n}] is {diagonal[n]:g}; of a "
            "covariance give the square roots of its diagonal as `std` of the items, and divide rows and columns by "
            "them."
        )


def _drawn(items: tuple[Vary, ...], loop: ClosedLoop, scenario: Scenario, normal: np.ndarray) -> Draw:
    root = Root(loop, scenario)
    values = [
        item.distribution.value(_number(item.read(root)), item.distribution.place(column))
        for item, column in zip(items, np.asarray(normal).T, strict=True)
    ]
    if items:
        root = root.moved(items, values)
    stack = np.stack if is_concrete(values) else jnp.stack
    table = stack(values, axis=1) if values else np.empty((len(normal), 0))
    none = np.zeros(len(normal), int)
    return Draw(root.loop, root.scenario, tuple(item.path for item in items), table, np.asarray(normal), none)


def _sized(item: Vary, device: AbstractGyro, sizes: AbstractGyro) -> Vary:
    """`item` of the device, as an item of the loop: as wide as the coupling that it varies is large."""
    design, size = item.find(device), item.find(sizes)
    path, law = f"{DEVICE_PREFIX}{item.path}", item.distribution
    if is_concrete(design, size):
        return Vary(path, law if float(size) <= abs(float(design)) else AtLeast(law, float(size)))
    return Vary(path, law if size is design else AtLeast(law, size))


def _instead(device: AbstractGyro, path: str) -> list[str]:
    """The paths of the coefficients that do not vary by themselves where `path`, a designer's name, does."""
    names = device.natural.instead if device.natural else {}
    return [f"{DEVICE_PREFIX}{name}" for name in names.get(path.removeprefix(DEVICE_PREFIX), "").split()]


def _number(value: Array) -> Scalar:
    """A Python number, which NumPy and SciPy work with fastest, unless it is traced."""
    return float(value) if is_concrete(value) else value
