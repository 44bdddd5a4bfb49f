"""Describing functions of textbook laws, and the resonance and quality factor that they make."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.diagnosis import describing
from memsgyro_jax.diagnosis.describing import consequence, describing_function, drift_over
from memsgyro_jax.effects.instrument import DampingDrift, FrequencyDrift, RecordGain
from memsgyro_jax.measurement.model import Model


OMEGA, QUALITY, MASS = 2 * np.pi * 20e3, 500.0, 2e-9
LARGEST = "at 2 µm, the largest amplitude of the sweeps"
QUALITIES = "the quality factor is {} in place of 500 (1/Q {} {})"
PLACE = np.array([1e-7, 5e-7, 2e-6])


def beside(model, records=()):
    """A model beside a case, as far as it is looked at."""
    case = SimpleNamespace(words=SimpleNamespace(displacement="m", force="N"), records=records)
    return SimpleNamespace(model=model, case=case, stepped_forces={})


@pytest.fixture
def model():
    device = NormalisedDevice(jnp.array([OMEGA**2]), jnp.array([OMEGA / QUALITY]), 1.0 / MASS)
    return Model(device, scale=jnp.ones(1), offset=jnp.zeros(1))


def test_a_cubic_spring_and_a_quadratic_damper(model):
    (spring,) = describing_function(model, mg.effects.CubicStiffness("x", 3e9), 0, OMEGA, PLACE)
    assert list(spring) == ["stiffness"]
    np.testing.assert_allclose(spring["stiffness"], 0.75 * 3e9 * PLACE**2, rtol=1e-10)
    (damper,) = describing_function(model, mg.effects.QuadraticDamping("x", 2e-6), 0, OMEGA, PLACE)
    assert list(damper) == ["damping"]
    np.testing.assert_allclose(damper["damping"], 8.0 / (3.0 * np.pi) * 2e-6 * OMEGA * PLACE, rtol=1e-3)


@pytest.mark.parametrize(
    ("effect", "told"),
    [
        (mg.effects.CubicStiffness("x", 3e9), f"{LARGEST}, the resonance is 2.85 Hz higher"),
        (mg.effects.CubicStiffness("x", -3e9), f"{LARGEST}, the resonance is 2.85 Hz lower"),
        (
            mg.effects.QuadraticDamping("x", 2e-6),
            f"{LARGEST}, {QUALITIES.format(270, 0.0017, 'higher')}",
        ),
        (
            mg.effects.QuadraticDamping("x", -2e-7),
            f"{LARGEST}, {QUALITIES.format(546, 0.00017, 'lower')}",
        ),
        (mg.effects.CubicStiffness("x", 1e5), ""),
        (mg.effects.PickoffNonlinearity("x", 1e3), ""),
    ],
)
def test_what_a_law_does_at_the_largest_swing(model, monkeypatch, effect, told):
    monkeypatch.setattr(describing, "_swept", lambda fit: [(1e-6, 0, "sweeps"), (2e-6, 0, "sweeps")])
    assert consequence(beside(model), effect) == told


def test_the_largest_swing_of_a_free_decay_counts_as_well(model):
    """Whose readings are 1 V for 2 µm/s: 4 µm at 20 kHz."""
    whole = Model(model.device, scale=0.5e6, order=1)
    decay = SimpleNamespace(free_modes=lambda case: [(0.5e6 * OMEGA * 4e-6, OMEGA, 0.5 * OMEGA / QUALITY)])
    driven = SimpleNamespace(free_modes=lambda case: None)
    said = consequence(beside(whole, (driven, decay)), mg.effects.QuadraticDamping("x", 2e-6))
    assert said == f"at 4 µm, the largest amplitude of the decays, {QUALITIES.format(185, 0.0034, 'higher')}"
    assert consequence(beside(whole, (driven,)), mg.effects.QuadraticDamping("x", 2e-6)) == ""


def test_a_drift_says_over_which_time_it_goes_on():
    fit = SimpleNamespace(modes=(SimpleNamespace(value=30e3),))
    both = {"strength": (-2e-5,), "begin": (0.0, 0.0), "span": (600.0, 600.0)}
    said = drift_over(fit, FrequencyDrift(**both, of="throughout"))
    assert said == (
        "T = 600 s, from the first row of all records to the last, by one clock: -0.6 Hz in all, -0.06 Hz per minute"
    )
    each = {"strength": (1e-3, 2e-3), "begin": (0.0, 600.0), "span": (500.0, 300.0)}
    assert drift_over(fit, DampingDrift(**each)) == "T = 300 to 500 s, of each record by itself"
    assert drift_over(fit, RecordGain((0.1,))) == ""
