"""A resonator between plates: its spring and what bends it go with the square of the bias voltage, and its drive and
its pick-off with the bias.
"""

import equinox as eqx
import numpy as np
import pytest
from lab import plates

import memsgyro_jax as mg
from memsgyro_jax import effects as fx
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.settings_apart import begun, in_each_place, put_beside, twins_of
from memsgyro_jax.diagnosis.worth_trying import worth_trying
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


PUSH, SHOW = plates.FORCE * 5.0, plates.SCALE * 5.0  # at 5 V: N/V, V/m
TRUE = {  # in volts of readings and of drive, as the records are
    "electrostatic_softening x": plates.SOFTENS / PUSH / SHOW,
    "electrostatic_cubic_stiffness x": plates.BENDS / PUSH / SHOW**3,
    "bias_transduction drive": 1.0,
    "bias_transduction pickoff": 1.0,
}


def true_model(case):
    stiffness = (2.0 * np.pi * plates.F0) ** 2 - plates.SOFTENS * 25.0 / plates.MASS
    damping = 2.0 * np.pi * plates.F0 / plates.Q
    device = NormalisedDevice(np.array([stiffness]), np.array([damping]), PUSH * SHOW / plates.MASS)
    softens, bends, drives, shows = TRUE.values()
    effects = (
        fx.ElectrostaticSoftening("x", softens), fx.ElectrostaticCubicStiffness("x", bends),
        fx.DriveTransduction(drives), fx.PickoffTransduction(shows),
    )  # fmt: skip
    return model_of(case, device, effects=effects)


def test_bent_sweeps_at_another_bias_are_predicted_on_their_branch(tmp_path):
    """At 15 V the motion is a third of what a read-out with the gain of 5 V would have: from there the balance ended at
    six times what the drive can hold, 480 times the noise off at rows beside the top.
    """
    case = mg.load_case(plates.plates(tmp_path, 41, biases=(15.0,), levels=(6,)))
    model = true_model(case)
    for some in readings_of(case):
        seen = eqx.filter_jit(lambda experiment: experiment.predict(model))(some.experiment)
        assert np.max(np.abs(seen - some.experiment.measured)) < 4.5 * plates.NOISE


def test_what_the_bias_bends_is_tried_where_there_are_several(tmp_path):
    def names(biases):
        case = mg.load_case(plates.plates(tmp_path, 9, biases=biases, levels=(2,)))
        return {effect.name for effect in worth_trying(case)}

    assert "electrostatic_cubic_stiffness" in names((5.0, 10.0))
    assert "electrostatic_cubic_stiffness" not in names((5.0,)), "a plain cubic spring there"


def test_drive_and_pick_off_share_what_a_linear_device_gains_by_its_bias(tmp_path):
    case = mg.load_case(plates.plates(tmp_path, 31, levels=(2,)))
    effects = fx.ElectrostaticSoftening("x"), fx.DriveTransduction(), fx.PickoffTransduction(), fx.CubicStiffness("x")
    joint = Joint(model_of(case, starting_device(case)).with_effect(*effects), readings_of(case))
    every, places = in_each_place(case), range(len(joint.model.effects))
    _, chosen = begun(joint, every, places)
    twins = twins_of(joint, every, chosen, places)
    assert [joint.model.effects[i].label for i in chosen] == ["electrostatic_softening x", "bias_transduction drive"]
    assert [joint.model.effects[i].label for i in twins] == ["bias_transduction pickoff"]
    shares = put_beside(joint, every, [*chosen, *twins])
    for place in (chosen[1], *twins):
        assert shares[joint.of_effect(place)].item() == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_the_plates_are_found(tmp_path):
    """Nine sweeps without a verdict in 420 s, with gains of each record in place of what bends it by the bias."""
    found = mg.diagnose(None, mg.load_case(plates.plates(tmp_path, 61)))
    assert found.verdict == "found"
    told = {one.label: (one.estimate[0], one.std[0]) for one in found.accepted}
    assert set(told) == set(TRUE)
    for label, true in TRUE.items():
        assert abs(told[label][0] - true) < 4.0 * told[label][1]
    assert not found.instrument
