"""The linear part of a model at every rate of a record, from few exact ones."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


_LEFT = 1e-10  # of a propagated state: what an interpolation between nodes may leave
_MANY = 32  # nodes: more than these cost more than the rates themselves, where those are few


class RateNodes(eqx.Module):
    """Rates at which something is made exactly, and how those make it up at the rate of each row.

    A propagator e^{LΔ} is an entire function of the rate: the modes turn into each other by at most the angle rate·Δ,
    and once an interpolation at Chebyshev points has more nodes than the angle has radians, its error falls faster than
    that of any power. Where that would be many, few rates, as of a table in steps, are nodes themselves.

    Args:
        rate: of each node [rad/s].
        weights: of the nodes at each row; a column of ones where all rows have one rate.
    """

    rate: Float[Array, " k"]
    weights: Float[Array, "t k"]

    @classmethod
    def of(cls, rate: np.ndarray, step: float) -> "RateNodes":
        """For rates (t,) [rad/s] that last for steps of `step` seconds each."""
        found, place = np.unique(rate, return_inverse=True)
        most = float(np.max(np.abs(found)))
        count = _enough(most * step)  # of the largest rate alone: experiments that are proposed have the same shapes
        if found.size == 1 or (count > _MANY and found.size < count):
            return cls(jnp.asarray(found), jnp.asarray(np.eye(found.size)[place.ravel()]))
        order = np.arange(count)
        angle, turned = np.pi * (order + 0.5) / count, np.arccos(rate / most)
        share = np.where(order == 0, 1.0, 2.0)[:, None] / count * np.cos(np.outer(order, angle))
        return cls(jnp.asarray(most * np.cos(angle)), jnp.asarray(np.cos(np.outer(turned, order)) @ share))

    @property
    def one(self) -> bool:
        """Whether all rows have the same rate."""
        return self.rate.size == 1

    def at_rows(self, values: Array) -> Array:
        """Values at the nodes (k, ...) as they are at each row (t, ...)."""
        flat = values.reshape(values.shape[0], -1)
        whole = jnp.iscomplexobj(values)
        made = self.weights @ (jnp.concatenate([flat.real, flat.imag], axis=1) if whole else flat)
        made = made[:, : flat.shape[1]] + 1j * made[:, flat.shape[1] :] if whole else made
        return made.reshape(-1, *values.shape[1:])


def mixed(weights: Float[Array, " k"], nodes: Array) -> Array:
    """Values at the nodes (k, n, m) as they are at one row (n, m), of which these are the weights."""
    return jnp.sum(weights[:, None, None] * nodes, axis=0)


def _enough(angle: float) -> int:
    """Nodes that e^{i·angle·x} asks for between −1 and 1: its Chebyshev series falls as (angle/2)ᵏ/k!."""
    half, left, count = max(angle, 1e-9) / 2, math.log(_LEFT / 4), 2
    while count * math.log(half) - math.lgamma(count + 1) > left:
        count += 1
    return count
