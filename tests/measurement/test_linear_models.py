"""A model that is affine is predicted without sampling its waveform: as one whose waveform is sampled says as well."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import bench

from memsgyro_jax.effects import ForceEffect, by_name, catalogue, strength
from memsgyro_jax.measurement.readings import readings_of
from memsgyro_jax.measurement.steady import steady_state


def acting(name, where, strength):
    return eqx.tree_at(lambda e: e.strength, by_name(name, where), jnp.asarray(strength))


ABSENT = by_name("cubic_stiffness", "x"), by_name("pickoff_nonlinearity", "y")  # at strength zero: sampled all the same
NONLINEAR = (
    "cubic_stiffness", "quadratic_stiffness", "cross_stiffness", "quadratic_damping", "squeeze_film_damping",
    "dry_friction", "drive_nonlinearity", "electrostatic_cubic_stiffness",
)  # fmt: skip
CURVED = "pickoff_nonlinearity", "pickoff_cubic_nonlinearity", "adc_saturation"
ACTING = (
    acting("thermal_drift", "stiffness", -6e-5),
    acting("thermal_drift", "damping", 3e-3),
    acting("electrostatic_softening", "x", 2e-4),
    acting("rate_scale_error", "", 0.01),
    acting("angular_acceleration", "", 1.0),
    acting("electrical_feedthrough", "x_to_y", 40.0),
    acting("readout_delay", "", 2e-6),
    acting("pickoff_crosstalk", "x_to_y", 0.02),
    acting("force_misalignment", "x_to_y", 0.02),
)


class Push(ForceEffect):
    name, unit, law = "push", "N", "F = s"
    strength: jax.Array = strength()

    def force(self, now):
        return self.along(now, self.strength)


@pytest.fixture(scope="module")
def taken():
    made = bench()
    return made.model(()), {type(r.experiment).__name__: r.experiment for r in readings_of(made.case)}


@pytest.mark.parametrize("effect", catalogue(2), ids=lambda effect: effect.label)
def test_which_effects_are_linear(taken, effect):
    model = taken[0].with_effect(effect)
    assert model.is_linear == (effect.name not in NONLINEAR)
    assert model.is_read_linearly == (effect.name not in CURVED)


@pytest.mark.parametrize(
    "kind",
    ["HarmonicSweep", *(pytest.param(k, marks=pytest.mark.slow) for k in ("RateTable", "RawCapture", "RingDown"))],
)
def test_predictions_are_those_of_sampled_waveforms(taken, kind):
    """And so are their derivatives by every number of the model."""
    model, experiment = taken[0].with_effect(*ACTING), taken[1][kind]
    sampled = model.with_effect(*ABSENT)
    assert (model.is_linear, model.is_read_linearly) == (True, True)
    assert (sampled.is_linear, sampled.is_read_linearly) == (False, False)

    @eqx.filter_jit
    def predicted(model):
        def along(relative):
            device = jax.tree.map(lambda leaf: leaf * (1.0 + relative), model.device)
            return experiment.predict(eqx.tree_at(lambda m: m.device, model, device))

        return jax.jvp(along, (0.0,), (1.0,))

    for plain, whole in zip(predicted(model), predicted(sampled), strict=True):
        size = np.max(np.abs(whole))
        assert size > 0
        np.testing.assert_allclose(plain / size, whole / size, rtol=0, atol=3e-9)


@pytest.mark.slow
def test_constant_accelerations_deflect_the_settled_state():
    """An affine model keeps its constant: the mean deflection that it causes is seen in harmonic zero alone."""
    made = bench()
    model = made.model(())
    pushed = model.with_effect(Push(strength=1e-9))
    omega, force, rest = jnp.sqrt(model.device.stiffness[0]), jnp.array([1e-8 + 0j, 0.0]), jnp.zeros(2, complex)
    around = next(r.experiment for r in readings_of(made.case)).surroundings
    first = jax.tree.map(lambda leaf: leaf[0], around)
    found = steady_state(pushed, omega, force, first, rest)
    plain = steady_state(model, omega, force, first, rest)
    moved = np.linalg.solve(model.device.stiffness_matrix, model.device.mobility * np.array([1e-9, 0.0]))
    np.testing.assert_allclose(found[0, :2], moved, rtol=1e-9)
    np.testing.assert_allclose(found[1:], plain[1:], rtol=1e-12, atol=1e-300)
