"""The information bound against an independent dense computation, finite differences and the filter's own error."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DualMassGyro, Inertial, SingleMassGyro
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.bound import CROSS_DAMPING_ASYMMETRY, compile_bound, information_bound
from memsgyro_jax.loop.controllers import DampingCompensation, OpenLoop, Tone
from memsgyro_jax.loop.engine import AbstractRecorder, run
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import ExtendedKalmanFilter
from memsgyro_jax.loop.observers.settings import Annealing
from memsgyro_jax.loop.readout import ChargeAmplifier, DirectReadout
from memsgyro_jax.loop.scenario import Constant, Ramp, Scenario, as_scenario


SINGLE, DUAL = SingleMassGyro.chi2010(), DualMassGyro.chi2010()
DRIVE = (Tone(2900.0, 1e-7), Tone(3600.0, 2e-7))


def closed(gyro=SINGLE, readout=None) -> ClosedLoop:
    readout = ChargeAmplifier.chi2010() if readout is None else readout
    observer = ExtendedKalmanFilter.for_device(gyro, readout, annealing=Annealing())
    return ClosedLoop(gyro, readout, observer, DampingCompensation(tones=Tone(600.0, 53.95)))


def forced(gyro=SINGLE) -> ClosedLoop:
    """Commands that ignore the estimate, so that an oracle knows them without the loop."""
    loop = closed(gyro)
    return ClosedLoop(gyro, loop.readout, loop.observer, OpenLoop(tones=DRIVE))


def record(theta: np.ndarray, start: np.ndarray, gyro, sample_rate: float, samples: int) -> np.ndarray:
    """Displacements (samples, 2) by SciPy's matrix exponential, from coefficients of `gyro.model` by their meaning."""
    if gyro is SINGLE:
        rate, kxx, kyy, kxy, dxx, dyy, dxy, sigma = theta
        stiffness, damping = [[kxx, kxy], [kxy, kyy]], [[dxx, dxy - 2 * rate], [dxy + 2 * rate, dyy]]
        gain = (sigma, sigma)
    else:
        rate_x, rate, kxx, kyy, kxy, kyx, dxx, dyy, *gain = theta
        stiffness, damping = [[kxx, kxy], [kyx, kyy]], [[dxx, -2 * rate_x], [2 * rate, dyy]]
    h, matrix = 1.0 / sample_rate, np.zeros((6, 6))
    matrix[:2, 2:4], matrix[2:4, :2], matrix[2:4, 2:4] = np.eye(2), -np.asarray(stiffness), -np.asarray(damping)
    matrix[2:4, 4:] = np.diag(gain)
    step = scipy.linalg.expm(h * matrix)
    middle = (np.arange(samples) + 0.5) * h
    pushes = [float(tone.amplitude) * np.sin(2 * np.pi * float(tone.frequency) * middle) for tone in DRIVE]
    state, seen = np.asarray(start), []
    for push in np.transpose(pushes):
        state = step[:4, :4] @ state + step[:4, 4:] @ push
        seen.append(state[:2])
    return np.asarray(seen)


def shaken(temperature: float, sample_rate: float, samples: int) -> np.ndarray:
    """Covariance of all displacements of SINGLE, (x, y) by sample, that its Brownian force makes (Van Loan, 1978)."""
    a, q = np.zeros((4, 4)), np.zeros((4, 4))
    mass, rate = float(SINGLE.mass), 1.0
    damping = np.array([[SINGLE.dxx, SINGLE.dxy], [SINGLE.dxy, SINGLE.dyy]], float)
    a[:2, 2:], a[2:, :2] = np.eye(2), -np.array([[SINGLE.kxx, SINGLE.kxy], [SINGLE.kxy, SINGLE.kyy]], float) / mass
    a[2:, 2:] = -damping / mass - 2.0 * rate * np.array([[0.0, -1.0], [1.0, 0.0]])
    q[2:, 2:] = 2.0 * 1.380649e-23 * temperature * damping / mass**2
    both = scipy.linalg.expm(np.block([[-a, q], [np.zeros((4, 4)), a.T]]) / sample_rate)
    step = both[4:, 4:].T
    added, covariance, found = step @ both[:4, 4:], np.zeros((4, 4)), np.zeros((samples, 2, samples, 2))
    for i in range(samples):
        covariance = step @ covariance @ step.T + added
        ahead = covariance
        for j in range(i, samples):
            found[j, :, i], found[i, :, j] = ahead[:2, :2], ahead[:2, :2].T
            ahead = step @ ahead
    return found.reshape(2 * samples, 2 * samples)


def dense_bound(
    gyro, sample_rate: float, samples: int, prior_std: np.ndarray | None = None, temperature: float = 0.0
) -> np.ndarray:
    """Bound by central differences of `record` and a plain scaled inverse."""
    theta, start = np.asarray([float(t) for t in gyro.coefficients(1.0)]), np.asarray([1e-6, 0.0, 0.0, 0.0])
    names, readout = gyro.model.names, ChargeAmplifier.chi2010()
    size = [1e-6, 1e-6, 2e-2, 2e-2, 1e-3, 1e-3]
    size += [1.0 if n.startswith("rate") else {"k": 4e8, "d": 2e4, "s": 5e6}[n[0]] for n in names]
    columns = []
    for i, unit in enumerate(size):
        moved = np.zeros(len(size))
        moved[i] = 3e-5 * unit
        pair = [
            record(theta + s * moved[6:], start + s * moved[:4], gyro, sample_rate, samples) * float(readout.scale[0])
            + s * moved[4:6]
            for s in (1.0, -1.0)
        ]
        columns.append((pair[0] - pair[1]).ravel() / 6e-5)
    sensitivity = np.asarray(columns).T / (1e-3 * np.sqrt(sample_rate / 10e6))
    information = sensitivity.T @ sensitivity
    if temperature:
        volts = float(readout.scale[0]) / (1e-3 * np.sqrt(sample_rate / 10e6))
        noise_covariance = np.eye(2 * samples) + volts**2 * shaken(temperature, sample_rate, samples)
        information = sensitivity.T @ np.linalg.solve(noise_covariance, sensitivity)
    if prior_std is not None:
        information += np.diag((np.asarray(size) / prior_std) ** 2)
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(size) * scale * np.sqrt(np.diag(np.linalg.inv(scale[:, None] * information * scale)))


def test_what_was_compiled_beside_a_sweep_is_not_compiled_again(caplog):
    loop, asked = closed(), {"sample_rate": 50e3, "duration": 1.2e-3, "prior": None, "known": (), "windows": 1}
    of_bound = lambda: [told.message for told in caplog.records if "XLA compilation of jit(_roots)" in told.message]  # noqa: E731
    with jax.log_compiles():
        compile_bound(loop, as_scenario(1.0), design=loop, **asked)
        assert len(of_bound()) == 1
        information_bound(loop, 1.0, design=loop, **asked)
    assert len(of_bound()) == 1


@pytest.mark.parametrize("gyro", [SINGLE, pytest.param(DUAL, marks=pytest.mark.slow)], ids=["single", "dual"])
def test_cramer_rao_is_that_of_an_independent_computation(gyro):
    got = information_bound(forced(gyro), 1.0, sample_rate=100e3, duration=0.004, windows=2)
    np.testing.assert_allclose(got.std[-1], dense_bound(gyro, 100e3, 400), rtol=2e-4)
    np.testing.assert_allclose(got.std[0], dense_bound(gyro, 100e3, 200), rtol=2e-4)
    assert got.time[-1] == pytest.approx(0.004)


def test_bayesian_bound_adds_the_prior():
    loop = forced()
    prior = loop.observer.prior
    std = np.asarray([float(v) for v in (*prior.motion_std, *prior.offset_std, *prior.theta_std)])
    # a program compiled above
    got = information_bound(loop, 1.0, sample_rate=100e3, duration=0.004, prior=prior, windows=2)
    np.testing.assert_allclose(got.std[-1], dense_bound(SINGLE, 100e3, 400, std), rtol=2e-4)
    assert np.all(got.std <= std * (1 + 1e-12))
    assert np.all(np.diff(got.std, axis=0) <= 1e-12 * got.std[:-1])


@pytest.mark.slow
def test_a_brownian_force_hides_what_it_shakes():
    """By generalised least squares over the covariance of all samples, at a temperature that counts."""
    hot, settings = 3e8, {"sample_rate": 50e3, "duration": 0.004, "windows": 2}
    loop = forced(SINGLE.at_temperature(hot))
    prior = loop.observer.prior
    std = np.asarray([float(v) for v in (*prior.motion_std, *prior.offset_std, *prior.theta_std)])
    got = information_bound(loop, 1.0, prior=prior, **settings)
    np.testing.assert_allclose(got.std[-1], dense_bound(SINGLE, 50e3, 200, std, hot), rtol=2e-4)
    cold = dense_bound(SINGLE, 50e3, 200, std)
    assert got.rate_std[-1] > 1.5 * cold[got.names.index("rate")]


@pytest.mark.slow
def test_at_zero_kelvin_the_bound_is_that_of_no_brownian_force():
    loop, settings = forced(SINGLE.at_temperature(0.0)), {"sample_rate": 50e3, "duration": 0.004, "windows": 2}
    prior = loop.observer.prior
    std = np.asarray([float(v) for v in (*prior.motion_std, *prior.offset_std, *prior.theta_std)])
    cold = information_bound(loop, 1.0, prior=prior, **settings)
    np.testing.assert_allclose(cold.std[-1], dense_bound(SINGLE, 50e3, 200, std), rtol=2e-4)


@pytest.mark.slow
def test_sensitivities_are_those_of_the_closed_loop_plant():
    """With commands held from a recorded run: the plant stepped with a changed device gives the same derivative."""
    loop, rate, samples = closed().sampled_at(100e3), 1.0, 100
    silent = eqx.tree_at(lambda made: made.readout.noise_density, loop, (jnp.zeros(()), jnp.zeros(())))

    class Force(AbstractRecorder):
        def init(self):
            return (jnp.zeros(()),) * 2

        def sample(self, memory, sample):
            return sample.force

        def block(self, memory):
            return memory, memory

    words = noise.die_words(jax.random.key(0), jnp.asarray(0))
    forces = np.stack(run(silent, as_scenario(rate), words, 1e-5, samples, 1, Force()).outputs, axis=-1)

    @jax.jit
    def volts(theta):
        dynamics = SINGLE.model.assemble(tuple(theta))

        def step(state, force):
            push = tuple(g * f for g, f in zip(dynamics.gain, force, strict=True))
            state = silent.discretisation.advance(state, push, dynamics.stiffness, dynamics.velocity, 1e-5)
            return state, jnp.stack([s * q for s, q in zip(silent.readout.scale, state[:2], strict=True)])

        return jax.lax.scan(step, silent.start, forces)[1]

    theta = np.asarray([float(t) for t in SINGLE.coefficients(rate)])
    change = np.where(theta == 1.0, 1e-2, 1e-4 * theta)
    columns = []
    for i in range(8):
        moved = change * (np.arange(8) == i)
        columns.append((volts(theta + moved) - volts(theta - moved)).ravel() / (2.0 * change[i]) / 1e-4)
    known = ("x", "y", "vx", "vy", "offset_x", "offset_y")
    got = information_bound(closed(), rate, sample_rate=100e3, duration=1e-3, known=known)
    scale = np.linalg.norm(columns, axis=1)
    root = np.asarray(columns).T / scale
    want = np.sqrt(np.diag(np.linalg.inv(root.T @ root))) / scale
    np.testing.assert_allclose(got.std[-1], want, rtol=1e-4)


def test_thesis_start_is_bounded_by_6_45_dps():
    got = information_bound(closed(), 1.0)
    assert np.degrees(got.rate_std[-1]) == pytest.approx(6.45, abs=0.02)
    assert np.all(np.isfinite(got.std[-1]))
    assert not got.degenerate


@pytest.mark.slow
def test_unequal_cross_damping_cannot_be_told_from_a_rate():
    got = information_bound(closed(), 1.0, also=(CROSS_DAMPING_ASYMMETRY,), duration=0.02)
    plain = information_bound(closed(), 1.0, duration=0.02)
    (direction,) = got.degenerate
    assert set(direction) == {"rate", "cross_damping_asymmetry"}
    assert direction["cross_damping_asymmetry"] / direction["rate"] == pytest.approx(-4.0, rel=1e-6)
    infinite = [name for name, std in zip(got.names, got.std[-1], strict=True) if np.isinf(std)]
    assert infinite == ["rate", "cross_damping_asymmetry"]
    assert "cannot be told apart: rate +1 rad/s, cross_damping_asymmetry -4 1/s" in str(got)
    rest = [i for i, name in enumerate(plain.names) if name != "rate"]
    np.testing.assert_allclose(got.std[-1][rest], plain.std[-1][rest], rtol=1e-6)


def test_a_resting_device_says_nothing_of_its_dynamics():
    still = eqx.tree_at(lambda loop: loop.start, forced(), tuple(0.0 * part for part in forced().start))
    still = eqx.tree_at(lambda loop: loop.controller, still, OpenLoop(tones=(Tone(2900.0, 0.0), Tone(3600.0, 0.0))))
    got = information_bound(still, 1.0, sample_rate=100e3, duration=0.004, windows=2)  # a program compiled above
    infinite = [name for name, std in zip(got.names, got.std[-1], strict=True) if np.isinf(std)]
    assert infinite == list(SINGLE.model.names)


@pytest.mark.parametrize("known", [("sigma", "kxx", "offset_x"), pytest.param(("sigma",), marks=pytest.mark.slow)])
def test_what_is_known_helps_or_is_neutral(known):
    plain = information_bound(closed(), 1.0)  # a program compiled above
    got = information_bound(closed(), 1.0, known=known)
    assert not set(known) & set(got.names)
    for name in got.names:
        assert got.of(name)[-1] <= plain.of(name)[-1] * (1 + 1e-9)


@pytest.mark.slow
def test_a_batch_is_its_dies_one_by_one():
    loop = closed()
    mass = 1.8e-7 * jnp.asarray([0.9, 1.0, 1.2])
    rates = jnp.asarray([-1.0, 0.0, 2.0])
    batch = eqx.tree_at(lambda made: made.device.mass, loop, mass)
    settings = {"sample_rate": 50e3, "duration": 0.01, "prior": loop.observer.prior, "windows": 4}
    got = information_bound(batch, Ramp(0.0, 5.0, rates), design=loop, **settings)
    assert got.std.shape == (4, 14, 3)
    assert got.to_xarray().sizes == {"time": 4, "quantity": 14, "quantity_": 14, "die": 3}
    for die in range(3):
        one = eqx.tree_at(lambda made: made.device.mass, loop, mass[die])
        want = information_bound(one, Ramp(0.0, 5.0, rates[die]), design=loop, **settings)
        np.testing.assert_allclose(got.std[..., die], want.std, rtol=1e-6)


def test_a_lost_die_holds_nan_and_the_others_do_not():
    loop = closed()
    # A feedback gain of the wrong scale: the die is driven to infinity within the run.
    batch = eqx.tree_at(lambda made: made.device.dxx, loop, jnp.asarray([3.6e-6, -3.6e-1]))
    got = information_bound(batch, 1.0, duration=0.05, design=loop, windows=2)
    assert np.all(np.isfinite(got.std[-1, :, 0]))
    assert np.all(np.isnan(got.std[-1, :, 1]))


def test_a_mass_out_of_its_travel_has_no_bound_from_then_on():
    """It left its travel, linear and finite: the trace said "lost", the bound 0.21 deg/s."""
    loop, settings = forced(), {"sample_rate": 100e3, "duration": 401e-5}  # a prime number of samples: blocks of one
    loop = dataclasses.replace(loop, start=(0.0, 0.0, 0.05, 0.0))
    whole = information_bound(loop, 1.0, **settings)
    bound = information_bound(dataclasses.replace(loop, travel=2e-6), 1.0, **settings)
    known = np.isfinite(bound.rate_std)
    assert not known[-1]
    assert np.isfinite(whole.rate_std[-1])
    assert np.isnan(bound.covariance).all()
    np.testing.assert_array_equal(bound.rate_std[known], whole.rate_std[known])
    assert "lost by then" in str(bound)


@pytest.mark.slow
def test_velocity_readout_is_bounded_too():
    readout = DirectReadout.of_velocity(1.0, 1e-9)
    got = information_bound(closed(readout=readout), 1.0, duration=0.02)
    assert np.all(np.isfinite(got.std[-1]))


def test_variance_follows_covariance():
    got = information_bound(closed(), 1.0)
    np.testing.assert_allclose(np.sqrt(np.diag(got.covariance)), got.std[-1], rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"known": ("mass",)}, "`known` must name some of x, y, .*sigma, but holds `mass`"),
        ({"duration": 1e-6}, "at least one sample and window, but 0 and 50"),
        ({"windows": 0}, "at least one sample and window"),
    ],
)
def test_bad_arguments_are_refused(arguments, says):
    with pytest.raises(InputError, match=says):
        information_bound(closed(), 1.0, **arguments)


@pytest.mark.parametrize("name", ["sample_rate", "duration"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_impossible_times_are_refused(name, value):
    with pytest.raises(InputError, match=f"`{name}` must be positive and finite"):
        information_bound(closed(), 1.0, **{name: value})


def test_a_noise_free_readout_has_no_bound():
    silent = ChargeAmplifier.chi2010(noise_density=(0.0, 1e-9))
    loop = dataclasses.replace(closed(), readout=silent)
    with pytest.raises(InputError, match="must have noise on both axes"):
        information_bound(loop, 1.0)


def test_an_unknown_quantity_is_refused():
    with pytest.raises(InputError, match=r"one of x, y, .* but `Q` was given"):
        information_bound(closed(), 1.0).of("Q")  # a program compiled above


class _Nothing(AbstractRecorder):
    def init(self):
        return ()

    def sample(self, memory, sample):
        return memory

    def block(self, memory):
        return memory, memory


@pytest.mark.slow
@pytest.mark.parametrize("sample_rate", [50e3, 100e3, 200e3])
def test_the_filter_reaches_the_bayesian_bound(sample_rate):
    """512 dies drawn from the filter's own prior: rms rate error over the bound, root-mean-square over dies."""
    loop, dies = closed().sampled_at(sample_rate), 512
    prior = loop.observer.prior
    draw = iter(np.random.default_rng(5).standard_normal((16, dies)))
    start = tuple(m + s * jnp.asarray(next(draw)) for m, s in zip(prior.motion, prior.motion_std, strict=True))
    theta = [t + s * jnp.asarray(next(draw)) for t, s in zip(prior.theta, prior.theta_std, strict=True)]
    rate, (kxx, kyy, kxy, dxx, dyy, dxy, sigma) = theta[0], theta[1:]
    mass = 1.0 / sigma
    device = SingleMassGyro(mass, *(mass * value for value in (kxx, kyy, kxy, dxx, dyy, dxy)))
    batch = eqx.tree_at(lambda made: (made.device, made.start), loop, (device, start))
    words = noise.die_words(jax.random.key(1), jnp.arange(dies))
    rates, block = Scenario(rate=Constant(rate)), int(1e-3 * sample_rate)
    go = eqx.filter_jit(lambda b: run(b, rates, words, 1 / sample_rate, 100, block, _Nothing(), loop))
    end = go(batch)
    assert bool(end.alive.all())
    error = np.asarray(loop.observer.estimate(end.state.observer).rate) - np.asarray(rate)
    bound = information_bound(batch, rates, sample_rate=sample_rate, prior=prior, design=loop, windows=1).rate_std[-1]
    square = error**2 / np.mean(bound**2)
    assert np.sqrt(np.mean(square)) == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean((error / bound) ** 2) - 1.0) < 4.0 * np.sqrt(2.0 / dies)


@pytest.mark.slow
def test_inertial_terms_do_not_disturb_the_bound():
    """The frame's Ω² terms are 1e-9 of the stiffness: the bound is that of the simplified device."""
    full = SingleMassGyro(1.8e-7, 63.96, 95.92, 12.78, 3.6e-6, 4.5e-6, 3.6e-7, rotating_frame=True)
    assert full.dynamics(Inertial(rate=1.0)).stiffness != SINGLE.dynamics(Inertial(rate=1.0)).stiffness
    got = information_bound(closed(full), 1.0, duration=0.02)
    np.testing.assert_allclose(got.std[-1], information_bound(closed(), 1.0, duration=0.02).std[-1], rtol=1e-4)
