"""The noise of a rate by its sources: what shakes the mass, what the electronics add, in °/√h and over frequency.

At the frequency ω of the swing the sense coordinate p obeys Δ(ω) p = a, with Δ = ω₂² − ω² + iω d, and a rate is the
acceleration a = g Ω, with g = 2 ω A for one mass. A demodulator takes the phase of the rate alone, so that a one-sided
density n of the acceleration is √2 n/g of the rate, whose angle walks by N = n/g. The Brownian force is that of the
*sense* axis' damping, N² = kT d/(m ω A)² per mass; the drive axis' loops take what shakes it. Noise of the displacement
counts |Δ| times.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.concrete import check_positive, is_concrete
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.plainly import at_once
from memsgyro_jax.device.brownian import thermal_acceleration
from memsgyro_jax.device.gyro import VX, AbstractGyro, Inertial, Scalar

from .controllers.classic import ClassicControl, locked_frequency
from .controllers.sense import ForceRebalance
from .loop import ClosedLoop, as_loop
from .operation import sample_rate_of
from .rebalance_noise import beyond_the_split


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

_PER_ROOT_HOUR = 60.0 * 180.0 / np.pi  # °/√h in a rad/√s
_DEGREES = 180.0 / np.pi
_POINTS = 121
DITHER = 0.5  # of a step, beyond which rounding is white: its correlation with the signal falls as exp(-2π² steps²)


class NoiseBudget(Shown, eqx.Module):
    """Angle random walk and density of the rate by source; powers add.

    `walk` [rad/√s] of each of the `sources`, `density` [rad/s/√Hz, one-sided] of each over `frequency` [Hz], referred
    to the rate that comes in: at low frequencies √2 times the walk. `split` [Hz] is how far the swing is from the sense
    mode, `amplitude` [m] and `swing` [Hz] are those of the motion. `instability` [rad/s] is the coefficient B of IEEE
    952 that flicker of the read-out makes of the quadrature: where it rules, the Allan deviation is 0.664·B. `notes`
    say what is not counted.
    """

    walk: Float[Array, " sources"]
    frequency: Float[Array, " frequencies"]
    density: Float[Array, "sources frequencies"]
    amplitude: Scalar
    swing: Scalar
    split: Scalar
    instability: Scalar
    sources: tuple[str, ...] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)

    @property
    def total(self) -> Scalar:
        """The angle random walk of all sources together [rad/√s]."""
        return jnp.sqrt(jnp.sum(self.walk**2))

    def of(self, source: str) -> Scalar:
        """The angle random walk of one source [rad/√s]; raises `InputError` for an unknown one."""
        if source not in self.sources:
            raise InputError(f"A source must be one of {', '.join(self.sources)}, but `{source}` was given.")
        return self.walk[self.sources.index(source)]

    def as_dict(self) -> dict[str, Any]:
        """Entries for JSON: angle random walk by source and of all, °/√h."""
        walks = {name: float(walk) * _PER_ROOT_HOUR for name, walk in zip(self.sources, self.walk, strict=True)}
        return {"walk_deg_per_root_hour": {**walks, "all": float(self.total) * _PER_ROOT_HOUR}}

    def __str__(self) -> str:
        if not is_concrete(self.walk):
            return f"Noise budget of {', '.join(self.sources)}"
        head = (
            f"Noise of the rate at a swing of {1e6 * float(self.amplitude):.4g} µm at {float(self.swing):.1f} Hz, "
            f"{float(self.split):.4g} Hz from the sense mode"
        )
        lines = [head, f"  {'source':<26} {'°/√h':>10} {'°/s/√Hz':>10} {'of the power':>13}"]
        total = max(float(self.total), 1e-300)
        rows = [*zip(self.sources, np.asarray(self.walk).tolist(), strict=True), ("all", float(self.total))]
        for name, walk in rows:
            share, low = 100.0 * (walk / total) ** 2, np.sqrt(2.0) * walk * _DEGREES
            lines.append(f"  {name:<26} {walk * _PER_ROOT_HOUR:>10.4g} {low:>10.4g} {share:>11.1f} %")
        if float(self.instability) > 0.0:
            lines.append(f"  {'bias instability B':<26} {float(self.instability) * _DEGREES * 3600.0:>10.4g} °/h")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def to_xarray(self) -> "xr.Dataset":
        """Walk and density over source and frequency, units in the attributes."""
        import xarray as xr

        variables = {
            "walk": ("source", self.walk, {"units": "rad/sqrt(s)"}),
            "density": (("source", "frequency"), self.density, {"units": "rad/s/sqrt(Hz)"}),
            "instability": ((), self.instability, {"units": "rad/s"}),
        }
        coordinates = {"source": list(self.sources), "frequency": ("frequency", self.frequency, {"units": "Hz"})}
        return xr.Dataset(variables, coordinates, {"notes": " ".join(self.notes)})

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Powers of the sources, one on another, over the frequency of the rate; °/√h in the legend."""
        ax = axes(ax)
        names = [f"{s}: {w * _PER_ROOT_HOUR:.3g} °/√h" for s, w in zip(self.sources, self.walk, strict=True)]
        power = (_DEGREES * np.asarray(self.density)) ** 2
        ax.stackplot(np.asarray(self.frequency), power, labels=names, alpha=0.8)
        ax.set(xlabel="frequency of the rate [Hz]", ylabel="power density as input rate [(°/s)²/Hz]", xscale="log")
        ax.set_ylim(0.0, (1.1 + 0.08 * len(names)) * float(np.max(power.sum(axis=0))))  # the legend stands above
        ax.legend(loc="upper left", frameon=False)
        return ax


class _Sense(NamedTuple):
    """The sense coordinate along a swing: ω [rad/s], amplitude [m], square of its own frequency, damping, acceleration
    per rate g, two-sided density of the Brownian acceleration, weights of the channels that show it, the swing's
    shape, and its acceleration by stiffness across.
    """

    omega: Scalar
    amplitude: Scalar
    square: Scalar
    damping: Scalar
    per_rate: Scalar
    shaken: Scalar
    weights: tuple[Scalar, Scalar]
    along: tuple[Scalar, Scalar]
    coupled: Scalar

    def resistance(self, omega: Scalar) -> Scalar:
        """Δ(ω) [1/s²]."""
        return self.square - omega**2 + 1j * omega * self.damping


def noise_budget(
    loop: ClosedLoop, *, sample_rate: float | str | None = None, amplitude: float | None = None
) -> NoiseBudget:
    """Angle random walk of `loop` at rest by its sources, from formulas.

    Of a `ClassicControl` x swings at the amplitude that it holds and y is the sense axis. In any other loop the motion
    is taken as a swing in the mode that the start excites most, at that amplitude or at `amplitude` [m], and the
    estimate as one that has found everything but the rate: where more than one mode swings, an observer may do better.
    `sample_rate` [Hz], of the usual operation unless given, spreads the converter's rounding.

    **Raises:** `InputError` for what is no loop, and for a motion or sample rate that is not positive.
    """
    loop = as_loop(loop)
    period = _period(loop, sample_rate)
    phase_locked = isinstance(loop.controller, ClassicControl)
    numbers = _numbers(loop, amplitude, period)
    check_positive("amplitude", numbers["amplitude"])
    return NoiseBudget(**numbers, notes=(*_notes(loop, phase_locked, period), *_beyond(loop, amplitude, numbers)))


def _beyond(loop: ClosedLoop, amplitude: Scalar | None, numbers: dict[str, Any]) -> tuple[str, ...]:
    if not is_concrete((loop, numbers["walk"])):
        return ()
    walks = dict(zip(numbers["sources"], np.sqrt(2.0) * np.asarray(numbers["walk"]), strict=True))
    forces = walks.pop("Brownian force")
    sense, shown = _sense(loop, amplitude)[0], float(np.hypot.reduce([*walks.values()]))
    swing, split = (2.0 * np.pi * float(numbers[name]) for name in ("swing", "split"))
    said = beyond_the_split(loop, sense.resistance, swing, split, shown, float(forces))
    return (said,) if said else ()


@at_once
def _numbers(loop: ClosedLoop, amplitude: Scalar | None, period: Scalar) -> dict[str, Any]:
    """All of a budget but its notes."""
    sense, phase_locked = _sense(loop, amplitude)
    shaken = sense.shaken > 0.0  # the root of nothing has no slope
    brownian = jnp.where(shaken, jnp.sqrt(jnp.where(shaken, 2.0 * sense.shaken, 1.0)), 0.0)
    parts = {"Brownian force": brownian + 0.0 * sense.omega}
    for name, density in loop.readout.noise_at(sense.omega / (2.0 * jnp.pi), period).items():
        moved = _displacement(loop, density, sense.omega)
        parts[name] = jnp.abs(sense.resistance(sense.omega)) * jnp.hypot(
            sense.weights[0] * moved[0], sense.weights[1] * moved[1]
        )
        if phase_locked:
            parts[f"{name}, in the phase"] = jnp.abs(sense.coupled) * moved[0] / sense.amplitude
    names = tuple(parts)
    walk = jnp.stack([parts[name] / jnp.abs(sense.per_rate) for name in names])
    frequency, shapes = _over_frequency(sense)
    bent = jnp.stack([shapes[0] if name == names[0] else shapes[1] for name in names])
    modes = jnp.sqrt(sense.square)
    return {
        "walk": walk,
        "frequency": frequency,
        "density": jnp.sqrt(2.0) * walk[:, None] * bent,
        "amplitude": sense.amplitude,
        "swing": sense.omega / (2.0 * jnp.pi),
        "split": jnp.abs(modes - sense.omega) / (2.0 * jnp.pi),
        "instability": _instability(loop, sense, phase_locked),
        "sources": names,
    }


def _period(loop: ClosedLoop, sample_rate: float | str | None) -> float:
    """Between samples [s], over which rounding spreads: any will do without a converter."""
    if sample_rate is None and loop.readout.adc is None:
        return 1.0
    return 1.0 / sample_rate_of(loop.device, sample_rate)


def thermal_left_out(loop: ClosedLoop, *, sample_rate: float | str | None = None, least: float = 0.0) -> str:
    """A sentence on what the Brownian force would add at 300 K to a loop whose device knows no temperature; empty for
    one that does, where no closed form tells, and below `least` times the density that is counted.
    """
    if loop.device.temperature is not None or not is_concrete(loop):
        return ""
    warm = eqx.tree_at(lambda made: made.device, loop, loop.device.at_temperature(300.0))
    try:
        budget = noise_budget(warm, sample_rate=sample_rate)
    except InputError:
        return ""
    thermal = float(budget.of("Brownian force"))
    rest = max(0.0, float(budget.total) ** 2 - thermal**2) ** 0.5
    if not np.isfinite(thermal + rest) or thermal < least * rest:
        return ""
    density = _DEGREES * np.sqrt(2.0)
    return (
        "The device knows no temperature, so no thermomechanical (Brownian) noise is counted: at 300 K it would be "
        f"{density * thermal:.3g} deg/s/√Hz beside {density * rest:.3g} of the read-out (closed form); "
        '`temperature = "300 K"` in `[device]` brings it'
    )


def _instability(loop: ClosedLoop, sense: _Sense, phase_locked: bool) -> Scalar:
    """B of the rate: a delay of a channel turns the part of the swing that it shows by ω times itself.

    Behind a phase-locked loop a delay of x turns the reference, and with it the quadrature; one of y turns what is left
    of y, the quadrature in open loop and nothing where a force nulls it.
    """
    flicker, control = loop.readout.flicker, loop.controller
    if flicker is None:
        return jnp.zeros(())
    if phase_locked:
        free = isinstance(control, ClassicControl) and not isinstance(control.sense, ForceRebalance)
        shown = sense.coupled * jnp.asarray((1.0, float(free)))
    else:
        stiff = jnp.real(sense.resistance(sense.omega)) * sense.amplitude
        shown = stiff * jnp.stack([w * a for w, a in zip(sense.weights, sense.along, strict=True)])
    turned = sense.omega * jnp.stack(flicker.delay) * shown
    return jnp.sqrt(jnp.sum(turned**2)) / jnp.abs(sense.per_rate)


def noise_in_steps(loop: ClosedLoop, period: float) -> float:
    """The least noise of a sample over a step of the read-out's converter; infinite without one, and where unknown."""
    adc = loop.readout.adc
    if adc is None or not is_concrete(loop.readout):
        return np.inf
    least = min(float(np.min(np.asarray(density))) for density in loop.readout.noise_density)
    return least * np.sqrt(0.5 / period) / float(np.max(np.asarray(adc.step)))


def _notes(loop: ClosedLoop, phase_locked: bool, period: float) -> tuple[str, ...]:
    found, steps = [], noise_in_steps(loop, period)
    if steps < DITHER:
        found.append(
            f"The converter's rounding is taken as white, but a sample's noise is only {steps:.2g} of its step: "
            "what it adds may be more, and depends on the signal."
        )
    if loop.device.temperature is None:
        found.append("The device knows no temperature: no Brownian force (`gyro.at_temperature(300.0)`).")
    if not phase_locked:
        found.append("The phase of the swing is taken as known; a phase-locked loop would add its own noise.")
    if loop.device.effects:
        found.append("Effects of the device are left out.")
    return tuple(found)


def _displacement(loop: ClosedLoop, density: tuple[Scalar, Scalar], omega: Scalar) -> tuple[Scalar, Scalar]:
    """Of a density in volts on both channels, that of the displacement."""
    per_unit = [omega if signal >= VX else 1.0 for signal in loop.readout.signals]
    found = (d / (jnp.abs(s) * u) for d, s, u in zip(density, loop.readout.scale, per_unit, strict=True))
    return tuple(found)


def _sense(loop: ClosedLoop, amplitude: float | None) -> tuple[_Sense, bool]:
    rest = loop.device.dynamics(Inertial())
    if isinstance(loop.controller, ClassicControl):
        nulled = isinstance(loop.controller.sense, ForceRebalance)
        omega = locked_frequency(loop.device, nulled=nulled)
        held = loop.controller.drive.amplitude if amplitude is None else amplitude
        return _along(loop.device, omega, held, jnp.asarray((1.0, 0.0)), jnp.eye(2)[1], jnp.eye(2)[1]), True
    (kxx, kxy), (kyx, kyy) = rest.stiffness
    mean, half = 0.5 * (kxx + kyy), 0.5 * (kxx - kyy)
    root = jnp.sqrt(half**2 + kxy * kyx)
    turned = jnp.where(half > 0.0, 1.0, -1.0) * root  # towards x of the first column, whatever couples
    shapes = jnp.stack([jnp.stack([half + turned, kyx + 0.0 * half]), jnp.stack([-kxy + 0.0 * half, half + turned])])
    shapes = shapes / jnp.linalg.norm(shapes, axis=1, keepdims=True)
    left = jnp.linalg.inv(shapes.T)  # rows that single out one mode
    squares = jnp.stack([mean + turned, mean - turned])
    place, speed = (left @ jnp.stack(jnp.broadcast_arrays(*pair)) for pair in (loop.start[:2], loop.start[2:]))
    sizes = place**2 + speed**2 / squares
    first = jnp.argmax(sizes)
    size = jnp.sqrt(sizes[first]) if amplitude is None else amplitude  # a root of the mode at rest has no slope
    found = _along(loop.device, jnp.sqrt(squares[first]), size, shapes[first], shapes[1 - first], left[1 - first])
    return found, False


def _along(gyro: AbstractGyro, omega: Scalar, amplitude: Scalar, along: Array, across: Array, left: Array) -> _Sense:
    """The sense coordinate `left` q, whose shape is `across`, beside a swing `along`."""
    rest = gyro.dynamics(Inertial())
    turning = gyro.dynamics(Inertial(rate=1.0)).coriolis - rest.coriolis
    temperature = 0.0 if gyro.temperature is None else gyro.temperature
    density = thermal_acceleration(rest.damping, rest.gain, temperature)
    stiffness, damping, coriolis, shaken = (_array(m) for m in (rest.stiffness, rest.damping, turning, density))
    return _Sense(
        omega=omega,
        amplitude=jnp.asarray(amplitude),
        square=left @ stiffness @ across,
        damping=left @ damping @ across,
        per_rate=(left @ coriolis @ along) * omega * amplitude,
        shaken=left @ shaken @ left,
        weights=(left[0], left[1]),
        along=(along[0], along[1]),
        coupled=(left @ stiffness @ along) * amplitude,
    )


def _array(matrix: Any) -> Array:
    return jnp.stack([jnp.stack(jnp.broadcast_arrays(*map(jnp.asarray, row))) for row in matrix])


def _over_frequency(sense: _Sense) -> tuple[Array, tuple[Array, Array]]:
    """Frequencies [Hz] of the rate, and how the densities of a force and of the read-out grow there, referred to the
    rate that comes in: a rate at f turns both sidebands ω ± 2πf, which the sense mode weighs differently.
    """
    top = jnp.maximum(0.9 * jnp.abs(jnp.sqrt(sense.square) - sense.omega), 2.0 * sense.damping)
    top = jnp.minimum(top, 0.5 * sense.omega) / (2.0 * jnp.pi)
    frequency = top * jnp.logspace(-3.0, 0.0, _POINTS)
    at = jax.vmap(lambda f: sense.resistance(sense.omega) / sense.resistance(sense.omega + 2.0 * jnp.pi * f))
    above, below = at(frequency), at(-frequency)
    heard = 0.5 * jnp.abs(above + jnp.conj(below))
    force = jnp.sqrt(0.5 * (jnp.abs(above) ** 2 + jnp.abs(below) ** 2)) / heard
    return frequency, (force, 1.0 / heard)
