"""How a record began, where nobody knows: the start is a nuisance that is solved for where the model stands (variable
projection: Golub and Pereyra, Inverse Problems 19 (2003) R1), so that no fit carries it.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.linalg import inverse


UNSEEN = 1e-12  # of the squared slope by a number, that is its own: less is rounding


def start_that_leaves_least(
    left: Callable[[Array], Array],
    begin: Float[Array, " s"],
    units: Float[Array, " s"],
    *,
    steps: int,
    far: float,
    bent: bool = False,
) -> tuple[Float[Array, " s"], Float[Array, "s r"]]:
    """The start that leaves least, by Gauss and Newton, and the slopes of what is left along `units`.

    Args:
        left: the whitened residual (r,) of a start.
        begin: displacement and velocity to begin with.
        units: of each.
        steps: to take.
        far: the longest, in units.
        bent: whether slopes change with the start: then those of the start that is found are looked at once more.
    """

    def step(start: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        value, slope = jax.vmap(lambda e: jax.jvp(left, (start,), (e,)), out_axes=(None, 0))(jnp.diag(units))
        move = -_solved(slope, value)
        move = move * jnp.minimum(1.0, far / (jnp.sqrt(jnp.sum(move**2)) + 1e-30))
        return start + units * move, (start, slope)

    found, (starts, slopes) = jax.lax.scan(step, begin, None, length=steps + bent)
    return starts[-1] if bent else found, slopes[-1]


def beside_start(left: Float[Array, " r"], slope: Float[Array, "s r"]) -> Float[Array, " r"]:
    """What is left without what another start would change."""
    return left - slope.T @ _solved(slope, left)


def _solved(slope: Float[Array, "s r"], left: Float[Array, " r"]) -> Float[Array, " s"]:
    """Least squares; what the readings do not show, as of an axis that was not recorded, is left alone."""
    square = jnp.sum(slope**2, axis=1)
    size = jnp.sqrt(jnp.where(square > 0, square, 1.0))
    slope = slope / size[:, None]
    return inverse(slope @ slope.T + UNSEEN * jnp.eye(len(slope))) @ (slope @ left) / size


def put_back(white: np.ndarray, waves: np.ndarray) -> np.ndarray:
    """Whitened residuals (pieces, m, channels, parts) with noise in place of what the start of each piece took of them.

    A start takes two numbers of every channel, its part in phase with the vibration and that in quadrature. What is
    left is therefore no white noise near the resonance, though all that was read had nothing else beside the model;
    with new noise there, always the same, it is again.

    Args:
        white: real, of waveforms or of both parts of phasors.
        waves: (pieces, m, channels) what was predicted over its noise, as phasors; zero where rows are not compared.
    """
    one = white.shape[-1] == 1
    turned = np.stack([waves, 1j * waves], axis=-1)  # (pieces, m, channels, 2)
    columns = turned.real[..., None, :] if one else np.stack([turned.real, turned.imag], axis=-2)
    basis, size = np.linalg.qr(np.moveaxis(columns, 2, 1).reshape(*waves.shape[::2], -1, 2))
    drawn = np.random.default_rng(0).standard_normal((*waves.shape[::2], 2))
    drawn = np.where(np.abs(np.diagonal(size, axis1=-2, axis2=-1)) > 0.0, drawn, 0.0)
    more = (basis @ drawn[..., None]).reshape(*waves.shape[::2], waves.shape[1], -1)
    return white + np.moveaxis(more, 1, 2)
