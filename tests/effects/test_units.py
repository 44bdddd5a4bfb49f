"""The declared unit of every strength is the right one: in other units of length, mass, time and voltage the numbers
change and the physics does not.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pint
import pytest
from effects.members import CONDITIONS, FORCE, FORCE_RATE, LABELS, MEMBERS, model, present, state_of

from memsgyro_jax import effects as fx
from memsgyro_jax.measurement.model import Model


# One new unit in SI: length, mass, time, voltage, temperature.
NEW = {"[length]": 1e-6, "[mass]": 1e-9, "[time]": 3e-5, "[voltage]": 0.02, "[temperature]": 7.0}
FIELDS = {"creep": "m/s", "rounding": "1", "omega": "rad/s", "quality": "1", "time": "s", "record": "1"}
REGISTRY = pint.UnitRegistry()


def size(unit: str) -> float:
    """The SI unit measured in the new units. A volt counts as a unit of its own (a current is none of ours)."""
    dimensions = dict(REGISTRY.parse_units(unit).dimensionality)
    volts = -dimensions.pop("[current]", 0)
    dimensions["[mass]"] = dimensions.get("[mass]", 0) - volts
    dimensions["[length]"] = dimensions.get("[length]", 0) - 2 * volts
    dimensions["[time]"] = dimensions.get("[time]", 0) + 3 * volts
    dimensions["[voltage]"] = volts
    return float(np.prod([NEW[name] ** -power for name, power in dimensions.items()]))


def converted(effect: fx.Effect) -> fx.Effect:
    leaves = [field.name for field in dataclasses.fields(effect) if not field.metadata.get("static")]
    for name in leaves:
        unit = effect.unit if name == "strength" else FIELDS[name]
        effect = eqx.tree_at(lambda e, name=name: getattr(e, name), effect, getattr(effect, name) * size(unit))
    return effect


def converted_model(effect: fx.Effect) -> Model:
    si = model()
    device = eqx.tree_at(
        lambda d: (d.stiffness, d.damping, d.mobility),
        si.device,
        (si.device.stiffness * size("1/s²"), si.device.damping * size("1/s"), si.device.mobility * size("1/kg")),
    )
    return Model(
        device,
        scale=si.scale * size("V/m"),
        offset=si.offset * size("V"),
        effects=(converted(effect),),
        reference_temperature=si.reference_temperature * size("K"),
        reference_bias=si.reference_bias * size("V"),
    )


@pytest.mark.parametrize("effect", [e for e in MEMBERS if not isinstance(e, fx.SweepEffect)], ids=lambda e: e.label)
def test_units_scale(effect):
    effect = present(effect)
    si, other = model(effect), converted_model(effect)
    assert isinstance(effect.strength, jnp.ndarray)
    state = state_of(si)
    units = np.array([size("m")] * 2 + [size("m/s")] * 2 + [size("m")] * effect.own_size)
    c = CONDITIONS
    conditions = eqx.tree_at(
        lambda c: (c.rate, c.angular_acceleration, c.temperature, c.bias_voltage, c.time),
        c,
        (
            c.rate * size("1/s"), c.angular_acceleration * size("1/s²"), c.temperature * size("K"),
            c.bias_voltage * size("V"), c.time * size("s"),
        ),
    )  # fmt: skip
    force, force_rate = FORCE * size("N"), FORCE_RATE * size("N/s")
    slope = other.derivative(state * units, force, conditions)
    np.testing.assert_allclose(slope, si.derivative(state, FORCE, c) * units * size("1/s"), rtol=1e-10)
    volts = other.observe(state * units, force, force_rate, conditions)
    np.testing.assert_allclose(volts, si.observe(state, FORCE, FORCE_RATE, c) * size("V"), rtol=1e-10)


def test_the_unit_of_a_sweep_is_that_of_a_speed_of_angular_frequency():
    assert fx.FiniteSweepRate().unit == "rad/s²"
    assert "finite_sweep_rate" in LABELS
