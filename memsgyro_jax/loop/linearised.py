"""A loop as control engineers read it: its linear state space at a moment.

A loop that swings is linear in small disturbances, but not the same at every moment of its swing. The state space is
that of one moment, or of some samples from there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantities, quantity, whole
from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.labelled import Labelled, labelled
from memsgyro_jax.device.gyro import Pair

from .loop import ClosedLoop, LoopState, Sample, as_loop
from .observers.base import MOTION, Clock
from .scenario import AbstractProfile, Conditions, Scenario, as_scenario
from .trace import count_steps


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

INPUTS = {"rate": "rad/s", "force x": "N", "force y": "N", "voltage x": "V", "voltage y": "V"}
"""What may disturb a loop: the rate, a force on the mass that the observer does not know, a voltage of the read-out."""
OUTPUTS = {"rate": "rad/s", "force x": "N", "force y": "N", "voltage x": "V", "voltage y": "V"}

_LOOK = 512  # samples within which the swing is looked for again
_BACK = 0.01  # of its size, within which it has come back
_EXACT = 1e-3  # of it, from which on an answer is off by what a reader may care for
_UNITS = {f"motion {name}": unit for name, unit in zip(MOTION, ("m", "m", "m/s", "m/s"), strict=True)}


class _Pushed(ClosedLoop):
    """A loop whose mass is pushed by a further force [N], of which no part of it knows."""

    push: Pair = (0.0, 0.0)

    def _moved(self, state: LoopState, conditions: Conditions, force: Pair, clock: Clock, shaking: Any) -> Any:
        whole = tuple(own + more for own, more in zip(force, self.push, strict=True))
        return super()._moved(state, conditions, whole, clock, shaking)


def _step(
    loop: ClosedLoop, conditions: Conditions, disturbance: Array, state: LoopState, clock: Clock
) -> tuple[LoopState, Sample]:
    """A sample without noise under the small disturbances, in the order of `INPUTS`."""
    rate, push, volts = disturbance[0], tuple(disturbance[1:3]), tuple(disturbance[3:5])
    drift = tuple(own + more for own, more in zip(conditions.offset_drift, volts, strict=True))
    conditions = eqx.tree_at(lambda c: (c.rate, c.offset_drift), conditions, (conditions.rate + rate, drift))
    parts = {name: getattr(loop, name) for name in ClosedLoop.__dataclass_fields__}
    return _Pushed(**parts, push=push).step(state, conditions, (0.0, 0.0), clock)


def _outputs(sample: Sample) -> Array:
    return jnp.stack([jnp.asarray(value, float) for value in (sample.rate, *sample.force, *sample.volts)])


def disturbed(
    loop: ClosedLoop, scenario: Scenario, state: LoopState, first: Any, samples: int, period: float, at: Any,
    told: Callable[[Sample], Array] = _outputs,
):  # fmt: skip
    """State and what is `told` of each sample, `samples` later; `at` gives the disturbances at a time."""

    def one(carry, index):
        time = index * period
        conditions = scenario.at(time + 0.5 * period)
        new, sample = _step(loop, conditions, at(time + 0.5 * period), carry, Clock(time, index, period))
        return jax.tree.map(lambda value, like: jnp.asarray(value, jnp.result_type(like)), new, carry), told(sample)

    state = jax.tree.map(jnp.asarray, state)
    return jax.lax.scan(one, state, first + jnp.arange(samples))


class StateSpace(NamedTuple):
    """The matrices of `x' = a x + b u`, `y = c x + d u`, and the time step in s."""

    a: Float[np.ndarray, "states states"]
    b: Float[np.ndarray, "states inputs"]
    c: Float[np.ndarray, "outputs states"]
    d: Float[np.ndarray, "outputs inputs"]
    dt: float


@dataclass(frozen=True, eq=False, repr=False)
class LinearisedLoop(Labelled):
    """A loop around the moment `time` [s]: how a small change of its state and of what enters it goes on.

    `space` are the matrices over one step of `dt` seconds, `scipy.signal.StateSpace(*space[:4], dt=space.dt)` or
    `control.ss(*space)`; the step is a sample, or so many as were asked for, over which inputs are held. `states` are
    named by where they stand in the loop and have the values of `point` there. `inputs` are the rate, a force that the
    observer does not know and a voltage of the read-out, `outputs` the rate given out, the command and the volts.
    `apart` is how far the swing ends the step from where it began, in its own size, and `recurs` after how many samples
    it first comes back to a hundredth: poles, and responses over many steps, need a step of that length. It is 0 where
    that was not seen within 512 samples, or inside a transformation of JAX. `nearest` is after how many it comes
    nearest, of `samples` and all within 512: what is left of `apart` is an error of every answer.
    """

    space: StateSpace
    states: tuple[str, ...]
    point: Float[np.ndarray, " states"]
    time: float
    apart: float = 0.0
    recurs: int = 0
    nearest: int = 0
    inputs: ClassVar[tuple[str, ...]] = tuple(INPUTS)
    outputs: ClassVar[tuple[str, ...]] = tuple(OUTPUTS)

    @property
    def poles(self) -> Complex[np.ndarray, " states"]:
        """Eigenvalues of a step, the largest first; a magnitude above one is a growing motion."""
        xp = np if is_concrete(self.space.a) else jnp
        found = xp.linalg.eigvals(self.space.a)
        return found[xp.argsort(-xp.abs(found))]

    def response(self, frequency: Any) -> Complex[np.ndarray, "frequencies outputs inputs"]:
        """Answer of every output to a small sine [Hz, or text] at every input, held over a step: c (z − a)⁻¹ b + d.

        Solved as it stands. What makes polynomials of the matrices first (`dfreqresp`, `dbode` and transfer functions
        of SciPy) loses its digits, as the poles of a step stand close together at 1.
        """
        a, b, c, d, dt = self.space
        turn = np.exp(2j * np.pi * quantities("frequency", frequency, "Hz") * dt)[:, None, None]
        xp = np if is_concrete(a) else jnp
        return c @ xp.linalg.solve(turn * np.eye(len(a)) - a, xp.broadcast_to(b, (len(turn), *b.shape))) + d

    def __str__(self) -> str:
        kinds = ", ".join(f"{sum(s.startswith(f'{k} ') for s in self.states)} of the {k}" for k in _kinds(self.states))
        return (
            f"Loop at {self.time:.6g} s over {1e6 * self.space.dt:.6g} µs: {len(self.states)} states ({kinds}), inputs "
            f"{', '.join(self.inputs)}; outputs {', '.join(self.outputs)}; largest pole {abs(self.poles[0]):.9g}"
            f"{self._not_whole}"
        )

    @property
    def _not_whole(self) -> str:
        if self.apart <= _BACK:
            small = f"\nThe swing ends the step {self.apart:.2g} of its size from where it began"
            return f"{small}: `samples={self.nearest}` brings it nearest." if self.apart > _EXACT else ""
        instead = f"`samples={self.recurs}` is one" if self.recurs else "none is near up to 512 samples"
        instead += f", {self.nearest} is nearest" if self.nearest not in (0, self.recurs) else ""
        return (
            f"\nThe swing ends the step {self.apart:.2g} of its size from where it began: poles, and responses over "
            f"many steps, mean something for a step of whole periods alone ({instead})."
        )

    def to_xarray(self) -> "xr.Dataset":
        """The matrices over `state`, `state_before`, `input` and `output`."""
        a, b, c, d, _ = self.space
        variables = {
            "a": (("state", "state_before"), a, None, "state by state a step before"),
            "b": (("state", "input"), b, None, "state by input"),
            "c": (("output", "state_before"), c, None, "output by state"),
            "d": (("output", "input"), d, None, "output by input"),
            "operating_point": ("state", self.point, None),
        }
        coordinates = {
            "state": list(self.states),
            "state_unit": ("state", [_UNITS.get(name, "") for name in self.states], None),
            "state_before": list(self.states),
            "input": list(self.inputs),
            "output": list(self.outputs),
            "input_unit": ("input", list(INPUTS.values()), None),
            "output_unit": ("output", list(OUTPUTS.values()), None),
        }
        return labelled(self, variables, coordinates, {"dt": self.space.dt, "time": self.time})

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """The poles of a step in the complex plane, with the unit circle; returns the axes."""
        ax, poles, around = axes(ax), self.poles, np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
        ax.plot(around.real, around.imag, color="0.7", lw=1.0)
        ax.plot(poles.real, poles.imag, "x", color="C0")
        ax.set(xlabel="real part", ylabel="imaginary part", aspect="equal")
        return ax


def _kinds(states: tuple[str, ...]) -> list[str]:
    return list(dict.fromkeys(name.split(" ")[0] for name in states))


def linearise(
    loop: ClosedLoop,
    scenario: Scenario | AbstractProfile | float | str = 0.0,
    *,
    sample_rate: float | str,
    after: float | str,
    samples: int = 1,
) -> LinearisedLoop:
    """The linear state space of a loop where it is `after` seconds of a run without noise, by exact derivatives.

    `samples` is how many make a step. A loop's matrices change along its swing: a period of it, or several, in whole
    samples say how slow disturbances die away. Gradients by every number of the loop go through, also those of the
    poles. Raises `InputError` as `simulate` does.
    """
    runtime.require_float64("linearise")
    loop, scenario, samples = as_loop(loop), as_scenario(scenario), whole("samples", samples, least=1)
    sample_rate, after = quantity("sample_rate", sample_rate, "Hz"), quantity("after", after, "s")
    first = count_steps(sample_rate, after)
    loop = loop.sampled_at(sample_rate, duration=after).present
    point, matrices, volts = _matrices(loop, scenario, 1.0 / sample_rate, first, samples)
    a, b, c, d = map(known_array, matrices)
    space = StateSpace(a, b, c, d, samples / sample_rate)
    swing = _recurrence(np.asarray(volts), samples) if is_concrete(volts) else ()
    return LinearisedLoop(space, _names(loop), known_array(point), after, *swing)


def _recurrence(volts: Float[np.ndarray, "n 2"], samples: int) -> tuple[float, int, int]:
    """How far the two readings `samples` later are from the first two, in the size of all, the first near them, and the
    nearest.
    """
    both = np.concatenate([volts[:-1], volts[1:]], axis=1)
    apart = np.linalg.norm(both - both[0], axis=1) / max(float(np.max(np.ptp(both, axis=0))), 1e-300)
    back = np.flatnonzero(apart[1:] <= _BACK)
    return float(apart[samples]), int(back[0]) + 1 if back.size else 0, int(np.argmin(apart[1:])) + 1


@eqx.filter_jit
def _matrices(
    loop: ClosedLoop, scenario: Scenario, period: float, first: int, samples: int
) -> tuple[Array, tuple, Float[Array, "n 2"]]:
    rest = jnp.zeros(len(INPUTS))
    state, _ = disturbed(loop, scenario, loop.init(), 0, first, period, lambda _: rest)
    vector, shaped = _as_vector(state)

    def go_on(at: Array, disturbance: Array) -> tuple[Array, Array]:
        end, outputs = disturbed(loop, scenario, shaped(at), first, samples, period, lambda _: disturbance)
        return _as_vector(end)[0], outputs[-1]

    (a, b), (c, d) = jax.jacfwd(go_on, argnums=(0, 1))(vector, rest)
    onward = disturbed(loop, scenario, state, first, max(samples, _LOOK) + 2, period, lambda _: rest)[1]
    return vector, (a, b, c, d), jax.lax.stop_gradient(onward[:, 3:])


def _as_vector(state: LoopState) -> tuple[Array, Any]:
    """The real numbers of a state in a row, and what puts them back; counters stay as they are."""
    numbers, others = eqx.partition(jax.tree.map(jnp.asarray, state), eqx.is_inexact_array)
    vector, back = ravel_pytree(numbers)
    return vector, lambda moved: eqx.combine(back(moved), others)


def _names(loop: ClosedLoop) -> tuple[str, ...]:
    state = jax.tree.map(jnp.asarray, loop.init())
    found = []
    for path, leaf in jax.tree_util.tree_flatten_with_path(eqx.filter(state, eqx.is_inexact_array))[0]:
        part, *rest = [text.strip(".[]'") for text in map(str, path)]
        if part == "motion":
            rest = [MOTION[int(rest[0])]]
        name = " ".join([part, ".".join(rest)]).strip()
        entries = [""] if leaf.ndim == 0 else [f"[{','.join(map(str, i))}]" for i in np.ndindex(leaf.shape)]
        found += [name + entry for entry in entries]
    return tuple(found)


def known_array(value: Any) -> Any:
    """Arrays of NumPy, but where a gradient is taken."""
    return np.asarray(value) if is_concrete(value) else value
