"""A loop as control engineers read it: its linear state space at a moment, and its response over frequency.

A loop that swings is linear in small disturbances, but not the same at every moment of its swing. The state space is
that of one moment (or of some samples from there); the response is what a simulation of a small sine shows on average,
taken exactly as the derivative of the run by the size of the sine.
"""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import quantity, whole
from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.labelled import Labelled, Tabular, labelled
from memsgyro_jax.device.gyro import Pair

from .loop import ClosedLoop, LoopState, Sample, as_loop
from .observers.base import MOTION, Clock
from .scenario import AbstractProfile, Conditions, Scenario, as_scenario
from .trace import count_steps


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

_LAGS = 30.0  # degrees: beyond it the lowest frequency does not stand for a constant rate
INPUTS = {"rate": "rad/s", "force x": "N", "force y": "N", "voltage x": "V", "voltage y": "V"}
"""What may disturb a loop: the rate, a force on the mass that the observer does not know, a voltage of the read-out."""
OUTPUTS = {"rate": "rad/s", "force x": "N", "force y": "N", "voltage x": "V", "voltage y": "V"}

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


def _advanced(loop: ClosedLoop, scenario: Scenario, state: LoopState, first: Any, samples: int, period: float, at: Any):
    """State and last sample, `samples` later; `at` gives the disturbances at a time."""

    def one(carry, index):
        time = index * period
        conditions = scenario.at(time + 0.5 * period)
        new, sample = _step(loop, conditions, at(time + 0.5 * period), carry, Clock(time, index, period))
        return jax.tree.map(lambda value, like: jnp.asarray(value, jnp.result_type(like)), new, carry), _outputs(sample)

    state = jax.tree.map(jnp.asarray, state)
    return jax.lax.scan(one, state, first + jnp.arange(samples))


def _outputs(sample: Sample) -> Array:
    return jnp.stack([jnp.asarray(value, float) for value in (sample.rate, *sample.force, *sample.volts)])


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
    """

    space: StateSpace
    states: tuple[str, ...]
    point: Float[np.ndarray, " states"]
    time: float
    inputs: ClassVar[tuple[str, ...]] = tuple(INPUTS)
    outputs: ClassVar[tuple[str, ...]] = tuple(OUTPUTS)

    @property
    def poles(self) -> Complex[np.ndarray, " states"]:
        """Eigenvalues of a step, the largest first; a magnitude above one is a growing motion."""
        found = np.linalg.eigvals(self.space.a)
        return found[np.argsort(-np.abs(found))]

    def __str__(self) -> str:
        kinds = ", ".join(f"{sum(s.startswith(f'{k} ') for s in self.states)} of the {k}" for k in _kinds(self.states))
        return (
            f"Loop at {self.time:.6g} s over {1e6 * self.space.dt:.6g} µs: {len(self.states)} states ({kinds}), inputs "
            f"{', '.join(self.inputs)}; outputs {', '.join(self.outputs)}; largest pole {abs(self.poles[0]):.9g}"
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
    samples say how slow disturbances die away. Raises `InputError` as `simulate` does.
    """
    runtime.require_float64("linearise")
    loop, scenario, samples = as_loop(loop), as_scenario(scenario), whole("samples", samples, least=1)
    sample_rate, after = quantity("sample_rate", sample_rate, "Hz"), quantity("after", after, "s")
    first = count_steps(sample_rate, after)
    loop = loop.sampled_at(sample_rate, duration=after).present
    point, matrices = _matrices(loop, scenario, 1.0 / sample_rate, first, samples)
    a, b, c, d = (np.asarray(block) for block in matrices)
    space = StateSpace(a, b, c, d, samples / sample_rate)
    return LinearisedLoop(space, _names(loop), np.asarray(point), after)


@eqx.filter_jit
def _matrices(loop: ClosedLoop, scenario: Scenario, period: float, first: int, samples: int) -> tuple[Array, tuple]:
    rest = jnp.zeros(len(INPUTS))
    state, _ = _advanced(loop, scenario, loop.init(), 0, first, period, lambda _: rest)
    vector, shaped = _as_vector(state)

    def go_on(at: Array, disturbance: Array) -> tuple[Array, Array]:
        end, outputs = _advanced(loop, scenario, shaped(at), first, samples, period, lambda _: disturbance)
        return _as_vector(end)[0], outputs[-1]

    (a, b), (c, d) = jax.jacfwd(go_on, argnums=(0, 1))(vector, rest)
    return vector, (a, b, c, d)


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


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(Tabular):
    """How the rate that a loop gives out answers a small sine of one of its `INPUTS`.

    `response` is the complex ratio over `frequency` [Hz], in rad/s per unit of the input, a phase that lags negative;
    `rest` the part of the answer, relative, that is no sine of that frequency: what had not settled, or beats with the
    swing. `level` is the constant rate [rad/s] around which it was taken.
    """

    disturbance: str
    frequency: Float[np.ndarray, " frequencies"]
    response: Complex[np.ndarray, " frequencies"]
    rest: Float[np.ndarray, " frequencies"]
    level: float
    along: ClassVar[str] = "frequency"

    @property
    def bandwidth(self) -> float:
        """The frequency in Hz at which the power has halved from that of the lowest one; NaN where it does not."""
        power = np.abs(self.response) ** 2 / np.abs(self.response[0]) ** 2
        below = np.flatnonzero(power < 0.5)
        if not below.size or below[0] == 0:
            return float("nan")
        k = int(below[0])
        share = np.log(power[k - 1] / 0.5) / np.log(power[k - 1] / power[k])
        return float(np.exp(np.log(self.frequency[k - 1]) + share * np.log(self.frequency[k] / self.frequency[k - 1])))

    def __str__(self) -> str:
        half = f"half the power of {self.frequency[0]:.4g} Hz at {self.bandwidth:.4g} Hz"
        phase = np.degrees(np.unwrap(np.angle(self.response)))
        if self.disturbance == "rate" and abs(phase[0]) > _LAGS:
            half += f", where it lags by {-phase[0]:.0f}° already: ask for lower frequencies too"
        lines = [f"Response of the rate to {self.disturbance} ({self._unit}), {half}"]
        rows = zip(self.frequency, np.abs(self.response), phase, self.rest, strict=True)
        lines += [f"  {f:>10.4g} Hz  {gain:>10.4g}  {angle:>8.1f}°  rest {rest:.1e}" for f, gain, angle, rest in rows]
        return "\n".join(lines)

    @property
    def _unit(self) -> str:
        return "1" if self.disturbance == "rate" else f"rad/s/{INPUTS[self.disturbance]}"

    def to_xarray(self) -> "xr.Dataset":
        """Gain, phase and rest over `frequency`."""
        variables = {
            "gain": ("frequency", np.abs(self.response), self._unit),
            "phase": ("frequency", np.unwrap(np.angle(self.response)), "rad"),
            "rest": ("frequency", self.rest, "1", "part of the answer that is no sine of the frequency"),
        }
        about = {"disturbance": self.disturbance, "bandwidth": self.bandwidth, "rate": self.level}
        return labelled(self, variables, {"frequency": ("frequency", self.frequency, "Hz")}, about)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Bode diagram: gain in dB, and the phase dashed on an axis at the right; returns the axes of the gain."""
        ax = axes(ax)
        ax.semilogx(self.frequency, 20.0 * np.log10(np.abs(self.response)), color="C0", marker=".")
        ax.set(xlabel="frequency [Hz]", ylabel=f"gain [dB of {self._unit}]")
        right = ax.twinx()
        phase = np.degrees(np.unwrap(np.angle(self.response)))
        right.semilogx(self.frequency, phase, color="C1", ls="--", marker=".", label="phase")
        right.set_ylabel("phase [°]")
        right.plot([], [], color="C0", marker=".", label="gain")
        right.legend(loc="best", frameon=False)
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter("")
        return ax


def frequency_response(
    loop: ClosedLoop,
    frequency: Float[np.ndarray, " frequencies"],
    disturbance: str = "rate",
    *,
    sample_rate: float | str,
    duration: float | str,
    settle: float | str | None = None,
    level: float | str = 0.0,
) -> FrequencyResponse:
    """The Bode diagram of any loop, linear or not: the derivative of a run without noise by the size of a small sine.

    Args:
        loop: whatever it is made of.
        frequency: of the sines [Hz], rising; each has its own run, side by side.
        disturbance: one of `INPUTS`.
        sample_rate, duration: of the runs, Hz and s.
        settle: from when on the answer is taken [s]; half the duration without.
        level: the constant rate [rad/s] around which the rate is disturbed.

    **Raises:** `InputError` for another name, for frequencies that do not rise between one in the settled part and half
    the sample rate, and as `simulate` does.
    """
    runtime.require_float64("frequency_response")
    loop, level = as_loop(loop), quantity("level", level, "rad/s")
    sample_rate, duration = quantity("sample_rate", sample_rate, "Hz"), quantity("duration", duration, "s")
    settle = 0.5 * duration if settle is None else quantity("settle", settle, "s")
    steps, frequency = count_steps(sample_rate, duration), np.atleast_1d(np.asarray(frequency, float))
    if disturbance not in INPUTS:
        raise InputError(f"Argument `disturbance` must be one of {', '.join(INPUTS)}, but is `{disturbance}`.")
    slowest, rising = 1.0 / max(duration - settle, 1e-300), np.all(np.diff(frequency) > 0.0)
    if not (rising and slowest <= frequency[0] and frequency[-1] < 0.5 * sample_rate):
        raise InputError(
            f"Argument `frequency` must rise from at least {slowest:.4g} Hz (a period in the settled part) to below "
            f"{0.5 * sample_rate:.4g} Hz, but goes from {frequency[0]:.4g} to {frequency[-1]:.4g} Hz."
        )
    loop = loop.sampled_at(sample_rate, duration=duration).present
    place = list(INPUTS).index(disturbance)
    start, omega = round(settle * sample_rate), jnp.asarray(2.0 * np.pi * frequency)
    found, rest = _answers(loop, as_scenario(level), 1.0 / sample_rate, steps, start, omega, place)
    return FrequencyResponse(disturbance, frequency, np.asarray(found), np.asarray(rest), level)


@eqx.filter_jit
def _answers(
    loop: ClosedLoop, scenario: Scenario, period: float, steps: int, start: int, omega: Array, place: int
) -> tuple[Array, Array]:
    def output(size: Array, omega: Array) -> Array:
        def at(time: Array) -> Array:
            return jnp.zeros(len(INPUTS)).at[place].set(size * jnp.sin(omega * time))

        return _advanced(loop, scenario, loop.init(), 0, steps, period, at)[1][:, 0]

    def answer(omega: Array) -> tuple[Array, Array]:
        tangent = jax.jvp(partial(output, omega=omega), (jnp.zeros(()),), (jnp.ones(()),))[1][start:]
        angle = omega * period * (start + 1.0 + jnp.arange(tangent.size))
        # A slow drift is what has not settled, and no part of the sine.
        basis = jnp.stack([jnp.sin(angle), jnp.cos(angle), jnp.ones_like(angle), angle - angle[0]], axis=1)
        parts = jnp.linalg.lstsq(basis, tangent)[0]
        left = tangent - basis[:, :2] @ parts[:2]
        size = jnp.sqrt(jnp.mean((basis[:, :2] @ parts[:2]) ** 2))
        return parts[0] + 1j * parts[1], jnp.sqrt(jnp.mean(left**2)) / size

    return jax.vmap(answer)(omega)
