"""What could stand in place of an effect without a first sign of it: an uneven spring softens as a cubic one does."""

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden

from memsgyro_jax.diagnosis.confusions import uneven_instead
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.next_experiment import JUMP, _beside_a_fall
from memsgyro_jax.diagnosis.optimum import optimise
from memsgyro_jax.diagnosis.search import CONFUSED
from memsgyro_jax.effects import CubicStiffness, QuadraticStiffness


@pytest.mark.slow
@pytest.mark.parametrize(("share", "softens"), [(-2.0, True), (2.0, False)])
def test_an_uneven_spring_explains_what_softens_and_nothing_that_hardens(share, softens):
    """A softening fork was "found: cubic_stiffness", though an uneven spring explained each of its sweeps as well."""
    case = bench(Hidden(cubic_stiffness_x=share * RESONATOR.kxx), 1, ONE_AXIS, RESONATOR).case
    fit = fit_case(case, [CubicStiffness("x")])
    joint = Joint(fit.model.with_effect(QuadraticStiffness("x")), fit.joint.readings)
    start = uneven_instead(joint, joint.start, 0, 1)
    assert uneven_instead(joint, joint.start, 1, 0) is None
    assert (start is not None) == softens
    if start is not None:
        (cubic,), (uneven,) = joint.of_effect(0), joint.of_effect(1)
        assert start[cubic] == 0.0
        places = np.array([i for i in range(start.size) if i not in joint.idle and i != cubic])
        instead = optimise(joint, start, places, joint.fitted)
        assert instead.chi2 < fit.optimum.chi2 + CONFUSED
        assert instead.vector[uneven] == pytest.approx(start[uneven], rel=0.05)


def test_rows_beside_a_fall_do_not_tell_two_models_apart():
    """Where a resonance falls from branch to branch, seven rows promised 10⁵ standard deviations."""
    off = np.full((40, 2), 0.3)
    off[7], off[8] = 1e9, 4.0 * JUMP
    assert np.flatnonzero(_beside_a_fall(off)).tolist() == [7, 8]
    assert not _beside_a_fall(np.full((40, 2), 1e5)).any()  # all rows tell: no fall
    assert not _beside_a_fall(np.where(np.arange(40)[:, None] < 20, 1e5, 0.1) * np.ones(2)).any()
