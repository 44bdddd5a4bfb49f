"""The sense axis of a classic gyro: measured in open loop, or held still by a force that is the measurement."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import jax.numpy as jnp

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.fields import AbstractVar
from memsgyro_jax.device.gyro import Pair, Scalar, check_not_negative, number

from ..observers.settings import arrays
from .demodulator import AbstractDemodulator
from .phase_locked_drive import phasor_product


State = TypeVar("State")


_DEMODULATOR = {"`bandwidth` of the demodulator": ("demodulator.bandwidth",)}


class AbstractSense(Displayed, Generic[State]):
    """What is done with the sense axis, whose demodulated displacement, times `conversion`, is a rate.

    `conversion` is the phasor [rad/s per m] that the design gives: rate and minus quadrature are its in-phase and
    quadrature part, `j Δ / (2 ω A)` where Δ is the dynamic stiffness per mass of the sense axis at the drive's ω.
    """

    demodulator: AbstractVar[AbstractDemodulator]
    conversion: AbstractVar[Pair]
    sets_bandwidth: ClassVar[Mapping[str, tuple[str, ...]]] = _DEMODULATOR

    @property
    def balanced(self) -> Pair:
        """What a demodulated displacement is times before it is used: `conversion`, or that in another phase."""
        return self.conversion

    @abc.abstractmethod
    def init(self) -> State:
        """At rest."""

    @abc.abstractmethod
    def step(self, state: State, volts: Scalar, turn: Pair, per_volt: Pair, period: Scalar) -> State:
        """The state after one more sample of `volts`, whose phase has the `turn` (cos φ, sin φ)."""

    @abc.abstractmethod
    def force(self, state: State) -> Pair:
        """In-phase and quadrature part of the force on y [N]."""

    @abc.abstractmethod
    def rate(self, state: State) -> Pair:
        """The rate and minus the quadrature, in rad/s."""


class OpenSense(AbstractSense[tuple[Any, Pair]]):
    """Open loop: the displacement is measured, thesis (2.7) to (2.11) and (5.3), and no force acts."""

    demodulator: AbstractDemodulator
    conversion: Pair = arrays()

    def init(self) -> tuple[Any, Pair]:
        """The demodulator's state, and the rate."""
        return self.demodulator.init(), (jnp.zeros(()), jnp.zeros(()))

    def step(
        self, state: tuple[Any, Pair], volts: Scalar, turn: Pair, per_volt: Pair, period: Scalar
    ) -> tuple[Any, Pair]:
        """The demodulated displacement as a rate."""
        held = self.demodulator.step(state[0], volts, turn, period)
        return held, phasor_product(phasor_product(self.demodulator.phasor(held), per_volt), self.conversion)

    def force(self, state: tuple[Any, Pair]) -> Pair:
        """None."""
        return jnp.zeros(()), jnp.zeros(())

    def rate(self, state: tuple[Any, Pair]) -> Pair:
        """The last one."""
        return state[1]


class RebalanceState(NamedTuple):
    """The demodulator's state, the integrals [rad/s] and the outputs [rad/s] of both loops."""

    held: Any
    integral: Pair
    output: Pair


class ForceRebalance(AbstractSense[RebalanceState]):
    """Force-to-rebalance and quadrature nulling: two loops hold the sense axis still, and their forces are the outputs.

    Each is `gain` times what is left of the rate (or quadrature) plus `integral` [1/s] times its integral; zero
    `quadrature_gain` and `quadrature_integral` leave the quadrature alone. `force_per_rate` [N per rad/s], 2 m ω A,
    holds a rate of one. What is left is turned by `turn` [rad] first: by zero, loops work in the phase of the
    displacement, by nearly a right angle in that of the velocity (`rebalance_design`). At the design the loops open
    are, ω the drive's and Δ the sense axis' dynamic stiffness,

        L(s) = e^(j turn) · (gain + integral/s) · b/(s + b) · Δ(jω)/Δ(s + jω).
    """

    demodulator: AbstractDemodulator
    conversion: Pair = arrays()
    force_per_rate: Scalar = number("N*s/rad", metadata={"unit": "N·s/rad"})
    gain: Scalar = number()
    integral: Scalar = number("1/s", metadata={"unit": "1/s"})
    quadrature_gain: Scalar = number()
    quadrature_integral: Scalar = number()
    turn: Scalar = number("rad", default=0.0)
    sets_bandwidth: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **_DEMODULATOR,
        "the rebalance loop's gains (`bandwidth` of the controller)": ("gain", "integral"),
    }

    def __check_init__(self):
        for name in ("gain", "integral", "quadrature_gain", "quadrature_integral"):
            check_not_negative(name, getattr(self, name))

    @property
    def balanced(self) -> Pair:
        """The conversion, turned."""
        return phasor_product(self.conversion, (jnp.cos(self.turn), jnp.sin(self.turn)))

    def init(self) -> RebalanceState:
        """No force."""
        zero = (jnp.zeros(()), jnp.zeros(()))
        return RebalanceState(self.demodulator.init(), zero, zero)

    def step(self, state: RebalanceState, volts: Scalar, turn: Pair, per_volt: Pair, period: Scalar) -> RebalanceState:
        """Both loops one sample on."""
        held = self.demodulator.step(state.held, volts, turn, period)
        left = phasor_product(phasor_product(self.demodulator.phasor(held), per_volt), self.balanced)
        rates, gains = (self.integral, self.quadrature_integral), (self.gain, self.quadrature_gain)
        integral = tuple(i + k * period * e for i, k, e in zip(state.integral, rates, left, strict=True))
        output = tuple(i + k * e for i, k, e in zip(integral, gains, left, strict=True))
        return RebalanceState(held, integral, output)

    def force(self, state: RebalanceState) -> Pair:
        """What balances the outputs: their phasor times j and the force per rate."""
        rate, minus_quadrature = state.output
        return -self.force_per_rate * minus_quadrature, self.force_per_rate * rate

    def rate(self, state: RebalanceState) -> Pair:
        """The outputs."""
        return state.output
