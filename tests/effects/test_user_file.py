"""A user's own file of effects: fifteen lines work, anything else is one sentence with file and line."""

import json
import sys

import numpy as np
import pytest

from memsgyro_jax import InputError
from memsgyro_jax import effects as fx
from memsgyro_jax.app import cli
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.measurement.model import Conditions, Model


GOOD = """\
import equinox as eqx, jax
from jax import Array

import memsgyro_jax.effects as fx


class Creep(fx.ForceEffect):
    name, unit, law = "creep", "N·s³/m³", "F = −s·v³"
    axis: int = eqx.field(static=True, default=0)
    strength: Array = fx.strength()

    def force(self, now):
        return self.along(now, -self.strength * now.velocity[self.axis] ** 3)
"""
assert len(GOOD.splitlines()) <= 15


@pytest.fixture
def load(tmp_path):
    def run(text, axes=2):
        path = tmp_path / "mine.py"
        path.write_text(text, encoding="utf-8")
        return fx.load_effects(path, axes)

    return run


def test_fifteen_lines_are_enough(load):
    effects = load(GOOD)
    assert [e.label for e in effects] == ["creep x", "creep y"]
    strong = type(effects[1])(1, 2e-3)
    state = np.array([0.0, 0.0, 0.1, 0.2])
    device = SingleMassGyro.chi2010()
    models = [Model(device, effects=more) for more in ((), (strong,))]
    slopes = [np.asarray(m.derivative(state, np.zeros(2), Conditions())) for m in models]
    expected = [0.0, 0.0, 0.0, -2e-3 * 0.2**3 / float(device.mass)]
    np.testing.assert_allclose(slopes[1] - slopes[0], expected, rtol=1e-9)
    assert [e.label for e in load(GOOD, axes=1)] == ["creep x"]
    assert "memsgyro_effects_of_user" not in sys.modules


def test_given_instances_are_taken_at_strength_zero(load):
    (effect,) = load(GOOD + "\nEFFECTS = (Creep(1, 3.0),)\n")
    assert effect.label == "creep y"
    assert float(effect.strength) == 0.0


def test_a_class_that_others_build_on_is_no_effect_of_its_own(load):
    more = "\n\nclass Fast(Creep):\n    name = 'fast'\n\n\nclass Slow(Creep):\n    name = 'slow'\n"
    assert [e.label for e in load(GOOD + more)] == ["fast x", "fast y", "slow x", "slow y"]


def test_every_port_can_be_used(load):
    text = GOOD.replace("ForceEffect", "ReadoutEffect").replace("def force(self, now)", "def signal(self, volts, now)")
    text = text.replace("return self.along", "return volts + self.along")
    assert isinstance(load(text)[0], fx.ReadoutEffect)
    drive = GOOD.replace("ForceEffect", "DriveEffect").replace(
        "def force(self, now)", "def applied(self, command, now)"
    )
    assert isinstance(load(drive.replace("return self.along", "return command + self.along"))[0], fx.DriveEffect)


NAMES = 'name, unit, law = "creep", "N·s³/m³", "F = −s·v³"'
FORCE = "self.along(now, -self.strength * now.velocity[self.axis] ** 3)"
BAD = {
    "syntax": ("class Creep(", "class Creep(:", "line 7: must be valid Python"),
    "import": ("import equinox as eqx", "import no_such_module as eqx", "line 1: must run, but: ModuleNotFoundError"),
    "crash": ("from jax import Array", "from jax import Array; 1 / 0", "line 2: must run, but: ZeroDivisionError"),
    "exit": ("from jax import Array", "raise SystemExit(3)", "line 2: must run, but: SystemExit: 3"),
    "no effect": ("(fx.ForceEffect)", "", "must define an effect for 2 axes"),
    "no port": ("fx.ForceEffect", "fx.Effect", "line 7: effect `Creep` must be a subclass of `ForceEffect` or"),
    "no method": ("def force", "def forse", "line 7: effect `Creep` must have the method `force`"),
    "no name": (NAMES, 'unit = "N"', "line 7: effect `Creep` must have a name"),
    "no unit": (NAMES, 'name = "creep"', "line 7: effect `Creep` must have a unit"),
    "empty unit": ("N·s³/m³", " ", "line 7: effect `Creep` must have a unit"),
    "unknown unit": ("N·s³/m³", "N·foo", 'line 7) must be one that can be read, e.g. "um", "deg/s" or "1", but is'),
    "two words": ('"creep"', '"slow creep"', 'line 7: the name of effect `Creep` must be one word, but is "slow'),
    "state that rests": (NAMES, NAMES + "\n    own_size = 1", "line 7: effect `Creep` must have the method `own_rate("),
    "state of no size": (
        "    def force",
        "    def own_rate(self, now):\n        return now.own\n\n    def force",
        "line 7: effect `Creep` must have an `own_size`",
    ),
    "clash": ('"creep"', '"cubic_stiffness"', "line 7: an effect must have a name of its own, but `cubic_stiff"),
    "no strength": ("    strength: Array = fx.strength()\n", "", "line 7: effect `Creep` must have the field `str"),
    "plain number": ("fx.strength()", "0.0", "but its strength is 0.0"),
    "missing field": ("fx.strength()\n", "fx.strength()\n    gap: Array\n", "line 7: must run, but: TypeError"),
    "no such field": ("now.velocity", "now.speed", "line 13: effect `creep x` must be computable, but: AttributeError"),
    "branch": (f"return {FORCE}", f"return {FORCE} if now.time > 0 else now.force", "choose with `jax.numpy.where`"),
    "list": (FORCE, f"list({FORCE})", "must return an array of shape (2,), but returns a list; `jax.numpy.stack`"),
    "third axis": ("velocity[self.axis]", "velocity[2]", "method `force` reaches for entry 2 of 2, counted from 0"),
    "arguments": ("force(self, now)", "force(self)", "method `force` of Creep must take (self, now), but takes (self)"),
    "shape": (FORCE, "self.strength * now.velocity[0]", "must return an array of shape (2,), but returns one of ()"),
    "not zero": ("** 3)", "** 3 + 1.0)", "line 7: effect `creep x`: method `force` must do exactly nothing"),
    "no number": (FORCE, "now.velocity * self.strength / self.strength", "must be finite at strength zero"),
    "reverse slope": (
        FORCE,
        "self.along(now, jax.numpy.where(self.strength > 0, jax.numpy.sqrt(self.strength), 0.0))",
        "must have a finite derivative by the strength at zero",
    ),
    "slope": ("-self.strength *", "-(self.strength**0.5) *", "must have a finite derivative by the strength at zero"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "words"), BAD.values(), ids=BAD)
def test_a_mistake_is_one_sentence_with_its_place(load, old, new, words):
    assert old in GOOD
    with pytest.raises(InputError) as error:
        load(GOOD.replace(old, new))
    text = str(error.value)
    assert words in text
    assert "mine.py" in text
    assert "\n" not in text
    assert text.endswith(".")


def test_an_own_state_without_its_rate_is_made_nowhere(load):
    """It once stayed zero and did nothing, unseen."""
    kind = type(load(GOOD)[0])
    with pytest.raises(InputError, match=r"`creep x` must have the method `own_rate\(self, now\)`.* is 1, but has not"):
        type("Rests", (kind,), {"own_size": 1, "__module__": kind.__module__})(0, 1.0)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("EFFECTS = 3", "`EFFECTS` must be a tuple of effects, but is of type int"),
        ("EFFECTS = (Creep,)", "write `()` behind the class"),
        ("EFFECTS = ()", "must define an effect"),
        ("EFFECTS = (Creep(), Creep())", "but two are called `creep x`"),
        ("EFFECTS = (fx.CubicStiffness(),)", "`cubic_stiffness` is in the catalogue"),
    ],
)
def test_a_mistake_in_the_list_is_one_sentence(load, line, words):
    with pytest.raises(InputError) as error:
        load(f"{GOOD}\n{line}\n")
    assert words in str(error.value)


def test_an_effect_on_an_axis_that_is_not_there(load):
    with pytest.raises(InputError, match="must fit a device with one axis, but needs 2"):
        load(GOOD + "\nEFFECTS = (Creep(1),)\n", axes=1)


def test_a_file_that_is_none(tmp_path):
    with pytest.raises(InputError, match=r"no_file\.py: no such Python file"):
        fx.load_effects(tmp_path / "no_file.py")
    (tmp_path / "bytes.py").write_bytes(b"# \xff\n")
    with pytest.raises(InputError, match="line 1: the Python file must be UTF-8"):
        fx.load_effects(tmp_path / "bytes.py")


def command(*tokens):
    with pytest.raises(SystemExit) as end:
        cli.main(["effects", *map(str, tokens)])
    return end.value.code


def test_the_command_lists_every_effect(capsys, tmp_path):
    (tmp_path / "mine.py").write_text(GOOD, encoding="utf-8")
    assert command(tmp_path / "mine.py", "--json", tmp_path / "effects.json") == 0
    own = capsys.readouterr().out
    assert own.startswith("creep")
    assert "Checked: strength zero is absence" in own
    assert "cubic_stiffness" not in own
    assert command() == 0
    text = capsys.readouterr().out
    for effect in fx.every_effect(2):
        assert effect.name in text
        assert effect.law in text
        assert effect.reference in text
    written = json.loads((tmp_path / "effects.json").read_text(encoding="utf-8"))
    assert written["schema"] == "memsgyro-effects/1"
    labels = {f"{e['name']} {w}".rstrip() for e in written["effects"] for w in e["variants"] or [""]}
    assert labels == {e.label for e in fx.every_effect(2)} | {"creep x", "creep y"}


def test_the_command_refuses_a_broken_file(capsys, tmp_path):
    (tmp_path / "mine.py").write_text(GOOD.replace("def force", "def forse"), encoding="utf-8")
    assert command(tmp_path / "mine.py") == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert "line 7" in told.err
