"""What could stand in place of an effect without a first sign of it: an uneven spring softens as a cubic one does."""

from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden

from memsgyro_jax.diagnosis.confusions import confusions, uneven_instead
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.next_experiment import JUMP, _beside_a_fall
from memsgyro_jax.diagnosis.optimum import optimise
from memsgyro_jax.diagnosis.score import score
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


@pytest.mark.parametrize(("sign", "fits"), [(1.0, 1), (-1.0, 0)])
def test_an_effect_that_would_need_an_impossible_sign_is_not_fitted(sign, fits):
    """A softening spring of the electrodes in place of a hardening one: programs of its own, two fits, kept at zero."""
    slope, asked = np.array([[3.0], [4.0], [0.0]]) * 10.0, []
    joint = SimpleNamespace(
        model=SimpleNamespace(effects=(CubicStiffness("x"), CubicStiffness("y"))),
        bounds=(np.zeros(2), np.full(2, np.inf)),
        of_effect=lambda place: np.array([place]),
    )
    residual, beside = np.array([0.0, 0.0, 1.0]), np.zeros((3, 0))
    search = SimpleNamespace(
        joint=joint,
        accepted=[0],
        optimum=SimpleNamespace(vector=np.array([1.0, 0.0]), residual=residual, chi2=1.0),
        own_score=lambda place: score(-slope[:, 0], beside, slope),
        jacobian_without=lambda place: beside,
        taken_by=lambda place: -slope[:, 0],
        without=lambda place: np.zeros(2),
        refit=lambda places, start, beat: asked.append((places, start.tolist())) or SimpleNamespace(chi2=1.0),
    )
    out = confusions(search, SimpleNamespace(places=(1,), slopes=(sign * slope,)))
    assert asked == [([1], [0.0, 1.0])] * fits
    assert list(out[0]) == [1] * fits


def test_rows_beside_a_fall_do_not_tell_two_models_apart():
    """Where a resonance falls from branch to branch, seven rows promised 10⁵ standard deviations."""
    off = np.full((40, 2), 0.3)
    off[7], off[8] = 1e9, 4.0 * JUMP
    assert np.flatnonzero(_beside_a_fall(off)).tolist() == [7, 8]
    assert not _beside_a_fall(np.full((40, 2), 1e5)).any()  # all rows tell: no fall
    assert not _beside_a_fall(np.where(np.arange(40)[:, None] < 20, 1e5, 0.1) * np.ones(2)).any()
