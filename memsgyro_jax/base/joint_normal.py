"""Numbers that were found together: what a fit hands on to whatever draws devices from it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


@dataclass(frozen=True, eq=False)
class JointNormal:
    """Values with their joint uncertainty.

    Args:
        paths: of the numbers in a device, dotted, e.g. `kxx` or `effects.cubic_stiffness_x.strength`.
        values: in SI (n,).
        covariance: (n, n); a variance is infinite where the data do not hold a number.
    """

    paths: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of each number (n,)."""
        return np.sqrt(np.diag(self.covariance))

    @classmethod
    def of(
        cls, paths: Sequence[str], device: Callable, vector: np.ndarray, root: np.ndarray, loose: np.ndarray
    ) -> "JointNormal":
        """Of the numbers at `paths` of `device(vector)`, for a vector (k,) with covariance root·rootᵀ, by linear
        propagation; what depends on an entry that is `loose` (k,) is not held, what depends on none is left out.
        """

        def numbers(at: Array) -> Array:
            made = device(at)
            return jnp.stack([number_at(made, path) for path in paths])

        at = jnp.asarray(vector)
        slope = np.asarray(jax.jacfwd(numbers)(at))
        moves = np.any(slope != 0, axis=1)
        kept, slope = [path for path, one in zip(paths, moves, strict=True) if one], slope[moves]
        spread = slope @ root
        covariance = spread @ spread.T
        open_ended = np.any((slope != 0) & loose, axis=1)
        covariance[open_ended, open_ended] = np.inf
        return cls(tuple(kept), np.asarray(numbers(at))[moves], covariance)


def number_at(tree: Any, path: str) -> Array:
    """The number of a device at a path, `kxx` or `effects.rate_bias_drift.strength[2]`."""
    fields, _, index = path.rstrip("]").partition("[")
    found = attrgetter(fields)(tree)
    return found[int(index)] if index else jnp.reshape(found, ())
