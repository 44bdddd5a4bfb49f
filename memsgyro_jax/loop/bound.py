"""How well anything could be known: Cramér-Rao and Bayesian information bound along a run.

Each sample adds (sensitivity of its voltage / its noise)² of information. What is kept is the triangular square root
of the information, updated by orthogonal transformations, and columns are scaled before it is inverted: std from
1e-9 m to 1e5 rad²/s² stand side by side in it.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from memsgyro_jax.base.concrete import at_hand, is_concrete, settled
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.base.units import rate_to_dps
from memsgyro_jax.device.gyro import Coefficient, Pair, check_positive

from .block_bound import goes_by_blocks, roots_in_blocks
from .blocks.run import prepared, sizes_of
from .least_variance import least_variance, with_slopes
from .loop import ClosedLoop, as_loop
from .observers.base import MOTION, OFFSETS
from .observers.known_rate import CROSS_DAMPING_ASYMMETRY as CROSS_DAMPING_ASYMMETRY
from .observers.settings import Prior
from .operation import run_of
from .scenario import AbstractProfile, Scenario, as_scenario
from .sensitivities import Unknowns, begin, lanes_of, sampling, unknowns_of


_WORTH_BLOCKS = 30_000  # samples of a run from which on blocks save more than their longer program takes to compile
_BLOCK = 200  # samples between two orthogonal updates, at most


class InformationBound(Shown, eqx.Module):
    """Smallest standard deviation that an unbiased estimator (with `prior`: any estimator, on average) can reach.

    `time` (windows,) in s; `std` (windows, quantities, *dies) in the quantities' units, infinite where the data say
    nothing; `covariance` (quantities, quantities, *dies) at the end, meaningful where `std` is finite. `degenerate`
    lists the directions that the whole run leaves undetermined (of the first die that has one), as {quantity: change in
    its unit}, 1 for the first; it is empty inside `jax.vmap` and `jax.jit`. Dies that were lost, out of their travel or
    not finite, hold NaN from then on.
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
        lines = [f"{self.settings.get('kind', 'Information')} bound after {self.time[-1]:g} s{dies}"]
        if np.isnan(last).all():
            return f"{lines[0]}\n  none: the run is lost by then, out of travel or not finite"
        rate = np.nanmedian(rate_to_dps(self.rate_std[-1]))
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
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
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
    the linear part. Quantisation and flicker are not counted; the Brownian force of a device that knows its temperature
    is, as a disturbance of the motion beside the run without it. A long run of a loop in blocks (from 30 000 samples
    on) goes by blocks, where no derivative is asked for. `windows` is how many moments the bound is given for, at most.
    `sample_rate` and `duration` follow the device where they are left out (`Operation`).
    For a batch of dies (trailing axis of leaves of `loop` and `scenario`) give the unbatched `design` too.
    Under `jax.grad` and `jax.jvp` first derivatives are exact; an infinite entry has none.

    Raises `InputError` for float32, an unknown name, a read-out without noise, or settings that make no sample.
    """
    require_float64("`information_bound`")
    asked = _asked(as_loop(loop), as_scenario(scenario), sample_rate, duration, prior, known, also, windows, design)
    unknown, chosen = asked.unknown, asked.chosen
    roots, information = asked.program(*asked.given)
    solved = least_variance(at_hand(settled(roots))[chosen - 1], unknown.scale, unknown.names)
    std, covariance = solved.std, solved.covariance
    if information is not None:
        std, covariance = with_slopes(solved, information[chosen - 1], unknown.scale)
    return InformationBound(
        asked.ends, std, covariance, unknown.names, unknown.units, solved.degenerate, asked.settings
    )


def compile_bound(
    loop: ClosedLoop, scenario: Scenario, *, sample_rate: float, duration: float, prior: Prior | None,
    known: tuple[str, ...], windows: int, design: ClosedLoop,
) -> None:  # fmt: skip
    """Compile what `information_bound` runs when it is asked the same, and run nothing of it."""
    asked = _asked(loop, scenario, sample_rate, duration, prior, known, (), windows, design)
    asked.program.lower(*asked.given).compile()


class _Asked(NamedTuple):
    """A program for the roots of the information, what it is given, which of them are `chosen`, counted from one, and
    at what time [s] each of these `ends`.
    """

    program: Any  # compiled by `filter_jit`
    given: tuple[Any, ...]
    unknown: Unknowns
    chosen: Int[np.ndarray, " windows"]
    ends: Float[np.ndarray, " windows"]
    settings: dict[str, Any]


def _asked(
    loop: ClosedLoop, scenario: Scenario, sample_rate: float | str | None, duration: float | str | None,
    prior: Prior | None, known: tuple[str, ...], also: tuple[Coefficient, ...], windows: int, design: ClosedLoop | None,
) -> _Asked:  # fmt: skip
    """What a bound is asked of; arguments and errors are those of `information_bound`."""
    sample_rate, duration = run_of(loop if design is None else design, sample_rate, duration)
    check_positive("sample_rate", sample_rate)
    check_positive("duration", duration)
    samples, period = round(sample_rate * duration), 1.0 / sample_rate
    if samples < 1 or windows < 1:
        raise InputError(
            f"Arguments `duration` and `windows` must make at least one sample and window, but {samples} and {windows} "
            "were given."
        )
    _check_noise(loop.readout.noise_density)
    design = prepared(loop if design is None else design)[0].sampled_at(sample_rate, duration=duration)
    loop = replace(loop.sampled_at(sample_rate, design, duration), blocks=design.blocks)
    unknown = unknowns_of(design, prior, known, also)
    lanes, slopes = lanes_of(loop, design, scenario), not is_concrete(loop, scenario, prior)
    start, sizes = sizes_of(loop, samples)
    if sizes and samples >= _WORTH_BLOCKS and not slopes and goes_by_blocks(unknown):
        program, way = roots_in_blocks, (start, sizes, lanes, windows == 1)
        ends = np.cumsum([start, *sizes])[-1 if windows == 1 else 0 :]
    else:
        block = max(size for size in range(1, min(samples, _BLOCK) + 1) if samples % size == 0)
        ends = block * np.arange(1, samples // block + 1)
        program, way = _roots, (len(ends), block, lanes, slopes)
    chosen = np.unique(np.linspace(len(ends), 1, min(windows, len(ends))).round().astype(int))
    kind = "Cramér-Rao" if prior is None else "Bayesian"
    settings = {"kind": kind, "sample_rate": sample_rate, "duration": duration, "known": ", ".join(known)}
    given = (loop, design, scenario, unknown, period, *way)
    return _Asked(program, given, unknown, chosen, ends[chosen - 1] * period, settings)


def moved_by(
    loop: ClosedLoop, design: ClosedLoop, scenario: Scenario, names: tuple[str, ...], period: float, samples: int
) -> Float[np.ndarray, "quantities *lanes"]:
    """By how many standard deviations of its noise a unit change of each of `names` moves all that a run measures,
    where all else is known: a filter whose model is off by less than one over it is misled by less than its noise does.

    Of a run beyond 30 000 samples of `period` [s] it is what the growth of a phase makes of so many at most; NaN for a
    lost die. Raises `InputError` for a read-out without noise.
    """
    _check_noise(loop.readout.noise_density)
    design = replace(design, blocks=None).sampled_at(1.0 / period, duration=samples * period)
    loop = replace(loop.sampled_at(1.0 / period, design, samples * period), blocks=None)
    others = tuple(name for name in (*MOTION, *OFFSETS, *design.device.model.names) if name not in names)
    unknown, few = unknowns_of(design, None, others, ()), min(samples, _WORTH_BLOCKS)
    block = max(size for size in range(1, min(few, _BLOCK) + 1) if few % size == 0)
    lanes = lanes_of(loop, design, scenario)
    roots, _ = _roots(loop, design, scenario, unknown, period, few // block, block, lanes, False)
    grown = max(samples / few, 1.0) ** 1.5  # the error of a frequency adds up twice: in the phase, and over samples
    size = grown * np.sqrt(np.sum(np.asarray(settled(roots))[-1] ** 2, axis=-2)) / np.asarray(unknown.scale)
    places = [unknown.names.index(name) for name in names]
    return np.moveaxis(size, -1, 0)[places]


def _check_noise(density: Pair) -> None:
    if is_concrete(density) and any(np.any(np.asarray(value) <= 0.0) for value in density):
        raise InputError(
            "The read-out must have noise on both axes for a bound to exist, but a `noise_density` of 0 was given."
        )


@eqx.filter_jit
def _roots(
    loop: ClosedLoop, design: ClosedLoop, scenario: Scenario, unknown: Unknowns, period: float, blocks: int,
    block: int, lanes: tuple[int, ...], slopes: bool,
) -> tuple[Float[Array, "blocks *lanes quantities quantities"], Array | None]:  # fmt: skip
    """Triangular root of the information at the end of each block, in scaled quantities.

    A root has no derivative where there is no information. With `slopes` the information itself comes along: its
    numbers are too poor to be inverted, but its derivative is that of the root's square.
    """
    samples = sampling(loop, scenario, unknown, loop.readout.noise_std(period), period, lanes)
    count = len(unknown.names)

    def one_block(carry, number):
        state, root, information = carry
        state, rows = samples(state, number * block + jnp.arange(block))
        root = jnp.linalg.qr(jnp.concatenate([root, jax.lax.stop_gradient(rows)], axis=-2), mode="r")
        if information is not None:
            information = information + jnp.swapaxes(rows, -1, -2) @ rows
        # The rows of a lost die are finite, but of a motion that cannot be.
        return (state, root, information), (jnp.where(state.alive[..., None, None], root, jnp.nan), information)

    known = jnp.broadcast_to(jnp.diag(unknown.scale / unknown.prior_std), (*lanes, count, count))
    warm = loop.device.temperature is not None
    start = begin(loop, design, unknown, lanes, warm), jax.lax.stop_gradient(known), known**2 if slopes else None
    return jax.lax.scan(one_block, start, jnp.arange(blocks))[1]
