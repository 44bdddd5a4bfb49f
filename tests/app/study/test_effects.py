"""A study's device may come from a fit and have effects; both survive writing, and what is wrong is one sentence."""

import equinox as eqx
import numpy as np
import pytest

import memsgyro_jax as mg


GYRO = mg.SingleMassGyro.chi2010()
ADDED = '[[effects]]\nname = "quadratic_damping"\naxis = "x"\nstrength = { value = 3, unit = "N*ms^2/mm^2" }\n'
OWN = """
from memsgyro_jax.effects import ForceEffect, strength

class Creep(ForceEffect):
    name, unit, law = "creep", "N*s**3/m**3", "F_x = -s v^3"
    strength: object = strength()
    axis = 0

    def force(self, now):
        return self.along(now, -self.strength * now.velocity[0] ** 3)
"""


@pytest.fixture
def written(tmp_path):
    """Writes a fitted device and a study beside it, and gives the study's path."""
    model = mg.Model(GYRO.with_effect(mg.effects.CubicStiffness(0, 8e8)), scale=(1e5, 9e4), offset=(0.015, 0.011))
    mg.write_model(model, tmp_path / "device.toml")

    def write(text):
        (tmp_path / "study.toml").write_text(text)
        return tmp_path / "study.toml"

    return write


def test_a_fitted_device_brings_its_effects_and_its_readout(written, tmp_path):
    study = mg.load_study(written(f'[device]\nfile = "device.toml"\n{ADDED}'))
    device = study.loop.device
    assert [effect.label for effect in device.effects] == ["cubic_stiffness x", "quadratic_damping x"]
    assert float(device.effects[1].strength) == pytest.approx(3.0, rel=1e-12)
    np.testing.assert_allclose([device.mass, device.kxy, device.dyy], [GYRO.mass, GYRO.kxy, GYRO.dyy], rtol=1e-14)
    np.testing.assert_allclose(study.loop.readout.scale, (1e5, 9e4))
    np.testing.assert_allclose(study.loop.readout.noise_density, mg.default_study().loop.readout.noise_density)
    note, open_ = study.notes
    assert "follows the device" in open_
    assert "cubic_stiffness x" in note
    assert "quadratic" not in note
    study.write(tmp_path / "again.toml")
    assert 'file = "device.toml"' in (tmp_path / "again.toml").read_text(), "the name stays relative"
    again = mg.load_study(tmp_path / "again.toml")
    assert eqx.tree_equal(again.loop, study.loop)
    assert again.changed({"sweep.dies": 3}).loop.device.effects[1].label == "quadratic_damping x"


def test_what_was_tuned_of_an_effect_is_written(written):
    study = mg.load_study(written(ADDED))
    tuned = eqx.tree_at(lambda loop: loop.device.effects[0].strength, study.loop, np.asarray(4.0))
    found = study.with_numbers(tuned, ("device.effects.0.strength",))
    assert float(found.loop.device.effects[0].strength) == 4.0
    fitted = mg.load_study(written('[device]\nfile = "device.toml"\n'))
    with pytest.raises(mg.InputError, match=r"no entry for `device.effects.0.strength`"):
        fitted.with_numbers(fitted.loop, ("device.effects.0.strength",))


def test_strengths_and_conditions_vary_from_die_to_die(written):
    study = mg.load_study(
        written(f"""{ADDED}
[scenario]
temperature = "40 degC"
[spread.parameters]
"device.effects.quadratic_damping_x.strength" = {{ kind = "normal", relative = "10 %" }}
"scenario.temperature.level" = {{ kind = "uniform", low = "10 degC", high = "300 K" }}
""")
    )
    drawn = study.spread.draw(study.loop, study.scenario, 0, np.arange(64))
    strength, temperature = drawn.table.T
    assert np.std(strength) == pytest.approx(0.3, rel=0.3)
    np.testing.assert_array_equal(drawn.loop.device.effects[0].strength, strength)
    assert temperature.min() > 283.15
    assert temperature.max() < 300.0


def test_effects_of_operation_along_a_recorded_temperature(written, tmp_path):
    (tmp_path / "oven.csv").write_text("t [min],T [degC]\n2,20\n3,80\n")
    text = """[[effects]]
name = "thermal_drift"
variant = "drive_gain"
strength = "300 1/MK"
[[effects]]
name = "self_heating"
strength = "4e3 K/W"
settings = { power = 2e-3 }
[scenario]
temperature = { kind = "record", file = "oven.csv" }
"""
    study = mg.load_study(written(text))
    drive, heating = study.loop.device.effects
    assert float(drive.strength) == pytest.approx(3e-4)
    assert (drive.label, float(heating.power)) == ("thermal_drift drive_gain", 2e-3)
    assert float(study.scenario.at(30.0).temperature) == pytest.approx(323.15)
    again = study.write(tmp_path / "again.toml")
    assert 'file = "oven.csv"' in again.read_text()
    assert mg.load_study(again).to_toml(tmp_path) == study.to_toml(tmp_path)
    (tmp_path / "oven.csv").write_text("t [min],rate [deg/s]\n2,20\n3,80\n")
    with pytest.raises(mg.InputError, match=r'must have the columns "t \[s\],T \[degC\]"'):
        mg.load_study(again)


def test_a_filter_knows_the_curves_of_the_pickoff_when_told_so(written):
    curve = '[[effects]]\nname = "pickoff_nonlinearity"\naxis = "x"\nstrength = "1e4 1/m"\n'
    told, plain = (
        mg.load_study(written(f'{curve}[observer]\nkind = "ekf"\nknows_pickoff = {known}\n')).loop.observer.pickoff
        for known in ("true", "false")
    )
    assert [effect.label for effect in told] == ["pickoff_nonlinearity x"]
    assert plain == ()
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    with pytest.raises(mg.InputError, match=r"curves of the pick-off.*`cubic_stiffness x` is none"):
        mg.ExtendedKalmanFilter.for_device(gyro, readout, pickoff=(mg.effects.CubicStiffness("x", 1.0),))
    velocity = mg.DirectReadout.of_velocity(1.0, 1e-9)
    with pytest.raises(mg.InputError, match="must have a displacement read-out"):
        mg.ExtendedKalmanFilter.for_device(gyro, velocity, pickoff=told)


def test_an_effect_of_ones_own_comes_with_its_file(written, tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    path = written('[[effects]]\nname = "creep"\nstrength = "2 N*s^3/m^3"\n')
    own = mg.load_effects(tmp_path / "own.py")
    study = mg.load_study(path, own)
    assert study.changed({"sweep.dies": 3}).loop.device.effects[0].label == "creep x"
    with pytest.raises(mg.InputError, match=r"line 2, `effects.0.name`.*creep.*--effects FILE.py"):
        mg.load_study(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"quadratic_damping"', '"quadratic_dampng"', ["effects.0", "quadratic_dampng"]),
        ('axis = "x"', 'axis = "z"', ["variant", "'z'"]),
        ('axis = "x"', 'axes = "x"', ["axes", "did you mean `axis`"]),
        ('unit = "N*ms^2/mm^2"', 'unit = "N"', ["effects.0.strength", '"N"']),
        ('{ value = 3, unit = "N*ms^2/mm^2" }', "3.0", ["must carry a unit"]),
        ('strength = { value = 3, unit = "N*ms^2/mm^2" }', "", ["effects.0.strength", "missing"]),
        ("[[effects]]", f"{ADDED}\n[[effects]]", ["must be given once"]),
        (
            "[[effects]]",
            '[device]\nfile = "none.toml"\n[[effects]]',
            ["device.file", "none.toml", "no such model file"],
        ),
        ("[[effects]]", '[readout]\nkind = "fitted"\n[[effects]]', ["readout", "must go with a fitted device"]),
    ],
)
def test_what_is_wrong_is_one_sentence(written, old, new, words):
    assert old in ADDED
    with pytest.raises(mg.InputError) as error:
        mg.load_study(written(ADDED.replace(old, new, 1)))
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


MODE = '[[effects]]\nname = "parasitic_mode"\naxis = "x"\nstrength = "0.1 %"\nsettings = {{ {} }}\n'


def test_settings_carry_their_unit(written, tmp_path):
    study = mg.load_study(written(MODE.format('omega = "18 krad/s", quality = "200"')))
    mode = study.loop.device.effects[0]
    np.testing.assert_allclose([mode.strength, mode.omega, mode.quality], [1e-3, 18e3, 200.0])
    table = mg.load_study(written(MODE.format('omega = { value = 18e3, unit = "rad/s" }, quality = 200')))
    assert float(table.loop.device.effects[0].omega) == 18e3
    again = mg.load_study(study.write(tmp_path / "again.toml"))
    assert again.loop.device.effects[0].omega == mode.omega


def test_a_number_of_an_effect_varies_in_its_unit(written):
    spread = '[spread.parameters]\n"device.effects.parasitic_mode_x.omega" = { kind = "uniform", low = "'
    spread += '17 krad/s", high = "1.9e4 rad/s" }\n'
    study = mg.load_study(written(MODE.format('omega = "18 krad/s", quality = 200') + spread))
    law = study.spread.items[0].distribution
    assert (law.low, law.high) == (17e3, 19e3)
    with pytest.raises(mg.InputError, match='must measure the same as "rad/s", but is "mm"'):
        mg.load_study(written(MODE.format('omega = "18 krad/s"') + spread.replace("17 krad/s", "17 mm")))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ('omega = "18e3"', 'must carry a unit, for example "18000 rad/s"'),
        ('omega = "3 kHz"', 'Unit of the value must measure the same as "rad/s", but is "kHz"'),
        ('omega = "fast"', "must be a number with a unit"),
        ('omega = "-1 rad/s"', "must be at least 0 rad/s"),
        ('omgea = "1 rad/s"', "`omgea` that is not known"),
    ],
)
def test_settings_that_are_none(written, settings, words):
    with pytest.raises(mg.InputError, match=r"effects\.0") as caught:
        mg.load_study(written(MODE.format(settings)))
    assert words in str(caught.value)


def test_a_setting_without_a_unit_of_its_own_is_a_plain_number(written, tmp_path):
    own = tmp_path / "own.py"
    own.write_text("""import equinox as eqx
import jax.numpy as jnp

import memsgyro_jax as mg


class Creep(mg.effects.ForceEffect):
    name, unit, law = "creep", "N·s³/m³", "F = −s·k·v³"
    strength: object = mg.effects.strength()
    knob: object = eqx.field(converter=jnp.asarray, default=1.0)

    def force(self, now):
        return -self.strength * self.knob * now.velocity**3
""")
    text = '[[effects]]\nname = "creep"\nstrength = "1 N*s^3/m^3"\nsettings = {{ knob = {} }}\n'
    study = mg.load_study(written(text.format("2.0")), mg.load_effects(own))
    assert float(study.loop.device.effects[0].knob) == 2.0
    with pytest.raises(mg.InputError, match=r"effects\.0\.settings\.knob.*plain number in SI.*no unit of `knob`"):
        mg.load_study(written(text.format('"2 m"')), mg.load_effects(own))
