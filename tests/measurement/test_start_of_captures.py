"""A capture under known forces tells its device at once, however it moves at its ends."""

import numpy as np
import pytest
from scipy.linalg import expm

import memsgyro_jax as mg
from memsgyro_jax.measurement.case.quality import assess
from memsgyro_jax.measurement.linear_start import starting_device


HERTZ, QUALITY, MOBILITY = np.array([6000.0, 6400.0]), np.array([3000.0, 1200.0]), 8e11
COUPLING = 2e5
CASE = """schema = "memsgyro-case/1"
name = "loop"
device = "single_mass"
[readout]
quantity = "{}"
[design]
[[experiment]]
name = "loop"
kind = "time_record"
file = "loop.csv"
hold = "zero_order"
start = "unknown"
"""


DESIGN = """[design]
mass = { value = 1e-9, tolerance = 0.5, unit = "kg" }
frequency_x = { value = 6000, tolerance = 0.1, unit = "Hz" }
frequency_y = { value = 6400, tolerance = 0.1, unit = "Hz" }
quality_factor_x = { value = 2000, tolerance = 0.9, unit = "1" }
quality_factor_y = { value = 2000, tolerance = 0.9, unit = "1" }
"""


def closed_loop(path, order=0, kept=0):
    """An amplitude held at resonance (x) beside a slow sine of frequency (y), forces held from row to row; readings are
    the displacement or a derivative of it [V], from a row on.
    """
    omega = 2 * np.pi * HERTZ
    stiffness = np.array([[omega[0] ** 2, COUPLING], [COUPLING, omega[1] ** 2]])
    period, count = 1 / 60e3, 9000
    equation = np.zeros((6, 6))
    equation[:2, 2:4] = np.eye(2)
    equation[2:4] = np.concatenate([-stiffness, -np.diag(omega / QUALITY), MOBILITY * np.eye(2)], axis=1)
    step, state, rows = expm(equation * period)[:4], np.zeros(6), []
    for k in range(count):
        size = np.hypot(state[0], state[2] / omega[0])
        state[4] = min(8e-8 * max(0.2 - size, 0.0) / 0.2 + 2e-8, 1e-7) * np.sign(state[2] or 1.0)
        state[5] = 2e-8 * np.sin(2 * np.pi * HERTZ[1] * k * period + 0.4 * np.sin(2 * np.pi * 7.0 * k * period))
        bend = equation[2:4] @ state
        rows.append([k * period, *((state[:2], state[2:4], bend)[order]), *state[4:]])
        state[:4] = step @ state
    rows = np.array(rows[kept:])
    rows[:, 1:3] += 1e-5 * np.abs(rows[:, 1:3]).max() * np.random.default_rng(5).standard_normal((len(rows), 2))
    header = "t [s],Vx [V],Vy [V],u_x [N],u_y [N]"
    np.savetxt(path, rows, "%.10g", ",", header=header, comments="")
    return path


@pytest.mark.parametrize(("order", "kept"), [(0, 0), (0, 3000), (1, 3000), (2, 0)])
def test_a_closed_loop_without_a_design(tmp_path, order, kept):
    """From leaking lines the quality factors started at 49 and 12, the fit ended 1600 times the noise off."""
    closed_loop(tmp_path / "loop.csv", order, kept)
    (tmp_path / "case.toml").write_text(CASE.format(("displacement", "velocity", "acceleration")[order]))
    case = mg.load_case(tmp_path)
    found = starting_device(case)
    stiffness, damping = np.asarray(found.stiffness), np.asarray(found.damping)
    hertz = np.sqrt(stiffness[:2]) / (2 * np.pi)
    np.testing.assert_allclose(hertz, HERTZ, atol=0.02)
    np.testing.assert_allclose(2 * np.pi * hertz / damping[:2], QUALITY, rtol=0.02)
    assert stiffness[2] == pytest.approx(COUPLING, rel=0.05)
    assert float(found.mobility) == pytest.approx(MOBILITY, rel=0.02)


def test_the_rows_tell_how_the_force_was_held(tmp_path):
    """`import` took every force for one that was sampled as it ran, half a row early where it was held."""
    found = mg.import_case([closed_loop(tmp_path / "loop.csv")], tmp_path / "case")
    assert found.case.records[0].hold == "zero_order"
    assert "nearer to a device where the force was held from row to row (`hold` is zero_order)." in str(found)
    assert "band_limited" not in str(found)
    path = tmp_path / "case" / "case.toml"
    path.write_text(path.read_text().replace('hold = "zero_order"', 'hold = "linear"'))
    assert not [one for one in assess(found.case).warnings if "hold" in one]
    (warning,) = [one for one in assess(mg.load_case(path.parent)).warnings if "hold" in one]
    assert warning.startswith("`loop`: its rows lie ")


def test_the_rows_tell_what_is_read(tmp_path):
    """Velocities were refused ("no record shows a clear resonance")."""
    found = mg.import_case([closed_loop(tmp_path / "loop.csv", 1, 3000)], tmp_path / "case")
    assert (found.case.readout.order, found.case.records[0].hold) == (1, "zero_order")
    assert "the read-out shows velocity" in str(found)
    assert assess(found.case).warnings == ()


def test_what_is_declared_of_the_read_out_is_held_against_the_rows(tmp_path):
    closed_loop(tmp_path / "loop.csv", 1, 3000)
    (tmp_path / "case.toml").write_text(CASE.format("displacement").replace("[design]", DESIGN))
    (warning,) = [one for one in assess(mg.load_case(tmp_path)).warnings if "`quantity`" in one]
    assert warning.startswith("`loop`: its rows lie ")
    assert warning.endswith("where the read-out shows velocity (`quantity` of `[readout]`).")


@pytest.mark.parametrize(("order", "late"), [
    pytest.param(0, 0.0, marks=pytest.mark.slow), (1, 0.0), pytest.param(2, 0.0, marks=pytest.mark.slow), (0, 0.125)
])  # fmt: skip
def test_one_axis_under_a_chirp_tells_what_is_read(tmp_path, order, late):
    """A read-out that is late by an eighth of a period is no other quantity."""
    omega, quality, period, rng = 2 * np.pi * 12e3, 4000.0, 5e-6, np.random.default_rng(3)
    time = period * np.arange(20000)
    force = np.cos(omega * (0.97 * time + 0.03 * time**2 / time[-1])) + 0.05 * rng.standard_normal(time.size)
    equation = np.array([[0, 1, 0], [-(omega**2), -omega / quality, 1], [0, 0, 0]])
    step, state, rows = expm(equation * period), np.zeros(3), []
    for push in force:
        state[2] = push
        rows.append((*state[:2], equation[1] @ state))
        state = step @ state
    read = np.array(rows)[:, order]
    lag = np.exp(-1j * late * 2 * np.pi / omega * 2 * np.pi * np.fft.rfftfreq(2 * read.size, period))
    read = np.fft.irfft(np.fft.rfft(read, 2 * read.size) * lag)[: read.size]
    read = read / np.abs(read).max() + 1e-4 * rng.standard_normal(read.size)
    header = "time (s),drive (V),signal (V)"
    np.savetxt(tmp_path / "r.csv", np.column_stack([time, force, read]), "%.9g", ",", header=header, comments="")
    assert mg.import_case([tmp_path / "r.csv"], tmp_path / "case").case.readout.order == order


def test_a_resonator_tells_it_too(tmp_path):
    """A gain that turns the phase stood for half a row, and a delay of half a row was found to be missing."""
    omega, quality, period, rng = 2 * np.pi * 87e3, 900.0, 1e-6, np.random.default_rng(9)
    step = expm(np.array([[0, 1, 0], [-(omega**2), -omega / quality, 1], [0, 0, 0]]) * period)
    state, rows = np.zeros(3), []
    for k in range(8000):
        state[2] = 150.0 * np.sign(np.sin(2 * np.pi * 87.05e3 * k * period)) * (k < 5000) + 30 * rng.standard_normal()
        rows.append([k * period, state[2] / 300.0, 1e3 * state[1]])
        state = step @ state
    rows = np.array(rows)
    rows[:, 2] += 2e-3 * np.abs(rows[:, 2]).max() * rng.standard_normal(len(rows))
    header = "Time (s);Drive (V);Velocity (mm/s)"
    np.savetxt(tmp_path / "burst.csv", rows, "%.9g", ";", header=header, comments="")
    case = mg.import_case([tmp_path / "burst.csv"], tmp_path / "case").case
    assert (case.records[0].hold, case.readout.order) == ("zero_order", 1)
    found = starting_device(case)
    assert float(np.sqrt(found.stiffness[0])) == pytest.approx(omega, rel=2e-6)
    assert omega / float(found.damping[0]) == pytest.approx(quality, rel=0.01)
