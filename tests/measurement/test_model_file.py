"""A model file gives back the very same model, and says what is wrong with another."""

import equinox as eqx
import jax
import numpy as np
import pytest

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.effects import (
    BY_RECORD,
    CubicStiffness,
    ParasiticMode,
    RateBiasDrift,
    ReadoutDelay,
    catalogue,
    load_effects,
)  # fmt: skip
from memsgyro_jax.effects.instrument import FrequencyDrift
from memsgyro_jax.effects.lock_in_terms import LockInFeedthrough, ReferencePhase
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.model_file import model_text, read_model, write_model


DEVICE = NormalisedDevice(np.array([3.56e8, 3.9e8 / 3, -2.1e6]), np.array([22.1, 28.4, 0.1 + 0.2]), 5.6e6)
OWN = """
import equinox as eqx
import memsgyro_jax as mg
from memsgyro_jax.effects import ForceEffect, strength

class Creep(ForceEffect):
    name, unit, law = "creep", "N*s**3/m**3", "F = -s v^3"
    axis: int = eqx.field(static=True, default=0)
    strength: object = strength()

    def force(self, now):
        return self.along(now, -self.strength * now.velocity[self.axis] ** 3)
"""


def model(*effects):
    return Model(DEVICE, scale=[5e5, 4.9e5], offset=[0.01, -1 / 3], effects=effects, reference_bias=10.0)


def same(a, b):
    return eqx.tree_equal(a, b) is not False and bool(eqx.tree_equal(a, b))


def test_a_round_trip_is_exact(tmp_path):
    effects = (
        CubicStiffness(axis=1, strength=8e8 / 7),
        ReadoutDelay(strength=1e-7),
        ParasiticMode(axis=0, strength=1e-4, omega=2e4 / 3, quality=300.0),
        RateBiasDrift(strength=np.arange(1, 7) / 70),
    )
    before = model(*effects)
    after = read_model(write_model(before, tmp_path / "m.toml"))
    assert same(before, after)
    assert [e.label for e in after.effects] == [e.label for e in effects]


def test_every_effect_of_the_catalogue_comes_back(tmp_path):
    strong = tuple(eqx.tree_at(lambda e: e.strength, e, np.full(e.strength.shape, 0.1) + 0.2) for e in catalogue(2))
    before = model(*jax.tree.map(jax.numpy.asarray, strong))
    assert same(before, read_model(write_model(before, tmp_path / "m.toml")))


def test_effects_of_strength_zero_are_left_out(tmp_path):
    after = read_model(write_model(model(*catalogue(2)), tmp_path / "m.toml"))
    assert after.effects == ()
    assert same(after, model(*catalogue(2)).present)


def test_a_resonator_has_one_axis(tmp_path):
    before = Model(Resonator(400.0, 20.0, 1.5), scale=2.0, effects=(CubicStiffness(strength=1e3),))
    assert same(before, read_model(write_model(before, tmp_path / "m.toml")))


def test_an_effect_of_ones_own_needs_its_file(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    own = load_effects(tmp_path / "own.py")
    path = write_model(model(eqx.tree_at(lambda e: e.strength, own[1], np.asarray(2.5))), tmp_path / "m.toml")
    assert read_model(path, own).effects[0].label == "creep y"
    with pytest.raises(InputError, match=r"m\.toml: line \d+.*creep.*--effects FILE\.py"):
        read_model(path)


def test_strengths_may_be_in_another_unit(tmp_path):
    path = write_model(model(CubicStiffness(strength=1e9)), tmp_path / "m.toml")
    text = path.read_text().replace("strength = 1000000000.0", "strength = 1").replace('"N/m³"', '"nN/um**3"')
    path.write_text(text)
    assert float(read_model(path).effects[0].strength) == pytest.approx(1e9, rel=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("memsgyro-model/1", "memsgyro-model/9", "line 1.*schema"),
        ("[device]", "[devise]", "devise.*did you mean `device`"),
        ("xy = ", "zz = ", "line 4.*zz"),
        ('unit = "1/kg"', 'unit = "kg"', 'line 6.*"1/kg"'),
        ('unit = "N/m³"', 'unit = "N/m"', "Unit of the strength"),
        ("cubic_stiffness", "cubic_softness", "cubic_softness"),
        ('axis = "x"', 'axis = "z"', "variant|'z'"),
        ("strength = 1000000000.0", "strength = [1.0, 2.0]", "shape"),
        ("strength = 1000000000.0", "strength = nan", "finite"),
        ("strength = 1000000000.0", "strength = 1.0\nsettings = { omega = 1.0 }", "`omega` that is not known"),
        ("offset = [0.01, ", "offset = [0.01, 1.0, ", "one entry per axis, 2, but has 3"),
        ("scale = [", "scale = [[", "TOML"),
        ("yy = ", "qq = ", "qq"),
    ],
)
def test_what_is_wrong_is_one_sentence_with_its_place(tmp_path, old, new, message):
    path = write_model(model(CubicStiffness(strength=1e9)), tmp_path / "m.toml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as error:
        read_model(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_what_is_not_finite_is_not_written(tmp_path):
    with pytest.raises(InputError, match="finite"):
        model_text(model(CubicStiffness(strength=np.inf)))


def test_no_file(tmp_path):
    with pytest.raises(InputError, match="no such model file"):
        read_model(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("xx = 356000000.0", "xx = 0.0", "`device.stiffness`: The stiffness matrix must be positive definite"),
        (
            "xx = 356000000.0",
            "xx = 1e30",
            "must be of a size below 1e+26 rad²/s², beyond which no device is",
        ),
        ("scale = [500000.0", "scale = [1e30", "must be of a size below 1e+20 V/m"),
        ("xy = -2100000.0", "xy = -3e8", "`device.stiffness`: The stiffness matrix must be positive definite"),
        ("xx = 22.1", "xx = -22.1", "`device.damping`: The damping matrix must be positive definite"),
        ("value = 5600000.0", "value = 0", "`device.mobility`: must be 1 / mass, positive, but is 0"),
        ("value = 298.15", "value = 0.5", "`reference.temperature`: must lie between 1 K and 1700 K"),
        ("value = 298.15", "value = 1e400", "must be finite"),
        ("value = 10.0", "value = 1" + 400 * "0", "`reference.bias_voltage.value`: must be a finite number"),
        ("scale = [500000.0", "scale = [0.0", "`readout.scale`: must not be zero"),
        ("quality = 300.0", "quality = 0.1", "`quality` must be at least 0.5, but is 0.1"),
        ("strength = 0.0001", "strength = -0.0001", "`strength` must be at least 0, but is -0.0001"),
        ("strength = 0.0001", "strength = nan", "must be a finite number"),
    ],
)
def test_what_no_device_is(tmp_path, old, new, words):
    text = model_text(model(ParasiticMode(axis=0, strength=1e-4, omega=2e4, quality=300.0)))
    assert old in text
    (tmp_path / "m.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=r"m\.toml: line \d+") as caught:
        read_model(tmp_path / "m.toml")
    assert words in str(caught.value)
    assert "?." not in str(caught.value)


def test_a_resonator_is_held_and_slowed(tmp_path):
    text = model_text(Model(Resonator(400.0, 20.0, 1.5), scale=2.0))
    for old in ("xx = 160000.0", "xx = 20.0"):
        (tmp_path / "m.toml").write_text(text.replace(old, "xx = 0.0"))
        with pytest.raises(InputError, match=r"m\.toml: line \d+, `device\.(stiffness|damping)`: .* positive"):
            read_model(tmp_path / "m.toml")


def test_what_the_instrument_does_comes_back_without_the_rows_it_belongs_to(tmp_path):
    """Its numbers are the file's; which rows take them, a case tells."""
    terms = (
        LockInFeedthrough(strength=[1e-3, -7e-4], entry=np.ones((3, 2, 2))),
        ReferencePhase(strength=[0.1, 0.2], entry=np.ones((3, 1, 2)), of=BY_RECORD),
        FrequencyDrift(strength=[1e-6], entry=np.ones((1, 1, 1)), begin=[0.0], span=[5.0]),
    )
    before = Model(Resonator(400.0, 20.0, 1.5), effects=(CubicStiffness(strength=1e3), *terms), order=1)
    path = write_model(before, tmp_path / "m.toml", note="of one case")
    after = read_model(path)
    assert path.read_text().startswith("# of one case\n")
    assert after.order == 1
    assert [e.label for e in after.effects] == [e.label for e in before.effects]
    for theirs, mine in zip(after.effects, before.effects, strict=True):
        np.testing.assert_array_equal(theirs.strength, mine.strength)
    assert [type(e) for e in after.physical().effects] == [CubicStiffness]


def test_a_term_of_the_instrument_that_is_not_known(tmp_path):
    text = model_text(Model(Resonator(400.0, 20.0, 1.5), effects=(ReferencePhase(strength=[0.1]),)))
    (tmp_path / "m.toml").write_text(text.replace("reference_phase", "reference_face"))
    with pytest.raises(InputError, match=r"m\.toml: line \d+.*reference_face"):
        read_model(tmp_path / "m.toml")
