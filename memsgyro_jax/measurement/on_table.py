"""A driven model on a table whose rate changes from step to step: the linear part exactly at the rate of every step."""

import equinox as eqx
import jax
from jaxtyping import Array, Complex

from memsgyro_jax.base.linalg import at_place, product, with_entry

from .block_mean import undone
from .envelope import Driven, Propagator, among_velocities, means_and_begins, state_units, steps_from, with_end
from .model import Conditions
from .rate_nodes import RateNodes, mixed


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

    def demodulated(
        self,
        start: Complex[Array, "h n"],
        step: Array,
        conditions: Conditions,
        added: Complex[Array, "t 2 h axes"] | None = None,
        boxcar: bool = True,
    ) -> tuple[Complex[Array, "t h n"], Complex[Array, "t h n"]]:
        """As `Driven.demodulated`."""
        base, nodes = self._base, (*self._nodes(step), self._changes)
        propagate, load, lock_in = base.propagator(step), base.load, base.lock_in(step, boxcar)

        def advance(state: Array, inputs: tuple) -> tuple[Array, Array]:
            weights, back, now, more = inputs
            power, first, change = (mixed(weights, node) for node in nodes)
            extra = (0.0, 0.0) if more is None else among_velocities(more, base.model.size)
            rest = lambda s: _without(base.rest(s, now), change, s)  # noqa: E731
            end, *left = _with_first(propagate, power, first).advance(state, load, rest, extra)
            mean = lock_in.with_first(base.operator[1] + change, back).over(state, end, *left)
            return end, with_end(mean, end)

        # Nodes are mixed in the step itself: for all steps and directions at once they would fill the memory.
        operators = base.operator[1] + self.rates.at_rows(jax.lax.stop_gradient(self._changes))
        steps = self.rates.weights, undone(operators), jax.vmap(base.around)(conditions), added
        return means_and_begins(start, jax.lax.scan(advance, start, steps)[1])

    def visited(self, start: Complex[Array, "t h n"], step: Array, conditions: Conditions) -> Complex[Array, "t 2 h n"]:
        """As `Driven.visited`."""
        base, at_rows = self._base, self.rates.at_rows
        rest = lambda s, now, change: _without(base.rest(s, base.around(now)), change, s)  # noqa: E731
        here = jax.vmap(rest)(start, conditions, at_rows(self._changes))
        every = jax.vmap(lambda *own: _with_first(base.propagator(step), *own))(*map(at_rows, self._nodes(step)))
        return steps_from(every, start, base.load + here)

    @property
    def _base(self) -> Driven:
        """At the first node."""
        return self._with(jax.tree.map(lambda leaf: leaf[0], self.driven.linear))

    @property
    def _changes(self) -> Array:
        """(k, n, n) what the rate of every node changes in the matrix of the first."""
        matrix = self.driven.linear[0]
        return matrix - matrix[0]

    def _with(self, linear: tuple[Array, Array]) -> Driven:
        return eqx.tree_at(lambda driven: driven.linear, self.driven, linear)

    def _nodes(self, step: Array) -> tuple[Array, Array]:
        """e^{LΔ} and Δφ₁(LΔ) of harmonic 1 at every node, (k, n, n) each; Δφ₂ tells only how what is left out
        changes.
        """
        units = state_units(self.driven.model)
        nodes = jax.vmap(lambda linear: Propagator.of(self._with(linear).operator[1], step, units))(self.driven.linear)
        return nodes.exponential, nodes.first


def _without(rest: Complex[Array, "h n"], change: Array, state: Complex[Array, "h n"]) -> Complex[Array, "h n"]:
    """What the linear part leaves out, without what its first node alone would."""
    return rest - at_place(product(change, state[1]), 1, len(state))


def _with_first(propagate: Propagator, power: Array, first: Array) -> Propagator:
    """With others for harmonic 1."""
    made = with_entry(propagate.exponential, 1, power), with_entry(propagate.first, 1, first)
    return eqx.tree_at(lambda p: (p.exponential, p.first), propagate, made)
