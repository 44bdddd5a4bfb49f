"""Records of two axes that do not tell the whole design: what is assumed and what is asked for."""

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.measurement.linear_start import starting_device


TURN = 2 * np.pi
HERTZ, QUALITY = np.array([6000.0, 6400.0]), np.array([900.0, 700.0])
DESIGN = """[design]
frequency_x = {{ value = {0}, tolerance = 0.01, unit = "Hz" }}
frequency_y = {{ value = {1}, tolerance = 0.01, unit = "Hz" }}
quality_factor_x = {{ value = 900, tolerance = 0.5, unit = "1" }}
quality_factor_y = {{ value = 700, tolerance = 0.5, unit = "1" }}
"""


def decay(path, loud=(0.4, 0.2)):
    """Both axes ring, each at its own frequency [V]."""
    time, rng = np.arange(3000) / 40e3, np.random.default_rng(2)
    columns = [
        a * np.exp(-np.pi * f / q * time) * np.cos(TURN * f * time + 0.5) + 1e-4 * rng.standard_normal(time.size)
        for a, f, q in zip(loud, HERTZ, QUALITY, strict=True)
    ]
    np.savetxt(path, np.stack([time, *columns], axis=1), "%.9g", ",", header="t [s],Vx [V],Vy [V]", comments="")
    return path


def test_a_decay_of_both_axes_is_a_design(tmp_path):
    case = mg.import_case([decay(tmp_path / "both.csv")], tmp_path / "case").case
    mass = case.design["mass"].value
    found = np.sqrt([case.design[key].value / mass for key in ("kxx", "kyy")]) / TURN
    np.testing.assert_allclose(found, HERTZ, rtol=1e-5)
    assert case.design["kxy"].value == 0.0


def test_what_is_missing_is_left_to_be_filled_in(tmp_path):
    """No file was left in which to put what was asked for, and it was asked for in words that nobody knows."""
    rows = np.stack([np.arange(200) * 5e-3, np.zeros(200), np.full(200, -0.08), np.full(200, 7e-4)], axis=1)
    rate = 10 * np.sin(np.arange(200) * 0.1)
    table = np.column_stack([rows[:, 0], rate, np.full(200, 0.05), rows[:, 1:], np.zeros(200)])
    header = "t [s],rate [deg/s],drive [V],Vx_I [V],Vx_Q [V],Vy_I [V],Vy_Q [V]"
    np.savetxt(tmp_path / "table.csv", table, "%.9g", ",", header=header, comments="")
    folder = tmp_path / "case"
    with pytest.raises(mg.InputError, match="must give frequency_x, frequency_y, quality_factor_x") as told:
        mg.import_case([tmp_path / "table.csv"], folder, reference="6 kHz", axis=["x"])
    assert str(told.value).endswith(f"fill in the lines there, then `memsgyro check {folder}`.")
    text = (folder / "case.toml").read_text()
    for key, value in {
        "frequency_x": 6e3,
        "frequency_y": 6400,
        "quality_factor_x": 900,
        "quality_factor_y": 700,
    }.items():
        assert f"# {key} = {{ value = ...," in text
        text = text.replace(f"# {key} = {{ value = ...,", f"{key} = {{ value = {value},")
    (folder / "case.toml").write_text(text)
    case = mg.load_case(folder)
    assert case.records[0].kind == "rate_table"
    assert case.design["kxy"].value == case.design["dxy"].value == 0.0


def test_axes_that_are_known_need_no_coupling(tmp_path):
    """One axis alone vibrates, so that its decay tells nothing of the other."""
    decay(tmp_path / "decay.csv", loud=(0.4, 0.0))
    head = 'schema = "memsgyro-case/1"\nname = "one"\ndevice = "single_mass"\n[readout]\nquantity = "displacement"\n'
    record = '[[experiment]]\nname = "decay"\nkind = "free_decay"\nfile = "decay.csv"\n'
    (tmp_path / "case.toml").write_text(head + record)
    with pytest.raises(mg.InputError, match="must give frequency_x"):
        mg.load_case(tmp_path)
    (tmp_path / "case.toml").write_text(head + DESIGN.format(*HERTZ) + record)
    case = mg.load_case(tmp_path)
    assert case.design["kxy"].value == 0.0
    low, high = case.resonances
    assert low < TURN * HERTZ[0] < TURN * HERTZ[1] < high
    assert low > 0.9 * TURN * HERTZ[0]


@pytest.mark.parametrize("noise", [0.0, 2e-4])
def test_amplitudes_of_two_axes_tell_their_coupling(tmp_path, noise):
    """A number that was no number went on into least squares; then it was asked for, in a unit that nobody knows."""
    rng, coupling, omega = np.random.default_rng(6), 2.1e6, TURN * HERTZ
    text = 'schema = "memsgyro-case/1"\nname = "two"\ndevice = "single_mass"\n[readout]\nquantity = "displacement"\n'
    stiffness, damping = np.diag(omega**2) + coupling * (1 - np.eye(2)), np.diag(omega / QUALITY)
    for axis, name in enumerate("xy"):
        hertz = HERTZ[axis] + np.linspace(-20, 20, 61)
        turn = 1j * TURN * hertz[:, None, None]
        response = np.linalg.inv(stiffness + turn**2 * np.eye(2) + turn * damping)[:, :, axis]
        parts = rng.normal(scale=max(noise, 1e-9), size=(2, 61, 2))
        seen = np.abs(1e6 * response + parts[0] + 1j * parts[1])
        rows = np.column_stack([hertz, np.full(61, 0.01), seen])
        header = f"f [Hz],F_{name} [V],Vx_amp [V],Vy_amp [V]"
        np.savetxt(tmp_path / f"{name}.csv", rows, "%.9g", ",", header=header, comments="")
        text += (
            f'[[experiment]]\nname = "{name}"\nkind = "frequency_sweep"\nfile = "{name}.csv"\ndrive_axis = "{name}"\n'
        )
    (tmp_path / "case.toml").write_text(text)
    case = mg.load_case(tmp_path)
    device = starting_device(case)
    assert float(device.stiffness[2]) == pytest.approx(coupling, rel=0.03 if noise else 1e-3)
    np.testing.assert_allclose(np.sqrt(np.asarray(device.stiffness)[:2]), omega, rtol=1e-5)
    np.testing.assert_allclose(np.asarray(device.damping)[:2], omega / QUALITY, rtol=0.01)
