"""How far the loops of classic control are from instability, all of them closed around both axes."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import VX, Inertial, Pair, Scalar

from .controllers import ClassicControl, ForceRebalance
from .controllers.classic import locked_frequency
from .filters import Lowpass
from .lateness import delays
from .loop import ClosedLoop


class LoopMargins(NamedTuple):
    """Least distance of the Nyquist curve from -1 of the phase-locked loop, the gain control and the rebalance loops of
    rate and quadrature, opened where the output acts while the others are closed (1 where nothing is fed back);
    negative where closing it makes the die unstable. Rate and quadrature, which share demodulator and force, are opened
    together: the least singular value of their return difference.
    """

    phase: Scalar
    amplitude: Scalar
    rate: Scalar
    quadrature: Scalar

    @property
    def least(self) -> Scalar:
        """Of all four."""
        return jnp.minimum(jnp.minimum(self.phase, self.amplitude), jnp.minimum(self.rate, self.quadrature))


def loop_margins(loop: ClosedLoop) -> LoopMargins:
    """Margins of the loops of `loop` about the state in which its device is locked at rest.

    Both axes with their coupling, the demodulators and the four loops are linearised in phasors that turn with the
    drive, averaged over a period of it. Where the axes do not couple, with d the damping and Δ the dynamic stiffness
    per mass and each with the demodulator's low-pass, what the distance |1 + L| is of is about

        phase      (k + i/s) / (s + d/2),   amplitude  (k + i/s) / (2 m ω (s + d/2)),
        sense      (k + i/s) C 2 ω A / (j Δ(s + jω)).

    A read-out that answers late (`ReadoutDelay`, `Delayed`) turns what both demodulators see by ω times the delay, and
    delays how it changes. Averaging and sampling are left out: exact for demodulators that are slow beside the drive,
    5 % of gain at a twentieth of it, and no more true of a loop that reaches beyond a tenth of the drive's frequency;
    so are all other effects, and what saturates.
    Differentiable by gains and device; a lot gives a margin for each die. Not for a program on several devices at once,
    where linear algebra can wait for itself: the loss `LoopMargin` takes each loop by itself. Raises
    `InputError` for another controller.
    """
    table, tree, velocity, lot = _numbers(loop)
    return LoopMargins(*(one.reshape(lot) for one in _margins(table, tree, velocity).T))


def _numbers(loop: ClosedLoop) -> tuple[Array, Any, tuple[bool, bool], tuple[int, ...]]:
    """The numbers of each die in a row, what puts them back, which axes show velocity, and the shape of the lot."""
    control: Any = loop.controller
    if not isinstance(control, ClassicControl):
        raise InputError(
            f"Argument `loop` must be driven by `ClassicControl`, but its controller is a {type(control).__name__}."
        )
    shut = isinstance(control.sense, ForceRebalance)
    dynamics = loop.device.dynamics(Inertial())
    numbers = _Numbers(
        tuple(tuple(row) for row in dynamics.stiffness), tuple(tuple(row) for row in dynamics.damping),
        tuple(dynamics.gain), tuple(a / b for a, b in zip(loop.readout.scale, control.scale, strict=True)),
        delays(loop), locked_frequency(loop.device, nulled=shut), control.drive, control.sense,
    )  # fmt: skip
    leaves, tree = jax.tree.flatten(numbers)
    lot = jnp.broadcast_shapes(*(jnp.shape(leaf) for leaf in leaves))
    table = jnp.stack([jnp.broadcast_to(leaf, lot).reshape(-1) for leaf in leaves], axis=1)
    velocity = tuple(signal >= VX for signal in control.signals)
    return table, tree, velocity, lot


class _Numbers(NamedTuple):
    """All that decides the margins of a die; `shown` is what the read-out shows over what the control takes it for,
    `late` by how much it shows it late [s].
    """

    stiffness: tuple[Pair, Pair]
    damping: tuple[Pair, Pair]
    gain: Pair
    shown: Pair
    late: Pair
    omega: Scalar
    drive: Any
    sense: Any


class Lock(NamedTuple):
    """The closed loops of one die where it is locked at rest, in phasors that turn with the drive: slope by state, by
    what acts, and what the four loops put out by the state; the slope by a rate and the rate given out by the state,
    both in units of the drive's angular frequency `omega` [rad/s].
    """

    closed: Float[np.ndarray, "n n"]
    push: Float[np.ndarray, "n 4"]
    out: Float[np.ndarray, "4 n"]
    turned: Float[np.ndarray, " n"]
    told: Float[np.ndarray, " n"]
    omega: float


def at_lock(loop: ClosedLoop) -> Lock:
    """Of one die. Raises `InputError` for another controller, and for a lot."""
    table, tree, velocity, lot = _numbers(loop)
    if lot:
        raise InputError("Argument `loop` must be one die, but holds several; `loop_margins` takes a lot.")
    omega = float(jax.tree.unflatten(tree, list(table[0])).omega)
    closed, push, out, turned, told = map(np.asarray, _matrices(table[0], tree, velocity))
    return Lock(closed, push, out, turned, told, omega)


def closed_poles(loop: ClosedLoop) -> Complex[np.ndarray, " states"]:
    """Poles [1/s] of the closed loops of one die where its device is locked at rest, in phasors that turn with the
    drive. Raises `InputError` for another controller, and for a lot.
    """
    return np.linalg.eigvals(at_lock(loop).closed)


@eqx.filter_jit
def _matrices(row: Array, tree: Any, velocity: tuple[bool, bool]) -> tuple[Array, ...]:
    """Those of a `Lock`."""
    numbers = jax.tree.unflatten(tree, list(row))
    *matrices, state = _around_the_lock(numbers, velocity)
    return *matrices, *_Flow(numbers, velocity).of_rate(state)


@eqx.filter_jit
def _margins(table: Float[Array, "dies numbers"], tree: Any, velocity: tuple[bool, bool]) -> Float[Array, "dies 4"]:
    return jax.vmap(lambda row: _of_die(jax.tree.unflatten(tree, list(row)), velocity))(table)


def _of_die(numbers: _Numbers, velocity: tuple[bool, bool]) -> Float[Array, " 4"]:
    closed, push, out, _ = _around_the_lock(numbers, velocity)
    without = closed - push.T[:, :, None] * out[:, None, :]
    poles = jnp.linalg.eigvals(jax.lax.stop_gradient(jnp.concatenate([closed[None], without]))).real
    rest = 1e-6 * numbers.drive.demodulator.bandwidth  # an integral's pole at zero, but for rounding
    unstable, *others = jnp.sum(poles > rest, axis=1)
    guilty = unstable > jnp.stack(others)
    guilty = guilty | ((unstable > 0) & ~jnp.any(guilty))
    return jnp.where(guilty, -1.0, 1.0) * _distances(closed, push, out)


def _around_the_lock(numbers: _Numbers, velocity: tuple[bool, bool]) -> tuple[Array, Array, Array, Array]:
    """The matrices of the closed loops, of what acts, and of what the loops put out, where the state rests, and it."""
    flow = _Flow(numbers, velocity)

    def step(_: int, carry: tuple) -> tuple:
        """Of Newton's way to where the state rests, which ends there."""
        state = carry[0]
        *matrices, slope = flow.linear(state)
        within, push, out = matrices
        return state - jnp.linalg.solve(within + push @ out, slope), *matrices

    start = flow.start()
    zeros = (jnp.zeros((len(start), size)) for size in (len(start), 4))
    state, within, push, out = jax.lax.fori_loop(0, _STEPS, step, (start, *zeros, jnp.zeros((4, len(start)))))
    return within + push @ out, push, out, state


class _Flow:
    """The slope [1/s] of the averaged state, a real vector: phasors of the displacements and of what both demodulators
    hold, the drive's integrals of frequency and force, those of rate and quadrature. Units are the drive's amplitude
    and ω.

    The equations of motion are (s + D + S)(s - S) with a matrix S whose eigenvalues turn forwards. That factor is kept;
    the other turns backwards, far from the drive, and is taken at the drive's frequency.
    """

    def __init__(self, numbers: _Numbers, velocity: tuple[bool, bool]):
        drive, sense = numbers.drive, numbers.sense
        self.numbers, self.velocity = numbers, velocity
        self.filters = [Lowpass(d.bandwidth, getattr(d, "order", 1)) for d in (drive.demodulator, sense.demodulator)]
        stiffness, damping = (jnp.array(part) for part in (numbers.stiffness, numbers.damping))
        self.turning = _forwards(stiffness, damping)
        self.pushing = numbers.omega**2 * jnp.linalg.inv(1j * numbers.omega * jnp.eye(2) + damping + self.turning)

    def start(self) -> Float[Array, " states"]:
        """Locked, y at rest."""
        size, zero = 1.0 / self.numbers.shown[0], jnp.zeros(())
        ahead = self.numbers.omega * self.numbers.late[0]  # x of what is shown
        held = [jnp.zeros(each.order, complex) for each in self.filters]
        held[0] = held[0].at[-1].set(1j if self.velocity[0] else 1.0)
        phasors = jnp.concatenate([jnp.stack([size * jnp.exp(1j * ahead), zero]), *held])
        decay = self.numbers.damping[0][0] / self.numbers.omega
        inner = jnp.stack([1.0 + 0.5 * decay * jnp.tan(ahead), decay * size / jnp.cos(ahead), zero, zero])
        return jnp.concatenate([phasors.real, phasors.imag, inner])

    def linear(self, state: Float[Array, " states"]) -> tuple[Array, Array, Array, Array]:
        """Slopes of the slope by the state with all loops open and by what acts, of what the loops put out by the
        state, and the slope with all closed.
        """
        acting = self._read(state)[0]
        within, push = jax.jacfwd(self._slope, argnums=(0, 1))(state, acting)
        return within, push, jax.jacfwd(lambda there: self._read(there)[0])(state), self._slope(state, acting)

    def of_rate(self, state: Float[Array, " states"]) -> tuple[Array, Array]:
        """The slope of the slope by a rate, and of the rate given out by the state, both in units of ω."""
        acting = self._read(state)[0]
        turned = jax.jacfwd(lambda rate: self._slope(state, acting, rate))(jnp.zeros(()))
        shut = isinstance(self.numbers.sense, ForceRebalance)
        return turned, jax.grad(lambda at: self._read(at)[0][2] if shut else self._read(at)[1][2][0])(state)

    def _slope(
        self, state: Float[Array, " states"], acting: Float[Array, " 4"], rate: Scalar | float = 0.0
    ) -> Float[Array, " states"]:
        """Where the phase turns with a speed, a force, a rate and a quadrature are acted by, and a `rate` turns it."""
        n, drive, sense = self.numbers, self.numbers.drive, self.numbers.sense
        _, (missing, lead, left), place, held = self._read(state)
        speed, force, *balance = acting
        push = jnp.stack([1j * force, -2j * rate * place[0]])
        nominal, pole = 2.0 * jnp.pi * drive.frequency / n.omega, 2.0 * jnp.pi * drive.demodulator.bandwidth
        tuned, pushed, *integral = state[-4:]
        slopes = [
            _kept(drive.phase_integral, lead / n.omega, pole * (nominal - tuned)),
            _kept(drive.force_integral, missing * n.gain[0] / n.omega**2, -pole * pushed),
            *(-pole * part for part in integral),
        ]
        if isinstance(sense, ForceRebalance):
            per_rate = sense.force_per_rate * n.gain[1] / (n.omega * drive.amplitude)
            push = push.at[1].add(1j * per_rate * (balance[0] + 1j * balance[1]))
            gains = (sense.integral, sense.quadrature_integral)
            slopes[2:] = [_kept(k, part, -pole * held) for k, part, held in zip(gains, left, integral, strict=True)]
        moving = self.turning @ place + self.pushing @ push
        seen = self._seen(place, moving)
        smoothed = [each.flow(*pair)[1] for each, pair in zip(self.filters, zip(held, seen, strict=True), strict=True)]
        phasors = jnp.concatenate([moving - 1j * n.omega * speed * place, *smoothed])
        return jnp.concatenate([phasors.real, phasors.imag, jnp.stack(slopes)])

    def _seen(self, place: Array, moving: Array) -> list[Array]:
        """What the read-out shows of both axes: places as they were, by the turn at ω, and to first order by how that
        changes. No read-out shows velocities late.
        """
        n = self.numbers
        late = jnp.stack(n.late)
        then = jnp.exp(-1j * n.omega * late) * (place - late * (moving - 1j * n.omega * place))
        return [n.shown[i] * (moving[i] / n.omega if fast else then[i]) for i, fast in enumerate(self.velocity)]

    def _read(self, state: Float[Array, " states"]) -> tuple:
        """The loops' outputs, what they miss, the displacements, and what the demodulators hold."""
        n, drive, sense = self.numbers, self.numbers.drive, self.numbers.sense
        count = (len(state) - 4) // 2
        phasors, (tuned, pushed, *integral) = state[:count] + 1j * state[count:-4], state[-4:]
        first = 2 + self.filters[0].order
        held = (phasors[2:first], phasors[first:])
        x, y = (each.flow(part, 0.0)[0] for each, part in zip(self.filters, held, strict=True))
        x, y = (part / 1j if fast else part for part, fast in zip((x, y), self.velocity, strict=True))
        lead = x.imag / jnp.abs(x)
        speed = tuned + drive.phase_gain * lead / n.omega
        x, y = (part / speed if fast else part for part, fast in zip((x, y), self.velocity, strict=True))
        missing = 1.0 - jnp.abs(x)
        rate = y * (sense.balanced[0] + 1j * sense.balanced[1]) * drive.amplitude / n.omega
        left = (rate.real, rate.imag)
        if isinstance(sense, ForceRebalance):
            gains = (sense.gain, sense.quadrature_gain)
            integral = [held + gain * part for held, gain, part in zip(integral, gains, left, strict=True)]
        force = pushed + drive.force_gain * missing * n.gain[0] / n.omega**2
        return jnp.stack([speed, force, *integral]), (missing, lead, left), phasors[:2], held


def _forwards(stiffness: Float[Array, "2 2"], damping: Float[Array, "2 2"]) -> Complex[Array, "2 2"]:
    """S with S² + D S + K = 0 and frequencies above zero."""

    def better(_: int, turning: Array) -> Array:
        square = stiffness + damping @ turning
        root = jnp.sqrt(square[0, 0] * square[1, 1] - square[0, 1] * square[1, 0])
        return 1j * (square + root * jnp.eye(2)) / jnp.sqrt(square[0, 0] + square[1, 1] + 2.0 * root)

    return jax.lax.fori_loop(0, _TURNS, better, jnp.zeros((2, 2), complex))


def _kept(gain: Scalar, part: Scalar, forgotten: Scalar) -> Scalar:
    """The slope of an integral; one without a gain forgets what it held."""
    return jnp.where(gain > 0.0, gain * part, forgotten)


_TURNS = 10  # each leaves 1/(2 Q) of the error
_STEPS = 6  # of Newton's way to the lock, whose start is a good one
_LOG, _ROUNDS = np.geomspace(1e-6, 1e2, 49), 6
_BESIDE = np.array([-3.0, -1.0, -0.3, 0.0, 0.3, 1.0, 3.0])  # of a pole, in units of its damping


def _distances(closed: Float[Array, "n n"], push: Float[Array, "n 4"], out: Float[Array, "4 n"]) -> Float[Array, " 4"]:
    """Least distances over frequency: found by the eigenvectors, and differentiable there by the matrices."""
    poles, shapes = jnp.linalg.eig(jax.lax.stop_gradient(closed))
    seen, moved = jax.lax.stop_gradient(out) @ shapes, jnp.linalg.solve(shapes, jax.lax.stop_gradient(push) + 0.0j)

    def far(omega: Array) -> Array:
        """By the modes, at (3, some) frequencies."""
        each = jnp.einsum("ik,...k,kj->...ij", seen, 1.0 / (1j * omega[..., None] - poles), moved)
        return jnp.stack([_apart(each[n])[..., n] for n in range(3)])

    def nearest(tried: Array) -> Array:
        """The nearest of frequencies that rise and the next other ones on either side of it, (3, 3); poles come in
        pairs, and their frequencies twice.
        """
        middle = jnp.take_along_axis(tried, jnp.argmin(far(tried), axis=1)[:, None], axis=1)
        below = jnp.max(jnp.where(tried < middle, tried, tried[:, :1]), axis=1)
        above = jnp.min(jnp.where(tried > middle, tried, tried[:, -1:]), axis=1)
        return jnp.stack([below, middle[:, 0], above], axis=1)

    beside = jnp.abs(poles.imag[:, None] + poles.real[:, None] * _BESIDE).reshape(-1)
    tried = jnp.sort(jnp.concatenate([beside, jnp.max(jnp.abs(poles)) * _LOG]))
    found = nearest(jnp.broadcast_to(tried, (3, len(tried))))
    closer = lambda _, three: nearest(jnp.linspace(three[:, 0], three[:, 2], 21, axis=1))  # noqa: E731
    best = jax.lax.fori_loop(0, _ROUNDS, closer, found)[:, 1]
    answers = jnp.linalg.solve(1j * best[:, None, None] * jnp.eye(len(closed)) - closed, push + 0.0j)
    phase, amplitude, sense = jnp.diagonal(_apart(out @ answers))
    return jnp.stack([phase, amplitude, sense, sense])


def _apart(answer: Complex[Array, "... 4 4"]) -> Float[Array, "... 3"]:
    """One over what an injection at an output becomes there, by the closed loops' answer to it: of phase, of amplitude,
    and the most of rate and quadrature together.
    """
    whole = jnp.eye(4) + answer
    alone = 1.0 / jnp.abs(jnp.stack([whole[..., 0, 0], whole[..., 1, 1]], axis=-1))
    pair = whole[..., 2:, 2:]
    power = 0.5 * jnp.sum(jnp.abs(pair) ** 2, axis=(-2, -1))
    product = jnp.abs(pair[..., 0, 0] * pair[..., 1, 1] - pair[..., 0, 1] * pair[..., 1, 0])
    rest = jnp.sqrt(jnp.maximum(power**2 - product**2, 1e-24))  # its slope stays finite where both directions are alike
    return jnp.concatenate([alone, 1.0 / jnp.sqrt(power + rest)[..., None]], axis=-1)
