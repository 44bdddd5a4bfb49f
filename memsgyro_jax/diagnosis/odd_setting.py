"""The one setting of a case that contradicts all others, as one whose temperature or bias was written down wrongly."""

import numpy as np

from memsgyro_jax.base.text import listed
from memsgyro_jax.effects import Scanned
from memsgyro_jax.measurement.case import Case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.one_place import NEAR, with_place
from memsgyro_jax.measurement.readings import model_of, readings_of

from .joint_residual import Joint
from .settings_apart import in_each_place, odd_one
from .worth_trying import worth_trying


def odd_setting(case: Case) -> str:
    """A sentence where all settings but one agree; empty where none stands out."""
    effects = [effect for effect in worth_trying(case) if not isinstance(effect, Scanned)]
    joint = Joint(model_of(case, starting_device(case)).with_effect(*effects), readings_of(case))
    found = odd_one(joint, in_each_place(case))
    if found is None:
        return ""
    one, places = found
    names = [
        r.name
        for r in with_place(case.records)
        if np.all(np.abs(r.temperature - one.temperature) < NEAR)
        and np.all(np.abs(r.bias_voltage - one.bias_voltage) < 1e-3)
    ]
    where = f"{one.temperature - 273.15:.4g} °C and {one.bias_voltage:.4g} V" + (f" ({listed(names)})" if names else "")
    agree = listed([joint.model.effects[i].label for i in places])
    return f"without what was taken at {where} all others go with {agree}; is it what the case says?"
