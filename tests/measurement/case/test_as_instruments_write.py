"""Records as instruments write them: any drive unit, velocity, X and Y, repeats, up and down, little declared."""

import numpy as np
import pytest
from measurement.case.test_case import assert_same_case

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.case import assess, load_case, write_case
from memsgyro_jax.measurement.linear_start import starting_device


HEAD = """\
schema = "memsgyro-case/1"
name = "wire"
device = "resonator"
"""
SWEEP = """
[[experiment]]
name = "sweep"
kind = "frequency_sweep"
file = "sweep.csv"
"""


def velocity(f, f0, quality, gain=-2.0):
    """Velocity per drive of a resonator."""
    w, w0 = 2 * np.pi * f, 2 * np.pi * f0
    return 1j * w * gain / (w0**2 - w**2 + 1j * w * w0 / quality)


def write(folder, header, columns, *, head=HEAD, readout='quantity = "velocity"', more=""):
    folder.mkdir(exist_ok=True)
    (folder / "case.toml").write_text(f"{head}[readout]\n{readout}\n{SWEEP}{more}")
    np.savetxt(folder / "sweep.csv", np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.12g")
    return folder


def wire(folder, f0=3966.7, quality=59.5, span=6.0, seed=0, noise=1e-3, readings="X [V],Y [V]", **more):
    """Two drives in ampere, up and down at each, the first twice; the drive is measured in every row."""
    rng = np.random.default_rng(seed)
    up = f0 * (1 + span / quality * np.linspace(-0.5, 0.5, 61))
    f = np.concatenate([up, up[::-1], up, up[::-1], up, up[::-1]])
    drive = np.repeat([1e-6, 3e-6], [244, 122]) * (1 + 1e-3 * rng.standard_normal(366))
    v = drive * velocity(f, f0, quality)
    v = v + noise * np.abs(v[:244]).max() * (rng.standard_normal(366) + 1j * rng.standard_normal(366))
    columns = [2.3 * np.arange(366), drive, f, *((np.abs(v),) if "R" in readings else (v.real, v.imag))]
    return write(folder, f"t [s],drive [A],f [Hz],{readings}", columns, **more)


def test_one_header_line_and_no_design_are_enough(tmp_path):
    case = load_case(wire(tmp_path / "wire"))
    (sweep,) = case.records
    assert (case.drive.unit, case.readout.order, case.readout.unit) == ("A", 1, "V")
    assert [(s.start, s.stop) for s in sweep.sweeps] == [(61 * k, 61 * k + 61) for k in range(6)]
    assert list(sweep.directions[::61]) == [1, -1, 1, -1, 1, -1]
    resonance, quality = (case.design[key] for key in ("resonance", "quality_factor"))
    assert resonance.unknown
    assert resonance.value == pytest.approx(2 * np.pi * 3966.7, rel=1e-4)
    assert quality.value == pytest.approx(59.5, rel=0.01)
    assert case.design["static_gain"].value * resonance.value**2 == pytest.approx(-2.0, rel=0.01)
    assert sweep.time[1] == 2.3
    write_case(case, tmp_path / "again")
    assert_same_case(case, load_case(tmp_path / "again"))


@pytest.mark.parametrize("quality", [50.0, 3e3, 1e6])
@pytest.mark.parametrize("readings", ["X [V],Y [V]", "R [V]"])
def test_a_start_for_any_quality(tmp_path, quality, readings):
    case = load_case(wire(tmp_path / "wire", 32.8e3, quality, seed=1, readings=readings))
    device = starting_device(case)
    w, d = float(np.sqrt(device.stiffness[0])), float(device.damping[0])
    assert abs(w - 2 * np.pi * 32.8e3) < 0.01 * d
    assert w / d == pytest.approx(quality, rel=0.02)
    assert abs(float(device.mobility)) == pytest.approx(2.0, rel=0.02)
    assert case.records[0].readings.dtype == (float if "R" in readings else complex)


def test_gain_that_turns_the_phase_and_a_background_do_not_lead_astray(tmp_path):
    f = np.linspace(1000, 1020, 81)
    v = velocity(f, 1009.0, 200.0) * np.exp(0.7j) + (3e-5 - 4e-5j)
    case = load_case(write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, v.real, v.imag], more='noise_std = "1 uV"'))
    assert case.design["quality_factor"].value == pytest.approx(200.0, rel=1e-3)
    assert case.design["resonance"].value == pytest.approx(2 * np.pi * 1009.0, rel=1e-5)


@pytest.mark.parametrize(("low", "high"), [(990, 1004), (1006, 1020)])
def test_one_side_of_the_resonance_is_enough(tmp_path, low, high):
    rng, f = np.random.default_rng(2), np.linspace(low, high, 81)
    v = velocity(f, 1005.0, 300.0) + 1e-6 * (rng.standard_normal(81) + 1j * rng.standard_normal(81))
    case = load_case(write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, v.real, v.imag]))
    assert case.design["resonance"].value == pytest.approx(2 * np.pi * 1005.0, rel=1e-4)
    assert case.design["quality_factor"].value == pytest.approx(300.0, rel=0.05)


def test_a_drive_in_volts_becomes_a_force_by_its_scale(tmp_path):
    f = np.linspace(1000, 1020, 81)
    v = velocity(f, 1009.0, 200.0)
    columns = [np.full(81, 5.0), f, v.real, v.imag]
    readout, drive = 'quantity = "velocity"\nscale = "4 V/(m/s)"', '[drive]\nunit = "V"\nscale = "2 uN/V"\n'
    design = '[design]\nmass = { value = 2e-9, tolerance = 0.1, unit = "kg" }\n'
    design += 'resonance = { value = 1009, tolerance = 0.1, unit = "Hz" }\n'
    folder = write(tmp_path / "w", "drive [V],f [Hz],X [V],Y [V]", columns, head=HEAD + drive + design, readout=readout)
    case = load_case(folder)
    assert case.records[0].drive[0] == pytest.approx(1e-5)
    assert case.words.force == "N"
    assert case.design["static_gain"].value == pytest.approx(1 / (2e-9 * (2 * np.pi * 1009) ** 2))
    write_case(case, tmp_path / "again")
    assert_same_case(case, load_case(tmp_path / "again"))


def test_a_column_that_nothing_depends_on_is_carried_along(tmp_path):
    f = np.linspace(1000, 1020, 81)
    v = velocity(f, 1009.0, 200.0)
    columns = [f, v.real, v.imag, np.arange(81) / 8]
    write(tmp_path / "w", "f [Hz],X [V],Y [V],pressure [mbar]", columns)
    case = load_case(tmp_path / "w")
    assert list(case.records[0].carried) == ["pressure [mbar]"]
    assert any("`pressure`" in sentence for sentence in assess(case).warnings)
    write_case(case, tmp_path / "again")
    again = load_case(tmp_path / "again")
    np.testing.assert_array_equal(again.records[0].carried["pressure [mbar]"], columns[3])
    assert not any("`pressure`" in sentence for sentence in assess(again).warnings), "it is declared"
    write(tmp_path / "w", "f [Hz],X [V],Y [V],fr [Hz]", columns)
    with pytest.raises(InputError, match="did you mean `f`"):
        load_case(tmp_path / "w")
    write(tmp_path / "w", "f [Hz],X [V],Y [V],fr [Hz]", columns, more='carried = ["fr"]\n')
    assert list(load_case(tmp_path / "w").records[0].carried) == ["fr [Hz]"]


def test_rows_may_be_repeated_but_not_copied(tmp_path):
    rng, f = np.random.default_rng(3), np.repeat(np.linspace(1000, 1020, 41), 3)
    v = velocity(f, 1009.0, 200.0)
    v = v + 1e-4 * np.abs(v).max() * (rng.standard_normal(v.size) + 1j * rng.standard_normal(v.size))
    case = load_case(write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, v.real, v.imag]))
    assert len(case.records[0].sweeps) == 1
    assert case.records[0].estimated_noise() == pytest.approx(1e-4 * np.abs(velocity(f, 1009.0, 200.0)).max(), rel=0.1)
    v[1] = v[0]
    write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, v.real, v.imag])
    with pytest.raises(InputError, match="line 3, column `f`: the value must not repeat line 2"):
        load_case(tmp_path / "w")


def test_the_noise_is_how_well_a_sweep_repeats(tmp_path):
    """An offset of each sweep is smooth along it, and seen by its repeats alone; up and down may differ for good."""
    rng, up = np.random.default_rng(5), np.linspace(1000, 1020, 61)
    f = np.concatenate([up, up[::-1]] * 6)
    v = velocity(f, 1009.0, 200.0)
    size = np.abs(v).max()
    shift = rng.standard_normal(12) + 1j * rng.standard_normal(12) + np.tile([3.0, -3.0], 6)
    v = (
        v
        + 1e-3 * size * np.repeat(shift, 61)
        + 1e-5 * size * (rng.standard_normal(732) + 1j * rng.standard_normal(732))
    )
    sweep = load_case(write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, v.real, v.imag])).records[0]
    assert [len(rows) for rows in sweep.courses] == [366, 366]
    assert 0.5e-3 * size < sweep.estimated_noise() < 1.5e-3 * size


def test_without_any_resonance_the_missing_numbers_are_named(tmp_path):
    rng, f = np.random.default_rng(4), np.linspace(1000, 1020, 41)
    write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, *rng.standard_normal((2, 41))])
    with pytest.raises(InputError, match="must give resonance, quality_factor, static_gain"):
        load_case(tmp_path / "w")


def test_the_noise_of_each_row(tmp_path):
    f = np.linspace(1000, 1020, 81)
    v, std = velocity(f, 1009.0, 200.0), np.linspace(1e-6, 3e-6, 81)
    case = load_case(write(tmp_path / "w", "f [Hz],X [V],Y [V],std [uV]", [f, v.real, v.imag, 1e6 * std]))
    np.testing.assert_allclose(case.records[0].noise_of_rows[:, 0], std, rtol=1e-9)
    (readings, other) = case.records[0].laid_out(case, [(0, case.records[0])], False)
    np.testing.assert_allclose(np.asarray(readings.experiment.noise.std)[:, 0], std[::2], rtol=1e-9)
    assert np.isinf(np.asarray(other.experiment.noise.std)[-1]), "padding has no weight"
    write_case(case, tmp_path / "again")
    assert_same_case(case, load_case(tmp_path / "again"))
    write(tmp_path / "w", "f [Hz],X [V],Y [V],std [uV]", [f, v.real, v.imag, std], more='noise_std = "1 uV"')
    with pytest.raises(InputError, match="must be left out where columns hold the noise"):
        load_case(tmp_path / "w")


SECOND = """
[[experiment]]
name = "second"
kind = "time_record"
file = "raw.csv"
hold = "zero_order"
start = "rest"
"""


@pytest.mark.parametrize(("turned", "said"), [(False, None), (True, "`second` reads as if inverted")])
def test_a_record_with_the_other_sign_is_named(tmp_path, turned, said):
    """A sweep and a burst of the same resonator, the burst with its wires exchanged."""
    f, period, w, d = np.linspace(950, 1050, 81), 2e-5, 2 * np.pi * 1000.0, 2 * np.pi * 20
    v = velocity(f, 1000.0, 50.0)
    write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, v.real, v.imag], more='noise_std = "1 uV"\n' + SECOND)
    t = period * np.arange(4000)
    push = np.where(abs(t - 0.035) < 2.5e-3, np.sin(2 * np.pi * 1003 * t), 0.0)
    decay = np.exp(-d / 2 * t) * np.cos(w * t)
    seen = -2.0 * period * np.convolve(push, decay)[:4000] * (-1 if turned else 1)
    table = np.column_stack([t, push, seen])
    np.savetxt(tmp_path / "w" / "raw.csv", table, delimiter=",", header="t [s],u [V],y [V]", comments="", fmt="%.12g")
    warnings = assess(load_case(tmp_path / "w")).signs
    assert len(warnings) == (said is not None)
    if said:
        assert said in warnings[0]
        path = tmp_path / "w" / "case.toml"
        path.write_text(path.read_text() + "inverted = true\n")
        assert not assess(load_case(tmp_path / "w")).signs, "the remedy mends it"


def test_phasors_of_the_other_convention_are_refused_with_the_remedy(tmp_path):
    f = np.linspace(1000, 1020, 81)
    v = velocity(f, 1009.0, 200.0).conj()
    write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, v.real, v.imag])
    with pytest.raises(InputError, match='say `convention = "exp\\(-iwt\\)"`'):
        load_case(tmp_path / "w")
    write(tmp_path / "w", "f [Hz],X [V],Y [V]", [f, v.real, v.imag], more='convention = "exp(-iwt)"\n')
    assert load_case(tmp_path / "w").design["quality_factor"].value == pytest.approx(200, rel=1e-3)


def test_a_sweep_below_its_noise_is_used_with_a_warning(tmp_path):
    rng = np.random.default_rng(6)
    f, drive = np.tile(np.linspace(1000, 1020, 81), 2), np.repeat([1e-9, 1e-3], 81)
    v = drive * velocity(f, 1009.0, 200.0) + 1e-6 * (rng.standard_normal(162) + 1j * rng.standard_normal(162))
    case = load_case(write(tmp_path / "w", "drive [A],f [Hz],X [V],Y [V]", [drive, f, v.real, v.imag]))
    assert any("hardly rises above its noise" in warning for warning in assess(case).warnings)
    assert case.design["resonance"].value == pytest.approx(2 * np.pi * 1009.0, rel=1e-3)


@pytest.mark.parametrize("order", ["displacement", "velocity"])
def test_a_decay_alone_is_enough(tmp_path, order):
    t = 1e-3 * np.arange(2000)
    x = np.exp(-3.0 * t) * np.cos(2 * np.pi * 37 * t) + 1e-3 * np.random.default_rng(7).standard_normal(2000)
    write(tmp_path / "w", "t [s],x [m],control [V]", [t, x, 0 * t], readout=f'quantity = "{order}"')
    path = tmp_path / "w" / "case.toml"
    path.write_text(path.read_text().replace("frequency_sweep", "free_decay"))
    case = load_case(tmp_path / "w")
    assert case.design["resonance"].value == pytest.approx(2 * np.pi * 37, rel=1e-4)
    assert case.design["quality_factor"].value == pytest.approx(np.pi * 37 / 3.0, rel=0.05)
