"""How well anything could be known: Cramér-Rao and Bayesian information bound along a run.

The motion of the run without noise is differentiated exactly by everything that is unknown (start of the motion,
read-out offsets, coefficients), sample by sample with the plant's own step, while the commands are held: an observer
knows what it commanded. Each sample adds (sensitivity of its voltage / its noise)² of information. What is kept is the
triangular square root of the information, updated by orthogonal transformations, and columns are scaled before it is
inverted: std from 1e-9 m to 1e5 rad²/s² stand side by side in it.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import quantity
from memsgyro_jax.base.concrete import is_concrete, settled
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.base.units import rate_to_dps
from memsgyro_jax.device.gyro import (
    UX,
    UY,
    VX,
    VY,
    Coefficient,
    Dynamics,
    Inertial,
    MotionModel,
    Pair,
    Scalar,
    Term,
    X,
    Y,
    check_positive,
    mode_frequencies,
)
from memsgyro_jax.device.propagate import State4, applied

from .engine import over_dies
from .least_variance import least_variance, with_slopes
from .loop import ClosedLoop, LoopState, as_loop
from .observers.base import MOTION, OFFSETS, Clock
from .observers.settings import Prior
from .scenario import AbstractProfile, Conditions, Scenario, as_scenario


CROSS_DAMPING_ASYMMETRY = Coefficient("cross_damping_asymmetry", (Term(0, VY, 0.5), Term(1, VX, -0.5)))
"""(dyx - dxy)/m in 1/s, for `also` of `information_bound`: the force is that of a rate four times smaller, so without a
prior neither can be known (thesis 4.1.2)."""

_BLOCK = 200  # samples between two orthogonal updates, at most


class InformationBound(Shown, eqx.Module):
    """Smallest standard deviation that an unbiased estimator (with `prior`: any estimator, on average) can reach.

    `time` (windows,) in s; `std` (windows, quantities, *dies) in the quantities' units, infinite where the data say
    nothing; `covariance` (quantities, quantities, *dies) at the end, meaningful where `std` is finite. `degenerate`
    lists the directions that the whole run leaves undetermined (of the first die that has one), as {quantity: change in
    its unit}, 1 for the first; it is empty inside `jax.vmap` and `jax.jit`. Dies whose loop diverged hold NaN.
    """

    time: Float[np.ndarray, " windows"]
    std: Float[np.ndarray, "windows quantities *dies"]
    covariance: Float[np.ndarray, "quantities quantities *dies"]
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    degenerate: tuple[dict[str, float], ...] = eqx.field(static=True, default=())
    settings: dict[str, Any] = eqx.field(static=True, default_factory=dict)

    @property
    def rate_std(self) -> Float[np.ndarray, "windows *dies"]:
        """Bound of the rate over time, in rad/s."""
        return self.of("rate")

    def of(self, name: str) -> Float[np.ndarray, "windows *dies"]:
        """Bound of quantity `name` over time; raises `InputError` for an unknown one."""
        if name not in self.names:
            raise InputError(f"A quantity must be one of {', '.join(self.names)}, but `{name}` was given.")
        return self.std[:, self.names.index(name)]

    def to_xarray(self) -> Any:
        """Dataset over time, quantity (and die)."""
        import xarray as xr

        dies = ("die",) if self.std.ndim == 3 else ()
        quantity = ("quantity", list(self.names))
        return xr.Dataset(
            {
                "std": (("time", "quantity", *dies), self.std),
                "rate_std": (("time", *dies), self.rate_std, {"units": "rad/s"}),
                "covariance": (("quantity", "quantity_", *dies), self.covariance),
            },
            coords={
                "time": ("time", self.time, {"units": "s"}),
                "quantity": quantity,
                "quantity_": list(self.names),
                "unit": ("quantity", list(self.units)),
            },
            attrs=dict(self.settings),
        )

    def plot(self, ax: Any = None) -> Any:
        """Bound of the rate over time in deg/s (median die); returns the axes."""
        import matplotlib.pyplot as plt

        ax = plt.subplots()[1] if ax is None else ax
        rate = rate_to_dps(np.median(self.rate_std.reshape(len(self.time), -1), axis=1))
        ax.semilogy(1e3 * self.time, rate, label=f"{self.settings.get('kind', 'information')} bound")
        ax.set(xlabel="time [ms]", ylabel="std of the rate [deg/s]")
        return ax

    def __str__(self) -> str:
        last = self.std[-1].reshape(len(self.names), -1)
        dies = "" if self.std.ndim == 2 else f", median of {last.shape[1]} dies"
        rate = np.nanmedian(rate_to_dps(self.rate_std[-1]))
        lines = [f"{self.settings.get('kind', 'Information')} bound after {self.time[-1]:g} s{dies}"]
        lines.append(f"  rate: {rate:.4g} deg/s")
        lines += [
            f"  {name:<24} {np.nanmedian(std):>12.4g} {unit}"
            for name, unit, std in zip(self.names, self.units, last, strict=True)
        ]
        for direction in self.degenerate:
            units = dict(zip(self.names, self.units, strict=True))
            parts = ", ".join(f"{name} {change:+.4g} {units[name]}" for name, change in direction.items())
            lines.append(f"  cannot be told apart: {parts}")
        return "\n".join(lines)


def information_bound(
    loop: ClosedLoop,
    scenario: Scenario | AbstractProfile | float = 1.0,
    *,
    sample_rate: float | str = 100e3,
    duration: float | str = 0.1,
    prior: Prior | None = None,
    known: tuple[str, ...] = (),
    also: tuple[Coefficient, ...] = (),
    windows: int = 50,
    design: ClosedLoop | None = None,
) -> InformationBound:
    """Bound of motion start, offsets and coefficients along the run that `loop` would make without noise.

    `prior` None gives the Cramér-Rao bound; with a prior its information is added (a standard deviation of zero means
    known exactly). `known` names quantities taken as known: x, y, vx, vy (at the start), offset_x, offset_y and the
    model's coefficients. `also` adds further coefficients as unknown, without prior. The rate that is bounded is a
    constant added to the scenario's. Effects of the device shape the run; what the quantities do to it is taken from
    the linear part. Quantisation is not counted. `windows` is how many moments the bound is given for,
    at most. For a batch of dies (trailing axis of leaves of `loop` and `scenario`) give the unbatched `design` too.
    Under `jax.grad` and `jax.jvp` first derivatives are exact; an infinite entry has none.

    Raises `InputError` for float32, an unknown name, a read-out without noise, or settings that make no sample.
    """
    require_float64("`information_bound`")
    loop = as_loop(loop)
    sample_rate, duration = quantity("sample_rate", sample_rate, "Hz"), quantity("duration", duration, "s")
    check_positive("sample_rate", sample_rate)
    check_positive("duration", duration)
    scenario, samples, period = as_scenario(scenario), round(sample_rate * duration), 1.0 / sample_rate
    if samples < 1 or windows < 1:
        raise InputError(
            f"Arguments `duration` and `windows` must make at least one sample and window, but {samples} and {windows} "
            "were given."
        )
    _check_noise(loop.readout.noise_density)
    design = (loop if design is None else design).sampled_at(sample_rate, duration=duration)
    loop = loop.sampled_at(sample_rate, design, duration)
    unknown = _unknowns(design, prior, known, also)
    block = max(size for size in range(1, min(samples, _BLOCK) + 1) if samples % size == 0)
    lanes = _lanes(loop, design, scenario)
    slopes, blocks = not is_concrete(loop, scenario, prior), samples // block
    roots, information = _roots(loop, design, scenario, unknown, period, blocks, block, lanes, slopes)
    chosen = np.unique(np.linspace(blocks, 1, min(windows, blocks)).round().astype(int))
    solved = least_variance(settled(roots)[chosen - 1], unknown.scale, unknown.names)
    std, covariance = solved.std, solved.covariance
    if information is not None:
        std, covariance = with_slopes(solved, information[chosen - 1], unknown.scale)
    kind = "Cramér-Rao" if prior is None else "Bayesian"
    settings = {"kind": kind, "sample_rate": sample_rate, "duration": duration, "known": ", ".join(known)}
    return InformationBound(
        chosen * block * period, std, covariance, unknown.names, unknown.units, solved.degenerate, settings
    )


class _Unknowns(eqx.Module):
    """What is to be found: names, units, the scale each column is computed in, and the prior's standard deviation."""

    scale: Float[Array, " quantities"]
    prior_std: Float[Array, " quantities"]
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    model: MotionModel = eqx.field(static=True)

    def tangent(self, name: str) -> Array:
        """How entry `name` moves by a unit step of each (scaled) quantity: a scaled unit vector, or zero if known."""
        unit = [float(name == own) for own in self.names]
        return self.scale * np.asarray(unit)


def _unknowns(
    loop: ClosedLoop, prior: Prior | None, known: tuple[str, ...], also: tuple[Coefficient, ...]
) -> _Unknowns:
    model = MotionModel(loop.device.model.coefficients + also)
    device, start = settled((loop.device, loop.start))
    xp = np if is_concrete(device, start) else jnp
    frequency = 2.0 * np.pi * xp.mean(mode_frequencies(device))
    length = xp.maximum(1e-9, xp.hypot(*(xp.max(xp.abs(xp.asarray(q))) for q in start[:2])))
    force = xp.mean(xp.stack([xp.mean(xp.asarray(g)) for g in device.dynamics(Inertial()).gain]))
    by_signal = {**dict.fromkeys((X, Y), (frequency**2, "1/s²")), **dict.fromkeys((VX, VY), (frequency, "1/s"))}
    by_signal |= dict.fromkeys((UX, UY), (force, "1/kg"))
    table = dict.fromkeys(MOTION[:2], (length, "m")) | dict.fromkeys(MOTION[2:], (length * frequency, "m/s"))
    table |= dict.fromkeys(OFFSETS, (1e-3, "V"))
    table |= {c.name: (1.0, "rad/s") if c.is_rate else by_signal[c.terms[0].signal] for c in model.coefficients}
    strange = set(known) - set(table)
    if strange:
        raise InputError(f"Argument `known` must name some of {', '.join(table)}, but holds `{sorted(strange)[0]}`.")
    std = dict.fromkeys(table, np.inf)
    if prior is not None:
        std |= dict(zip(table, (*prior.motion_std, *prior.offset_std, *prior.theta_std), strict=False))
    exact = {name for name, value in settled(std).items() if is_concrete(value) and value == 0.0}
    names = tuple(name for name in table if name not in exact.union(known))
    scale, units = zip(*(table[name] for name in names), strict=True)
    return _Unknowns(jnp.asarray(scale), jnp.asarray([std[name] for name in names]), names, units, model)


def _check_noise(density: Pair) -> None:
    if is_concrete(density) and any(np.any(np.asarray(value) <= 0.0) for value in density):
        raise InputError(
            "The read-out must have noise on both axes for a bound to exist, but a `noise_density` of 0 was given."
        )


def _lanes(loop: ClosedLoop, design: ClosedLoop, scenario: Scenario) -> tuple[int, ...]:
    """The batch: axes that leaves of the loop have beyond those of the design, or that the scenario's values have."""
    leaves = zip(jax.tree.leaves(loop), jax.tree.leaves(design), strict=True)
    extra = [jnp.shape(leaf)[jnp.ndim(like) :] for leaf, like in leaves]
    return jnp.broadcast_shapes(*extra, *map(jnp.shape, jax.tree.leaves(scenario.at(0.0))))


class _Carry(NamedTuple):
    """State of the loop, and the motion's derivative by each quantity."""

    loop: LoopState
    tangents: tuple[Float[Array, "quantities *lanes"], ...]


@eqx.filter_jit
def _roots(
    loop: ClosedLoop, design: ClosedLoop, scenario: Scenario, unknown: _Unknowns, period: float, blocks: int,
    block: int, lanes: tuple[int, ...], slopes: bool,
) -> tuple[Float[Array, "blocks *lanes quantities quantities"], Array | None]:  # fmt: skip
    """Triangular root of the information at the end of each block, in scaled quantities.

    A root has no derivative where there is no information. With `slopes` the information itself comes along: its
    numbers are too poor to be inverted, but its derivative is that of the root's square.
    """
    std = loop.readout.noise_std(period)
    silent = eqx.tree_at(lambda made: made.readout.noise_density, loop, (jnp.zeros(()), jnp.zeros(())))
    count = len(unknown.names)

    def sample(carry: _Carry, xs):
        index, conditions = xs
        clock = Clock(index * period, index, period)
        state, taken = silent.step(carry.loop, conditions, (0.0, 0.0), clock)
        tangents = _propagated(silent, carry, conditions, taken.force, clock, unknown)
        return _Carry(state, tangents), _voltage_rows(silent, tangents, std, unknown, lanes)

    def one_block(carry, number):
        state, root, information = carry
        index = number * block + jnp.arange(block)
        state, rows = jax.lax.scan(sample, state, (index, jax.vmap(scenario.at)((index + 0.5) * period)))
        rows = jnp.moveaxis(rows.reshape(2 * block, count, *lanes), (0, 1), (-2, -1))
        root = jnp.linalg.qr(jnp.concatenate([root, jax.lax.stop_gradient(rows)], axis=-2), mode="r")
        if information is not None:
            information = information + jnp.swapaxes(rows, -1, -2) @ rows
        return (state, root, information), (root, information)

    begin = jax.tree.map(
        lambda value, like: over_dies(value, jnp.ndim(like), lanes), loop.init(), jax.eval_shape(design.init)
    )
    first = tuple(over_dies(unknown.tangent(name), 1, lanes) for name in MOTION)
    known = jnp.broadcast_to(jnp.diag(unknown.scale / unknown.prior_std), (*lanes, count, count))
    start = (_Carry(begin, first), jax.lax.stop_gradient(known), known**2 if slopes else None)
    return jax.lax.scan(one_block, start, jnp.arange(blocks))[1]


def _propagated(
    loop: ClosedLoop, carry: _Carry, conditions: Conditions, force: Pair, clock: Clock, unknown: _Unknowns
) -> tuple[Array, ...]:
    """The derivative of the motion, one sample later: a jvp of the plant's own step per quantity."""
    true, model = loop.device.dynamics(conditions.inertial), unknown.model

    def plant(motion: State4, change: tuple[Scalar, ...]) -> State4:
        changed = _plus(true, model.assemble(change))
        push = applied(changed, force)
        return loop.discretisation.advance(motion, push, changed.stiffness, changed.velocity, clock.period)

    at = (carry.loop.motion, tuple(jnp.zeros(()) for _ in model.names))
    moves = tuple(unknown.tangent(name) for name in model.names)
    return jax.vmap(lambda *tangents: jax.jvp(plant, at, tangents)[1])(carry.tangents, moves)


def _plus(true: Dynamics, change: Dynamics) -> Dynamics:
    return Dynamics(
        stiffness=true.stiffness + change.stiffness,
        damping=true.damping + change.damping,
        coriolis=true.coriolis + change.coriolis,
        gain=true.gain + change.gain,
        bias=true.bias,
    )


def _voltage_rows(
    loop: ClosedLoop, tangents: tuple[Array, ...], std: Pair, unknown: _Unknowns, lanes: tuple[int, ...]
) -> Float[Array, "2 quantities *lanes"]:
    """Derivative of both voltages by each quantity, in standard deviations of their noise."""
    readout, rows = loop.readout, []
    for signal, scale, noise, name in zip(readout.signals, readout.scale, std, OFFSETS, strict=True):
        offset = over_dies(unknown.tangent(name), 1, lanes)
        rows.append((scale * tangents[signal] + offset) / noise)
    return jnp.stack(rows)
