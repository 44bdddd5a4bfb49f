"""A driven model on a table whose rate changes from step to step: the linear part exactly at the rate of every step."""

import equinox as eqx
import jax
from jaxtyping import Array, Complex

from .envelope import Course, Driven, Propagator
from .model import Conditions
from .rate_nodes import RateNodes


class OnTable(eqx.Module):
    """As `Driven`, its linear part at some rates, and the rate of every step between them.

    A row may last for many beats between the drive and a mode: what a new rate couples into that mode would turn all
    the while, and is no remainder that goes straight from one end of a step to the other.

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
        around = jax.vmap(lambda linear, now: self._with(linear).around(now))(self._linear, conditions)

        def advance(state: Array, inputs: tuple) -> tuple[Array, Array]:
            linear, propagate, now, more = inputs
            return self._with(linear).advance(propagate, state, now, more)

        steps = self._linear, self._propagators(step), around, added
        return Course.of(start, *jax.lax.scan(advance, start, steps))

    def visited(self, course: Course, step: Array) -> Complex[Array, "t 2 h n"]:
        """As `Driven.visited`."""
        return course.visited(self._propagators(step), jax.vmap(lambda linear: self._with(linear).load)(self._linear))

    def demodulated(self, course: Course, step: Array, boxcar: bool = True) -> Complex[Array, "t h n"]:
        """As `Driven.demodulated`."""

        def one(linear: tuple[Array, Array], row: Course) -> Array:
            return self._with(linear).demodulated(jax.tree.map(lambda leaf: leaf[None], row), step, boxcar)[0]

        return jax.vmap(one)(self._linear, course)

    @property
    def _linear(self) -> tuple[Array, Array]:
        """The linear part of every step."""
        return jax.tree.map(self.rates.at_rows, self.driven.linear)

    def _with(self, linear: tuple[Array, Array]) -> Driven:
        return eqx.tree_at(lambda driven: driven.linear, self.driven, linear)

    def _propagators(self, step: Array) -> Propagator:
        """Of every step."""
        at_nodes = jax.vmap(lambda linear: self._with(linear).propagator(step))(self.driven.linear)
        return jax.tree.map(self.rates.at_rows, at_nodes)
