"""The motion of a sample integrated to a tolerance: the judge of the other discretisations, and a way through effects
too stiff for them.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from memsgyro_jax.device.carried import each_die
from memsgyro_jax.device.gyro import Pair, Scalar
from memsgyro_jax.device.propagate import AbstractAddition, AbstractDiscretisation, Exact, State4, Transition
from memsgyro_jax.device.small import Matrix

from .own_states import Own, stacked


class Integrated(AbstractDiscretisation):
    """The 8th-order method of Dormand and Prince (diffrax' `Dopri8`) with a step of its own within each sample, under
    the force held there.

    `tolerance` is that of a step, relative to the state; `floor` the absolute one, in m. A die that needs more than
    `steps` steps in a sample is lost, the others are not touched by it. Some hundred times slower than `Exact`.
    """

    tolerance: float = eqx.field(static=True, default=1e-12)
    floor: float = eqx.field(static=True, default=1e-20)
    steps: int = eqx.field(static=True, default=4096)
    linear: Exact = eqx.field(default_factory=Exact)

    def advance(self, motion: State4, push: Pair, stiffness: Matrix, velocity: Matrix, period: Scalar) -> State4:
        """The motion one sample later."""
        return each_die(self._solved, motion, (), push, stiffness, velocity, period, None)[0]

    def extended(
        self, motion: State4, own: Own, push: Pair, stiffness: Matrix, velocity: Matrix, beside: AbstractAddition
    ) -> tuple[State4, Own]:
        """Motion and own states one sample later, the accelerations `beside` followed at every moment."""
        return each_die(self._solved, motion, own, push, stiffness, velocity, beside.period, beside)

    def transition(self, stiffness: Matrix, velocity: Matrix, period: Scalar) -> Transition:
        """That of the linear part, exact."""
        return self.linear.transition(stiffness, velocity, period)

    def _solved(
        self, motion: State4, own: Own, push: Pair, stiffness: Matrix, velocity: Matrix, period: Scalar,
        beside: AbstractAddition | None,
    ) -> tuple[State4, Own]:  # fmt: skip
        """For one die. Velocities are taken over the largest eigenfrequency, time in samples."""
        import diffrax  # here, since whoever does not ask for a reference must not wait for it

        omega = jnp.sqrt(jnp.maximum(jnp.asarray(stiffness[0][0], float), stiffness[1][1]))

        def slope(time: Scalar, state: tuple[Array, Array, Array], _: None) -> tuple[Array, Array, Array]:
            q, v, inner = state[0], omega * state[1], state[2]
            more, rates = ((0.0, 0.0), ()) if beside is None else beside.rates((*q, *v), tuple(inner))
            pushed = [
                push[i] + more[i] - stiffness[i][0] * q[0] - stiffness[i][1] * q[1]
                - velocity[i][0] * v[0] - velocity[i][1] * v[1]
                for i in (0, 1)
            ]  # fmt: skip
            return period * v, period / omega * jnp.stack(pushed), period * stacked(rates)

        found = diffrax.diffeqsolve(
            diffrax.ODETerm(slope), diffrax.Dopri8(), 0.0, 1.0, 1.0,
            (stacked(motion[:2]), stacked(motion[2:]) / omega, stacked(own)),
            stepsize_controller=diffrax.PIDController(rtol=self.tolerance, atol=self.floor),
            adjoint=diffrax.DirectAdjoint(), max_steps=self.steps, throw=False,
        )  # fmt: skip
        done = found.result == diffrax.RESULTS.successful
        q, v, inner = (jnp.where(done, part[-1], jnp.nan) for part in found.ys)
        return (*q, *(omega * v)), tuple(inner)
