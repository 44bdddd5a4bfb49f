"""Which combinations of the unknown a motion tells about, and which it never can, whatever the noise.

Two questions, one kind of answer. `observability` asks along the run of a loop as it is sampled: how the voltages of a
stretch of time move with everything unknown. `observability_matrix` asks at one instant of a motion given as a formula
(thesis (4.5)): derivatives of the output by everything unknown. Both are non-dimensional (lengths over that of the
motion, time in radians of the mean mode), without which a rank depends on the units.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jax.experimental.jet import jet
from jaxtyping import Array, Float

from memsgyro_jax.base.arguments import quantity, refuse_traced
from memsgyro_jax.base.concrete import settled
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.device.gyro import UX, VX, Coefficient, MotionModel, Pair, Scalar, check_positive, mode_frequencies

from .loop import ClosedLoop, as_loop
from .observers.base import OFFSETS
from .operation import run_of
from .scenario import AbstractProfile, Scenario, as_scenario
from .sensitivities import Dimensions, Unknowns, begin, dimensions_of, fresh, lanes_of, sampling, unknowns_of


PERIODS = 4  # of the slower mode in a window, where none is given
_PART = 1e-3  # of the largest entry: a quantity with less has no part in a null direction
_LARGE = 0.1  # of the largest entry: a quantity with less is not named where a direction is merely told least


class Observability(Shown, eqx.Module):
    """What stretches of a run (or instants of a motion) tell about everything unknown.

    `time` (windows,) in s, of the end of each stretch; `singular_values` (windows, quantities), descending, of the
    non-dimensional sensitivities; `directions` (windows, quantities, quantities), rows that belong to them, in
    `scale`d quantities; singular values below `tolerance` of the largest count as zero.
    """

    time: Float[np.ndarray, " windows"]
    singular_values: Float[np.ndarray, "windows quantities"]
    directions: Float[np.ndarray, "windows quantities quantities"]
    scale: Float[np.ndarray, " quantities"]
    tolerance: float = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)

    @property
    def rank(self) -> np.ndarray:
        """Of each stretch (windows,): how many combinations of the unknown it tells."""
        return np.sum(self.singular_values > self.tolerance * self.singular_values[:, :1], axis=1)

    @property
    def condition(self) -> np.ndarray:
        """Largest over smallest singular value of each stretch (windows,); infinite where one is zero."""
        with np.errstate(divide="ignore"):
            return self.singular_values[:, 0] / self.singular_values[:, -1]

    @property
    def null(self) -> tuple[dict[str, float], ...]:
        """What even the stretch of highest rank does not tell: directions as {quantity: change in its unit}, 1 for the
        largest part; empty where everything is told.
        """
        best = int(np.argmax(self.rank))
        return tuple(self._named(row, _PART) for row in _reduced(self.directions[best, self.rank[best] :]))

    @property
    def weakest(self) -> dict[str, float]:
        """The combination that the stretch of median condition tells least of, as in `null`, by its main parts."""
        order = np.argsort(self.condition)
        return self._named(self.directions[order[len(order) // 2], -1], _LARGE)

    def _named(self, direction: np.ndarray, part: float) -> dict[str, float]:
        large = np.abs(direction) > part * np.max(np.abs(direction))
        physical = direction * self.scale
        first = physical[np.argmax(np.abs(direction))]
        return {name: float(physical[i] / first) for i, name in enumerate(self.names) if large[i]}

    def to_xarray(self) -> Any:
        """Dataset over time, number of the singular value and quantity."""
        import xarray as xr

        return xr.Dataset(
            {
                "singular_values": (("time", "number"), self.singular_values),
                "directions": (("time", "number", "quantity"), self.directions * self.scale),
                "rank": (("time",), self.rank),
            },
            coords={
                "time": ("time", self.time, {"units": "s"}),
                "quantity": list(self.names),
                "unit": ("quantity", list(self.units)),
            },
            attrs={"tolerance": self.tolerance},
        )

    def plot(self, ax: Any = None) -> Any:
        """Singular values over time, those that count as zero grey; returns the axes."""
        import matplotlib.pyplot as plt

        ax = plt.subplots()[1] if ax is None else ax
        floor = self.tolerance * self.singular_values[:, 0]
        zero = self.singular_values <= floor[:, None]
        marker = "o" if self.time.size == 1 else None
        for k in range(len(self.names)):
            colour = "0.6" if np.all(zero[:, k]) else f"C{k % 10}"
            ax.semilogy(1e3 * self.time, self.singular_values[:, k], color=colour, marker=marker)
        ax.semilogy(1e3 * self.time, floor, "k:", label=f"{self.tolerance:g} of the largest")
        ax.set(xlabel="time [ms]", ylabel="singular value (non-dimensional)")
        ax.legend()
        return ax

    def __str__(self) -> str:
        rank, count = self.rank, len(self.names)
        told = f"{rank.min()}" if rank.min() == rank.max() else f"{rank.min()} to {rank.max()}"
        lines = [f"Observability of {count} quantities: rank {told} of {count} over {self.time.size} windows"]
        for direction in self.null:
            lines.append(f"  nothing tells apart: {self._written(direction)}")
        if not self.null:
            lines.append(
                f"  condition number: median {np.median(self.condition):.4g}, worst {self.condition.max():.4g}"
            )
            lines.append(f"  told least: {self._written(self.weakest)}")
        return "\n".join(lines)

    def _written(self, direction: dict[str, float]) -> str:
        units = dict(zip(self.names, self.units, strict=True))
        return ", ".join(f"{name} {change:+.4g} {units[name]}" for name, change in direction.items())


def _reduced(basis: np.ndarray) -> np.ndarray:
    """Another basis (k, quantities) of the same directions: each alone moves one quantity that stands out."""
    if not len(basis):
        return basis
    pivots = scipy.linalg.qr(basis, mode="r", pivoting=True)[1][: len(basis)]
    return np.linalg.solve(basis[:, np.sort(pivots)], basis)


def observability(
    loop: ClosedLoop,
    scenario: Scenario | AbstractProfile | float = 1.0,
    *,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    window: float | str | None = None,
    known: tuple[str, ...] = (),
    also: tuple[Coefficient, ...] = (),
    tolerance: float = 1e-6,
) -> Observability:
    """What each stretch of `window` seconds of the run that `loop` would make without noise tells about its unknown.

    Unknown are the motion at the beginning of the stretch, the read-out's offsets, the coefficients of the device's
    model and `also` further ones, but what is `known` (names as in `information_bound`). Commands are held, as one who
    gave them knows them. `window` None takes four periods of the slower mode; `sample_rate` and `duration` follow the
    device where they are left out (`Operation`). Effects of the device shape the run; what
    the quantities do to it is taken from the linear part. One die at a time.

    Raises `InputError` for float32, an unknown name, a batch of dies, or a window that a run does not have.
    """
    require_float64("`observability`")
    refuse_traced("`observability` tells ranks and", "plain numbers, or take `information_bound`", loop, scenario)
    loop, scenario = as_loop(loop), as_scenario(scenario)
    sample_rate, duration = run_of(loop, sample_rate, duration)
    check_positive("sample_rate", sample_rate)
    check_positive("duration", duration)
    period, samples = 1.0 / sample_rate, round(sample_rate * duration)
    design = loop.sampled_at(sample_rate, duration=duration)
    if lanes_of(loop, loop, scenario):
        raise InputError("`observability` takes one die, but the loop or its scenario holds several; take one of them.")
    frequency = float(np.min(np.asarray(settled(mode_frequencies(loop.device)))))
    length = PERIODS / frequency if window is None else quantity("window", window, "s")
    block = round(float(length) * sample_rate)
    unknown, size = unknowns_of(design, None, known, also), dimensions_of(design)
    if not len(unknown.names) <= 2 * block <= 2 * samples:
        raise InputError(
            f"Argument `window` must hold at least {-(-len(unknown.names) // 2)} samples and at most the run's "
            f"{samples}, but `{length:g}` s are {block}."
        )
    unknown = eqx.tree_at(lambda u: u.scale, unknown, _scales(unknown, size, loop.readout.scale))
    rows = _rows(design, scenario, unknown, _signal(loop, size), period, samples // block, block)
    _, singular, directions = np.linalg.svd(np.asarray(settled(rows)))
    time = np.arange(1, samples // block + 1) * block * period
    return Observability(time, singular, directions, np.asarray(unknown.scale), tolerance, unknown.names, unknown.units)


def _signal(loop: ClosedLoop, size: Dimensions) -> Pair:
    """Volts that stand for one: the motion's size on each channel."""
    moving = (size.length, size.length * size.frequency)
    return tuple(
        abs(scale) * moving[signal >= VX]
        for scale, signal in zip(loop.readout.scale, loop.readout.signals, strict=True)
    )


def _scales(unknown: Unknowns, size: Dimensions, scale: Pair) -> Array:
    """Non-dimensional units: offsets in that of the motion, rates in the mean mode's, the rest as for the bound."""
    own = dict(zip(unknown.names, unknown.scale, strict=True))
    own |= {name: abs(volts) * size.length for name, volts in zip(OFFSETS, scale, strict=True) if name in own}
    own |= {name: size.frequency for name, unit in zip(unknown.names, unknown.units, strict=True) if unit == "rad/s"}
    return jnp.stack([jnp.asarray(value, dtype=float) for value in own.values()])


@eqx.filter_jit
def _rows(loop, scenario, unknown: Unknowns, unit: Pair, period: float, windows: int, block: int) -> Array:
    """Triangular root (windows, quantities, quantities) of each window's sensitivities, over its samples' number."""
    samples = sampling(loop, scenario, unknown, unit, period, ())

    def one(carry, number):
        again = eqx.tree_at(lambda c: c.tangents, carry, fresh(unknown, ()))
        carry, rows = samples(again, number * block + jnp.arange(block))
        return carry, jnp.linalg.qr(rows / jnp.sqrt(block), mode="r")

    return jax.lax.scan(one, begin(loop, loop, unknown, ()), jnp.arange(windows))[1]


def observability_matrix(
    model: MotionModel,
    motion: Callable[[Scalar], Pair],
    force: Callable[[Scalar], Pair],
    time: Float[np.ndarray, " instants"],
    *,
    frequency: float,
    velocity: bool = False,
    known: tuple[str, ...] = (),
    also: tuple[Coefficient, ...] = (),
    tolerance: float = 1e-9,
    rows: int | None = None,
) -> Observability:
    """Rank and singular values of thesis (4.6) to (4.10) at instants of a motion that is given as a formula.

    The motion and its velocity are told by the output and its first derivative, so the rank is that of the
    coefficients' part W_p: the forces per unit of each coefficient and their derivatives by time, of x and y in turn.
    Add four (and two offsets) for the rank of the whole.

    Args:
        model: its coefficients are the quantities.
        motion, force: of the time in s, giving x, y in m and the forces in N; differentiable by JAX as often as there
            are coefficients.
        time: instants in s.
        frequency: the unit of time is 1/(2π·frequency), in Hz; lengths are over the largest |motion| at the instants.
        velocity: the read-out shows the velocity, or a displacement with an unknown offset: the forces themselves are
            then taken up by what is not known of the motion, and the first derivative is the first row.
        known, also, tolerance: as in `observability`.
        rows: of the matrix; None takes as many as there are coefficients, as the thesis does.

    Raises `InputError` for float32 or an unknown name.
    """
    require_float64("`observability_matrix`")
    check_positive("frequency", frequency)
    table = MotionModel((*model.coefficients, *also))
    for name in known:
        table.index(name)
    asked = tuple(c for c in table.coefficients if c.name not in known)
    omega, time = 2.0 * np.pi * frequency, np.atleast_1d(np.asarray(time, dtype=float))
    count = len(asked) if rows is None else rows
    signals = _derivatives(motion, force, time, omega, velocity + -(-count // 2))
    length, push = np.max(np.abs(signals[0, :VX])), np.max(np.abs(signals[0, UX:]))
    signals = signals / np.where(np.arange(6) < UX, length, push if push > 0.0 else 1.0)[:, None]
    scales, units = zip(*(_unit(c, omega, omega**2 * length / push if push > 0.0 else 1.0) for c in asked), strict=True)
    parts = np.zeros((time.size, len(signals), 2, len(asked)))
    for k, coefficient in enumerate(asked):
        for axis, signal, factor in coefficient.terms:
            parts[:, :, axis, k] += factor * np.moveaxis(signals[:, signal], 0, 1)
    parts = parts[:, int(velocity) :].reshape(time.size, -1, len(asked))[:, :count]
    _, singular, directions = np.linalg.svd(parts)
    if count < len(asked):
        singular = np.pad(singular, ((0, 0), (0, len(asked) - count)))
    names = tuple(c.name for c in asked)
    return Observability(time, singular, directions, np.array(scales), tolerance, names, units)


def _derivatives(motion, force, time: np.ndarray, omega: float, orders: int) -> np.ndarray:
    """Derivatives (orders, 6, instants) of displacement, velocity and force by the angle ω·t, the velocity over ω."""

    def both(angle: Scalar) -> Array:
        return jnp.stack([jnp.asarray(value, dtype=float) for value in (*motion(angle / omega), *force(angle / omega))])

    def series(angle: Scalar) -> Array:
        value, higher = jet(both, (angle,), ((1.0, *[0.0] * (orders - 1)),))
        return jnp.stack([value, *higher])

    x, y, ux, uy = np.moveaxis(np.asarray(jax.vmap(series)(jnp.asarray(omega * time))), (0, 1, 2), (2, 1, 0))
    return np.stack([x[:-1], y[:-1], x[1:], y[1:], ux[:-1], uy[:-1]], axis=1)


def _unit(coefficient: Coefficient, omega: float, gain: float) -> tuple[float, str]:
    """The non-dimensional unit of a coefficient, and its unit in SI."""
    signal = coefficient.terms[0].signal
    if signal >= UX:
        return gain, "1/kg"
    return (omega, "rad/s" if coefficient.is_rate else "1/s") if signal >= VX else (omega**2, "1/s²")
