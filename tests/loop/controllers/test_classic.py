"""Classic control against the sampled periodic steady state, transfer functions and stability by linear algebra."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import classic

import memsgyro_jax as mg
from memsgyro_jax.loop.controllers.classic import locked_frequency


RATE = np.radians(100.0)
PERIOD = 5e-6
SPLIT = mg.SingleMassGyro.from_modes(
    1e-8, (10e3, 10.3e3), (2000.0, 300.0), quadrature=np.radians(200.0), cross_damping=0.01
)
MATCHED = mg.SingleMassGyro.from_modes(1e-8, (10e3, 10e3), (2000.0, 300.0), cross_damping=-0.02)
TWO_MASSES = mg.DualMassGyro.from_modes(3e-8, 2e-8, (9e3, 8.6e3), (900.0, 200.0), quadrature=0.5)
DISPLACEMENT = mg.ChargeAmplifier.chi2010(0.0)
VELOCITY = mg.DirectReadout.of_velocity((7.0, -5.0), 0.0)
LOOPS = {
    "open": (SPLIT, DISPLACEMENT, mg.ClassicControl.open_loop),
    "open, matched, of velocity": (MATCHED, VELOCITY, mg.ClassicControl.open_loop),
    "open, two masses": (TWO_MASSES, DISPLACEMENT, mg.ClassicControl.open_loop),
    "rebalanced": (SPLIT, DISPLACEMENT, mg.ClassicControl.force_rebalance),
    "rebalanced, matched, of velocity": (MATCHED, VELOCITY, mg.ClassicControl.force_rebalance),
    "rebalanced, two masses": (TWO_MASSES, DISPLACEMENT, mg.ClassicControl.force_rebalance),
}


def loop_of(gyro, readout, control):
    return mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), control, start=(0.0,) * 4)


def settled(loop, rate, duration=0.3):
    """Frequency, force, rate and quadrature at the end of a run from rest."""
    trace = mg.simulate(loop, rate, sample_rate=1.0 / PERIOD, duration=duration, decimation=round(duration / PERIOD))
    told = trace.readings
    return jnp.stack([told.frequency[-1], told.force[-1], trace.rate_estimate[-1], told.quadrature[-1]])


@pytest.mark.parametrize(
    "name", [name if n in (0, 4, 5) else pytest.param(name, marks=pytest.mark.slow) for n, name in enumerate(LOOPS)]
)
def test_the_steady_state_and_its_slope_are_those_of_linear_algebra(name):
    gyro, readout, make = LOOPS[name]
    control = make(gyro, readout, amplitude=1e-6)
    nulled = isinstance(control.sense, mg.ForceRebalance)
    value, slope = jax.jvp(lambda rate: settled(loop_of(gyro, readout, control), rate, 0.5), (RATE,), (1.0,))
    conversion = complex(*map(float, control.sense.conversion))
    near = float(locked_frequency(gyro, nulled=nulled)) / (2.0 * np.pi)

    def expected(rate):
        return np.array(classic.steady(gyro, rate, PERIOD, 1e-6, conversion, nulled, near, "velocity" in name))

    sizes = np.array([near, 1e-8, 1.0, 1.0])
    assert np.asarray(value) / sizes == pytest.approx(expected(RATE) / sizes, rel=1e-9, abs=1e-9)
    h = 4.0
    differences = [(expected(RATE + n * h) - expected(RATE - n * h)) / (2 * n * h) for n in (1, 2)]
    wanted = (4.0 * differences[0] - differences[1]) / 3.0
    assert np.asarray(slope) / sizes == pytest.approx(wanted / sizes, rel=1e-9, abs=1e-9)
