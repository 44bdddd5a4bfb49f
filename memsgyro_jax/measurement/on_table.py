"""A driven model on a table whose rate changes from step to step: the linear part exactly at the rate of every step."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex

from memsgyro_jax.base.linalg import at_place, product

from .envelope import Course, Driven, Propagator, among_velocities, state_units
from .model import Conditions
from .rate_nodes import RateNodes


class OnTable(eqx.Module):
    """As `Driven`, its linear part at some rates, and the rate of every step between them.

    A row may last for many beats between the drive and a mode: what a new rate couples into that mode turns all the
    while, and is no remainder that goes straight from one end of a step to the other. Harmonics 0 and 2, far from all
    modes, stay with the rate of the first node.

    Args:
        driven: with the linear part (k, n, n), (k, n, axes) at every node.
        rates: of the steps.
    """

    driven: Driven
    rates: RateNodes

    @property
    def force(self) -> Complex[Array, " axes"]:
        """The drive [N]."""
        return self.driven.force

    def run(
        self,
        start: Complex[Array, "h n"],
        step: Array,
        conditions: Conditions,
        added: Complex[Array, "t 2 h axes"] | None = None,
    ) -> tuple[Array, Course]:
        """As `Driven.run`."""
        base, changes = self._base, self._changes
        propagate, load = base.propagator(step), base.load

        def advance(state: Array, inputs: tuple) -> tuple[Array, Array]:
            (power, first, change), now, more = inputs
            extra = (0.0, 0.0) if more is None else among_velocities(more, base.model.size)
            here = _with_first(propagate, power, first)
            rest = lambda s: base.rest(s, now) - at_place(product(change, s[1]), 1, len(s))  # noqa: E731
            end, *left = here.advance(state, load, rest, extra)
            return end, jnp.stack([end, *left])

        steps = (*self._propagators(step), changes), jax.vmap(base.around)(conditions), added
        return Course.of(start, *jax.lax.scan(advance, start, steps))

    def visited(self, course: Course, step: Array) -> Complex[Array, "t 2 h n"]:
        """As `Driven.visited`."""
        base = self._base
        every = jax.vmap(lambda *own: _with_first(base.propagator(step), *own))(*self._propagators(step))
        return course.visited(every, base.load)

    def demodulated(self, course: Course, step: Array, boxcar: bool = True) -> Complex[Array, "t h n"]:
        """As `Driven.demodulated`."""
        base = self._base
        return base.demodulated(course, step, boxcar, base.operator[1] + self._changes)

    @property
    def _base(self) -> Driven:
        """At the first node."""
        return self._with(jax.tree.map(lambda leaf: leaf[0], self.driven.linear))

    @property
    def _changes(self) -> Array:
        """(t, n, n) what the rate of every step changes in the matrix of the first node."""
        matrix = self.driven.linear[0]
        return self.rates.at_rows(matrix - matrix[0])

    def _with(self, linear: tuple[Array, Array]) -> Driven:
        return eqx.tree_at(lambda driven: driven.linear, self.driven, linear)

    def _propagators(self, step: Array) -> tuple[Array, Array]:
        """e^{LΔ} and Δφ₁(LΔ) of harmonic 1, (t, n, n) each. Δφ₂ tells only how what is left out changes."""
        units = state_units(self.driven.model)
        nodes = jax.vmap(lambda linear: Propagator.of(self._with(linear).operator[1], step, units))(self.driven.linear)
        return self.rates.at_rows(nodes.exponential), self.rates.at_rows(nodes.first)


def _with_first(propagate: Propagator, power: Array, first: Array) -> Propagator:
    """With others for harmonic 1."""
    pairs = (propagate.exponential, power), (propagate.first, first)
    made = tuple(jnp.concatenate([every[:1], own[None], every[2:]]) for every, own in pairs)
    return eqx.tree_at(lambda p: (p.exponential, p.first), propagate, made)
