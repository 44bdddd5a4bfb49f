"""Numbers that are known now, beside those that a transformation traces: checks can only be made of the former."""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from .errors import InputError


Tree = TypeVar("Tree", bound=PyTree)
Number = Float[Array, "*lanes"]


held = jax.jit(jnp.asarray, inline=True)
"""A Python float or NumPy's array as `jnp.asarray` gives it, in half the time."""


def is_concrete(*values: object) -> bool:
    """Whether all values are numbers now, rather than tracers inside a transformation (which cannot be checked)."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))


def settled(tree: Tree) -> Tree:
    """`tree` without its derivatives: under `jax.grad` and `jax.jvp` the numbers themselves, known now; under `vmap`
    and `jit`, where they are not, as it was.
    """

    def one(leaf: object) -> object:
        return jnp.asarray(jax.lax.stop_gradient(leaf)) if isinstance(leaf, jax.core.Tracer) else leaf

    return tree if is_concrete(tree) else jax.tree.map(one, tree)


def at_hand(tree: Tree) -> Tree:
    """`tree` with NumPy's arrays in place of JAX's, on which a single operation takes a tenth of the time, where all of
    its numbers are known now; else as it was.
    """

    def one(leaf: object) -> object:
        return np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf

    return jax.tree.map(one, tree) if is_concrete(tree) else tree


def strong(tree: Tree) -> Tree:
    """The same numbers without JAX's weak types: one written in Python runs through the program of a computed one."""
    known: dict[tuple[object, ...], Array] = {}  # many are zero, or alike

    def one(leaf: object) -> object:
        if not (isinstance(leaf, jax.Array) and leaf.weak_type):
            return leaf
        if isinstance(leaf, jax.core.Tracer):
            return jnp.asarray(leaf, leaf.dtype)
        now = np.asarray(leaf)
        key = now.dtype, now.shape, now.tobytes()
        if key not in known:
            known[key] = held(now)
        return known[key]

    return jax.tree.map(one, tree)


def check_positive(name: str, value: Number) -> None:
    """Raise `InputError` unless every entry is positive and finite; traced values pass."""
    if is_concrete(value) and not np.all(((now := np.asarray(value)) > 0.0) & np.isfinite(now)):
        raise InputError(f"Argument `{name}` must be positive and finite, but {_worst(value)} was given.")


def check_not_negative(name: str, value: Number) -> None:
    """Raise `InputError` unless every entry is zero or positive, and finite; traced values pass."""
    if is_concrete(value) and not np.all(((now := np.asarray(value)) >= 0.0) & np.isfinite(now)):
        raise InputError(f"Argument `{name}` must be finite and not negative, but {_worst(value)} was given.")


def check_finite(name: str, value: Number) -> None:
    """Raise `InputError` where an entry is NaN or infinite; traced values pass."""
    if is_concrete(value) and not np.all(np.isfinite(np.asarray(value))):
        raise InputError(f"Argument `{name}` must be finite, but {_worst(value)} was given.")


def check_positive_definite(name: str, xx: Number, yy: Number, xy: Number) -> None:
    """Raise `InputError` unless the symmetric matrix [[xx, xy], [xy, yy]] is positive definite; traced values pass."""
    if not is_concrete(xx, yy, xy):
        return
    xx, yy, xy = (np.asarray(v, dtype=float) for v in (xx, yy, xy))
    with np.errstate(over="ignore"):
        holds = np.all((xx > 0.0) & (yy > 0.0) & (xx * yy > xy**2) & np.isfinite(xx * yy))
    if not holds:
        raise InputError(
            f"The {name} matrix must be positive definite (xx > 0, yy > 0, xx·yy > xy²), "
            f"but xx = {_worst(xx)}, yy = {_worst(yy)}, xy = {float(np.max(np.abs(xy))):g} was given; "
            "lower the coupling or correct the sign."
        )


def _worst(value: Number) -> str:
    """The entry to complain about: the first that is not finite, else the smallest."""
    entries = np.ravel(np.asarray(value))
    bad = entries[~np.isfinite(entries)]
    return f"{float(bad[0] if bad.size else np.min(entries)):g}"
