"""Channels or drives of a gyro that were exchanged in one of its sweeps, or in all."""

import numpy as np
import pytest

from memsgyro_jax.measurement.exchanged_axes import all_exchanged, exchanged_axes, phasors_of_sweep


def sweeps():
    """Of x at two drives and of y at two, in hertz and volts; the channel of y reads 1.35 times as much."""
    f = np.linspace(11_850.0, 12_150.0, 81)
    stiffness = np.array([[11_940.0**2, 6e4], [6e4, 12_052.0**2]])
    damping = np.array([[11_940.0 / 900, 0.3], [0.1, 12_052.0 / 1100]])
    dynamic = stiffness - f[:, None, None] ** 2 * np.eye(2) + 1j * f[:, None, None] * damping
    noise, found = np.random.default_rng(0), []
    for name, axis, volts in (("x20", 0, 0.02), ("x60", 0, 0.06), ("y20", 1, 0.02), ("y60", 1, 0.06)):
        z = 3e5 * volts * np.linalg.inv(dynamic)[:, :, axis] * [1.0, 1.35]
        z = z + 4e-5 * (noise.standard_normal(z.shape) + 1j * noise.standard_normal(z.shape))
        found.append((name, phasors_of_sweep(2 * np.pi * f, z, axis, np.full(f.size, volts))))
    return found


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (("motion",), "its channels x and y were exchanged"),
        (("force",), "the other axis was driven"),
    ],
)
def test_what_was_exchanged_in_one_sweep_is_named(what, said):
    told = sweeps()
    assert exchanged_axes(told) == {}
    name, one = told[1]
    told[1] = name, one._replace(**{field: getattr(one, field)[:, ::-1] for field in what})
    ((named, sentence),) = exchanged_axes(told).items()
    assert named == name
    assert said in sentence
    assert all_exchanged(told) == ""


def test_of_all_sweeps_it_is_said_that_axes_are_exchanged():
    told = [(name, one._replace(motion=one.motion[:, ::-1])) for name, one in sweeps()]
    assert exchanged_axes(told) == {}
    assert "in `x20`, `x60`, `y20`, `y60` the axis moves that is not driven" in all_exchanged(told)
    assert all_exchanged(sweeps()) == ""
