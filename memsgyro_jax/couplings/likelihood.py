"""Maximum likelihood of one or several frequency sweeps: what is free, where to start, and the fit itself."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, PyTree

from memsgyro_jax.base.transforms import Free, Log, LogLogit, fixed, mark
from memsgyro_jax.effects import FiniteSweepRate, ReadoutDelay

from . import start as sweep_start
from .bench import Bench
from .frequency_sweep import FrequencySweep
from .sense_view import SeenBench
from .tree_fit import Fit, best_start, evaluate, fit_tree, fit_tree_from


STARTS = 2  # of each family scanned
QUALITIES = (1.0, 1e9)  # what any resonator has: a sweep that does not show a mode would let its quality run away
GAIN_RATIOS = (1e-4, 1e4)
SPEEDS = np.geomspace(1e-3, 3.0, 8)  # sweep rates to start from, in squared decay rates of the narrower mode


def free_parameters(seen: SeenBench, sweeps: Sequence[FrequencySweep]) -> PyTree:
    """What a set of sweeps may move: modes, couplings and read-out; the force coupling of an electrode only where it
    was driven.
    """
    axes = {sweep.axis for sweep in sweeps}
    spec = mark(fixed(seen), lambda b: (b.omega, b.readout.gain), Free(Log()))
    spec = mark(spec, lambda b: b.quality, Free(LogLogit(*QUALITIES)))
    spec = mark(spec, lambda b: b.readout.gain_ratio, Free(LogLogit(*GAIN_RATIOS)))
    spec = mark(spec, lambda b: (b.coupling, b.readout.phase, b.readout.phase_asymmetry), Free())
    if 0 in axes:
        spec = mark(spec, lambda b: b.force_yx, Free())
    if 1 in axes:
        spec = mark(spec, lambda b: b.force_xy, Free())
    if len(axes) == 2:
        spec = mark(spec, lambda b: b.readout.drive_ratio, Free(Log()))
        spec = mark(spec, lambda b: b.readout.drive_asymmetry, Free())
    if seen.feedthrough is not None:
        spec = eqx.tree_at(lambda b: b.feedthrough, spec, jax.tree.map(lambda _: Free(), seen.feedthrough))
    if seen.sweep_rate is not None:
        spec = mark(spec, lambda b: b.sweep_rate.strength, Free(Log()))
    if seen.delay is not None:  # of either sign: what the reference comes late by, the read-out comes early by
        spec = mark(spec, lambda b: b.delay.strength, Free())
    if seen.offsets is not None:
        spec = mark(spec, lambda b: b.offsets, Free())
    return spec


@eqx.filter_jit
def fit_sweeps(
    sweeps: Sequence[FrequencySweep],
    *,
    leak: bool = False,
    moving: bool = False,
    late: bool = False,
    apart: bool = False,
    starts: int = STARTS,
) -> Fit:
    """Fit device and read-out to all sweeps from starts that the records themselves give.

    Args:
        sweeps: records of one device and one read-out, with either electrode driven.
        leak: add `LeakPhasors` for the electrodes driven.
        moving: add `FiniteSweepRate`, one speed for all sweeps.
        late: add `ReadoutDelay`, of both channels in all sweeps.
        apart: let the frequencies of each sweep be higher or lower than those of the first.
        starts: how many of each family of scanned starts to optimise.

    Returns:
        A `Fit` whose values are a `SeenBench`, with the gauge |phase asymmetry| < 90°.
    """
    candidates = _candidates(tuple(sweeps), leak, moving, starts)
    if late:
        none = ReadoutDelay(jnp.zeros_like(candidates.readout.phase))
        candidates = eqx.tree_at(lambda seen: seen.delay, candidates, none, is_leaf=_absent)
    if apart:
        same = jnp.zeros((*candidates.readout.phase.shape, len(sweeps) - 1))
        candidates = eqx.tree_at(lambda seen: seen.offsets, candidates, same, is_leaf=_absent)
    spec = free_parameters(jax.tree.map(lambda leaf: leaf[0], candidates), sweeps)
    best = fit_tree_from(candidates, spec, sweeps)
    return evaluate(gauge_fixed(best.values), spec, sweeps, converged=best.converged, steps=best.steps)


@eqx.filter_jit
def refit(start: SeenBench, sweeps: Sequence[FrequencySweep], **options) -> Fit:
    """Fit from one start, gauge fixed before; use it for noise draws around a known device (under `vmap`)."""
    return fit_tree(gauge_fixed(start), free_parameters(start, sweeps), sweeps, **options)


def refit_draws(start: SeenBench, sweep: FrequencySweep, draws: Complex[Array, "d n 2"], together: int = 4) -> Fit:
    """Refit every noise draw of a sweep from one start, by `vmap` over `together` of them at a time so that they stay
    in the cache.

    Every leaf of the result has the draws along its leading axis.
    """
    return jax.lax.map(
        lambda measured: refit(start, (sweep.with_measured(measured),), tolerance=1e-5), draws, batch_size=together
    )


def gauge_fixed(seen: SeenBench) -> SeenBench:
    """The twin with |phase asymmetry| < 90°: turning the y axis round, (λ, c, k, asymmetries) → (−λ, −c, −k, +180°),
    changes no prediction.
    """
    readout = seen.readout
    turned = jnp.cos(readout.phase_asymmetry) < 0
    sign = jnp.where(turned, -1.0, 1.0)

    def wrapped(angle: Array) -> Array:
        return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi

    half = jnp.where(turned, jnp.pi, 0.0)
    # The seen products carry ρ, whose sign the turn changes together with that of C: only the force couplings |ρ|·λ
    # change sign.
    return eqx.tree_at(
        lambda b: (b.force_yx, b.force_xy, b.readout.phase, b.readout.phase_asymmetry, b.readout.drive_asymmetry),
        seen,
        (
            sign * seen.force_yx,
            sign * seen.force_xy,
            wrapped(readout.phase),
            wrapped(readout.phase_asymmetry + half),
            wrapped(readout.drive_asymmetry + half),
        ),
    )


def _candidates(sweeps: tuple[FrequencySweep, ...], leak: bool, moving: bool, starts: int) -> SeenBench:
    first = min(sweeps, key=lambda sweep: sweep.axis)
    families = sweep_start.candidates(first, leak)
    other = next((sweep for sweep in sweeps if sweep.axis != first.axis), None)
    if other is not None:
        families = [jax.vmap(lambda bench: sweep_start.with_other_axis(bench, other))(family) for family in families]
    # Each family keeps its best: the one that wins on a wide sweep fits noise with its second pole on a narrow one.
    kept = [best_start(family, sweeps, starts) for family in families]
    # the best of each family first, then the second of each
    benches = jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=1).reshape(-1, *leaves[0].shape[1:]), *kept)
    if moving:
        benches = best_start(_at_speeds(benches), sweeps, len(families) * starts)
    return jax.vmap(lambda bench: gauge_fixed(SeenBench.of(bench)))(benches)


def _at_speeds(benches: Bench) -> Bench:
    """Every bench of a batch at each of `SPEEDS`, as one batch."""
    decay = jnp.min(benches.device.omega / benches.device.quality, axis=-1) / 2
    speeds = jnp.asarray(SPEEDS) * decay[:, None] ** 2

    def at(bench: Bench, speed: Array) -> Bench:
        return eqx.tree_at(_speed, bench, FiniteSweepRate(speed), is_leaf=_absent)

    grid = jax.vmap(lambda bench, row: jax.vmap(lambda speed: at(bench, speed))(row))(benches, speeds)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), grid)


def _speed(bench: Bench) -> FiniteSweepRate | None:
    return bench.sweep_rate


def _absent(leaf: object) -> bool:
    return leaf is None
