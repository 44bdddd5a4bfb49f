"""Scores of absent effects from their forces alone, beside models that carry every effect through every sample."""

from dataclasses import replace

import numpy as np
import pytest
from bench_case import DIE, EFFECTS, ONE_AXIS, RESONATOR, bench, truth
from lab.devices import gyro
from lab.die import Die, Hidden
from numpy.testing import assert_allclose

from memsgyro_jax.diagnosis import joint_residual
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.effects import AdcSaturation, CubicStiffness, ForceEffect, ReadoutDelay, Scanned, catalogue
from memsgyro_jax.effects.base import SurroundingsEffect, strength
from memsgyro_jax.effects.instrument import RecordGain
from memsgyro_jax.effects.lock_in_terms import ReferencePhase
from memsgyro_jax.effects.numbers import parameter
from memsgyro_jax.measurement.absent import of_first_order
from memsgyro_jax.measurement.import_case import import_case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import model_of, readings_of


GYROS = {
    "thesis": DIE,
    "4 kHz": gyro(4e3, 300.0, 2000.0, 2.2e-7, 0.03),
    "1.5 kHz": gyro(1.5e3, 60.0, 150.0, 1.2e-7, 0.05),
}


LATE = "readout_delay"


class Ledge(ForceEffect):
    """A law of one's own with a number of its own, which says nothing of a derivative."""

    name, unit = "ledge", "N"
    strength: object = strength()
    reach: object = parameter(start=3e-8, low=1e-9, unit="m")

    def force(self, now):
        return self.along(now, -self.strength * (now.displacement[0] / self.reach) ** 5)


# What bias, temperature and rate move, where none of them is changed.
UNMOVED = {
    *(
        "electrostatic_softening x",
        "electrostatic_cubic_stiffness x",
        "bias_transduction drive",
        "bias_transduction pickoff",
    ),
    *(f"thermal_{kind} {what}" for kind in ("drift", "curvature") for what in ("stiffness", "damping")),
    "centrifugal",
}


class Warming(SurroundingsEffect):
    """Warms all that a temperature changes: not told by its own force."""

    name, unit = "warming", "K"
    strength: object = strength()

    def warmer(self, now):
        return self.strength


def not_the_same(model: Model, case, monkeypatch) -> set[str]:
    """Which strengths that are zero a prediction does not see, or sees otherwise as a response than carried along."""
    joint = Joint(model, readings_of(case))
    absent = [i for i in range(len(model.effects)) if not np.any(joint.start[joint.of_effect(i)])]
    columns = np.concatenate([joint.of_effect(i) for i in absent])
    units = np.eye(joint.start.size)[columns]
    value, quick = joint.linearise(joint.start, units, joint.fitted)
    monkeypatch.setattr(joint_residual, "CARRIED", len(model.effects))
    same, carried = joint.linearise(joint.start, units, joint.fitted)
    assert np.isfinite(carried).all()
    assert_allclose(value, same, atol=1e-7)
    size, apart = (np.linalg.norm(part, axis=0) for part in (carried, quick - carried))
    names = [joint.parameters[i].name for i in columns]
    # A read-out that is late turns a phasor as one that rests, where its response is that to the velocity: they differ
    # in a rate table by how much the phasor changes within a block, in a decay by how far it is from the reference.
    most = [1e-4 if name == LATE else 1e-6 for name in names]
    return {name for name, a, s, m in zip(names, apart, size, most, strict=True) if not s or a > m * s}


@pytest.mark.slow
@pytest.mark.parametrize("die", GYROS.values(), ids=GYROS)
def test_responses_are_those_of_a_model_that_carries_every_effect(die: Die, monkeypatch):
    """Sweeps, a rate table, a raw capture; and a ring-down, through which all are carried."""
    case = bench(die=die).case
    assert not_the_same(truth(case, die, Hidden()), case, monkeypatch) == set()


@pytest.mark.slow
def test_responses_are_those_of_a_model_that_carries_every_fifth_effect(monkeypatch):
    """In a sweep at one bias and temperature and without rate, which leaves what these move unseen."""
    die = GYROS["1.5 kHz"]
    whole = bench(die=die).case
    case = replace(whole, records=tuple(r for r in whole.records if r.name == "sweep_x"))
    chosen = EFFECTS[::5]
    unseen = UNMOVED & {effect.label for effect in chosen}
    assert unseen
    assert not_the_same(truth(case, die, Hidden(), chosen), case, monkeypatch) == unseen


def test_effects_that_act_through_others_are_carried():
    model = truth(bench().case, DIE, Hidden(), EFFECTS[:1])
    assert all(of_first_order(model, effect) for effect in (*EFFECTS, RecordGain(), Ledge()))
    slow = *(e for e in catalogue(2) if isinstance(e, AdcSaturation) or e.own_size), Warming(), ReferencePhase()
    assert len(slow) == 5
    assert not any(of_first_order(model, effect) for effect in slow)


@pytest.mark.slow
@pytest.mark.parametrize(
    "beside",
    [
        (CubicStiffness("x", 8e8), ReadoutDelay(2e-5)),
        (CubicStiffness("y", -5e8), AdcSaturation(0.4)),
    ],
    ids=lambda effects: " ".join(e.label for e in effects),
)
def test_responses_beside_effects_that_are_present(beside, monkeypatch):
    case, labels = bench().case, {e.label for e in beside}
    others = [e for e in (*EFFECTS, Ledge(), Warming()) if e.label not in labels]
    model = truth(case, DIE, Hidden(), ()).with_effect(*others[:9], *beside, *others[9:])
    assert not_the_same(model, case, monkeypatch) <= {"warming"}


@pytest.mark.slow
@pytest.mark.parametrize("beside", [(), (CubicStiffness(0, 10.0),)], ids=["alone", "hardening"])
def test_responses_of_a_resonator(beside, monkeypatch):
    """Its sweeps see no even law, of which rounding is left, and neither bias nor temperature nor rate."""
    unseen = UNMOVED | {"quadratic_stiffness x", "drive_nonlinearity x", "pickoff_nonlinearity x"}
    case = bench(protocol=ONE_AXIS, die=RESONATOR).case
    effects = [e for e in catalogue(1) if not isinstance(e, Scanned) and e.label not in {b.label for b in beside}]
    model = truth(case, RESONATOR, Hidden(), ()).with_effect(*effects, *beside)
    assert not_the_same(model, case, monkeypatch) <= unseen


@pytest.mark.slow
@pytest.mark.parametrize("beside", [(), (CubicStiffness("x", 1.2e8),)], ids=["alone", "hardening"])
def test_responses_of_a_decay_from_an_unknown_start(beside, monkeypatch, tmp_path):
    """Waveforms of two axes that ring by themselves, piece by piece; what a start makes up for is not seen."""
    time, rng = np.arange(1500) / 80e3, np.random.default_rng(3)
    rings = [
        a * np.exp(-np.pi * f / q * time) * np.cos(2 * np.pi * f * time + p) + 1e-4 * rng.standard_normal(time.size)
        for a, f, q, p in ((0.4, 9000.0, 250.0, 0.3), (0.2, 9600.0, 180.0, 1.2))
    ]
    rows = np.stack([time, *rings], axis=1)
    np.savetxt(tmp_path / "decay.csv", rows, "%.9g", ",", header="t [s],Vx [V],Vy [V]", comments="")
    case = import_case([tmp_path / "decay.csv"], tmp_path / "case").case
    labels = {e.label for e in beside}
    effects = [e for e in catalogue(2) if not isinstance(e, Scanned) and e.label not in labels]
    model = model_of(case, starting_device(case)).with_effect(*effects, *beside)
    unseen = not_the_same(model, case, monkeypatch)
    assert "cubic_stiffness y" not in unseen
    shown = {"quadratic_damping x", "quadratic_stiffness x", "squeeze_film_damping y", "pickoff_nonlinearity x"}
    shown |= {"cross_damping_asymmetry", "pickoff_crosstalk x_to_y", "dry_friction x"}
    assert not shown & unseen, unseen


@pytest.mark.slow
@pytest.mark.parametrize("beside", [(), (CubicStiffness("x", 1.2e8),)], ids=["alone", "hardening"])
def test_responses_of_the_phasors_of_a_decay(beside, monkeypatch, tmp_path):
    """Of a lock-in beside two axes that ring by themselves, piece by piece."""
    time, rng = np.arange(600) / 6e3, np.random.default_rng(3)
    rings = [
        a * np.exp((2j * np.pi * (f - 9000.0) - np.pi * f / q) * time + 1j * p)
        + 1e-4 * (rng.standard_normal(time.size) + 1j * rng.standard_normal(time.size))
        for a, f, q, p in ((0.4, 9050.0, 1250.0, 0.3), (0.2, 9260.0, 980.0, 1.2))
    ]
    rows = np.column_stack([time, *(part for ring in rings for part in (ring.real, ring.imag))])
    header = "t [s],Vx_I [V],Vx_Q [V],Vy_I [V],Vy_Q [V]"
    np.savetxt(tmp_path / "decay.csv", rows, "%.9g", ",", header=header, comments="")
    case = import_case([tmp_path / "decay.csv"], tmp_path / "case", reference="9000 Hz").case
    labels = {e.label for e in beside}
    effects = [e for e in catalogue(2) if not isinstance(e, Scanned) and e.label not in labels]
    model = model_of(case, starting_device(case)).with_effect(*effects, *beside)
    assert all(r.experiment.nothing(model) is not None for r in readings_of(case))
    unseen = not_the_same(model, case, monkeypatch)
    shown = {"cubic_stiffness y", "quadratic_damping x", "squeeze_film_damping y", "pickoff_cubic_nonlinearity x"}
    shown |= {"cross_damping_asymmetry", "pickoff_crosstalk x_to_y", "dry_friction x"}
    assert not shown & unseen, unseen
