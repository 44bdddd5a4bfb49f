"""Fabrication spread: which numbers of a loop differ from die to die, and how.

Die `i` is defined by (seed, i) alone: its place in a scrambled Sobol sequence (or its own random key) does not depend
on how many dies are drawn, in which order or on how many machines.
"""

import abc
import math
import re
from dataclasses import dataclass
from typing import Any, Protocol

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import stats

from memsgyro_jax.base.display import Displayed, Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Scalar, is_concrete
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import Scenario


DEVICE_PREFIX = "device."
_ROUNDING = 1e-13  # smallest eigenvalue of a correlation that a Cholesky decomposition survives


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


class AbstractDistribution(Displayed):
    """Turns a standard normal number into a value around a design value; a new kind gives `value`."""

    def place(self, normal: Float[np.ndarray, " dies"]) -> Float[np.ndarray, " dies"]:
        """Where the dies stand, whatever the design: a function of their standard normal numbers, itself by default."""
        return normal

    @abc.abstractmethod
    def value(self, design: Scalar, place: Float[Array, " dies"]) -> Float[Array, " dies"]:
        """Values of the dies, differentiable by the design value."""


class Normal(AbstractDistribution):
    """Normal about the design value, or about `mean` where one is given, cut at ±`cut` deviations; `relative` to it or
    `std` in its unit.
    """

    relative: float = 0.0
    std: float = 0.0
    cut: float = 4.0
    mean: float | None = None

    def __check_init__(self):
        if not (self.relative >= 0.0 and self.std >= 0.0):
            raise InputError(f"A spread must not be negative, but {self.relative:g}, {self.std:g} were given.")
        if not self.cut > 0.0:
            raise InputError(f"Argument `cut` must be positive, but {self.cut:g} was given.")

    def place(self, normal):
        return stats.truncnorm.ppf(stats.norm.cdf(normal), -self.cut, self.cut)

    def value(self, design, place):
        design = design if self.mean is None else self.mean
        std = self.relative * abs(design) if self.std == 0.0 else jnp.hypot(self.relative * design, self.std)
        return design + place * std


class Uniform(AbstractDistribution):
    """Uniform; `relative` half width about the design value, or from `low` to `high` in its unit."""

    relative: float | None = None
    low: float = math.nan
    high: float = math.nan

    def __check_init__(self):
        missing = [math.isnan(end) for end in (self.low, self.high)]
        if any(missing) if self.relative is None else not all(missing):
            raise InputError("A uniform spread must have either `relative`, or `low` and `high`.")
        if self.relative is not None and not self.relative >= 0.0:
            raise InputError(f"A spread must not be negative, but {self.relative:g} was given.")
        if self.high < self.low:
            raise InputError(f"A uniform spread must have low <= high, but {self.low:g} and {self.high:g} were given.")

    def place(self, normal):
        return stats.norm.cdf(normal)

    def value(self, design, place):
        if self.relative is not None:
            return design * (1.0 + self.relative * (2.0 * place - 1.0))
        return self.low + place * (self.high - self.low)


@dataclass(frozen=True, repr=False)
class Vary(Shown):
    """A number of the loop or scenario and its distribution.

    `path` names it from the loop, like `device.kxx`, `readout.opamp_offset.0`, `start.0`, an effect by number or label,
    like `device.effects.cubic_stiffness_x.strength`, or from the scenario, like `scenario.rate.level`.
    """

    path: str
    distribution: AbstractDistribution

    def read(self, root: "Root") -> Array:
        """The design value; raises `InputError` when the path does not lead to a number."""
        here = self.find(root)
        if not (eqx.is_inexact_array(here) and here.ndim == 0):
            raise InputError(f"A spread must name one number, but `{self.path}` is {type(here).__name__}.")
        return here

    def find(self, root: "Root") -> Any:
        """Whatever stands at the path."""
        here: Any = root
        for part in self.path.split("."):
            try:
                here = here[int(part)] if re.fullmatch(r"\d+", part) else getattr(here, part.replace(" ", "_"))
            except (AttributeError, IndexError, TypeError):
                raise InputError(
                    f"A spread must name a number of the loop, but `{self.path}` has no `{part}`."
                ) from None
        return here


class Root(eqx.Module):
    """Where paths start: the parts of the loop, and the scenario."""

    loop: ClosedLoop
    scenario: Scenario

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.loop, name)


@dataclass(frozen=True, eq=False)
class Points:
    """Dies at chosen places: `normal` (dies, items) in standard deviations, and `noise` (dies,), the number of the die
    whose measurement noise each of them gets.
    """

    normal: Float[np.ndarray, "dies items"]
    noise: Int[np.ndarray, " dies"]

    def __repr__(self) -> str:
        return f"Points of {len(self.normal)} dies"


@dataclass(frozen=True, repr=False)
class Spread(Shown):
    """Independent or correlated variations of a lot; `correlation` is a matrix over `items` of the underlying normal
    numbers.

    `quasi=True` draws a scrambled Sobol sequence (percentiles converge faster), False pseudo-random numbers. With
    `points` nothing is drawn: die i is the i-th of them.
    """

    items: tuple[Vary, ...] = ()
    correlation: tuple[tuple[float, ...], ...] | None = None
    quasi: bool = True
    everywhere: AbstractDistribution | None = None
    points: Points | None = None

    @classmethod
    def relative(cls, std: float, *, quasi: bool = True) -> "Spread":
        """Each physical parameter of the device varies by `std` of itself (normal, independent); zero means identical
        dies.
        """
        return cls(quasi=quasi, everywhere=Normal(relative=std))

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
        # A mass and the stiffness over it are held to a million times different shares: rounding must not let the
        # correlation lose its definiteness.
        values, vectors = np.linalg.eigh(found.covariance / np.outer(std, std))
        joint = (vectors * np.maximum(values, _ROUNDING)) @ vectors.T
        return cls(items, tuple(map(tuple, joint.tolist())), quasi)

    def resolved(self, loop: ClosedLoop) -> tuple[Vary, ...]:
        """The variations, with `everywhere` written out over the device's non-zero parameters that `items` does not
        name.
        """
        if self.everywhere is None:
            return self.items
        named = {item.path for item in self.items}
        device = [f"{DEVICE_PREFIX}{name}" for name in device_numbers(loop)]
        return (*self.items, *(Vary(path, self.everywhere) for path in device if path not in named))

    def draw(self, loop: ClosedLoop, scenario: Scenario, seed: int, dies: np.ndarray) -> "Draw":
        """Dies `dies` (their numbers): loop and scenario with one value per die on a trailing axis, and the values.

        Raises `InputError` when a die would be impossible, a negative mass say.
        """
        drawn = self.at(loop, scenario, self.normal(len(self.resolved(loop)), seed, dies))
        _check_possible(drawn.loop, dies)
        return drawn

    def at(self, loop: ClosedLoop, scenario: Scenario, normal: Float[np.ndarray, "dies items"]) -> "Draw":
        """Dies at given normal numbers, one column per variation; differentiable by the design values in `loop`."""
        root, items = Root(loop, scenario), self.resolved(loop)
        values = [
            jnp.asarray(item.distribution.value(_number(item.read(root)), item.distribution.place(column)))
            for item, column in zip(items, np.asarray(normal).T, strict=True)
        ]
        if items:
            root = eqx.tree_at(lambda r: [item.find(r) for item in items], root, values)
        stack = np.stack if is_concrete(values) else jnp.stack
        table = stack(values, axis=1) if values else np.empty((len(normal), 0))
        return Draw(root.loop, root.scenario, tuple(item.path for item in items), table)

    def normal(self, count: int, seed: int, dies: np.ndarray) -> Float[np.ndarray, "dies items"]:
        """The standard normal numbers, correlated where asked for, that define the dies with these numbers."""
        if self.points is not None:
            return np.asarray(self.points.normal)[dies]
        if count == 0:
            return np.empty((len(dies), 0))
        uniform = self._uniform(count, seed, np.asarray(dies, int))
        normal = stats.norm.ppf(np.clip(uniform, 1e-12, 1.0 - 1e-12))
        if self.correlation is None:
            return normal
        matrix = np.asarray(self.correlation, float)
        if matrix.shape != (count, count):
            raise InputError(
                f"Argument `correlation` must be {count}x{count}, one row per item, but {matrix.shape} was given."
            )
        try:
            return normal @ np.linalg.cholesky(matrix).T
        except np.linalg.LinAlgError:
            raise InputError(
                "Argument `correlation` must be positive definite; lower its off-diagonal entries."
            ) from None

    def noise(self, dies: np.ndarray) -> Int[np.ndarray, " dies"]:
        """The numbers that key the measurement noise of the dies: their own, but for chosen points."""
        return dies if self.points is None else np.asarray(self.points.noise)[dies]

    def _uniform(self, count: int, seed: int, dies: np.ndarray) -> Float[np.ndarray, "dies items"]:
        if not self.quasi:
            return np.stack([np.random.default_rng((seed, int(die))).random(count) for die in dies])
        first, last = int(dies.min()), int(dies.max())
        sequence = stats.qmc.Sobol(count, scramble=True, rng=np.random.default_rng(seed))
        # The very first call must ask for a power of two (scipy warns of lost balance); the sequence is the same
        # however it is cut.
        points = [sequence.random_base2(0)] if first == 0 else [sequence.fast_forward(first).random(0)]
        rest = last - first + 1 - len(points[0])
        return np.concatenate([*points, sequence.random(rest)])[dies - first]


@dataclass(frozen=True)
class Draw:
    """Drawn dies: `loop` and `scenario` with dies as trailing axis, `table` (dies, parameters) of the drawn values."""

    loop: ClosedLoop
    scenario: Scenario
    parameters: tuple[str, ...]
    table: Float[np.ndarray, "dies parameters"]


def device_numbers(loop: ClosedLoop) -> tuple[str, ...]:
    """Names of the device's fields that hold a non-zero number."""
    fields = vars(loop.device)
    return tuple(name for name, value in fields.items() if eqx.is_inexact_array(value) and np.all(np.asarray(value)))


def _number(value: Array) -> Scalar:
    """A Python number, which NumPy and SciPy work with fastest, unless it is traced."""
    return float(value) if is_concrete(value) else value


def _check_possible(loop: ClosedLoop, dies: np.ndarray) -> None:
    try:
        for part in (loop.device, loop.readout, loop.filter):
            getattr(part, "__check_init__", lambda: None)()
    except InputError as error:
        raise InputError(
            f"The spread makes one of the dies {dies[0]} to {dies[-1]} impossible; lower it, or its `cut`. {error}"
        ) from None
