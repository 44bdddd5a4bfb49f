"""The sampled observer equals its NumPy twin, tends to the continuous (4.11), and makes the Lyapunov function fall."""

import numpy as np
import pytest
from harness import observe
from oracles import kalman, motion
from oracles.lyapunov import Lyapunov, energy
from scipy.integrate import solve_ivp

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DualMassGyro, SingleMassGyro
from memsgyro_jax.loop.observers import LyapunovObserver
from memsgyro_jax.loop.readout import ChargeAmplifier, DirectReadout


SINGLE, DUAL = SingleMassGyro.chi2010(), DualMassGyro.chi2010()
NAMES = ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy")
READOUT = DirectReadout(scale=(-6.0, 5.0), offset=(0.01, -0.02), signals=(2, 3))
LENGTH, W = 1e-6, 2 * np.pi * 3000.0
FORCE = (6e-6, -9e-6)


def twin(observer):
    """The oracle told what `observer` was told; units as the docstring has them."""
    theta = np.array(observer.theta)
    table = kalman.DUAL if observer.model == DUAL.model else kalman.SINGLE
    design = np.array((DUAL if table is kalman.DUAL else SINGLE).coefficients(0.0))
    signal = [terms[0][1] for terms in table]
    units = np.array([d if s >= 4 else W if s >= 2 else W**2 for d, s in zip(design, signal, strict=True)])
    return Lyapunov(table, observer.motion, theta, observer.gain, observer.adaptation, units, LENGTH, W)


def truth(rate, count, start=(1e-6, 0.0, 0.0, 0.0)):
    """Motion of the single-mass design turning at 1 rad/s under a constant force."""
    system = motion.single_mass(*(float(getattr(SINGLE, n)) for n in NAMES), frame=motion.Frame(wz=1.0))
    return motion.trajectory(system, start, [FORCE] * count, 1.0 / rate)


def volts_of(states):
    return np.array(READOUT.scale) * states[:, 2:] + np.array(READOUT.offset)


@pytest.mark.parametrize(
    ("device", "options"),
    [
        (SINGLE, {}),
        pytest.param(SINGLE, {"known": ("sigma",), "gain": (12.0, 40.0)}, marks=pytest.mark.slow),
        pytest.param(DUAL, {"start": 0.9, "gain": 20.0}, marks=pytest.mark.slow),
    ],
    ids=["mass unknown", "mass known", "dual mass"],
)
def test_equals_its_twin(device, options):
    observer = LyapunovObserver.for_device(device, READOUT, **{"start": 0.8, **options})
    rng, rate = np.random.default_rng(1), 1e6
    force = 1e-5 * rng.standard_normal((800, 2))
    system = motion.single_mass(*(float(getattr(SINGLE, n)) for n in NAMES), frame=motion.Frame(wz=1.0))
    states = motion.trajectory(system, [1e-6, 0, 0, 0], force, 1 / rate)
    volts = volts_of(states) + 1e-4 * rng.standard_normal((800, 2))
    got, oracle = observe(observer, volts, force, 1 / rate), twin(observer)
    velocity = (volts - np.array(READOUT.offset)) / np.array(READOUT.scale)
    for i in range(800):
        oracle.step(velocity[i], force[i], 1 / rate)
        now = np.array([m[i] for m in got.motion])
        assert np.all(np.abs(now - oracle.motion) < 1e-11 * np.array([1, 1, W, W]) * LENGTH)
        theta = np.array([t[i] for t in got.theta])
        assert np.all(np.abs(theta - oracle.theta) < 1e-11 * oracle.units)
    if "known" in options:
        assert theta[-1] == np.array(SINGLE.coefficients(0.0))[-1]


@pytest.fixture(scope="module")
def sampled():
    """Errors at 0.4 ms of the sampled observer against the continuous equations, at three sample rates, scaled."""
    observer = LyapunovObserver.for_device(SINGLE, READOUT, start=0.9, gain=5.0)
    oracle, duration = twin(observer), 4e-4
    a, b, _ = motion.single_mass(*(float(getattr(SINGLE, n)) for n in NAMES), frame=motion.Frame(wz=1.0))
    scales = np.concatenate([[1e-6, 1e-6, 1e-6 * W, 1e-6 * W], [1e-6, 1e-6, 1e-6 * W, 1e-6 * W], oracle.units])

    def together(_, state):
        plant, seen, theta = np.split(state * scales, [4, 8])
        moved = oracle.derivative(seen, theta, np.array(FORCE), plant[2:])
        return np.concatenate([a @ plant + b @ FORCE, *moved]) / scales

    start = np.concatenate([[1e-6, 0, 0, 0], oracle.motion, oracle.theta]) / scales
    done = solve_ivp(together, (0, duration), start, method="DOP853", rtol=1e-11, atol=1e-13)
    errors = []
    for rate in (1e6, 2e6, 4e6):
        count = round(duration * rate)
        got = observe(observer, volts_of(truth(rate, count)), np.array([FORCE] * count), 1 / rate)
        end = np.array([part[-1] for part in (*got.motion, *got.theta)])
        errors.append(np.abs(end / scales[4:] - done.y[4:, -1]))
    return np.array(errors), np.abs(done.y[4:, -1] - start[4:])


def test_tends_to_the_continuous_observer(sampled):
    errors, moved = sampled
    norms = np.linalg.norm(errors, axis=1)
    assert norms[2] < 0.01 * np.linalg.norm(moved)
    assert norms[0] / norms[1] == pytest.approx(2.0, rel=0.1)
    assert norms[1] / norms[2] == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
def test_lyapunov_function_falls_by_what_the_damping_takes():
    """V̇ = -e₂ᵀ(D + L)e₂ without noise (thesis (4.33), with V as a symmetric form): never rising, and accounted for."""
    observer = LyapunovObserver.for_device(SINGLE, READOUT, start=0.85, gain=2.0, motion=(0.9e-6, 0.1e-6, 0.0, 0.0))
    rate, count = 4e6, 8000
    states, oracle = truth(rate, count), twin(observer)
    got = observe(observer, volts_of(states), np.array([FORCE] * count), 1 / rate)
    design = np.array(SINGLE.coefficients(1.0))
    motions, thetas = np.stack(got.motion, axis=1), np.stack(got.theta, axis=1)
    k = np.array([[design[1], design[3]], [design[3], design[2]]])
    v = np.array(
        [energy(k, s - m, design - t, oracle.units, LENGTH, W) for s, m, t in zip(states, motions, thetas, strict=True)]
    )
    e2 = (states[:, 2:] - motions[:, 2:]) / (LENGTH * W)
    damping = np.array([[design[4], design[6]], [design[6], design[5]]]) / W + np.diag(np.array(observer.gain))
    taken = np.cumsum(np.einsum("ti,ij,tj->t", e2, damping, e2)) * W / rate
    assert v[-1] < 0.9 * v[0]
    assert np.max(np.diff(v)) < 1e-5 * v[0]
    assert np.max(np.abs(v[0] - v - (taken - taken[0]))) < 0.01 * (v[0] - v[-1])


def test_starts_where_it_is_told():
    observer = LyapunovObserver.for_device(SINGLE, READOUT, start=0.8, known=("sigma", "kxy"))
    ratio = np.array(observer.init().theta)[1:] / np.array(SINGLE.coefficients(0.0))[1:]
    assert np.allclose(ratio, [0.8, 0.8, 1.0, 0.8, 0.8, 0.8, 1.0], rtol=1e-15)
    estimate = observer.estimate(observer.init())
    assert estimate.rate == 0.0
    assert estimate.rate_variance is None
    assert [float(o) for o in estimate.offset] == [0.01, -0.02]


def test_a_displacement_read_out_is_refused():
    with pytest.raises(InputError, match=r"needs a velocity read-out; use `DirectReadout.of_velocity`"):
        LyapunovObserver.for_device(SINGLE, ChargeAmplifier.chi2010())


@pytest.mark.parametrize("change", [{"gain": 0.0}, {"gain": (1.0, -2.0)}, {"length": 0.0}, {"frequency": -1.0}])
def test_impossible_gains_and_units_are_refused(change):
    with pytest.raises(InputError, match=f"`{next(iter(change))}` must be positive and finite"):
        LyapunovObserver.for_device(SINGLE, READOUT, **change)
