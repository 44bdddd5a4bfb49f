"""What is free: a tree beside the values that says, leaf by leaf, what an optimiser may change and within which bounds.

A value tree (a device, a read-out, an observer...) says what *is*. The tree of this module has the same shape and says
what may *move*: a leaf is either `None` (fixed) or a `Free` with a transform to the unbounded line and, where something
is known beforehand, a prior. Fitting and tuning both work on the flat vector that `to_vector` makes of the two trees.

    spec = mark(fixed(bench), lambda b: b.device.quality, Free(Log()))
    vector = to_vector(bench, spec)             # unbounded coordinates of the free leaves
    bench = from_vector(vector, bench, spec)    # back; fixed leaves pass through untouched
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import PyTreeDef
from jaxtyping import Array, Float, PyTree

from .concrete import is_concrete
from .display import Displayed
from .errors import InputError


class Transform(Displayed):
    """A smooth one-to-one map between the admissible interval of a value and the unbounded line."""

    @abc.abstractmethod
    def forward(self, value: Array) -> Array:
        """Unbounded coordinate of a value."""

    @abc.abstractmethod
    def inverse(self, coordinate: Array) -> Array:
        """Value at an unbounded coordinate."""

    @abc.abstractmethod
    def admits(self, value: Array) -> Array | np.ndarray:
        """Whether each element can be represented."""


class Identity(Transform):
    """Any real number: coordinate = value."""

    def forward(self, value: Array) -> Array:
        return value

    def inverse(self, coordinate: Array) -> Array:
        return coordinate

    def admits(self, value: Array) -> Array | np.ndarray:
        return np.isfinite(value) if is_concrete(value) else jnp.isfinite(value)


class Log(Transform):
    """Positive numbers: coordinate = ln(value), so a step of 0.01 is one per cent."""

    def forward(self, value: Array) -> Array:
        return jnp.log(value)

    def inverse(self, coordinate: Array) -> Array:
        return jnp.exp(coordinate)

    def admits(self, value: Array) -> Array:
        return jnp.isfinite(value) & (value > 0)


class Logit(Transform):
    """Numbers strictly between `low` and `high`: coordinate = ln((value - low) / (high - value))."""

    low: Array = eqx.field(converter=jnp.asarray)
    high: Array = eqx.field(converter=jnp.asarray)

    def forward(self, value: Array) -> Array:
        return jnp.log(value - self.low) - jnp.log(self.high - value)

    def inverse(self, coordinate: Array) -> Array:
        return self.low + (self.high - self.low) * jax.nn.sigmoid(coordinate)

    def admits(self, value: Array) -> Array:
        return (value > self.low) & (value < self.high)


class LogLogit(Transform):
    """Positive numbers strictly between `low` and `high`, even on a logarithmic scale: coordinate = logit of the
    position of ln(value).
    """

    low: Array = eqx.field(converter=jnp.asarray)
    high: Array = eqx.field(converter=jnp.asarray)

    def forward(self, value: Array) -> Array:
        # An optimiser that ran to the bound stands on it to rounding; its coordinate must stay finite to go on from
        # there.
        place = jnp.clip(jnp.log(value / self.low) / jnp.log(self.high / self.low), 1e-12, 1 - 1e-12)
        return jnp.log(place) - jnp.log1p(-place)

    def inverse(self, coordinate: Array) -> Array:
        return self.low * jnp.exp(jnp.log(self.high / self.low) * jax.nn.sigmoid(coordinate))

    def admits(self, value: Array) -> Array:
        return (value >= self.low) & (value <= self.high)


class GaussianPrior(Displayed):
    """What is known before the data: a normal distribution of the *coordinate* (of ln(value) under `Log`), mean and
    standard deviation.
    """

    mean: Array = eqx.field(converter=jnp.asarray)
    std: Array = eqx.field(converter=jnp.asarray)


class Free(Displayed):
    """A leaf that may move, through `transform`, optionally held by `prior`."""

    transform: Transform = Identity()
    prior: GaussianPrior | None = None


def fixed(values: PyTree) -> PyTree:
    """The tree beside `values` in which nothing is free."""
    return jax.tree.map(lambda _: None, values)


def mark(spec: PyTree, where: Callable[[PyTree], Any], free: Free | None) -> PyTree:
    """Return `spec` with the leaf (or tuple of leaves) picked by `where` free as given; `None` fixes it again."""
    picked = where(spec)
    leaves = picked if isinstance(picked, tuple) else (picked,)
    return eqx.tree_at(where, spec, (free,) * len(leaves) if isinstance(picked, tuple) else free, is_leaf=_is_spec)


def to_vector(values: PyTree, spec: PyTree) -> Float[Array, " n"]:
    """Unbounded coordinates of every free leaf, one after the other in the order of the tree.

    **Raises:** `InputError` if nothing is free, or (outside jit) if a value lies outside its bounds.
    """
    pairs = _free_leaves(values, spec)
    for name, value, free in pairs:
        admitted = free.transform.admits(value)
        if is_concrete(admitted) and not np.all(admitted):
            raise InputError(
                f"Argument `{name}` must lie within the bounds of its transform {free.transform}, but is {value}."
            )
    parts = [free.transform.forward(value) for _, value, free in pairs]
    if is_concrete(parts):  # in NumPy: a program for every shape of a leaf takes longer
        return jnp.asarray(np.concatenate([np.ravel(part) for part in parts]))
    return jnp.concatenate([jnp.ravel(part) for part in parts])


def from_vector(vector: Float[Array, " n"], values: PyTree, spec: PyTree) -> PyTree:
    """The value tree with its free leaves taken from `vector`; fixed leaves are those of `values`."""
    position = 0
    leaves, treedef = jax.tree.flatten(values)
    if is_concrete(vector):  # sliced in NumPy: a program for every slice takes longer
        vector = np.asarray(vector)
    moved = []
    for leaf, free in zip(leaves, _spec_leaves(spec, treedef), strict=True):
        if free is None:
            moved.append(leaf)
            continue
        size = jnp.size(leaf)
        moved.append(jnp.asarray(free.transform.inverse(vector[position : position + size].reshape(jnp.shape(leaf)))))
        position += size
    return jax.tree.unflatten(treedef, moved)


def prior_residual(vector: Float[Array, " n"], values: PyTree, spec: PyTree) -> Float[Array, " p"]:
    """(coordinate - mean) / std of every free element that has a prior; empty without priors."""
    parts, position = [jnp.zeros(0)], 0
    for _, value, free in _free_leaves(values, spec):
        size = jnp.size(value)
        if free.prior is not None:
            parts.append((vector[position : position + size] - jnp.ravel(free.prior.mean)) / jnp.ravel(free.prior.std))
        position += size
    return jnp.concatenate(parts)


def names(values: PyTree, spec: PyTree) -> tuple[str, ...]:
    """A readable name for each element of the vector, e.g. `device.quality[0]`."""
    out: list[str] = []
    for name, value, _ in _free_leaves(values, spec):
        size = int(jnp.size(value))
        out += [name] if jnp.ndim(value) == 0 else [f"{name}[{i}]" for i in range(size)]
    return tuple(out)


def logarithmic(values: PyTree, spec: PyTree) -> tuple[bool, ...]:
    """Whether each element of the vector is free on a logarithmic scale."""
    return tuple(
        isinstance(free.transform, Log | LogLogit)
        for _, value, free in _free_leaves(values, spec)
        for _ in range(int(jnp.size(value)))
    )


def _is_spec(leaf: Any) -> bool:
    return leaf is None or isinstance(leaf, Free)


def _spec_leaves(spec: PyTree, values: PyTreeDef) -> list[Free | None]:
    try:
        return values.flatten_up_to(spec)
    except (ValueError, TypeError) as error:
        raise InputError(
            "Argument `spec` must have the shape of the values beside it, but has another; "
            "build it with `fixed` and `mark`."
        ) from error


def _free_leaves(values: PyTree, spec: PyTree) -> list[tuple[str, Array, Free]]:
    with_path, treedef = jax.tree_util.tree_flatten_with_path(values)
    spec_leaves = _spec_leaves(spec, treedef)
    pairs = [
        (jax.tree_util.keystr(path).lstrip("."), leaf, free)
        for (path, leaf), free in zip(with_path, spec_leaves, strict=True)
        if free is not None
    ]
    if not pairs:
        raise InputError("Argument `spec` must leave at least one leaf free, but all are fixed.")
    return pairs
