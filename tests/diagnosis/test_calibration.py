"""The stated rate of false alarms on four devices: `studies/diagnosis_calibration.py` asks more."""

import numpy as np
import pytest
from lab.devices import DEVICES
from lab.die import Hidden
from lab.laboratory import make_case
from linear_nulls import LEVEL, Nulls

from memsgyro_jax.measurement.case import load_case


pytestmark = pytest.mark.slow
DRAWS = 400


@pytest.mark.parametrize("name", DEVICES)
def test_noise_alone_alarms_as_often_as_stated(name, tmp_path):
    """Within three standard deviations of the level where the noise is declared; never more often where it is told by
    the rows.
    """
    device, rng = DEVICES[name], np.random.default_rng(12)
    made = make_case(tmp_path / "case", device.die, Hidden(), 0, device.protocol)
    nulls = Nulls.of(made, load_case(made.folder))
    draws, spread = [nulls.noise(rng) for _ in range(DRAWS)], 3 * np.sqrt(LEVEL * (1 - LEVEL) / DRAWS)
    declared = np.mean([nulls.decide(one).alarm for one in draws])
    estimated = np.mean([nulls.decide(one, nulls.estimated(one)).alarm for one in draws])
    assert LEVEL - spread <= declared <= LEVEL + spread
    assert estimated <= LEVEL + spread
