"""The instrument beside a dominant effect: a strongly driven one-axis device, made by other code."""

import pytest
from lab import driven

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.nuisances import instrument_between
from memsgyro_jax.diagnosis.search import start_search
from memsgyro_jax.effects import by_name, catalogue
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


@pytest.mark.slow
def test_the_instrument_comes_before_what_imitates_it(tmp_path):
    """Once the spring hardens, the phase of the reference and a complex background are left: no delay, no real part."""
    case = mg.load_case(driven.write(tmp_path))
    names = (("cubic_stiffness", "x"), ("readout_delay", ""), ("electrical_feedthrough", "x_to_x"))
    effects = [by_name(*name, among=catalogue(1)) for name in names]
    model = model_of(case, starting_device(case)).with_effect(*effects)
    search = start_search(case, Joint(model, readings_of(case)), 0.045, (), lambda text: None)
    ranking = search.rank()
    search.take(*search.best(ranking))
    assert search.joint.model.effects[search.accepted[0]].label == "cubic_stiffness x"
    assert search.steps[-1].fit.chi2_per_dof > 100
    beside = instrument_between(search, search.rank())
    assert [step.added for step in beside.steps][:2] == ["", "cubic_stiffness x"]
    found = {beside.joint.model.effects[i].label for i in beside.given}
    assert found == {"reference_phase", "lock_in_feedthrough"}
    assert beside.steps[-1].fit.chi2_per_dof < 1.2
    assert beside.steps[-1].fit.joint is beside.joint  # what is known beforehand of other terms is no part of it
    (place,) = beside.accepted
    (strength,) = beside.optimum.vector[beside.joint.of_effect(place)]
    assert strength == pytest.approx(driven.CUBIC, rel=1e-3)


@pytest.mark.slow
def test_a_driven_bench_is_diagnosed(tmp_path):
    """Effect, instrument and calibration; what is known is kept as it goes."""
    kept = []
    found = mg.diagnose(None, mg.load_case(driven.write(tmp_path)), keep=lambda fit, stages: kept.append(stages))
    assert found.verdict == "found"
    (spring,) = found.accepted
    assert spring.label == "cubic_stiffness x"
    assert abs(spring.estimate[0] - driven.CUBIC) < 4 * spring.std[0]
    assert spring.calibration == pytest.approx(0.086, abs=0.002)
    assert {term.label for term in found.instrument} == {"reference_phase", "lock_in_feedthrough"}
    assert "it is not the device" in found.sentence
    assert [len(stages) for stages in kept] == sorted(len(stages) for stages in kept)
