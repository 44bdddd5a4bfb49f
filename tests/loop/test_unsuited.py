"""Parts of a loop that do not go together, and parts of a user's own of another shape: one sentence each."""

import dataclasses
import logging

import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.loop.unsuited import unsuited


GYRO = mg.SingleMassGyro.from_modes("1 mg", ("5 kHz", "5.2 kHz"), (500, 700), quadrature="10 deg/s")
READOUT = mg.DirectReadout(1e5, noise_density=1e-7)
KALMAN = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT)
IDLE = mg.NoObserver.for_device(GYRO, READOUT)
CLASSIC = mg.ClassicControl.open_loop(GYRO, READOUT, amplitude="2 um")
RUN = {"sample_rate": 140e3, "duration": 1e-3}


class ThreeForces(mg.AbstractController):
    def init(self):
        return ()

    def command(self, state, estimate, clock):
        return jnp.zeros(3), state


class OnlyForces(ThreeForces):
    def command(self, state, estimate, clock):
        return 0.0, 0.0, 0.0


class SaysNothing(mg.AbstractObserver):
    model = mg.SingleMassGyro.model

    def init(self):
        return ()

    def update(self, state, measured, force, clock):
        return state

    def estimate(self, state):
        return None


def loop_of(observer=IDLE, controller=CLASSIC, readout=READOUT, **others):
    return mg.ClosedLoop(GYRO, readout, observer, controller, start=(0.0,) * 4, **others)


@pytest.mark.parametrize(
    ("observer", "controller", "words"),
    [
        (KALMAN, ThreeForces(), r"`command` of ThreeForces must return .* its force is of 3 numbers"),
        (KALMAN, OnlyForces(), r"`command` of OnlyForces must return .* returns .* tuple of 3 entries"),
        (SaysNothing(), mg.DampingCompensation(), r"`estimate` of SaysNothing must return .* but returns None"),
    ],
)
def test_own_parts_of_another_shape_are_named(observer, controller, words):
    with pytest.raises(mg.InputError, match=words):
        mg.simulate(loop_of(observer, controller), **RUN)


@pytest.mark.parametrize("rates", [np.ones(10), [0.0, 1.0]])
def test_a_rate_over_time_as_an_array_is_sent_to_a_record(rates):
    for ask in (
        lambda: mg.simulate(loop_of(), rates, **RUN),
        lambda: mg.sweep(loop_of(), mg.Spread.relative(0.01), rates, dies=2, **RUN),
    ):
        with pytest.raises(mg.InputError, match=r"`scenario` must be .* of \d+ numbers; .* `mg.Recorded"):
            ask()


def test_a_share_is_no_spread():
    for ask in (mg.sweep, mg.tornado, mg.corners, mg.sobol, mg.datasheet):
        with pytest.raises(mg.InputError, match=r"`spread` must be a `Spread`, .* is 0.1 of type float"):
            ask(loop_of(), 0.1)


def test_what_measures_beside_another_and_what_measures_nothing_is_told(caplog):
    (beside,) = unsuited(loop_of(KALMAN))
    assert "ClassicControl, which measures by itself: ExtendedKalmanFilter beside it" in beside
    (nothing,) = unsuited(loop_of(IDLE, mg.Saturated(mg.DampingCompensation(), (1e-6, 1e-6))))
    assert "zero whatever turns the device: NoObserver learns nothing, and DampingCompensation" in nothing
    assert unsuited(loop_of()) == unsuited(loop_of(KALMAN, mg.DampingCompensation())) == ()
    with caplog.at_level(logging.WARNING):
        mg.simulate(loop_of(IDLE, mg.DampingCompensation()), **RUN)
    assert nothing in caplog.text


def test_a_swing_beyond_the_converter_or_the_travel_is_told():
    small = dataclasses.replace(READOUT, adc=mg.Adc("0.15 V", 16))
    (said,) = unsuited(loop_of(readout=small))
    assert "reaches 0.2 V at the read-out, but the converter clips at 0.15 V" in said
    assert unsuited(loop_of(readout=dataclasses.replace(READOUT, adc=mg.Adc("0.25 V", 16)))) == ()
    velocity = mg.DirectReadout.of_velocity(1.0, 0.0)
    fast = mg.ClassicControl.open_loop(GYRO, velocity, amplitude="2 um")
    seen = dataclasses.replace(velocity, adc=mg.Adc("0.05 V", 16))
    made = mg.ClosedLoop(GYRO, seen, mg.NoObserver.for_device(GYRO, seen), fast, start=(0.0,) * 4)
    assert "reaches 0.0628 V" in unsuited(made)[0]
    with pytest.raises(mg.InputError, match=r"`amplitude` .* below the loop's travel of 1 µm, .* is 2 µm"):
        loop_of(travel=1e-6)


def test_a_lot_says_what_its_dies_were_lost_by():
    lot = mg.sweep(loop_of(travel=2.1e-6), mg.Spread.relative(0.01), 50.0, dies=2, sample_rate=140e3, duration=0.05)
    assert lot.summary.failed == 2
    assert "ms: beyond 2.1 µm (`travel`), or not finite" in str(lot)


def test_numbers_that_cannot_be_meant_are_refused():
    for bits in (12.5, True):
        with pytest.raises(mg.InputError, match="`bits` of the converter must be a whole number"):
            mg.Adc(1.0, bits)
    both = tuple(mg.Vary(f"device.{name}", mg.Normal(relative=0.01)) for name in ("kxx", "kyy"))
    for matrix, words in ((((1.0, 2.0), (2.0, 1.0)), "no negative eigenvalue"), (((1.0, 0.5),), "square")):
        with pytest.raises(mg.InputError, match=words):
            mg.Spread(both, correlation=matrix)
    for made in (lambda: mg.Constant(np.inf), lambda: mg.Step(0.1, -np.inf), lambda: mg.Sine(np.inf, 10.0)):
        with pytest.raises(mg.InputError, match="must be finite, but is infinite"):
            made()
    assert np.isinf(mg.Step(np.inf, 1.0).at)
