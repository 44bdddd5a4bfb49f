"""What a lock-in makes of each block of a driven motion whose state is slowly varying harmonics."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex

from memsgyro_jax.base.linalg import inverse, solved, with_entry


class BlockMean(eqx.Module):
    """Harmonic by harmonic the mean of the state over a step, and with a `boxcar` (over a whole number of cycles) in
    harmonic 1 also what passes from harmonic 0 and from the conjugate while they change.

    Means of S·e^{ikωt} follow from the equation of motion: L times the mean is the change of S less the load.

    Args:
        operator: L of each harmonic.
        undone: their inverses, without derivatives.
        load: what drives each harmonic.
        omega: of the drive [rad/s].
        step: a block [s].
        boxcar: whether each is a mean over whole cycles.
    """

    operator: Complex[Array, "h n n"]
    undone: Complex[Array, "h n n"]
    load: Complex[Array, "h n"]
    omega: Array
    step: Array
    boxcar: bool = eqx.field(static=True)

    @classmethod
    def of(cls, operator: Array, load: Array, omega: Array, step: Array, boxcar: bool) -> "BlockMean":
        """Of blocks that have one operator (h, n, n)."""
        return cls(operator, undone(operator), load, omega, step, boxcar)

    def with_first(self, operator: Complex[Array, "n n"], back: Complex[Array, "n n"]) -> "BlockMean":
        """With another operator of harmonic 1, and its inverse."""
        made = with_entry(self.operator, 1, operator), with_entry(self.undone, 1, back)
        return eqx.tree_at(lambda mean: (mean.operator, mean.undone), self, made)

    def over(self, start: Array, end: Array, here: Array, there: Array) -> Complex[Array, "h n"]:
        """Of one block, from the states (h, n) at its ends and what the linear part leaves out there."""
        often, turn = 1.0 / self.step, 1.0 / (1j * self.omega)  # complex numbers divide many times as slowly
        change, drift = (end - start) * often, (there - here) * often
        right = change - self.load - 0.5 * (here + there)
        means = [solved(*of_one) for of_one in zip(self.operator, self.undone, right, strict=True)]
        if self.boxcar:
            one, back = self.operator[1], self.undone[1]
            conjugate = solved(jnp.conj(one), jnp.conj(back), change[1] - drift[1] * (turn / 2))
            constant = solved(one, back, change[0] + drift[0] * turn)
            means[1] = means[1] + jnp.conj(conjugate) + 2 * constant
        return jnp.stack(means)


def undone(matrices: Complex[Array, "*t n n"]) -> Complex[Array, "*t n n"]:
    """Inverses, without derivatives."""
    return jax.vmap(inverse)(jax.lax.stop_gradient(matrices))
