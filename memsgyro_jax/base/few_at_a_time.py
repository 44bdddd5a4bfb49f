"""A function of each row of some arrays, few rows at a time: each few iterate as long as they need, not all as long as
the slowest row.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PyTree


FEW = 16  # rows: fewer gain nothing more, as a step of the loop has its own price


def over_rows(function: Callable[..., Any], *arguments: PyTree) -> PyTree:
    """What `jax.vmap(function)(*arguments)` gives, to the last bit, with arrays (n, ...) for leaves; `None` is none.

    An iteration that is mapped goes on for every row until the last one has ended. On a processor the rows are taken
    `FEW` at a time, one lot after the other; an accelerator, which has room for all, takes all at once.
    """
    count = jax.tree.leaves(arguments)[0].shape[0]
    if count <= FEW or jax.default_backend() != "cpu":
        return jax.vmap(function)(*arguments)
    lots = jax.tree.map(lambda leaf: _in_lots(jnp.asarray(leaf), -count % FEW), arguments)
    _, out = jax.lax.scan(lambda none, some: (none, jax.vmap(function)(*some)), None, lots)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], out)


def _in_lots(leaf: jax.Array, short: int) -> jax.Array:
    """Rows (n, ...) as lots (k, FEW, ...), the last row repeated where some lack."""
    filled = jnp.concatenate([leaf, jnp.repeat(leaf[-1:], short, axis=0)]) if short else leaf
    return filled.reshape(-1, FEW, *leaf.shape[1:])
