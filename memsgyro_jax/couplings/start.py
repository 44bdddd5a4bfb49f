"""A starting point for the fit of a sweep that needs no luck: linear algebra from the record to every parameter but
one.

Both channels are rational functions with the same two poles. A rational fit (Sanathanan and Koerner's iteration) gives
poles and numerators; in a two-mode gyroscope these are

    Vx·det = G (s² + (γy − λη) s + ωy² − λα),   Vy·det = G ρ (λ s² + (λγx − η) s + λωx² − α),   det = Dx Dy − (α + ηs)²

with real brackets, which yields G, the phase of ρ (up to the sign that |arg ρ| < 90° fixes) and, for each gain ratio
|ρ|, all the rest. The gain ratio itself shows only in second order of the coupling, so it is scanned.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.measurement.experiments import PolarNoise

from .bench import Bench, LeakPhasors, LockIn
from .frequency_sweep import FrequencySweep
from .modal import circle_pole
from .modes import CoupledModes, mirrored


GAIN_RATIOS = np.geomspace(0.05, 20.0, 13)
PHASES = np.radians(np.arange(-75.0, 76.0, 25.0))


_FAR = np.geomspace(0.05, 20.0, 16)
PLACES = np.concatenate([-_FAR[::-1], _FAR])  # of the sense mode from the drive mode, in half widths of the band
COARSE_PHASES = np.radians([-50.0, 0.0, 50.0])


def candidates(sweep: FrequencySweep, leak: bool = False) -> list[Bench]:
    """Families of benches to start from, each along the leading axis of every leaf: by rational fit, by the ratio, by
    scanning the sense mode.

    Args:
        sweep: record of a sweep with either electrode driven.
        leak: whether to explain the constant part of the response by electrical feed-through.
    """
    response = sweep.measured / sweep.drive[:, None]
    # With y driven, the same formulas hold with the axes exchanged.
    response = response[:, ::-1] if sweep.axis else response
    centre = 0.5 * (sweep.frequency.max() + sweep.frequency.min())
    half = 0.5 * (sweep.frequency.max() - sweep.frequency.min())
    t = (sweep.frequency - centre) / half
    poles, residues, constant = _rational(t, response, isinstance(sweep.noise, PolarNoise), leak)
    poles, residues = 1j * (centre + half * poles), 1j * half * residues
    own = own_guess(poles, residues)
    phases = jnp.append(jnp.asarray(PHASES), own[0, 1])
    grid = jnp.stack(jnp.meshgrid(jnp.asarray(GAIN_RATIOS), phases), axis=-1).reshape(-1, 2)
    guesses = jnp.concatenate([grid, own])
    benches = jax.vmap(lambda guess: _bench(poles, residues, guess, sweep.axis))(guesses)
    poles = _single_poles(sweep.frequency, response)
    others = jax.vmap(lambda guess: _bench_of_ratio(sweep.frequency, response, poles, guess, sweep.axis))(guesses)
    families = [benches, others, _beyond(sweep.frequency, response, poles, sweep.axis)]
    if not leak:
        return families
    parts = jnp.stack([constant.real, constant.imag], axis=-1)
    parts = parts[::-1] if sweep.axis else parts

    def leaking(family: Bench) -> Bench:
        each = jnp.broadcast_to(parts, (family.device.force_yx.shape[0], 2, 2))
        feedthrough = LeakPhasors(None, each) if sweep.axis else LeakPhasors(each)
        return Bench(family.device, family.readout, feedthrough)

    return [leaking(family) for family in families]


def _beyond(frequency: Array, response: Array, poles: Array, axis: int) -> Bench:
    """Benches with the sense mode tried at places within and beyond the band: noise hides its pull."""
    half = 0.5 * (frequency.max() - frequency.min())
    places = poles[0].imag + half * jnp.asarray(PLACES)
    tries = jnp.stack(jnp.meshgrid(places, jnp.asarray(COARSE_PHASES)), axis=-1).reshape(-1, 2)

    def at(place: Array, phase: Array) -> Bench:
        both = jnp.stack([poles[0], poles[0].real + 1j * place])
        return _bench_of_ratio(frequency, response, both, jnp.stack([jnp.ones_like(phase), phase]), axis)

    return jax.vmap(at)(tries[:, 0], tries[:, 1])


def _rational(t: Float[Array, " n"], response: Complex[Array, "n 2"], relative: bool, leak: bool):
    """Common poles (2,) in t, numerators at them divided by the pole distance (2 poles, 2 channels), and constants (2,)
    of both channels.
    """
    weight = 1 / jnp.abs(response) if relative else jnp.broadcast_to(1 / jnp.abs(response).max(axis=0), response.shape)
    powers = jnp.stack([jnp.ones_like(t), t, t**2], axis=1) + 0j
    columns = powers
    none = jnp.zeros_like(columns)

    def solve(denominator: Array) -> Array:
        w = weight / jnp.abs(denominator)[:, None]
        rows = [
            jnp.concatenate(
                [-response[:, c, None] * powers[:, :2], *(columns if i == c else none for i in (0, 1))], axis=1
            )
            * w[:, c, None]
            for c in (0, 1)
        ]
        matrix = jnp.concatenate(rows)
        right = jnp.concatenate([response[:, c] * powers[:, 2] * w[:, c] for c in (0, 1)])
        scale = jnp.linalg.norm(matrix, axis=0)
        q, r = jnp.linalg.qr(matrix / scale)
        return jax.scipy.linalg.solve_triangular(r, q.conj().T @ right) / scale

    def iterate(_: int, state: tuple[Array, Array]) -> tuple[Array, Array]:
        solution = solve(state[1])
        poles = _stable(_quadratic_roots(solution[1], solution[0]))
        return solution, (t - poles[0]) * (t - poles[1])

    first = 0.1 * jnp.ones_like(t) + 0j
    solution, _ = jax.lax.fori_loop(0, 15, iterate, (jnp.zeros(2 + 2 * columns.shape[1]) + 0j, first))
    poles = _stable(_quadratic_roots(solution[1], solution[0]))
    numerators = solution[2:].reshape(2, -1)
    at_poles = jnp.stack([numerators @ p ** jnp.arange(columns.shape[1]) for p in poles])
    constant = numerators[:, 2]
    return poles, at_poles / (poles - poles[::-1])[:, None], constant


def _quadratic_roots(b: Array, c: Array) -> Complex[Array, " 2"]:
    root = jnp.sqrt(b * b - 4 * c)
    root = jnp.where((b.conj() * root).real < 0, -root, root)
    q = -0.5 * (b + root)
    return jnp.stack([q, c / q])


def _stable(poles: Array) -> Array:
    """Poles in t = (ω − centre)/half lie above the real axis when they decay."""
    return poles.real + 1j * jnp.maximum(jnp.abs(poles.imag), 1e-7)


def _bench(poles: Complex[Array, " 2"], residues: Complex[Array, "2 2"], guess: Float[Array, " 2"], axis: int) -> Bench:
    """Bench with the guessed (gain ratio, phase asymmetry) that has the poles and residues found [rad/s].

    The poles are kept whatever the guess: the uncoupled modes follow from them and the coupling by undoing the narrow-
    band splitting, (ux − uy)² = (p1 − p2)² + (C/ω)². A wrong guess then misses only the small second resonance of the
    drive channel.
    """
    ratio, phase = guess
    order = jnp.argsort(-jnp.abs(residues[:, 0]))  # the drive mode is the one the drive channel shows
    poles, residues = poles[order], residues[order]
    gain = _gain(poles, residues)
    e0, e1, e2 = _bracket(poles, _sense_bracket(poles, residues) / (ratio * jnp.exp(1j * phase)))
    middle, half = poles.mean(), 0.5 * (poles[0] - poles[1])

    def uncoupled(_: int, ux: Array) -> Array:
        coupling = -(e0 + e1 * ux + e2 * ux**2)  # C at the drive mode, where Dx vanishes
        shift = jnp.sqrt(half**2 + coupling**2 / (4 * jnp.abs(poles[0] * poles[1])))
        return middle + jnp.where((shift * half.conj()).real < 0, -shift, shift)

    ux = jax.lax.fori_loop(0, 4, uncoupled, poles[0])
    modes = jnp.stack([ux, 2 * middle - ux])
    omega, damping = jnp.abs(modes), -2 * modes.real
    # A wrong guess can ask for negative damping; share the sum evenly then.
    quality = omega / jnp.where(jnp.min(damping) > 0, damping, jnp.abs(damping.mean()))
    eta, alpha = e2 * damping[0] - e1, e2 * omega[0] ** 2 - e0
    return _placed(CoupledModes(omega, quality, eta, alpha, e2, 0.0 * e2), gain, ratio, phase, axis)


def _gain(poles: Array, residues: Array) -> Array:
    """Complex gain of the drive channel: Vx·det = G s² + ..., det = Π (s − p)(s − p*)."""
    return 2j * jnp.abs(poles).mean() * residues[:, 0].sum()


def _sense_bracket(poles: Array, residues: Array) -> Complex[Array, " 2"]:
    """Vy·det/G at the two poles."""
    others = poles[::-1]
    slope = (poles - others) * (poles - poles.conj()) * (poles - others.conj())
    return residues[:, 1] * slope / _gain(poles, residues)


def _bracket(poles: Array, values: Array) -> Float[Array, " 3"]:
    """Real e0, e1, e2 for which e0 + e1 s + e2 s² comes closest to the values at both poles.

    The three columns are written about the mean frequency, where they are nearly orthogonal.
    """
    size = jnp.abs(poles).mean()
    columns = jnp.stack([jnp.ones_like(poles), poles / size, 1 + (poles / size) ** 2], axis=1)
    matrix = jnp.concatenate([columns.real, columns.imag])
    norm = jnp.linalg.norm(matrix, axis=0)
    solution = jnp.linalg.lstsq(matrix / norm, jnp.concatenate([values.real, values.imag]))[0] / norm
    e2 = solution[2] / size**2
    return jnp.stack([solution[0] + solution[2], solution[1] / size, e2])


def _single_poles(frequency: Array, response: Array) -> Complex[Array, " 2"]:
    """Coupled drive pole from the drive channel and uncoupled sense pole from the ratio (λDx − C)/Dy, each alone
    [rad/s].

    The ratio shows the sense mode where the sweep does not reach its resonance; its decay is then taken from the drive
    mode.
    """
    poles = jnp.stack([circle_pole(frequency, response[:, 0]), circle_pole(frequency, response[:, 1] / response[:, 0])])
    decay = jnp.maximum(-poles.real, 1e-7 * jnp.abs(poles))
    reach = 0.2 * jnp.min(jnp.abs(frequency - poles[1].imag)) + decay[0]
    decay = jnp.stack([decay[0], jnp.where(poles[1].real < -reach, decay[0], decay[1])])
    return -decay + 1j * jnp.abs(poles.imag)


def _bench_of_ratio(frequency: Array, response: Array, poles: Array, guess: Array, axis: int) -> Bench:
    """Bench with the guessed (gain ratio, phase asymmetry), its couplings from linear least squares on the ratio for
    given poles.
    """
    ratio, phase = guess
    measured = response[:, 1] / response[:, 0]
    omega, quality = jnp.abs(poles), jnp.abs(poles) / (-2 * poles.real)
    dx, dy, *_ = CoupledModes(omega, quality).dynamic_stiffness(frequency)
    columns = jnp.stack([dx / dy, -1 / dy], axis=1) / jnp.abs(measured)[:, None]
    norm = jnp.linalg.norm(columns, axis=0)
    seen = jnp.linalg.lstsq(columns / norm, measured / jnp.abs(measured))[0] / norm
    force, coupling = seen / (ratio * jnp.exp(1j * phase))
    shift = coupling**2 / (4 * omega[0] ** 2 * (poles[0] - poles[1]))
    drive = poles[0] + jnp.where(jnp.abs(shift) < 0.5 * jnp.abs(poles[0] - poles[1]), shift, 0.0)
    drive = jnp.where(drive.real < 0, drive, poles[0])
    omega = jnp.stack([jnp.abs(drive), omega[1]])
    quality = jnp.stack([jnp.abs(drive) / (-2 * drive.real), quality[1]])
    modes = CoupledModes(omega, quality, coupling.imag / omega[0], coupling.real, force.real, 0.0 * force.real)
    gain = _regress(modes.response(frequency, 0)[:, 0], response[:, 0])
    return _placed(modes, gain, ratio, phase, axis)


def _placed(modes: CoupledModes, gain: Array, ratio: Array, phase: Array, axis: int) -> Bench:
    """The bench of modes found with the driven axis first."""
    if axis == 0:
        return Bench(modes, LockIn(jnp.abs(gain), jnp.angle(gain), ratio, phase))
    # The driven channel is y: its gain is gain·drive_ratio·gain_ratio of the lock-in, with the drive ratio left at one.
    return Bench(mirrored(modes), LockIn(jnp.abs(gain) * ratio, jnp.angle(gain) + phase, 1 / ratio, -phase))


def own_guess(poles: Complex[Array, " 2"], residues: Complex[Array, "2 2"]) -> Float[Array, "2 2"]:
    """Two guesses of (gain ratio, phase) that the record itself offers.

    The first has the phase, within ±90°, that makes the bracket of the sense numerator real (it shows in the force
    coupling), the second the complex ratio that makes the coupling seen in the sense channel agree with the zero of the
    drive channel.
    """
    order = jnp.argsort(-jnp.abs(residues[:, 0]))
    poles, residues = poles[order], residues[order]
    bracket = _sense_bracket(poles, residues)
    turn = bracket[1] / poles[1].imag - bracket[0] / poles[0].imag
    zero = (residues[0, 0] * poles[1] + residues[1, 0] * poles[0]) / residues[:, 0].sum()
    square = -4 * jnp.abs(poles[0]) ** 2 * (poles[0] - (poles.sum() - zero)) * (poles[0] - zero)
    ratio = -bracket[0] / jnp.sqrt(square)
    ratio = jnp.where(ratio.real < 0, -ratio, ratio)
    size = jnp.clip(jnp.abs(ratio), 0.01, 100.0)
    return jnp.stack([jnp.stack([size, jnp.arctan(turn.imag / turn.real)]), jnp.stack([size, jnp.angle(ratio)])])


def with_other_axis(bench: Bench, sweep: FrequencySweep) -> Bench:
    """A bench found with x driven, completed by a sweep with y driven: its drive gain and its force coupling, by linear
    least squares.
    """
    device, readout = bench.device, bench.readout
    dx, dy, cxy, cyx = device.dynamic_stiffness(sweep.frequency, sweep.rate)
    numerators = sweep.measured / sweep.drive[:, None] * (dx * dy - cxy * cyx)[:, None] / readout.channels(0)
    drive = _regress(dx, numerators[:, 1])
    cross = numerators[:, 0] / drive
    force_xy = _regress(dy, cross + cxy, 1 / jnp.abs(cross)).real
    leak = bench.feedthrough and LeakPhasors(bench.feedthrough.x_drive, jnp.zeros_like(bench.feedthrough.x_drive))
    return eqx.tree_at(
        lambda b: (b.device.force_xy, b.readout.drive_ratio, b.readout.drive_asymmetry, b.feedthrough),
        bench,
        (force_xy, jnp.abs(drive), jnp.angle(drive), leak),
        is_leaf=lambda leaf: leaf is None,
    )


def _regress(column: Array, right: Array, weight: Array | None = None) -> Array:
    """Complex factor f of column·f ≈ right, weighted, by default by 1/|right|."""
    weight = (1 / jnp.abs(right) if weight is None else weight) ** 2
    return jnp.sum(weight * column.conj() * right) / jnp.sum(weight * jnp.abs(column) ** 2)
