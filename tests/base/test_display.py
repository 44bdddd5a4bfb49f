"""Objects show their numbers with units, and what tells two of them apart are their numbers."""

import dataclasses
import re
import types

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base import provenance
from memsgyro_jax.base.display import Displayed, stated_unit
from memsgyro_jax.base.provenance import fingerprint


GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
TONE = mg.Tone(600.0, 53.95)
OBSERVER = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, annealing=mg.Annealing(), fading=mg.AdaptiveFading())
EXAMPLES = {
    "loop": mg.ClosedLoop(GYRO, READOUT, OBSERVER, mg.DampingCompensation(TONE), filter=mg.Lowpass(100.0)),
    "dual mass": mg.DualMassGyro.chi2010(),
    "resonator": mg.Resonator(2e4, 1e3),
    "read-out": mg.DirectReadout(1e5, adc=mg.Adc(5.0, 16)),
    "Lyapunov": mg.LyapunovObserver.for_device(GYRO, mg.DirectReadout.of_velocity(1.0)),
    "energy": mg.EnergyObserver(
        mg.LyapunovObserver.for_device(GYRO, mg.DirectReadout.of_velocity(1.0)), (3e3, 5e3), (1e-6, 1e-6)
    ),
    "energy control": mg.EnergyControl(mg.OpenLoop(TONE), (3e3, 5e3), (1e-6, 1e-6), 9e3),
    "saturated": mg.Saturated(mg.Ahead(mg.DampingCompensation(TONE)), (1e-6, 1e-6)),
    "sliding mode": mg.SlidingMode.for_device(GYRO, mg.DirectReadout.of_velocity(1.0), TONE),
    "delayed": mg.Delayed(READOUT, 1e-6),
    "reference model": mg.ReferenceModel((2.9e3, 3.7e3), TONE),
    "designed motion": mg.DesignedMotion(TONE),
    "open loop": mg.OpenLoop(TONE),
    "fading": mg.FixedFading(1400.0),
    "band-pass": mg.Bandpass(1.0, 100.0),
    "scenario": mg.Scenario(mg.Step(0.05, 1.0) + mg.Sine(1.0, 5.0) + mg.Ramp(0.0, 1.0) + mg.RandomWalk(1.0, 0.1)),
    "chirp": mg.Chirp(1.0, 1.0, 9.0, 0.1),
    "record": mg.Recorded([0.0, 1.0, 2.0], [1.0, 2.0, 3.0]),
    "model": mg.Model(GYRO, scale=1e5),
    "coupled modes": mg.CoupledModes([1e4, 2e4], [1e3, 1e3]),
    "angles": mg.AxisAngles(),
    "errors": mg.ModelErrors(),
    "spread": mg.Normal(0.15),
    "uniform": mg.Uniform(low=1.0, high=2.0),
    "every effect": GYRO.with_effect(*mg.effects.catalogue(2)),
}


def inside(value, around=""):
    """Every field that holds numbers, as (object, field, unit)."""
    for field in dataclasses.fields(value):
        held = getattr(value, field.name)
        unit = stated_unit(value, field, around)
        leaves = jax.tree.leaves(held, is_leaf=lambda leaf: isinstance(leaf, Displayed))
        for leaf in leaves:
            if isinstance(leaf, Displayed):
                yield from inside(leaf, unit)
        if any(eqx.is_inexact_array(leaf) for leaf in leaves):
            yield type(value).__name__, field.name, unit


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_number_has_a_unit_and_is_shown(name):
    nameless = [(kind, field) for kind, field, unit in inside(EXAMPLES[name]) if unit is None]
    assert not nameless, "give the field a unit in `base/display.py` or in its metadata"
    assert "f64" not in repr(EXAMPLES[name])
    assert "float64[]" not in repr(EXAMPLES[name])


def test_a_device_is_written_as_it_is_made():
    short = mg.SingleMassGyro(1.8e-7, 63.96, 95.92, 12.78, 3.6e-6, 4.5e-6, 0.0)
    assert repr(short.with_effect(mg.effects.CubicStiffness("y", 8e8))) == (
        "SingleMassGyro(\n"
        "  effects=(CubicStiffness(axis='y', strength=8e+08 N/m³),),\n"
        "  mass=1.8e-07 kg,\n"
        "  kxx=63.96 N/m,\n"
        "  kyy=95.92 N/m,\n"
        "  kxy=12.78 N/m,\n"
        "  dxx=3.6e-06 N·s/m,\n"
        "  dyy=4.5e-06 N·s/m,\n"
        "  dxy=0 N·s/m,\n"
        "  cross_damping_asymmetry=0 N·s/m,\n"
        "  rotating_frame=False\n"
        ")"
    )
    assert repr(mg.Scenario(mg.Step(0.05, 1.0)).rate) == "Step(at=0.05 s, after=1, before=0)"
    assert "rate=Step(at=0.05 s, after=1 rad/s, before=0 rad/s)" in repr(mg.Scenario(mg.Step(0.05, 1.0)))


def test_a_gradient_by_a_device_is_in_no_unit_of_the_device():
    gyro = mg.SingleMassGyro.chi2010()
    slope = jax.grad(lambda device: device.coefficients(0.0)[1])(gyro)
    assert not re.search(r"\d kg|N/m|N·s/m", repr(slope))
    assert "no units" in repr(slope)
    assert "no units" not in repr(gyro)


def test_numbers_of_a_gyro_are_exchanged_one_by_one():
    gyro = mg.SingleMassGyro(1e-8, 1.0, 1.0, 0.0, 1e-6, 1e-6, 0.0, dyx=1e-8, temperature=300.0)
    other = dataclasses.replace(gyro, kxx=2.0)
    assert (float(other.kxx), float(other.kyy), float(other.temperature)) == (2.0, 1.0, 300.0)
    assert float(other.cross_damping_asymmetry) == 1e-8
    assert float(dataclasses.replace(gyro, dyx=3e-8).cross_damping_asymmetry) == 3e-8


def test_many_dies_show_their_range_and_traced_numbers_that_they_are():
    dies = eqx.tree_at(lambda g: g.mass, GYRO, jnp.linspace(1e-7, 2e-7, 64))
    assert "mass=float64[64] from 1e-07 to 2e-07 kg" in repr(dies)
    seen = []
    jax.make_jaxpr(lambda gyro: seen.append(repr(gyro)))(GYRO)
    assert "mass=traced float64[] kg" in seen[0]


def test_a_notebook_shows_the_same_text():
    assert mg.Tone(1.0, 2.0)._repr_html_().endswith(">Tone(frequency=1 Hz, amplitude=2, phase=0 rad)</pre>")
    assert "&lt;" in mg.Spread((mg.Vary("<b>", mg.Normal(0.1)),))._repr_html_()
    results = (
        "Trace",
        "InformationBound",
        "Lot",
        "Sobol",
        "Tornado",
        "Corners",
        "Tuning",
        "RecordTuning",
        "Identification",
    )
    for name in (*results, "Comparison", "CaseFit", "Diagnosis", "MotionDesign", "CaseQuality", "Case"):
        assert hasattr(getattr(mg, name), "_repr_html_"), name


def test_a_fingerprint_changes_with_every_number_and_only_with_those():
    values = [mg.Spread.relative(jnp.asarray(v)) for v in (0.25, 0.26)]
    assert fingerprint(values[0]) != fingerprint(values[1])
    assert fingerprint(values[0]) == fingerprint(mg.Spread.relative(0.25))
    points = [dataclasses.replace(values[0], points=p) for p in ((1.0, 2.0), (1.0, 2.5))]
    assert fingerprint(points[0]) != fingerprint(points[1])
    assert fingerprint(GYRO) == fingerprint(mg.SingleMassGyro.chi2010())
    leaves, structure = jax.tree.flatten(EXAMPLES["loop"])
    told = {
        fingerprint(structure.unflatten([*leaves[:i], 1.5 * leaves[i] + 1.0, *leaves[i + 1 :]]))
        for i in range(len(leaves))
    }
    assert len(told | {fingerprint(EXAMPLES["loop"])}) == len(leaves) + 1


def test_a_fingerprint_does_not_rest_on_what_is_printed():
    class Silent(eqx.Module):
        number: float = eqx.field(static=True)

        def __repr__(self):
            return "Silent()"

    assert fingerprint(Silent(1.0)) != fingerprint(Silent(2.0))

    def shifted(by):
        return lambda time: time + by

    assert fingerprint(shifted(1.0)) != fingerprint(shifted(2.0))
    assert fingerprint(shifted(1.0)) == fingerprint(shifted(1.0))
    assert fingerprint(lambda time: 2.0 * time) != fingerprint(lambda time: 3.0 * time)
    assert fingerprint(np.ones(2)) != fingerprint(np.ones(2, np.float32))


OWN = """
import equinox as eqx
import jax
GAIN = 2.0
def force(x):
    return GAIN * x
class Effect(eqx.Module):
    size: float
    @jax.jit
    def value(self, x):
        return force(x) + again(self, x)
def again(effect, x):
    return 3 * x if x else effect.value(x)
"""


@pytest.mark.parametrize(
    "change", [("2.0", "2.5"), ("GAIN * x", "GAIN + x"), ("force(x) +", "force(x) -"), ("3 *", "4 *")]
)
def test_a_fingerprint_changes_with_the_code_of_a_class_of_ones_own(change):
    def made(text):
        module = types.ModuleType("own")
        exec(compile(text, "own.py", "exec"), vars(module))  # the user's file, edited
        return fingerprint(module.Effect(1.0))

    assert made(OWN) == made("# told better\n" + OWN)
    assert made(OWN) != made(OWN.replace(*change))


def test_a_fingerprint_changes_with_the_versions_that_decide_bits(monkeypatch):
    before = fingerprint(1.0)
    for place, (name, _) in enumerate(provenance.versions()):
        others = [*provenance.versions()]
        others[place] = name, "0.0.1"
        monkeypatch.setattr(provenance, "versions", lambda others=tuple(others): others)
        assert fingerprint(1.0) != before
        monkeypatch.undo()


def test_a_fingerprint_of_jax_and_sets_is_the_same_twice():
    values = (jnp.sin, jax.jit(lambda x: x), frozenset({1, "a", None}), jax.nn.relu)
    assert " at 0x" not in str(provenance._parts(values))


@pytest.mark.parametrize(
    "value",
    [OBSERVER.estimate(OBSERVER.init()), mg.PolarNoise(1e-3, 0.01), mg.geometry.Comb(100, 5e-6, 1e-6, 5e-5), mg.Free()],
    ids=lambda value: type(value).__name__,
)
def test_nothing_prints_the_type_of_a_number_in_its_place(value):
    assert "f64[" not in repr(value)
    assert "Array(" not in repr(value)
    assert value._repr_html_().startswith("<pre")
