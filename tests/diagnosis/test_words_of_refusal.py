"""What is said of an effect that does not stay, and of the base model of a climb."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import memsgyro_jax
from memsgyro_jax.diagnosis.acceptance import refusal, too_late
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


@pytest.mark.parametrize(
    ("seconds", "left", "stepped", "refused"),
    [
        (1.38e-4, 94.0, True, True),
        (1.38e-4, 1.0, True, False),
        (4e-5, 94.0, True, False),
        (1.38e-4, 94.0, False, False),
    ],
)
def test_a_delay_of_periods_that_explains_little_is_a_phase(seconds, left, stepped, refused):
    """Angles of the reference by record, which took it back, stood beside 2.8 periods of a perfect instrument. One that
    leaves noise alone may be a converter's pipeline; one over time is seen directly.
    """
    record = SimpleNamespace(stepped=stepped, readings=np.zeros(3, complex), driven=True)
    joint = SimpleNamespace(
        model=SimpleNamespace(effects=(by_name("readout_delay"),)),
        at=lambda vector: SimpleNamespace(device=SimpleNamespace(stiffness_matrix=(2 * np.pi * 20e3) ** 2 * np.eye(1))),
        of_effect=lambda place: np.array([0]),
    )
    after = SimpleNamespace(vector=np.array([seconds]), chi2=900 * left, dof=900)
    said = too_late(joint, 0, after, SimpleNamespace(records=(record,)))
    assert said.startswith("it would be 2.8 periods of the resonance") if refused else said == ""


def test_a_delay_of_what_nobody_drives_is_another_beginning():
    """Beside a bent pick-off 1.5 µs of it were "found" in a ring-down on an oscilloscope, whose start is unknown."""
    joint = SimpleNamespace(model=SimpleNamespace(effects=(by_name("readout_delay"), by_name("cubic_stiffness x"))))
    decay, sweep = (SimpleNamespace(stepped=False, readings=np.zeros(3), driven=driven) for driven in (False, True))
    said = [too_late(joint, place, None, SimpleNamespace(records=(decay,))) for place in (0, 1)]
    assert said == ["a record that nothing drives begins somewhere else instead, which is solved for", ""]
    assert too_late(joint, 0, None, SimpleNamespace(records=(decay, sweep))) == ""


def test_the_lowest_drive_is_named_where_drives_differ(demo):
    """A climb over one drive, of which a bias varies, begins with no lowest one."""
    assert len(clear_drives(demo)) > 1
    said = [whence(case) for case in (demo, lowest_drives(demo, 1))]
    assert "lowest drive" in said[0]
    assert "drive" not in said[1]
