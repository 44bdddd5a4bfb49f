"""One sample of a linear two-axis oscillator: exact under held force and rate, or by forward Euler as the thesis does.

Matrices are those of `small`, whose scalars XLA fuses into a whole step over a batch of dies. `fence` keeps the fusion
from recomputing what many results share.
"""

import abc
import math
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base import runtime
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import AbstractVar

from .brownian import white_covariance
from .gyro import Dynamics, Pair, Scalar
from .small import Matrix, Vector, identity, zeros


State4 = tuple[Scalar, Scalar, Scalar, Scalar]


class Node(eqx.Module):
    """A moment inside a sample at which a parameter error is taken to act.

    `reach` and `push` lead from the start of the sample to it, like `full` and `push` of `Transition`; `kick` (4×2) is
    what an acceleration, acting there for the share of the sample that the moment stands for, adds to the motion at the
    end.
    """

    reach: Matrix = eqx.field(converter=Matrix)
    push: Matrix = eqx.field(converter=Matrix)
    kick: Matrix = eqx.field(converter=Matrix)


class Transition(eqx.Module):
    """How a sample maps the motion (x, y, vx, vy): `full @ motion + push @ acceleration`, and the nodes for its
    derivative.

    The derivative by a coefficient is the integral over the sample of (propagator to the end) × (signal of the
    coefficient), here a Gauss rule over `nodes`. One node in the middle is exact for what accumulates at the
    resonances.
    """

    full: Matrix = eqx.field(converter=Matrix)
    push: Matrix = eqx.field(converter=Matrix)
    nodes: tuple[Node, ...]


class AbstractAddition(eqx.Module):
    """What a device has beside its linear equations during a sample: accelerations, and own states of theirs."""

    period: AbstractVar[Scalar]

    @abc.abstractmethod
    def rates(self, motion: State4, own: tuple[Scalar, ...]) -> tuple[Pair, tuple[Scalar, ...]]:
        """The acceleration beside the linear one [m/s²], and the own states' derivative by time."""

    @abc.abstractmethod
    def carried(
        self, own: tuple[Scalar, ...], rates: tuple[Scalar, ...], start: State4, end: State4
    ) -> tuple[Scalar, ...]:
        """The own states a period later, from their `rates` at its start or along the motion."""

    @abc.abstractmethod
    def corrected(
        self, own: tuple[Scalar, ...], rates: tuple[Scalar, ...], later: tuple[Scalar, ...]
    ) -> tuple[Scalar, ...]:
        """`carried` own states once their rates at the end, `later`, are known too."""


class AbstractDiscretisation(Displayed):
    """Turns `acceleration = push - stiffness @ displacement - velocity @ velocity` into samples of `period` seconds."""

    @abc.abstractmethod
    def advance(self, motion: State4, push: Pair, stiffness: Matrix, velocity: Matrix, period: Scalar) -> State4:
        """The motion one sample later."""

    def extended(
        self, motion: State4, own: tuple[Scalar, ...], push: Pair, stiffness: Matrix, velocity: Matrix,
        beside: AbstractAddition,
    ) -> tuple[State4, tuple[Scalar, ...]]:  # fmt: skip
        """Motion and own states one sample later with accelerations `beside` the linear ones, here as a symmetric kick:
        second order in the period, also where they depend on the velocity.
        """
        half = 0.5 * beside.period
        first, rates = beside.rates(motion, own)
        start = _kicked(motion, half, first)
        end = self.advance(start, push, stiffness, velocity, beside.period)
        carried = beside.carried(own, rates, start, end)
        second, later = beside.rates(_kicked(end, half, first), carried)
        return _kicked(end, half, second), beside.corrected(carried, rates, later)

    @abc.abstractmethod
    def transition(self, stiffness: Matrix, velocity: Matrix, period: Scalar) -> Transition:
        """The same as matrices, with the nodes that a derivative needs."""

    def white(self, stiffness: Matrix, velocity: Matrix, density: Matrix, period: Scalar) -> Matrix:
        """Covariance of the motion that a white acceleration of two-sided `density` [m²/s³] adds in a sample."""
        return white_covariance(stiffness, velocity, density, period, _LONG)


_LONG = 24  # terms, for modes up to a third of the sample rate


def _kicked(motion: State4, time: Scalar, acceleration: Pair) -> State4:
    x, y, vx, vy = motion
    return (x, y, vx + time * acceleration[0], vy + time * acceleration[1])


class Exact(AbstractDiscretisation):
    """Matrix exponential under held acceleration, from a power series of half a sample, squared.

    `order` is the last power kept, `nodes` the moments inside a sample at which its derivative is taken. What is given
    stands; what is left out is chosen where sample rate and duration are known (`covering`), until then it is 12 and 1.
    A filter takes its covariance from the derivative: with one node at 27 samples in a period the standard deviations
    that it claims are up to 0.2 % off (`claim_error`) and single estimates 0.08 of them. Raises `InputError` for less
    than 1.
    """

    order: int = eqx.field(static=True)
    nodes: int = eqx.field(static=True)
    given: tuple[int | None, int | None] = eqx.field(static=True, repr=False)

    def __init__(self, order: int | None = None, nodes: int | None = None, *, otherwise: tuple[int, int] = (12, 1)):
        for name, value in (("order", order), ("nodes", nodes)):
            if value is not None and value < 1:
                raise InputError(f"Argument `{name}` must be at least 1, but {value} was given.")
        self.given = (order, nodes)
        self.order, self.nodes = (b if a is None else a for a, b in zip(self.given, otherwise, strict=True))

    @classmethod
    def covering(
        cls, highest_frequency: float, sample_rate: float, chosen: "Exact | None" = None, left: float = 1.0
    ) -> "Exact":
        """The shortest series whose remainder is below 1e-17 for modes up to `highest_frequency`, both in Hz, with
        enough nodes for a filter; but what was given to `chosen` stands.

        `left` is the share that damping leaves of a swing in the time a filter runs. As much does the filter know the
        motion better than the coefficients, so that its derivative must be the more exact the longer it runs. Raises
        `InputError` below two samples per period, where nothing could be observed.
        """
        if sample_rate < 2.0 * highest_frequency:
            raise InputError(
                f"Argument `sample_rate` must exceed twice the highest frequency to be followed, "
                f"{highest_frequency:.0f} Hz, but {sample_rate:g} Hz was given; "
                f"use at least {2.5 * highest_frequency:.0f} Hz."
            )
        phase = 2.0 * math.pi * highest_frequency / sample_rate
        wanted = _NODES_ERROR * max(left, _LEAST_LEFT)
        nodes = next(count for count in range(1, 99) if _gauss_error(count, 2.0 * phase) < wanted)
        return cls(*((None, None) if chosen is None else chosen.given), otherwise=(_order(phase, least=4), nodes))

    def claim_error(self, highest_frequency: float, sample_rate: float) -> float:
        """Largest share by which a filter's claimed standard deviations differ from those of many nodes, once a period
        has been seen; measured on devices of 4, 10 and 25 kHz at 18 to 40 samples per period.
        """
        return _CLAIMED * _gauss_error(self.nodes, 4.0 * math.pi * highest_frequency / sample_rate)

    def advance(self, motion: State4, push: Pair, stiffness: Matrix, velocity: Matrix, period: Scalar) -> State4:
        """Exact to rounding when the order covers the sample rate: the Taylor series of the motion itself."""
        spring, damper = -Matrix(stiffness), -Matrix(velocity)
        derivatives = [Vector(motion[:2]), Vector(motion[2:])]  # of the displacement, by time
        for power in range(1, self.order + 1):
            older, last = derivatives[-2:]
            following = spring @ older + damper @ last
            derivatives.append(following + Vector(push) if power == 1 else following)
        weights = _taylor_weights(period, len(derivatives))
        return (*(Vector(weights) @ derivatives), *(Vector(weights[:-1]) @ derivatives[1:]))

    def transition(self, stiffness: Matrix, velocity: Matrix, period: Scalar) -> Transition:
        """Exact to rounding when the order covers the sample rate."""
        points, weights = np.polynomial.legendre.leggauss(self.nodes)
        shares = [0.5 * (1.0 + float(point)) for point in points]
        parts = [_series(stiffness, velocity, share * period, _shorter(self.order, share)) for share in shares]
        # Gauss points are symmetric: the way from a point to the end is the way from the start to its mirror image.
        (first, first_push), (last, last_push) = parts[0], parts[-1]
        full = last @ first
        push = last @ first_push + last_push
        nodes = tuple(
            Node(reach, reach_push, 0.5 * float(weight) * period * Matrix(row[2:] for row in rest))
            for (reach, reach_push), (rest, _), weight in zip(parts, reversed(parts), weights, strict=True)
        )
        return Transition(full, push, nodes)

    def white(self, stiffness: Matrix, velocity: Matrix, density: Matrix, period: Scalar) -> Matrix:
        """Exact to rounding when the order covers the sample rate: squares turn twice as fast as the motion."""
        return white_covariance(stiffness, velocity, density, period, _twice(self.order))


_NODES_ERROR = 0.08  # of the derivative, in what turns at twice the highest frequency; a run's figures do not show it
_CLAIMED = 0.22  # of the derivative's error remains in the claimed standard deviations
_LEAST_LEFT = 1e-6  # beyond, a covariance is singular to rounding


def _gauss_error(nodes: int, phase: float) -> float:
    """Share by which the rule of Gauss misses the integral of a sine over a sample of `phase` [rad]."""
    constant = math.factorial(nodes) ** 4 / ((2 * nodes + 1) * math.factorial(2 * nodes) ** 3)
    return constant * phase ** (2 * nodes)


def _twice(order: int) -> int:
    """The order that covers twice the phase that `order` covers."""
    return _order(2.0 * (_REMAINDER * math.factorial(order + 1)) ** (1.0 / (order + 1)), least=order)


def _shorter(order: int, share: float) -> int:
    """The order that covers `share` of a sample as well as `order` covers the whole."""
    covered = (_REMAINDER * math.factorial(order + 1)) ** (1.0 / (order + 1))
    return min(order, _order(covered * share, least=1))


_REMAINDER = 1e-17


def _order(phase: float, least: int) -> int:
    """The last power to keep, at least `least`, for the exponential of a `phase` in rad."""
    order = least
    while phase ** (order + 1) / math.factorial(order + 1) > _REMAINDER:
        order += 1
    return order


class ForwardEuler(AbstractDiscretisation):
    """The thesis' own step, motion + period * derivative; it pumps energy (anti-damping ω²·period)."""

    def advance(self, motion: State4, push: Pair, stiffness: Matrix, velocity: Matrix, period: Scalar) -> State4:
        """Motion plus `period` times its derivative."""
        step = self.transition(stiffness, velocity, period)
        return tuple(step.full @ motion + step.push @ push)

    def transition(self, stiffness: Matrix, velocity: Matrix, period: Scalar) -> Transition:
        """First order in `period`; a parameter error acts at the start of the sample and reaches the velocity alone."""
        one, spring, damper = identity(2), -Matrix(stiffness), -Matrix(velocity)
        full = one.beside(period * one).above((period * spring).beside(one + period * damper))
        push = zeros(2, 2).above(period * one)
        return Transition(full, push, (Node(identity(4), zeros(4, 2), push),))

    def white(self, stiffness: Matrix, velocity: Matrix, density: Matrix, period: Scalar) -> Matrix:
        """All in the velocities: what moves the mass comes a sample later."""
        return zeros(2, 4).above(zeros(2, 2).beside(period * Matrix(density)))


def applied(dynamics: Dynamics, force: Pair) -> Pair:
    """The held acceleration of a force [N] on the device: gain * force + bias, in m/s²."""
    return tuple(dynamics.gain * Vector(force) + dynamics.bias)


def _series(stiffness: Matrix, velocity: Matrix, h: Scalar, order: int) -> tuple[Matrix, Matrix]:
    """Propagator and its input matrix over `h` from the impulse response q'' = -q' C - q K, q(0) = 0, q'(0) = 1.

    Three sums of the same Taylor coefficients give the response, its derivative and its integral; the displacement
    columns follow from E' = E A.
    """
    spring, damper = -Matrix(stiffness), -Matrix(velocity)
    terms = [zeros(2, 2), identity(2)]
    for _ in range(order):
        terms.append(terms[-2] @ spring + terms[-1] @ damper)
    # All sums at the end: adding each term as it comes would read and write twelve numbers of every die per order.
    weights = _taylor_weights(h, len(terms) + 1)
    rate, response, integral = (_weighted(weights[n:], terms[1:]) for n in (0, 1, 2))
    displaced, displaced_rate = rate + response @ velocity, response @ spring
    return displaced.beside(response).above(displaced_rate.beside(rate)), integral.above(response)


def _taylor_weights(h: Scalar, count: int) -> tuple[Scalar, ...]:
    """1, h, h²/2, h³/6, ..."""
    weights = [1.0]
    for power in range(1, count):
        weights.append(weights[-1] * h / power)
    return tuple(weights)


def _weighted(weights: tuple[Scalar, ...], matrices: list[Matrix]) -> Matrix:
    """Sum of matrices times weights; weights without a matrix are left over."""
    return sum((weight * matrix for weight, matrix in zip(weights, matrices, strict=False)), zeros(2, 2))


def fence(time: Scalar, tree: object) -> object:
    """`tree`, computed once: without multi-output fusion, a conditional that fusion does not reach through.

    XLA on CPU copies a cheap producer into each of its consumers, and a recursion of cheap scalars, shared by a hundred
    results, was computed a hundred times over (0.07 M steps/s without the fence, 2.1 M with it). `time` is any running,
    non-negative number: the condition always holds but only at run time. Where multi-output fusion is on, or off the
    CPU, nothing is done.
    """
    if jax.default_backend() != "cpu" or fuses_many_outputs():
        return tree
    return _apart(time, jax.tree.map(jnp.asarray, tree))


def once(time: Scalar, shared: object) -> object:
    """`shared`, numbers of a sample that all dies have in common, computed for the sample and not for every die.

    XLA on CPU takes a sine of one number into a loop over the dies that uses it, and calls it there for each of them.
    `time` is any running, non-negative number, as for `fence`.
    """
    if jax.default_backend() != "cpu":
        return shared
    numbers = jax.tree.map(jnp.asarray, shared)
    single, each = eqx.partition(numbers, lambda leaf: leaf.ndim == 0)
    return eqx.combine(_apart(time, single), each)


def _apart(time: Scalar, arrays: object) -> object:
    """`arrays` through a conditional on `time` that always holds, which the compiler cannot know."""
    return jax.lax.cond(time > -1.0, lambda t: t, lambda t: jax.tree.map(jnp.zeros_like, t), arrays)


def fuses_many_outputs() -> bool:
    """Whether XLA on CPU was told to fuse computations with several results (`runtime.configure` does)."""
    return runtime.MANY_OUTPUTS in os.environ.get("XLA_FLAGS", "")
