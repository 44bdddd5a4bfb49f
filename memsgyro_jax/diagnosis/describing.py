"""What a law amounts to in a swing of one amplitude: a stiffness and a damping (its describing function), and with them
a resonance and a quality factor.

Gelb and Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, McGraw-Hill 1968.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.text import spoken
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import Effect, ForceEffect
from memsgyro_jax.effects.evaluation import moment
from memsgyro_jax.effects.instrument import THROUGHOUT, ClockedTerm, FrequencyDrift, FrequencyWander
from memsgyro_jax.measurement.calibration import unit_of_records
from memsgyro_jax.measurement.experiments.missing_force import SweepForce
from memsgyro_jax.measurement.model import Model

from .fit import CaseFit


_PHASES = 64  # of a period, over which a force is averaged
_MATTERS = 1e-3  # of the larger part of a law, below which the other is left out
_SEEN = 0.01  # of a resonance's width, and of its quality factor: a smaller change is not told
_COURSE = 1001  # moments of a course


def force_of(model: Model, effect: Effect, displacement: Array, velocity: Array) -> np.ndarray:
    """Force (rows, axes) [N] at displacements and velocities (rows, axes), at the reference conditions."""

    def one(q: Array, v: Array) -> Array:
        conditions = Conditions(temperature=None, bias_voltage=None)
        now = moment(
            q, v, jnp.zeros_like(q), conditions, device=model.device, scale=model.scale,
            reference_temperature=model.reference_temperature, reference_bias=model.reference_bias, order=model.order,
        )  # fmt: skip
        return effect.force(now)  # type: ignore[attr-defined]

    return np.asarray(jax.vmap(one)(jnp.asarray(displacement), jnp.asarray(velocity)))


def _along(axis: int, axes: int, values: np.ndarray) -> np.ndarray:
    out = np.zeros((len(values), axes))
    out[:, axis] = values
    return out


def describing_function(
    model: Model, effect: Effect, axis: int, omega: float, place: Float[np.ndarray, " amplitudes"]
) -> list[dict[str, Float[np.ndarray, " amplitudes"]]]:
    """Per axis of the force, the stiffness [N/m] and the damping [N s/m] that the law amounts to in a swing along an
    axis at `omega`, of each amplitude `place` [m]; a part that is next to nothing beside the other is left out.
    """
    angle = 2.0 * np.pi * np.arange(_PHASES) / _PHASES
    turned, rate = np.outer(place, np.cos(angle)), -omega * np.outer(place, np.sin(angle))
    motion = [_along(axis, model.axes, values.ravel()) for values in (turned, rate)]
    force = force_of(model, effect, *motion).reshape(len(place), _PHASES, model.axes)
    stiffness = -2.0 * np.mean(force * np.cos(angle)[:, None], axis=1) / place[:, None]
    damping = 2.0 * np.mean(force * np.sin(angle)[:, None], axis=1) / (omega * place[:, None])
    out = []
    for along in range(model.axes):
        parts = {"stiffness": stiffness[:, along], "damping": damping[:, along]}
        sizes = {"stiffness": np.ptp(stiffness[:, along]), "damping": omega * np.ptp(damping[:, along])}
        out.append({name: parts[name] for name, size in sizes.items() if size > _MATTERS * max(sizes.values()) > 0.0})
    return out


def consequence(fit: CaseFit, effect: Effect) -> str:
    """A sentence on what an effect does to resonance and quality factor at the largest swing of the sweeps and decays;
    empty where it is no force that follows the motion of one axis, or none shows how far it swings along that.
    """
    if not isinstance(effect, ForceEffect) or effect.own_size:
        return ""
    swings = [one for one in (*_swept(fit), *_left_alone(fit)) if one[1] == getattr(effect, "axis", one[1])]
    if not swings:
        return ""
    (amplitude, axis, of), device = max(swings), fit.model.device
    stiffness, damping = np.asarray(device.stiffness_matrix)[axis, axis], np.asarray(device.damping_matrix)[axis, axis]
    omega = float(np.sqrt(stiffness))
    parts = describing_function(fit.model, effect, axis, omega, np.array([0.5, 1.0]) * amplitude)[axis]
    added = {name: abs(float(device.mobility)) * values[-1] for name, values in parts.items()}
    higher = float(np.sqrt(max(0.0, stiffness + added.get("stiffness", 0.0)))) - omega
    before, after = omega / damping, (omega + higher) / (damping + added.get("damping", 0.0))
    loss = 1.0 / after - 1.0 / before
    said = [f"the resonance is {spoken(abs(higher) / (2 * np.pi), 'Hz', 3)} {'higher' if higher > 0 else 'lower'}"]
    said = said if abs(higher) > _SEEN * damping else []
    if "damping" in added and abs(after / before - 1.0) > _SEEN:
        way = f"1/Q {abs(loss):.3g} {'higher' if loss > 0 else 'lower'}"
        said.append(f"the quality factor is {after:.0f} in place of {before:.0f} ({way})")
    swing = spoken(amplitude, unit_of_records(fit.case, "m"), 3)
    return f"at {swing}, the largest amplitude of the {of}, {' and '.join(said)}" if said else ""


def _swept(fit: CaseFit) -> list[tuple[float, int, str]]:
    """Largest displacement that each record over frequency shows [m], its axis, and what such records are called."""
    swept = (one for one in fit.stepped_forces.values() if isinstance(one, SweepForce))
    return [(float(np.max(one.amplitude)), one.axis, "sweeps") for one in swept]


def _left_alone(fit: CaseFit) -> list[tuple[float, int, str]]:
    """The same of free decays."""
    scale, order, out = np.abs(np.asarray(fit.model.scale)), fit.model.order, []
    for record in fit.case.records:
        for axis, (reading, omega, _) in enumerate(record.free_modes(fit.case) or ()):
            out.append((float(reading / (scale[axis] * omega**order)), axis, "decays"))
    return out


def drift_over(fit: CaseFit, term: Effect) -> str:
    """A sentence on the time over which a drift goes on, and on how far and fast the resonance moves; empty for all
    else.
    """
    if not isinstance(term, ClockedTerm):
        return ""
    spans, shares = np.unique(np.asarray(term.span)), np.asarray(term.strength)
    if isinstance(term, FrequencyWander):
        over = np.ptp(term.course(np.linspace(0.0, 1.0, _COURSE)) @ shares) * float(fit.modes[0].value)
        return f"T = {spans[0]:.4g} s, by one clock: the resonance moves over {over:.3g} Hz"
    if term.where == THROUGHOUT:
        said = f"T = {spans[0]:.4g} s, from the first row of all records to the last, by one clock"
    else:
        said = f"T = {' to '.join(f'{s:.4g}' for s in spans[[0, -1][: len(spans)]])} s, of each record by itself"
    if not isinstance(term, FrequencyDrift) or shares.size > 1 or len(spans) > 1:
        return said
    moved = float(shares[0]) * float(fit.modes[0].value)
    return f"{said}: {moved:+.3g} Hz in all, {60.0 * moved / spans[0]:+.3g} Hz per minute"
