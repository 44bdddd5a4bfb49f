"""A loop that drives one axis hard while the other hardly moves, recorded: what the first hides must not be sought in
the second, whose numbers the record holds badly.
"""

import numpy as np
import pytest

import memsgyro_jax as mg


STUDY = """
[device]
kind = "single_mass"
mass = "2 ug"
frequency = ["21.3 kHz", "21.9 kHz"]
quality_factor = [30_000, 8_000]
quadrature = "50 deg/s"

[readout]
kind = "displacement"
scale = "0.3 V/um"
noise_density = "1 uV/sqrt(Hz)"

[[effects]]
name = "cubic_stiffness"
axis = "x"
strength = "2e10 N/m^3"

[controller]
kind = "classic"
sense = "rebalanced"
amplitude = "2 um"

[sweep]
sample_rate = "200 kHz"
duration = "{duration}"
"""


@pytest.fixture
def recorded(tmp_path, request):
    (tmp_path / "study.toml").write_text(STUDY.format(duration=request.param))
    study = mg.load_study(tmp_path / "study.toml")
    loop, scenario = study.die(None)
    plan = study.settings
    trace = mg.simulate(loop, scenario, sample_rate=plan.sample_rate, duration=plan.duration, seed=0)
    return mg.load_case(trace.to_case(tmp_path / "case").parent)


@pytest.mark.slow
@pytest.mark.parametrize("recorded", ["15 ms"], indirect=True)
def test_a_fit_ends_at_a_device(recorded):
    """The stiffness of y went to a fifth of itself, 34 standard deviations off, and its damping fed the motion of x."""
    found = mg.fit(None, recorded, effects=[mg.effects.CubicStiffness("x", 1e9)])
    assert found.optimum.converged
    assert found.chi2_per_dof < 1.1
    device = found.model.device
    assert np.all(np.linalg.eigvalsh(np.asarray(device.damping_matrix)) > 0)
    told = {estimate.name: estimate for estimate in found.estimates}
    for name, true in (("kxx/m", (2 * np.pi * 21300.0) ** 2), ("kyy/m", (2 * np.pi * 21900.0) ** 2)):
        assert abs(told[name].value - true) < 4 * told[name].std, name
    assert float(found.model.effects[0].strength) == pytest.approx(2e10, rel=3e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The effects of the device acted once in a sample")  # 1.4 standard deviations here
@pytest.mark.parametrize("recorded", ["50 ms"], indirect=True)
def test_the_spring_is_found(recorded):
    found = mg.diagnose(None, recorded)
    assert found.verdict == "found"
    assert [a.label for a in found.accepted] == ["cubic_stiffness x"]
