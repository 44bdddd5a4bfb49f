"""Loops sampled ever faster tend to the continuous equations of the thesis, integrated without the package."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import motion
from oracles.kalman import SINGLE, influence
from scipy.integrate import solve_ivp

import memsgyro_jax as mg
from memsgyro_jax.loop.observers import Clock
from memsgyro_jax.loop.scenario import as_scenario


GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.DirectReadout((-6.0, 5.0), (0.01, -0.02), signals=(2, 3))
W, LENGTH, FREQUENCY, AMPLITUDE = 2 * np.pi * 3000.0, 1e-6, np.array([3000.0, 5000.0]), np.array([1e-6, 0.5e-6])
START, DURATION, RATE = (1e-6, 0.4e-6, 0.0, 0.001), 4e-4, 1.0
OMEGA = 2 * np.pi * FREQUENCY
DESIGN = np.array(GYRO.coefficients(0.0))
UNITS = np.array([W, *3 * [W**2], *3 * [W], DESIGN[-1]])
PLANT = motion.single_mass(
    *(float(getattr(GYRO, n)) for n in ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy")), frame=motion.Frame(wz=RATE)
)
GAIN, ENERGY_GAIN, TONE = 5.0, 4000.0, (600.0, 50.0)


def without_units(q, v, u):
    """Acceleration without units per unit of each coefficient: the transposed L2 of (4.11)."""
    return influence(SINGLE, [*q / LENGTH, *v / (LENGTH * W), *u * DESIGN[-1] / (LENGTH * W**2)])


def energy(q, v):
    return 0.5 * np.sum(v**2 + (OMEGA * q) ** 2)


def cancelled(theta, q, v):
    """What of the estimated acceleration no force makes."""
    return -influence(SINGLE, [*q, *v, 0.0, 0.0]) @ theta


class Observed:
    """Lyapunov observer and a law of the estimate; `state` is the plant's motion, the estimated one, coefficients."""

    def __init__(self, law, level=None):
        self.law, self.level = law, level
        self.start = np.concatenate([START, START, DESIGN * np.array([1.0, *6 * [0.9], 1.0])])

    def derivative(self, time, state):
        q, v, theta = state[4:6], state[6:8], state[8:]
        u = self.law(time, theta, q, v)
        error = (state[2:4] - v) / (LENGTH * W)
        driving = error
        if self.level is not None:
            driving = error + (energy(q, state[2:4]) - self.level) / (LENGTH * W) ** 2 * v / (LENGTH * W)
        push = influence(SINGLE, [*q, *v, *u]) @ theta + GAIN * error * LENGTH * W**2
        moving = W * UNITS * (without_units(q, v, u).T @ driving)
        return np.concatenate([PLANT[0] @ state[:4] + PLANT[1] @ u, v, push, moving[:-1], [0.0]])


def compensation(time, theta, q, v):
    rates = np.array([[theta[4], theta[6]], [theta[6], theta[5]]]) @ v
    return (rates + TONE[1] * np.sin(2 * np.pi * TONE[0] * time)) / theta[-1]


def reference(time, theta, q, v):
    return (cancelled(theta, q, v) - OMEGA**2 * q) / theta[-1]


def kept(time, theta, q, v):
    missing = 1.0 - energy(q, v) / energy(AMPLITUDE, np.zeros(2))
    return reference(time, theta, q, v) + ENERGY_GAIN * missing * v / theta[-1]


class Sliding:
    """`state` is the plant's motion, the integrated error of the displacement, coefficients."""

    layer, forgetting = 0.3, 0.25
    start = np.concatenate([START, [0.0, 0.0], DESIGN * np.array([1.0, *6 * [0.9], 1.0])])

    def derivative(self, time, state):
        v, e, theta = state[2:4], state[4:6], state[6:]
        turn = OMEGA * time
        r, rv, ra = AMPLITUDE * np.cos(turn), -AMPLITUDE * OMEGA * np.sin(turn), -AMPLITUDE * OMEGA**2 * np.cos(turn)
        slip, q = v - rv, r + e
        s = (slip + W * e) / (LENGTH * W)
        wanted = ra - W * slip - LENGTH * W**2 * np.clip(s / self.layer, -1.0, 1.0)
        u = (wanted + cancelled(theta, q, v)) / theta[-1]
        moving = W * UNITS * (without_units(q, v, u).T @ s)
        plant = PLANT[0] @ state[:4] + PLANT[1] @ u
        return np.concatenate([plant, slip - self.forgetting * W * e, moving[:-1], [0.0]])


def observer():
    return mg.LyapunovObserver.for_device(GYRO, READOUT, gain=GAIN, known=("sigma",), start=0.9, motion=START)


def closed(observer, controller):
    return mg.ClosedLoop(GYRO, READOUT, observer, controller, START).sampled_at(4e6)


REFERENCE = mg.ReferenceModel(tuple(FREQUENCY))
PAIRS = {
    "damping compensation": (
        Observed(compensation),
        lambda: closed(observer(), mg.DampingCompensation(mg.Tone(*TONE))),
    ),
    "reference model": (Observed(reference), lambda: closed(observer(), REFERENCE)),
    "energy": (
        Observed(kept, energy(AMPLITUDE, np.zeros(2))),
        lambda: closed(
            mg.EnergyObserver(observer(), tuple(FREQUENCY), tuple(AMPLITUDE)),
            mg.EnergyControl(REFERENCE, tuple(FREQUENCY), tuple(AMPLITUDE), ENERGY_GAIN),
        ),
    ),
    "sliding mode": (
        Sliding(),
        lambda: closed(
            mg.NoObserver.for_device(GYRO, READOUT),
            mg.SlidingMode.for_device(
                GYRO, READOUT, tuple(mg.Tone(f, a, np.pi / 2) for f, a in zip(FREQUENCY, AMPLITUDE, strict=True)),
                layer=Sliding.layer, known=("sigma",), start=0.9,
            ),
        ),
    ),
}  # fmt: skip
SLOW = ("damping compensation", "reference model")


@eqx.filter_jit
def sampled(loop, period, count):
    """True motion and coefficients after `count` samples; a loop of any length is one program."""

    def sample(i, state):
        clock = Clock(i * period, i, period)
        return loop.step(state, as_scenario(RATE).at(clock.time), (0.0, 0.0), clock)[0]

    start = jax.tree.map(lambda v: jnp.asarray(v, float), loop.init())
    state = jax.lax.fori_loop(0, count, sample, start)
    return jnp.stack([*state.motion, *loop.estimate(state).theta])


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in PAIRS])
def test_tends_to_the_continuous_equations_in_the_first_order(name):
    oracle, made = PAIRS[name]
    scales = np.array([LENGTH, LENGTH, LENGTH * W, LENGTH * W, *UNITS])
    size = np.concatenate(
        [scales[:4], oracle.start[4:-8] * 0.0 + np.tile(scales[:4], 2)[: len(oracle.start) - 12], UNITS]
    )
    done = solve_ivp(
        lambda t, y: oracle.derivative(t, y * size) / size, (0.0, DURATION), oracle.start / size, method="DOP853",
        rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    ends = np.concatenate([done.y[:4, -1], done.y[-8:, -1]])
    moved = np.linalg.norm(done.y[-8:, -1] - done.y[-8:, 0])
    loop = made()
    errors = [
        np.linalg.norm(sampled(loop, 1.0 / rate, jnp.asarray(round(DURATION * rate))) / scales - ends)
        for rate in (1e6, 2e6, 4e6)
    ]
    assert errors[2] < 0.02 * moved
    assert errors[0] / errors[1] > 1.8
    assert errors[1] / errors[2] > 1.8
