"""What the tests of all members share: a device, unremarkable conditions and states, and strengths that matter."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.effects import Effect, ForceEffect, catalogue
from memsgyro_jax.measurement.model import Conditions, Model


MEMBERS = catalogue(2)
LABELS = [effect.label for effect in MEMBERS]
AXES_AND_MEMBERS = [(axes, effect) for axes in (1, 2) for effect in catalogue(axes)]

# Strengths at which each effect is about a per cent of what it acts on, at 1 µm, 0.1 m/s and 10 nN, in SI.
STRENGTHS = {
    "cubic_stiffness": 1e12, "quadratic_stiffness": 1e6, "cross_stiffness": 1e12, "electrostatic_softening": 1e-2,
    "electrostatic_cubic_stiffness": 1e11, "bias_transduction": 0.02, "thermal_curvature": 1e-4,
    "cross_damping_asymmetry": 2e-7, "quadratic_damping": 1e-6, "squeeze_film_damping": 1e5, "dry_friction": 1e-8,
    "damping_step": 0.1, "thermal_drift": 1e-3, "parasitic_mode": 1e-3, "rate_offset": 0.1, "rate_scale_error": 0.01,
    "rate_bias_drift": (0.1, -0.2, 0.05, 0.02, -0.03, 0.01), "angular_acceleration": 1.0, "centrifugal": 1.0,
    "force_misalignment": 0.01, "drive_nonlinearity": 1e6, "electrical_feedthrough": 1e4, "readout_delay": 1e-7,
    "pickoff_scale_error": 0.01, "pickoff_nonlinearity": 1e4, "pickoff_cubic_nonlinearity": 1e10,
    "pickoff_crosstalk": 0.01, "adc_saturation": 4.0, "finite_sweep_rate": 100.0,
}  # fmt: skip


def present(effect: Effect, factor: float = 1.0) -> Effect:
    """The effect at a strength that matters."""
    return eqx.tree_at(lambda e: e.strength, effect, factor * jnp.asarray(STRENGTHS[effect.name], float))


def device(axes: int = 2) -> NormalisedDevice:
    """A gyro of 0.18 mg and some 19 kHz, or its x axis."""
    stiffness, damping = np.array([64.0, 72.0, 0.5]) / 1.8e-7, np.array([3.6e-6, 4.5e-6, 2e-7]) / 1.8e-7
    size = 3 if axes == 2 else 1
    return NormalisedDevice(stiffness[:size], damping[:size], 1 / 1.8e-7)


def model(*effects: Effect, axes: int = 2) -> Model:
    return Model(device(axes), scale=5e5, offset=0.01, effects=effects, reference_bias=2.0)


CONDITIONS = Conditions(
    rate=1.5, angular_acceleration=30.0, temperature=310.0, bias_voltage=3.0, time=0.2, progress=0.3, record=0.0
)
FORCE, FORCE_RATE = np.array([1e-8, -2e-8]), np.array([1e-3, 3e-3])


def state_of(of: Model, seed: int = 0) -> np.ndarray:
    """Micrometres and 0.1 m/s; own states are displacements."""
    scales = np.full(of.size, 1e-6)
    scales[of.axes : 2 * of.axes] = 0.1
    return scales * np.random.default_rng(seed).uniform(0.3, 1.0, of.size) * np.resize([1.0, -1.0], of.size)


def seen(of: Model, state, conditions=CONDITIONS):
    """All an effect can change at an instant: derivative of the motion, own derivatives, voltages."""
    force, rate = FORCE[: of.axes], FORCE_RATE[: of.axes]
    return of.derivative(state, force, conditions), of.observe(state, force, rate, conditions)


def forces(effects) -> list[Effect]:
    return [effect for effect in effects if isinstance(effect, ForceEffect)]
