"""What is said of an effect that does not stay, and of the base model of a climb."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import memsgyro_jax
from memsgyro_jax.diagnosis.acceptance import refusal
from memsgyro_jax.diagnosis.climb import whence
from memsgyro_jax.diagnosis.parameters import Parameter
from memsgyro_jax.effects import by_name
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.drive_levels import clear_drives, lowest_drives


@pytest.fixture(scope="module")
def demo():
    return load_case(Path(memsgyro_jax.__file__).parent / "demo")


def test_the_bound_at_which_a_strength_ends_is_told(demo):
    joint = SimpleNamespace(
        model=SimpleNamespace(effects=(by_name("readout_delay"),)),
        bounds=(np.array([0.0]), np.array([2.5e-5])),
        of_effect=lambda place: np.array([0]),
        parameters=(Parameter("readout_delay", "s", 0, "strength", low=0.0, high=2.5e-5),),
    )
    before, after = SimpleNamespace(chi2=900.0, dof=10), SimpleNamespace(chi2=20.0, dof=9, vector=np.array([2.5e-5]))
    said = refusal(joint, 0, before, after, others=0, case=demo)
    assert said == "its strength ends at 2.5e-05 s, the bound that physics sets"


def test_the_lowest_drive_is_named_where_drives_differ(demo):
    """A climb over one drive, of which a bias varies, begins with no lowest one."""
    assert len(clear_drives(demo)) > 1
    said = [whence(case) for case in (demo, lowest_drives(demo, 1))]
    assert "lowest drive" in said[0]
    assert "drive" not in said[1]
