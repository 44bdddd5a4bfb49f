"""A linear device whose channels have unequal white noise, which no file declares, lacks nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import memsgyro_jax
from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.measurement.case import load_case


def two_sweeps(noise, seed):
    """Both sweeps of the demonstration as a linear device would answer, read with noise (2,) that is not declared."""
    case, rng = load_case(Path(memsgyro_jax.__file__).parent / "demo"), np.random.default_rng(seed)
    stiffness = np.diag((2 * np.pi * np.array([3027.6, 3158.3])) ** 2)
    stiffness[0, 1] = stiffness[1, 0] = 2e5
    damping = np.diag(2 * np.pi * np.array([3027.6 / 950, 3158.3 / 845]))
    records, gain = [], 0.0
    for record in (case.record("sweep_x"), case.record("sweep_y")):
        omega = record.frequency[:, None, None]
        dynamic = stiffness - omega**2 * np.eye(2) + 1j * omega * damping
        force = np.eye(2)[record.axis][:, None] * record.drive[:, None, None]
        motion = np.linalg.solve(dynamic, force)[..., 0]
        gain = gain or np.max(np.abs(record.phasors)) / np.max(np.abs(motion))
        white = rng.standard_normal((2, *motion.shape))
        records.append(replace(record, phasors=gain * motion + noise * (white[0] + 1j * white[1]), noise_std=None))
    return replace(case, records=tuple(records))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [(15e-5, 1e-5), (1e-4, 1e-4)])
def test_nothing_is_missing(noise):
    outcome = diagnose(None, two_sweeps(np.array(noise), 4))
    assert outcome.verdict == "nothing_missing"
    assert 0.8 < outcome.base.chi2_per_dof < 1.25
    levels = outcome.to_dict()["base"]["per_experiment"][0]["noise_std"]
    assert [levels["x"], levels["y"]] == pytest.approx(noise, rel=0.25)
