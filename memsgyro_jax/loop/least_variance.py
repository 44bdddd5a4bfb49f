"""From triangular roots of information to least variances, and the directions that nothing was learnt about.

Columns are scaled before they are inverted: std from 1e-9 m to 1e5 rad²/s² stand side by side in one root.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.concrete import is_concrete


_NULL = 1e-11  # singular values of the scaled information root below this share of the largest carry no information
_TOUCHED = 1e-5  # a quantity takes part in a direction when its (scaled) share is above this


class LeastVariance(NamedTuple):
    """Standard deviations, the covariance at the end, its root at each moment, and the directions without
    information.
    """

    std: Float[Array, "windows quantities *dies"]
    covariance: Float[Array, "quantities quantities *dies"]
    root: Float[Array, "windows *dies quantities quantities"]
    degenerate: tuple[dict[str, float], ...]


def least_variance(roots: Array, scale: Array, names: tuple[str, ...]) -> LeastVariance:
    """What triangular `roots` (windows, *dies, quantities, quantities) of the information say, in units of `scale`."""
    xp = np if is_concrete(roots, scale) else jnp
    roots, scale = xp.asarray(roots), xp.asarray(scale)
    lost = ~xp.all(xp.isfinite(roots), axis=(-2, -1))
    roots = xp.where(lost[..., None, None], np.eye(roots.shape[-1]), roots)
    size = xp.linalg.norm(roots, axis=-2, keepdims=True)
    size = xp.where(size > 0.0, size, 1.0)
    _, singular, turned = xp.linalg.svd(roots / size)
    null = singular < _NULL * singular[..., :1]
    weight = xp.where(null, 0.0, 1.0 / xp.where(null, 1.0, singular))
    unit = scale / size[..., 0, :]
    inverse = xp.swapaxes(turned, -1, -2) * weight[..., None, :] * unit[..., :, None]
    std = xp.linalg.norm(inverse, axis=-1)
    touched = xp.any(null[..., :, None] & (xp.abs(turned) > _TOUCHED), axis=-2)
    std = xp.where(lost[..., None], np.nan, xp.where(touched, np.inf, std))
    covariance = inverse[-1] @ xp.swapaxes(inverse[-1], -1, -2)
    covariance = xp.where(lost[-1][..., None, None], np.nan, covariance)
    directions = _directions(null[-1], turned[-1], unit[-1], names) if xp is np else ()
    return LeastVariance(xp.moveaxis(std, -1, 1), xp.moveaxis(covariance, (-2, -1), (0, 1)), inverse, directions)


def with_slopes(solved: LeastVariance, information: Array, scale: Array) -> tuple[Array, Array]:
    """Standard deviations and covariance with their derivatives: dC = -C dI C, as the (scaled) information moves."""
    moved = information - jax.lax.stop_gradient(information)  # zero, but for its derivative
    root, scaled = solved.root, solved.root / scale[:, None]
    change = -root @ (jnp.swapaxes(scaled, -1, -2) @ moved @ scaled) @ jnp.swapaxes(root, -1, -2)
    variance = jnp.moveaxis(jnp.diagonal(change, axis1=-2, axis2=-1), -1, 1)
    known = jnp.isfinite(solved.std)
    std = jnp.where(known, solved.std + variance / (2.0 * jnp.where(known, solved.std, 1.0)), solved.std)
    return std, solved.covariance + jnp.moveaxis(change[-1], (-2, -1), (0, 1))


def _directions(
    null: np.ndarray, turned: np.ndarray, unit: np.ndarray, names: tuple[str, ...]
) -> tuple[dict[str, float], ...]:
    """Null directions of the first die that has any, each scaled to 1 in its first quantity."""
    affected = np.argwhere(np.any(null, axis=-1))
    if not len(affected):
        return ()
    die = tuple(affected[0])
    found = []
    for vector in turned[die][null[die]]:
        large = np.flatnonzero(np.abs(vector) > _TOUCHED)
        physical = (vector * unit[die])[large]
        found.append({names[i]: float(v / physical[0]) for i, v in zip(large, physical, strict=True)})
    return tuple(found)
