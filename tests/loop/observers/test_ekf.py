"""The block-structured filter equals the textbook's dense one, in double precision and in 50 digits."""

import jax
import mpmath
import numpy as np
import pytest
from harness import observe
from oracles import kalman, motion

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DualMassGyro, SingleMassGyro
from memsgyro_jax.device.propagate import Exact, ForwardEuler
from memsgyro_jax.effects import PickoffNonlinearity
from memsgyro_jax.loop.controllers import DampingCompensation, Tone
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import Clock, ExtendedKalmanFilter
from memsgyro_jax.loop.observers.fading import AdaptiveFading, FixedFading
from memsgyro_jax.loop.observers.settings import Annealing, Prior, ProcessNoise
from memsgyro_jax.loop.readout import ChargeAmplifier, DirectReadout
from memsgyro_jax.loop.trace import simulate


SINGLE, DUAL = SingleMassGyro.chi2010(), DualMassGyro.chi2010()
CIRCUIT, VELOCITY = ChargeAmplifier.chi2010(), DirectReadout.of_velocity(-6.0, 3e-7)
WALK = ProcessNoise((1e-18, 2e-18, 1e-8, 3e-8), (1e-6, 2e-6), (4.0, *(1e-4 * k for k in SINGLE.coefficients(0.0)[1:])))
NAMES = ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy")
GAUSS2 = ((0.5 - 0.5 / 3**0.5, 0.5), (0.5 + 0.5 / 3**0.5, 0.5))

# name: device, read-out, sample rate, what `for_device` is told, what the oracle is told beyond what it reads off
FEW = {"known": ("kxy", "dxx", "dyy", "dxy", "sigma")}  # nine states compile in half the time of fourteen
VARIANTS = {
    "14 states": (SINGLE, CIRCUIT, 100e3, {}, {}),
    "16 states": (DUAL, CIRCUIT, 100e3, {}, {}),
    "mass known": (SINGLE, CIRCUIT, 100e3, {"known": ("sigma",)}, {}),
    "ideal circuit": (SINGLE, DirectReadout(-1e5, noise_density=4.5e-7), 100e3, {"with_offsets": False}, {}),
    "mass known, ideal circuit": (
        DUAL, DirectReadout(-1e5, noise_density=4.5e-7), 100e3,
        {"known": ("sigma_x", "sigma_y"), "with_offsets": False}, {},
    ),
    "velocity": (SINGLE, VELOCITY, 100e3, FEW, {}),
    "process noise": (SINGLE, CIRCUIT, 100e3, FEW | {"process_noise": WALK}, {}),
    "fixed fading": (
        SINGLE, CIRCUIT, 100e3, FEW | {"fading": FixedFading(500.0)}, {"fading": lambda *_: np.exp(500.0 / 1e5)},
    ),
    "adaptive fading": (
        SINGLE, CIRCUIT, 100e3, {"fading": AdaptiveFading(5e-4, 1.05)}, {"fading": kalman.Xia(5e-4, 1.05, 1e-5)},
    ),
    "annealing": (
        SINGLE, CIRCUIT, 100e3, FEW | {"annealing": Annealing(1000.0, 5e-4)},
        {"annealing": lambda time: 1 + 1000 * np.exp(-time / 5e-4)},
    ),
    "two nodes": (SINGLE, CIRCUIT, 20e3, FEW | {"discretisation": Exact(24, 2)}, {"gauss": GAUSS2}),
    "forward Euler": (SINGLE, CIRCUIT, 2e6, FEW | {"discretisation": ForwardEuler()}, {"euler": True}),
    "curved pick-off": (
        SINGLE, CIRCUIT, 100e3, FEW | {"pickoff": (PickoffNonlinearity("x", 1e5), PickoffNonlinearity("y", -4e4))},
        {"curve": (1e5, -4e4)},
    ),
    "iterated": (SINGLE, CIRCUIT, 100e3, FEW | {"iterations": 2}, {"iterations": 2}),
    "all at once": (
        DUAL, CIRCUIT, 50e3,
        {
            "known": ("kyx",), "iterations": 2, "fading": FixedFading(200.0), "annealing": Annealing(30.0, 1e-3),
            "process_noise": ProcessNoise.of(DUAL.model, rate=5.0, rate_x=2.0), "discretisation": Exact(20, 2),
        },
        {
            "gauss": GAUSS2, "iterations": 2, "fading": lambda *_: np.exp(200.0 / 5e4),
            "annealing": lambda time: 1 + 30 * np.exp(-time / 1e-3),
        },
    ),
}  # fmt: skip


def recorded(device, readout, rate, count, seed=0):
    """Volts and forces of a die 5 % off the design, made without the package's own propagator and read-out."""
    rng, h = np.random.default_rng(seed), 1.0 / rate
    names = "mx my kxx kyy kxy kyx dxx dyy" if device.model == DUAL.model else "m kxx kyy kxy dxx dyy dxy"
    fields = {"m": "mass", "mx": "mass_x", "my": "mass_y"}
    values = {n: float(getattr(device, fields.get(n, n))) * (1 + 0.05 * rng.standard_normal()) for n in names.split()}
    make = motion.dual_mass if "mx" in values else motion.single_mass
    time = (np.arange(count) + 0.5) * h
    force = 9.7e-6 * np.stack([np.sin(2 * np.pi * 600 * time), np.cos(2 * np.pi * 730 * time)], axis=1)
    system = make(**values, frame=motion.Frame(wz=1.0))
    states = motion.trajectory(system, [1.02e-6, 0.03e-6, 2e-4, -3e-4], force, h)
    scale, density = np.array(readout.scale), np.array(readout.noise_density)
    volts = scale * states[:, list(readout.signals)] + np.array(readout.offset)
    return volts + density * np.sqrt(rate / 2) * rng.standard_normal((count, 2)), force


def dense(observer, rate, number=float, **extra):
    """The oracle told what `observer` was told, in numbers of kind `number`."""

    def of(values):
        return np.array([number(float(v)) for v in values], dtype=float if number is float else object)

    estimated = [i in observer.estimated for i in range(len(observer.model.names))]
    free = of([1] * 4 + [observer.with_offsets] * 2 + estimated)
    prior, noise = observer.prior, observer.process_noise
    std = of([*prior.motion_std, *prior.offset_std, *prior.theta_std]) * free
    return kalman.Kalman(
        table=kalman.DUAL if observer.model == DUAL.model else kalman.SINGLE,
        mean=of([*prior.motion, *prior.offset, *prior.theta]),
        covariance=np.diag(std**2),
        scale=of(observer.scale),
        signals=observer.signals,
        density=of(observer.noise_density),
        h=number(1.0 / rate),
        walk=of([*noise.motion, *noise.offset, *noise.theta]) * free,
        **extra,
    )


def states_of(observer, states):
    """Means and covariances over time as (time, states[, states]), in the order of `observer.covariance`."""
    means = np.concatenate([np.stack(states.motion, axis=1), states.constants], axis=1)
    return means, np.asarray(jax.vmap(observer.covariance)(states))


def carried(observer):
    """Places of the observer's states among the oracle's."""
    offsets = [4, 5] if observer.with_offsets else []
    return [0, 1, 2, 3, *offsets, *(6 + i for i in observer.estimated)]


def disagreement(oracle, places, mean, covariance):
    """Largest difference of the means in standard deviations, and of the covariances likewise."""
    exact = oracle.covariance[np.ix_(places, places)].astype(float)
    std = np.sqrt(np.diag(exact))
    mean_error = (mean - oracle.mean[places]).astype(float) / std
    return np.max(np.abs(mean_error)), np.max(np.abs((covariance - exact) / np.outer(std, std)))


# Their parts stand alone beside them, or another of their kind does.
LONG = (
    "mass known",
    "mass known, ideal circuit",
    "all at once",
    "two nodes",
    "adaptive fading",
    "fixed fading",
    "iterated",
    "16 states",
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in VARIANTS]
)
def test_equals_the_dense_filter(name):
    device, readout, rate, options, extra = VARIANTS[name]
    observer = ExtendedKalmanFilter.for_device(device, readout, **options)
    volts, force = recorded(device, readout, rate, 1500)
    states = observe(observer, volts, force, 1.0 / rate)
    means, covariances = states_of(observer, states)
    assert_sound(covariances)
    claimed = np.asarray(states.nis)
    oracle, places, worst, factors = dense(observer, rate, terms=26, **extra), carried(observer), np.zeros(3), []
    for i, (z, u) in enumerate(zip(volts[:600], force[:600], strict=True)):
        oracle.step(z, u, (i + 1) / rate)
        nis = abs(oracle.nis - claimed[i]) / (1.0 + oracle.nis)
        worst = np.maximum(worst, [*disagreement(oracle, places, means[i], covariances[i]), nis])
        factors.append(oracle.factor)
    assert np.all(worst < 1e-7)
    if name == "adaptive fading":
        assert np.unique(factors).size > 10, "the record must exercise the law between its limits"
        assert {1.0, 1.05} <= set(factors), "and at both limits"


def assert_sound(covariances):
    """Symmetric to the last bit and positive definite, at every sample."""
    assert np.array_equal(covariances, np.swapaxes(covariances, 1, 2))
    std = np.sqrt(np.einsum("tii->ti", covariances))
    smallest = np.linalg.eigvalsh(covariances / (std[:, :, None] * std[:, None, :]))[:, 0]
    assert np.all(smallest > 0.0)


@pytest.mark.slow
def test_long_fading_keeps_the_covariance_sound():
    """The memory of thesis 5.3, 0.7 ms, for 100 ms: rounding must not gain on what is forgotten."""
    observer = ExtendedKalmanFilter.for_device(SINGLE, CIRCUIT, fading=FixedFading(1400.0))
    volts, force = recorded(SINGLE, CIRCUIT, 100e3, 10_000)
    means, covariances = states_of(observer, observe(observer, volts, force, 1e-5))
    assert_sound(covariances[::50])
    assert np.all(covariances[3000:, 6, 6] < 10.0**2)
    assert np.all(np.abs(means[3000:, 6] - 1.0) < 6 * np.sqrt(covariances[3000:, 6, 6]))


def in_fifty_digits(name, count):
    """Largest disagreement with the 50-digit filter over `count` samples."""
    device, readout, rate, options, extra = VARIANTS[name]
    observer = ExtendedKalmanFilter.for_device(device, readout, **options)
    volts, force = recorded(device, readout, rate, 1500)
    means, covariances = states_of(observer, observe(observer, volts, force, 1.0 / rate))
    with mpmath.workdps(50):
        if "gauss" in extra:
            root = 1 / (2 * mpmath.sqrt(3))
            extra = extra | {"gauss": tuple((mpmath.mpf(1) / 2 + s * root, mpmath.mpf(1) / 2) for s in (-1, 1))}
        else:
            extra = extra | {"gauss": ((mpmath.mpf(1) / 2, mpmath.mpf(1)),)}
        oracle, places, worst = dense(observer, rate, mpmath.mpf, terms=28, **extra), carried(observer), np.zeros(2)
        for i in range(count):
            z, u = ([mpmath.mpf(v) for v in row] for row in (volts[i], force[i]))
            oracle.step(z, u, (i + 1) / rate)
            worst = np.maximum(worst, disagreement(oracle, places, means[i], covariances[i]))
    return worst


def test_equals_a_fifty_digit_filter():
    assert np.all(in_fifty_digits("14 states", 40) < 1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("14 states", 1500), ("16 states", 500), ("all at once", 400)])
def test_equals_a_fifty_digit_filter_for_long(name, count):
    assert np.all(in_fifty_digits(name, count) < 1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["14 states", "16 states", "fixed fading", "forward Euler"])
def test_a_simulation_with_a_chosen_series_equals_a_fifty_digit_filter(name):
    """The run's own volts and forces, filtered again; six nodes are the exact derivative."""
    device, readout, rate, options, extra = VARIANTS[name]
    options = {"discretisation": Exact(24, nodes=6)} | options
    observer = ExtendedKalmanFilter.for_device(device, readout, **options)
    loop = ClosedLoop(device, readout, observer, DampingCompensation(Tone(600.0, 53.95)))
    trace = simulate(loop, 1.0, sample_rate=rate, duration=60 / rate)
    points, weights = np.polynomial.legendre.leggauss(6)
    with mpmath.workdps(50):
        rule = tuple((mpmath.mpf((1.0 + p) / 2.0), mpmath.mpf(w / 2.0)) for p, w in zip(points, weights, strict=True))
        oracle = dense(observer, rate, mpmath.mpf, terms=28, gauss=rule, **extra)
        for i in range(60):
            z, u = ([mpmath.mpf(float(v)) for v in row[i]] for row in (trace.volts, trace.force))
            oracle.step(z, u, (i + 1) / rate)
            std = np.sqrt(np.diag(oracle.covariance).astype(float))
            mean = np.concatenate([trace.motion_estimate[i], trace.offset_estimate[i], trace.theta_estimate[i]])
            assert np.all(np.abs((mean - oracle.mean).astype(float)) <= 1e-7 * std)
            assert abs(trace.rate_std[i] / std[6 + device.model.index("rate")] - 1.0) < 1e-7


@pytest.mark.parametrize("with_offsets", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_equals_the_linear_filter_when_every_coefficient_is_known(with_offsets):
    """A filter for the motion and offsets alone is linear: the plain Kalman filter, in Joseph form."""
    walk = ProcessNoise((1e-18, 2e-18, 1e-8, 3e-8), (1e-6, 2e-6), (0.0,) * 8)
    known = {"known": SINGLE.model.names, "with_offsets": with_offsets}
    observer = ExtendedKalmanFilter.for_device(SINGLE, CIRCUIT, process_noise=walk, **known)
    volts, force = recorded(SINGLE, CIRCUIT, 100e3, 1500)
    states = observe(observer, volts, force, 1e-5)
    means, covariances = states_of(observer, states)
    a, b, _ = motion.single_mass(*(float(getattr(SINGLE, n)) for n in NAMES))
    step, push = motion.held(a, b, 1e-5)
    f, h = np.eye(6), np.hstack([np.diag(np.array(CIRCUIT.scale)), np.zeros((2, 2)), np.eye(2)])
    f[:4, :4] = step
    prior = observer.prior
    start, free = np.diag(np.array([*prior.motion_std, *prior.offset_std]) ** 2), 4 + 2 * with_offsets
    start[free:] = 0.0
    plain = kalman.LinearKalman(np.array([*prior.motion, *prior.offset]), start)
    q = np.diag(np.array([*walk.motion, *walk.offset])) * 1e-5
    q[free:] = 0.0
    r = np.diag(np.array(CIRCUIT.noise_density) ** 2) * 0.5e5
    for i in range(1500):
        plain.step(f, np.concatenate([push @ force[i], np.zeros(2)]), q, h, r, volts[i])
        std = np.sqrt(np.diag(plain.covariance))[:free]
        assert np.all(np.abs(means[i] - plain.mean[:free]) < 1e-8 * std)
        assert np.all(np.abs(covariances[i] - plain.covariance[:free, :free]) < 1e-8 * np.outer(std, std))
    assert observer.estimate(observer.init()).rate_variance is None
    assert observer.estimate(observer.init()).rate == 0.0


def test_nothing_known_exactly_changes_in_a_prior_without_spread():
    """Zero standard deviation means known: the coefficient never moves and its row of the covariance stays zero."""
    observer = ExtendedKalmanFilter.for_device(SINGLE, CIRCUIT)
    std = (*observer.prior.theta_std[:7], 0.0)
    prior = observer.prior
    prior = Prior(prior.motion, prior.motion_std, prior.offset, prior.offset_std, prior.theta, std)
    observer = ExtendedKalmanFilter.for_device(SINGLE, CIRCUIT, prior=prior)
    means, covariances = states_of(observer, observe(observer, *recorded(SINGLE, CIRCUIT, 100e3, 1500), 1e-5))
    assert np.all(means[:, 13] == 1.0 / 1.8e-7)
    assert np.all(covariances[:, 13] == 0.0)


def test_a_second_iteration_pulls_the_linearisation_towards_the_truth():
    """On one sample from a far prior, iterating comes nearer to the least-squares answer than linearising once."""
    prior = Prior(
        (1e-6, 0.0, 0.0, 0.0), (1e-9, 1e-9, 0.05, 0.05), (0.0, 0.0), (1e-6, 1e-6),
        SINGLE.coefficients(0.0), tuple(0.6 * abs(float(c)) + 1.0 for c in SINGLE.coefficients(0.0)),
    )  # fmt: skip
    volts, force, clock = (-0.09, 0.02), (3e-5, 2e-5), Clock(5e-5, 1, 5e-5)
    exact = Exact(24, 3)

    def loss(observer, state):
        """Negative log posterior of the end state, as a function of the start that leads there."""
        theta = state.constants[2:]
        dynamics = observer.model.assemble(tuple(theta))
        back = exact.transition(dynamics.stiffness, dynamics.velocity, clock.period)
        f, g = np.array(back.full), np.array(back.push)
        push = g @ np.array([float(dynamics.gain[0]) * force[0], float(dynamics.gain[1]) * force[1]])
        start = np.linalg.solve(f, np.array(state.motion) - push)
        means = np.array([*prior.motion, *prior.offset, *prior.theta])
        std = np.array([*prior.motion_std, *prior.offset_std, *prior.theta_std])
        apart = (np.concatenate([start, state.constants]) - means) / std
        seen = np.array(CIRCUIT.scale) * np.array(state.motion[:2]) + state.constants[:2]
        noise = np.array(CIRCUIT.noise_density) * np.sqrt(0.5 / clock.period)
        return float(np.sum(apart**2) + np.sum(((np.array(volts) - seen) / noise) ** 2))

    losses = []
    for iterations in (1, 2, 3):
        observer = ExtendedKalmanFilter.for_device(
            SINGLE, CIRCUIT, prior=prior, iterations=iterations, discretisation=exact
        )
        losses.append(loss(observer, observer.update(observer.init(), volts, force, clock)))
    assert losses[2] < losses[1] < losses[0]


def test_estimate_and_error_name_the_right_entries():
    observer = ExtendedKalmanFilter.for_device(DUAL, CIRCUIT, known=("kxy",))
    state = observer.init()
    estimate = observer.estimate(state)
    assert [float(t) for t in estimate.theta] == pytest.approx([float(c) for c in DUAL.coefficients(0.0)], rel=1e-15)
    assert estimate.rate_variance == pytest.approx(9.0)
    assert estimate.rate == estimate.theta[1]
    truth = tuple(float(c) + 1.0 for c in DUAL.coefficients(0.0))
    error = observer.error(state, (0.0, 0.0, 0.0, 0.0), (0.25, 0.5), truth)
    assert np.allclose(error, [1e-6, 0, 0, 0, -0.25, -0.5, *[-1.0] * 9], atol=1e-12)
    assert observer.covariance(state).shape == (15, 15)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"known": ("mass",)}, "must be one of rate, kxx, kyy, kxy, dxx, dyy, dxy, sigma, but `mass`"),
        ({"iterations": 0}, "`iterations` must be at least 1, but 0"),
    ],
)
def test_bad_settings_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        ExtendedKalmanFilter.for_device(SINGLE, CIRCUIT, **options)


def test_process_noise_is_named_after_coefficients():
    noise = ProcessNoise.of(SINGLE.model, rate=4.0, dyy=2.0)
    assert [float(v) for v in noise.theta] == [4.0, 0, 0, 0, 0, 2.0, 0, 0]
    assert {float(v) for v in (*noise.motion, *noise.offset)} == {0.0}
    with pytest.raises(InputError, match="but `omega` was given"):
        ProcessNoise.of(SINGLE.model, omega=1.0)


def test_a_filter_is_told_of_the_converter():
    """What is told of a 12-bit converter whose rounding is 1.6 times the noise: without, it was sure of 1 + 1.6² times
    as much, an NIS of 7.0 of 2, and every die of a lot "did not bear being linearised".
    """
    step = 1.6 * np.sqrt(12.0) * 1e-6 * np.sqrt(0.5 * 100e3)
    gyro = mg.SingleMassGyro.chi2010()
    readout = mg.DirectReadout(1e5, noise_density=1e-6, adc=mg.Adc(step * 2**11, 12))
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    loop = mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))
    lot = mg.sweep(loop, mg.Spread.relative(0.02), 1.0, dies=32, duration=0.02, bound_dies=0)
    assert lot.summary.nis == pytest.approx(2.0, abs=0.1)
