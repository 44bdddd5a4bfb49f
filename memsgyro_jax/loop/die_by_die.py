"""Parts from outside the package, written for one die: in a lot they are mapped over the dies.

The package's own parts compute dies side by side, along a trailing axis, and add up over none of it. Whoever writes a
part need not know of that axis: a mean over the two channels would be one over all dies, unseen.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from memsgyro_jax.base.own_code import is_outside
from memsgyro_jax.device.carried import Effects


def from_outside(*trees: Any) -> bool:
    """Whether a module anywhere in `trees` is of a class from outside the package; effects are mapped wherever they
    act, and do not count.
    """
    return any(True for _ in own_parts(*trees))


def own_parts(*trees: Any) -> Iterator[eqx.Module]:
    """The modules of classes from outside, the outer ones first."""
    return (part for tree in trees for part in _modules(tree) if is_outside(type(part)))


def _modules(tree: Any) -> Iterator[eqx.Module]:
    if isinstance(tree, Effects):
        return
    if isinstance(tree, eqx.Module):
        yield tree
        held = vars(tree)  # a module's own look-up is slow
        inside: Any = (held.get(name) for name in _fields(type(tree)))
    else:
        inside = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, tuple | list) else ()
    for part in inside:
        yield from _modules(part)


@functools.cache
def _fields(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))


def differs(dies: PyTree, one: PyTree) -> PyTree[bool]:
    """Which leaves differ between dies: those with more axes than for `one` die."""
    return jax.tree.map(lambda value, plain: np.ndim(value) > np.ndim(plain), dies, one)


def die_by_die(function: Callable[..., Any], given: tuple, one: tuple) -> Any:
    """`function` of `given`, mapped over the dies that trail in them and in what it returns; `one` is the like of
    `given` for a single die.
    """
    varied, common = eqx.partition(given, differs(given, one))
    return jax.vmap(lambda chosen: function(*eqx.combine(chosen, common)), in_axes=-1, out_axes=-1)(varied)
