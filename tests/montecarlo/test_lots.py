"""What lots say of filters that are right, sure of what varies, or claim too little or nothing: figures, no bits."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.device.gyro import SINGLE_MASS, MotionModel
from memsgyro_jax.montecarlo.divergence import NO_OBSERVER, Divergence
from memsgyro_jax.montecarlo.status import DIVERGED


SHORT = {"sample_rate": 100e3, "duration": 0.002, "bound_dies": 0}
SPREAD = mg.Spread.relative(0.15)


@pytest.fixture(scope="module")
def loop() -> mg.ClosedLoop:
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    return mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)))


class Wrapped(mg.AbstractObserver):
    """Somebody's own observer, which gives an innovation but no full covariance."""

    inner: mg.ExtendedKalmanFilter
    model: MotionModel = eqx.field(static=True, default=SINGLE_MASS)

    def init(self):
        return self.inner.init()

    def update(self, state, measured, force, clock):
        return self.inner.update(state, measured, force, clock)

    def estimate(self, state):
        return self.inner.estimate(state)


def test_an_observer_from_outside_the_package_can_be_swept(loop):
    known = tuple(name for name in loop.device.model.names if name != "rate")  # a small filter compiles faster
    inner = mg.ExtendedKalmanFilter.for_device(loop.device, loop.readout, known=known, with_offsets=False)
    lot = mg.sweep(replace(loop, observer=Wrapped(inner)), SPREAD, dies=2, **SHORT)
    assert lot.summary.nis is not None
    assert lot.summary.nees is None
    assert "NEES unknown (the observer claims no covariance), NIS" in repr(lot)
    without = replace(lot.summary, divergence=Divergence(unjudged=NO_OBSERVER), convergence_time=0.0)
    assert not any(word in repr(without) for word in ("NEES", "diverged"))
    assert "not shown: the median die is within" in repr(without)


def test_filters_that_take_as_known_what_varies_are_diverged_and_told_so(loop, tmp_path):
    """What varies by 15 % makes the claims of a filter that is sure of it impossible, within travel or not."""
    sure = eqx.tree_at(lambda made: made.observer.prior, loop, mg.design_prior(loop.device, spread=0.0))
    lot = mg.sweep(sure, SPREAD, dies=40, chunk=8, out=tmp_path, **SHORT)
    assert lot.summary.divergence.dies == tuple(range(40))
    assert lot.summary.failed == 0
    (cause,) = lot.summary.divergence.causes
    assert cause.startswith("40 of them (0, 1, 2, 3, 4, ...) differ in what the filter takes as known exactly: kxx")
    assert np.all(mg.load(tmp_path)["status"].values == DIVERGED)
    assert np.isnan(lot.summary.sound.rms)
    assert np.isfinite(lot.summary.end.rms)
    text = repr(lot)
    assert "0 lost, 40 diverged" in text
    assert "none, as every die that is not lost diverged" in text
    assert "nan" not in text
    assert "NEES unknown (the claimed covariance is singular" in text


def test_dies_drawn_again_and_a_filter_that_claims_too_little_are_told(loop):
    narrow = eqx.tree_at(lambda made: made.observer.prior, loop, mg.design_prior(loop.device, spread=0.05))
    lot = mg.sweep(narrow, mg.Spread.relative(0.8), dies=40, chunk=8, **SHORT)
    again = int(np.sum(lot.to_xarray()["redrawn"].values > 0))
    assert lot.summary.redrawn == lot.summary.as_dict()["redrawn"] == again > 0
    assert f"{again} of 40 dies" in repr(lot)
    assert "the filter claims too little error" in repr(lot)
    right = mg.sweep(loop, SPREAD, dies=40, chunk=8, **SHORT)
    low, high = right.summary.nees_interval
    assert (low, high) == pytest.approx((11.96, 16.25), abs=0.3), "χ² of 14, mean over 40 dies"
    assert "drawn again" not in repr(right)
    assert "the filter claims" not in repr(right)


def test_a_singular_covariance_has_no_nees(loop):
    known = mg.design_prior(loop.device, motion_error=0.0)
    sure = eqx.tree_at(lambda made: made.observer.prior, loop, known)
    assert mg.sweep(sure, SPREAD, dies=40, chunk=8, **SHORT).summary.nees is None
