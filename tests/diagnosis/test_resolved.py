"""A law with a kink is predicted with as many harmonics and samples as it needs, a smooth one with the first few."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden, Outside
from lab.protocol import Laboratory

from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.effects import CubicStiffness, ForceEffect, on_axis, strength
from memsgyro_jax.measurement.steady import FINENESS


GAP, STIFF = 0.05, 0.5 * RESONATOR.kxx
QUIET = Laboratory(tuple(replace(sweep, noise=2e-5) for sweep in ONE_AXIS.experiments), digits=17)


class Contact(ForceEffect):
    """A stiff stop behind a known gap: a kink."""

    name, unit, law = "contact", "N/m", "F = −s·max(q − 0.05, 0)"
    axis: int = on_axis()
    strength: object = strength(sign=+1)

    def force(self, now):
        return self.along(now, -self.strength * jnp.maximum(now.displacement[self.axis] - GAP, 0.0))


@pytest.mark.slow  # so much is asked of a softer stop in `test_diagnose.py::test_a_user_s_own_effect_is_then_found`
def test_the_exact_law_with_a_kink_leaves_noise():
    """With three harmonics it left several times the noise."""
    hidden = Hidden(outside=Outside(stop_x=STIFF, stop_gap=GAP))
    touched = fit_case(bench(hidden, 1, QUIET, RESONATOR).case, [Contact("x")])
    assert {r.experiment.fineness for r in touched.joint.readings} <= set(FINENESS[1:])
    assert all(error.explained for error in touched.errors)
    (found,) = [e for e in touched.estimates if e.name == "contact x"]
    assert found.value == pytest.approx(STIFF, rel=1e-3)
    assert touched.apart == 0.0
    coarse = touched.joint.readings[0].experiment
    first = replace(coarse, fineness=FINENESS[0]).residual(touched.model)
    assert np.sqrt(np.mean(np.asarray(first) ** 2)) > 2.0


@pytest.mark.slow
def test_a_smooth_law_keeps_the_first_resolution():
    case = bench(Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx), 1, ONE_AXIS, RESONATOR).case
    fit = fit_case(case, [CubicStiffness("x")])
    assert {r.experiment.fineness for r in fit.joint.readings} == {FINENESS[0]}
    assert "resolved" not in fit.status
