"""How a record began, where nobody knows: the start is a nuisance that is solved for where the model stands (variable
projection: Golub and Pereyra, Inverse Problems 19 (2003) R1), so that no fit carries it.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
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
