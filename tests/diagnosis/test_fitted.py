"""What is said of a fitted device that is none."""

from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.diagnosis.fitted import of_energy


def test_a_damping_that_feeds_a_motion_is_said():
    stiffness, mobility = [1.0e9, 1.1e9, 1e6], 1e7
    assert of_energy(NormalisedDevice(stiffness, [10.0, 12.0, 3.0], mobility)) == ""
    assert of_energy(NormalisedDevice([1e9], [0.1], mobility)) == ""
    assert "no study takes it" in of_energy(NormalisedDevice(stiffness, [10.0, 12.0, 11.5], mobility))
